"""How a camera turned and in which direction it moved from image to image.

Corners (Shi, Tomasi) of an image are followed to the next one by pyramidal Lucas-Kanade, and back: those that do not
come back to where they were are dropped. The essential matrix of the rest by five points and RANSAC tells what moves
with the world and what does not; of its four poses the one with the small turn and the points ahead is taken. All that
agrees then refines it: the Sampson distances are minimised over rotation and direction (recon.numerics.epipolar).

Sigmas come from the corners that agree: the size of their residuals by the median, and the inverse of the normal
equations, whose root mean squares over the three axes and the two ways across are given. An image pair gives nothing
where fewer than `_LEAST` corners agree or they are the smaller part, and no direction where most of them hardly move
beyond what the rotation explains: that is what standing is, even beside a lorry that pulls away.

How far it moved one camera cannot tell: fuser.map takes the scale from GNSS and wheels. The way is that of the camera,
given in the axes of the box that it is fixed to.

References
    Shi, Tomasi (1994), "Good features to track", CVPR, 593-600.
    Bouguet (2000), "Pyramidal implementation of the Lucas Kanade feature tracker", Intel.
    Kalal, Mikolajczyk, Matas (2010), "Forward-backward error", ICPR, 2756-2759.
    Nister (2004), "An efficient solution to the five-point relative pose problem", IEEE T-PAMI 26(6), 756-770.
    Scaramuzza, Fraundorfer (2011), "Visual odometry", IEEE Robotics and Automation Magazine 18(4), 80-92.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import field_validator

from recon import (
    FRAMES,
    VISUAL,
    Array,
    Integrator,
    Metric,
    Params,
    Streams,
    build,
    hookimpl,
    meta,
    metrics,
    quantity,
    setting,
    time_ns,
    vector,
    warning,
    with_meta,
)
from recon.errors import DataError
from recon.extras import needs
from recon.numerics.epipolar import TwoViews
from recon.numerics.rotation import from_euler, from_matrix, to_matrix
from recon_integrators._pictures import Grey, pictures
from recon_integrators._two_images import followed, motion, rays

Times = NDArray[np.int64]

_OPTICAL: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of an image (right, down, ahead) to ahead, left, up."""
_EARLY: Final = 0.9
"""Share of the interval after which an image is far enough from the one before: cameras jitter."""
_LONGEST_S: Final = 1.0
"""Images further apart are not compared."""


class VisualOdometryParams(Params):
    """The camera, and which images are compared."""

    folder: str = setting(doc="Folder that the files of the stream frames are in: images, or their video.")
    focal: tuple[float, float] = setting(doc="Focal length in pixels, across and down: fx, fy of a calibration.")
    centre: tuple[float, float] = setting(doc="Principal point in pixels, from the left and the top: cx, cy.")
    mounting: tuple[float, float, float] = quantity(
        ..., "deg", doc="Roll, pitch, yaw of the camera in the axes of imu; all 0 deg looks along x with z up."
    )
    distortion: tuple[float, ...] = setting((), doc="k1, k2, p1, p2, further ones, as OpenCV's calibration has them.")
    interval: float = quantity(0.1, "s", gt=0, le=1, doc="Images that come sooner after the last one are left out.")
    features: int = setting(400, ge=50, doc="Corners that are followed, at most.")

    @field_validator("focal")
    @classmethod
    def _positive(cls, value: tuple[float, float]) -> tuple[float, float]:
        if min(value) <= 0.0:
            raise ValueError("focal lengths are above 0")
        return value

    @field_validator("distortion")
    @classmethod
    def _as_opencv_has_it(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if len(value) not in (0, 4, 5, 8, 12, 14):
            raise ValueError(f"it has {len(value)} numbers; OpenCV knows models of 4, 5, 8, 12 and 14")
        return value

    @property
    def rot_bc(self) -> Array:
        """(3, 3), axes of an image to those of the box."""
        roll, pitch, yaw = self.mounting
        return np.asarray(to_matrix(from_euler(yaw, pitch, roll)) @ _OPTICAL)


class _Motion(NamedTuple):
    """Between two images: their rows, what they tell, the corners that agree, and whether the camera moved."""

    first: int
    last: int
    views: TwoViews
    agreeing: int
    moves: bool


def visual_odometry(*, frames: pa.Table, params: VisualOdometryParams) -> Streams:
    """The stream visual, a row for each pair of images that tells a motion.

    frames : time; file, relative to the folder; index, the number of the frame in a video
    raises : DataError where no image can be read or the camera is not theirs, PluginError where OpenCV is missing
    """
    with needs("integrator.visual_odometry", "OpenCV", extra="vision"):
        import cv2  # noqa: F401
    rows = _apart(time_ns(frames), params.interval)
    seen = _Seen(frames.take(pa.array(rows)), params)
    motions = list(seen.motions())
    visual = with_meta(_table(motions, seen.t_ns, params), **meta(frames))
    return {"visual": visual, "metrics": metrics(_learnt(motions, seen))}


def _apart(t_ns: Times, interval_s: float) -> Times:
    """Rows whose times are an interval apart."""
    rows, least_ns = [0] if len(t_ns) else [], round(_EARLY * interval_s * 1e9)
    while rows:
        following = int(np.searchsorted(t_ns, t_ns[rows[-1]] + least_ns))
        if following == len(t_ns):
            break
        rows.append(following)
    return np.array(rows, dtype=np.int64)


class _Seen:
    """Images of frames, and what was found in them."""

    def __init__(self, frames: pa.Table, params: VisualOdometryParams) -> None:
        self.t_ns = time_ns(frames)
        self.pairs, self.unread = 0, list[str]()
        self._params = params
        self._files = frames["file"].to_pylist()
        if None in self._files:
            raise DataError(
                "frames names no files, but times alone",
                "read the images, or a list of times and files, by reader.frames",
            )
        self._numbers = vector(frames, "index").astype(np.int64).tolist()

    def motions(self) -> Iterator[_Motion]:
        """Motions between neighbouring images."""
        before: Grey | None = None
        shape: tuple[int, ...] = ()
        folder = Path(self._params.folder)
        for row, image in enumerate(pictures(folder, self._files, self._numbers)):
            if image is None:
                self.unread.append(self._files[row])
            elif not shape:
                shape = image.shape
                self._refuse_other_camera(shape)
            if before is not None and image is not None and image.shape == before.shape:
                yield from self._between(row, before, image)
            before = image
        if self._files and not shape:
            raise DataError(
                f"none of the {len(self._files)} images of frames can be read, {folder / self._files[0]} the first",
                "give the folder that their names are relative to: integrator.visual_odometry.folder",
            )

    def _between(self, row: int, before: Grey, image: Grey) -> Iterator[_Motion]:
        if self.t_ns[row] - self.t_ns[row - 1] > _LONGEST_S * 1e9:
            return
        self.pairs += 1
        params = self._params
        lens = params.focal, params.centre, params.distortion
        first, last = (rays(corners, *lens) for corners in followed(before, image, params.features))
        found = motion(first, last, 2.0 / sum(params.focal))
        if found is not None:
            yield _Motion(row - 1, row, *found)

    def _refuse_other_camera(self, shape: tuple[int, ...]) -> None:
        (x, y), (height, width) = self._params.centre, shape
        if not (0.0 < x < width and 0.0 < y < height):
            raise DataError(
                f"the centre {x:g}, {y:g} lies outside of images of {width} x {height} pixels",
                "give focal and centre of a calibration at the size of these images",
            )


def _table(motions: list[_Motion], t_ns: Times, params: VisualOdometryParams) -> pa.Table:
    """The stream visual, in the axes of the box."""
    rot_bc, views = params.rot_bc, [motion.views for motion in motions]
    turns = np.array([rot_bc @ one.rot_ab @ rot_bc.T for one in views]).reshape(-1, 3, 3)
    moves = np.array([motion.moves for motion in motions], dtype=bool)
    ways = np.array([rot_bc @ one.direction_a for one in views]).reshape(-1, 3)
    return build(
        VISUAL,
        time=t_ns[[motion.first for motion in motions]],
        end_time=t_ns[[motion.last for motion in motions]],
        q=from_matrix(turns),
        direction=np.where(moves[:, None], ways, np.nan),
        rotation_std=np.array([one.rotation_std for one in views]),
        direction_std=np.where(moves, np.array([one.direction_std for one in views]), np.nan),
    )


def _learnt(motions: list[_Motion], seen: _Seen) -> list[Metric]:
    agreeing = float(np.median([motion.agreeing for motion in motions])) if motions else 0.0
    moving = float(sum(motion.moves for motion in motions))
    learnt = [
        Metric("image_pairs", float(seen.pairs), note="compared"),
        Metric("image_pairs_used", float(len(motions)), note="in which enough corners agree on a motion"),
        Metric("image_pairs_moving", moving, note="that tell a direction of travel"),
        Metric("corners_agreeing", agreeing, method="median", note="of the pairs used"),
    ]
    if seen.unread:
        learnt.append(warning(f"{len(seen.unread)} images of frames cannot be read, {seen.unread[0]} the first"))
    if 2 * len(motions) < seen.pairs:
        learnt.append(warning(f"only {len(motions)} of {seen.pairs} pairs of images tell a motion"))
    return learnt


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.visual_odometry."""
    yield Integrator(
        name="visual_odometry",
        summary="How a camera turned and in which direction it moved from image to image.",
        params=VisualOdometryParams,
        reads={"frames": FRAMES.need("file", "index")},
        writes={"visual": VISUAL},
        run=visual_odometry,
        references=("Nister 2004", "Bouguet 2000", "Kalal, Mikolajczyk, Matas 2010", "Hartley, Zisserman 2004"),
    )
