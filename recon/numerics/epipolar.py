"""Motion between two views of a calibrated camera: rotation, direction of travel, and how well both are known.

A point is seen along a = (x, y, 1) in the first view and along b in the second, both in the axes of the camera. With
R = R_ab, which takes axes of the second view to those of the first, and the direction d in which the camera moved,
axes of the first, the two rays and d lie in one plane:

    e = a . (d x R b) = 0,      residual  r = e / sqrt(|de/d(x, y)_a|^2 + |de/d(x, y)_b|^2)

r is the distance to the nearest pair of points that fits, to first order (Sampson). Minimised over three angles and the
two of d by Gauss-Newton with Cauchy's weights; the size of the noise is taken from the residuals themselves.

References
    Hartley, Zisserman (2004), "Multiple view geometry in computer vision", 2nd ed., sections 9.6 and 11.4.3 (Sampson).
    Longuet-Higgins (1981), Nature 293, 133-135.
    Huber (1981), "Robust statistics", section 7.6 (covariance of robust estimates).
    Holland, Welsch (1977), Communications in Statistics A6(9) (Cauchy's weights).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from recon.numerics.rotation import Floats, cross_matrix, from_rotvec, to_matrix

_ROUNDS: Final = 15
_CAUCHY: Final = 2.385
"""Sigmas at which a residual weighs half; 95 % as efficient as least squares on normal noise."""
_MAD: Final = 1.4826
"""Sigma of normal noise by its median absolute value."""
_TELLS: Final = 3.0
"""Sigmas that a point must have moved beyond the rotation to tell of the direction: else its own noise would."""
_UNKNOWN: Final = np.diag([0.0, 0.0, 0.0, 1.0, 1.0])
"""Information beforehand: a sigma of one radian of the direction, which is nothing."""
_LEAST_CURVED: Final = 0.1
"""Of one: the mean second derivative of what is minimised, which is below where most pairs are wrong."""
_DONE: Final = 1e-6
"""rad, of a step."""


class TwoViews(NamedTuple):
    """What two views tell of the motion between them.

    rot_ab : (3, 3), axes of the second view to those of the first; direction_a : (3,) unit vector, axes of the first
    covariance : (5, 5) rad^2, of the turn about the axes of the second view, and of two axes across the direction
    residual : (n,) of the pairs, on the plane at distance 1; noise : its sigma
    """

    rot_ab: Floats
    direction_a: Floats
    covariance: Floats
    residual: Floats
    noise: float

    @property
    def rotation_std(self) -> float:
        """About the axis that is known least, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[:3, :3])[-1]))

    @property
    def direction_std(self) -> float:
        """The way across that is known least, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:, 3:])[-1]))


def two_views(a: Floats, b: Floats, rot_ab: Floats, direction_a: Floats, least_noise: float) -> TwoViews:
    """The motion that fits pairs of rays best, from one near it.

    a, b : (n, 3) rays of the same points in both views, third component 1; n > 5
    rot_ab, direction_a : (3, 3), (3,), to begin with; least_noise : the sigma of the residuals is not below it
    """
    for _ in range(_ROUNDS):
        residual, slope = _linearised(a, b, rot_ab, direction_a)
        noise = max(_MAD * float(np.median(np.abs(residual))), least_noise)
        slope[:, 3:] *= (parallax(a, b, rot_ab) > _TELLS * noise)[:, None]
        weight = 1.0 / (1.0 + (residual / (_CAUCHY * noise)) ** 2)
        weighted = slope * weight[:, None]
        normal = weighted.T @ slope / noise**2 + _UNKNOWN
        step = np.asarray(-np.linalg.solve(normal, weighted.T @ residual / noise**2))
        rot_ab, direction_a = _moved(rot_ab, direction_a, step)
        if np.abs(step).max() < _DONE:
            break
    residual = sampson(a, b, rot_ab, direction_a)
    return TwoViews(rot_ab, direction_a, _covariance(residual / noise, slope / noise), residual, noise)


def _covariance(residual: Floats, slope: Floats) -> Floats:
    """Of the estimate, by the tails that the residuals have: Huber 1981, section 7.6. (5, 5)

    residual : (n,), slope : (n, 5), both by the noise
    """
    far, count = (residual / _CAUCHY) ** 2, len(residual)
    curved = max(float(((1.0 - far) / (1.0 + far) ** 2).mean()), _LEAST_CURVED)
    scores = float(((residual / (1.0 + far)) ** 2).sum()) / (count - 5)
    return np.asarray(np.linalg.inv(slope.T @ slope * (curved**2 / scores) + _UNKNOWN))


def parallax(a: Floats, b: Floats, rot_ab: Floats) -> Floats:
    """How far points moved beyond what the rotation explains: (n,), on the plane at distance 1 of the first view.

    a, b : (n, 3) as in `two_views`
    """
    turned = b @ rot_ab.T
    return np.asarray(np.hypot(*(turned[:, :2] / turned[:, 2:] - a[:, :2]).T))


def forward(a: Floats, b: Floats, rot_ab: Floats, direction_a: Floats) -> Floats:
    """The direction of travel or its opposite: the one that sees the points in front of the camera.

    A point at distance s a lies at s a = d + t R b, hence s |a x R b|^2 = (d x R b) . (a x R b).
    """
    turned = b @ rot_ab.T
    ahead = (np.cross(direction_a, turned) * np.cross(a, turned)).sum()
    return direction_a if ahead > 0.0 else -direction_a


def across(direction: Floats) -> Floats:
    """Two unit vectors across a unit vector (3,), as columns: (3, 2)."""
    return np.asarray(np.linalg.svd(direction[None])[2][1:].T)


def _linearised(a: Floats, b: Floats, rot_ab: Floats, direction_a: Floats) -> tuple[Floats, Floats]:
    """Residuals (n,) and their derivatives (n, 5): those of the denominators, too.

    Without them the result leans to where denominators are large, by more than its sigma once the noise is a third of
    a pixel and the camera moves ahead.
    """
    essential = cross_matrix(direction_a) @ rot_ab
    changes = np.concatenate([essential @ cross_matrix(np.eye(3)), cross_matrix(across(direction_a).T) @ rot_ab])
    error, size, line_a, line_b = _lines(a, b, essential)
    by_a, by_b = b @ changes.swapaxes(1, 2), a @ changes  # (5, n, 3)
    longer = (line_a[:, :2] * by_a[..., :2]).sum(axis=2) + (line_b[:, :2] * by_b[..., :2]).sum(axis=2)
    slope = ((a * by_a).sum(axis=2) - error / size**2 * longer) / size
    return error / size, slope.T


def _moved(rot_ab: Floats, direction_a: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Rotation and direction after a step: (5,) rad, as in `TwoViews.covariance`."""
    moved = direction_a + across(direction_a) @ step[3:]
    return rot_ab @ to_matrix(from_rotvec(step[:3])), np.asarray(moved / np.linalg.norm(moved))


def sampson(a: Floats, b: Floats, rot_ab: Floats, direction_a: Floats) -> Floats:
    """Distances of pairs of rays from those that fit a motion, with their signs: (n,), arguments as in `two_views`."""
    error, size, _, _ = _lines(a, b, cross_matrix(direction_a) @ rot_ab)
    return error / size


def _lines(a: Floats, b: Floats, essential: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Errors and the sizes of their gradients (n,), epipolar lines in the first and the second view (n, 3)."""
    line_a, line_b = b @ essential.T, a @ essential
    size = np.sqrt((line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1))
    return (a * line_a).sum(axis=1), np.maximum(size, np.finfo(float).tiny), line_a, line_b
