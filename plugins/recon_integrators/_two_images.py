"""Corners followed from one image to the next, and the motion of the camera on which most of them agree."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon import Array
from recon.numerics.epipolar import TwoViews, forward, parallax, sampson, two_views
from recon_integrators._pictures import Grey

Agree = NDArray[np.bool_]

_BACK_PX: Final = 0.5
"""Corners come back to where they were within this."""
_AGREES_PX: Final = 0.5
"""Distance from its line within which a corner agrees with a motion."""
_NOISE_PX: Final = 0.05
"""No tracker is better."""
_STANDS_PX: Final = 0.5
"""Median motion of corners beyond the rotation that tells a direction."""
_ROUNDS: Final = 2
"""Of asking which corners agree."""
_LEAST: Final = 40
"""Corners that agree."""
_SHARE: Final = 0.5
"""Of the corners that were followed, that agree."""
_CLEAR: Final = 3e-3
"""Least eigenvalue of a corner in OpenCV's units, gradients of 1.8 grey levels a pixel: noise in the dark has less."""
_WINDOW, _LEVELS, _CLOSEST_PX = (11, 11), 3, 10.0
"""Of the tracker: pixels, halvings; distance between corners.

Coming nearer, the road grows, at the lower edge of a window more than at the upper one, which looks like a slow climb:
by 0.37 deg in windows of 21 pixels, 0.26 of 15, 0.20 of 11. In smaller ones the noise grows.
"""


def followed(before: Grey, image: Grey, most: int) -> tuple[Array, Array]:
    """Corners in two images: (n, 2) px each, those that are found in the second and back again.

    before, image : (h, w)
    """
    import cv2

    first = cv2.goodFeaturesToTrack(before, most, 0.01, _CLOSEST_PX)
    if first is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    options = {"winSize": _WINDOW, "maxLevel": _LEVELS, "minEigThreshold": _CLEAR}
    last, there, _ = cv2.calcOpticalFlowPyrLK(before, image, first, None, **options)  # type: ignore[call-overload]
    again, back, _ = cv2.calcOpticalFlowPyrLK(image, before, last, None, **options)  # type: ignore[call-overload]
    apart = np.linalg.norm((again - first).reshape(-1, 2), axis=1)
    kept = (there.ravel() == 1) & (back.ravel() == 1) & (apart < _BACK_PX)
    return first.reshape(-1, 2)[kept].astype(np.float64), last.reshape(-1, 2)[kept].astype(np.float64)


def rays(
    corners: Array, focal: tuple[float, float], centre: tuple[float, float], distortion: tuple[float, ...]
) -> Array:
    """Rays (n, 3) in the axes of an image, third component 1, of corners (n, 2) px; the lens as OpenCV describes it."""
    import cv2

    if not len(corners):
        return np.zeros((0, 3))
    (fx, fy), (cx, cy) = focal, centre
    camera = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    plane = cv2.undistortPoints(corners[:, None], camera, np.array(distortion or (0.0,) * 4))
    return np.hstack([plane[:, 0], np.ones((len(corners), 1))])


def motion(a: Array, b: Array, pixel: float) -> tuple[TwoViews, int, bool] | None:
    """What rays of the same points in two images tell: the motion, how many agree, does it move; else None.

    a, b : (n, 3), third component 1; pixel : its size on the plane at distance 1
    """
    import cv2

    if len(a) < _LEAST:
        return None
    essential, mask = cv2.findEssentialMat(
        a[:, :2], b[:, :2], np.eye(3), method=cv2.RANSAC, prob=0.999, threshold=_AGREES_PX * pixel
    )
    if essential is None or len(essential) < 3 or mask.sum() < _LEAST:
        return None
    one, other, way = cv2.decomposeEssentialMat(essential[:3])
    rot_ab = np.asarray(max(one, other, key=np.trace).T, dtype=np.float64)
    views, agree = _refined(a, b, rot_ab, np.asarray(rot_ab @ way[:, 0]), mask.ravel() == 1, pixel)
    if agree.sum() < max(_LEAST, _SHARE * len(a)):
        return None
    a, b = a[agree], b[agree]
    moves = float(np.median(parallax(a, b, views.rot_ab))) > _STANDS_PX * pixel
    ahead = forward(a, b, views.rot_ab, views.direction_a)
    return views._replace(direction_a=ahead), int(agree.sum()), moves


def _refined(a: Array, b: Array, rot_ab: Array, way: Array, agree: Agree, pixel: float) -> tuple[TwoViews, Agree]:
    """The motion by all rays that agree with it, which may be others than RANSAC found: they are asked again."""
    for _ in range(_ROUNDS):
        views = two_views(a[agree], b[agree], rot_ab, way, _NOISE_PX * pixel)
        rot_ab, way = views.rot_ab, views.direction_a
        agree = np.abs(sampson(a, b, rot_ab, way)) < _AGREES_PX * pixel
        if agree.sum() < _LEAST:
            break
    return views, agree
