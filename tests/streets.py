"""A street for a camera: a textured ground with walls and posts beside the way, seen along a drive that is known.

Every pixel is the nearest of what its ray meets. The texture has three sizes of grain, each of which fades where it
becomes finer than a pixel, as it does in a lens.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pyarrow as pa

from recon import FRAMES, build, matrix, time_ns, with_meta
from recon.numerics.rotation import multiply, to_matrix
from recon.numerics.rotation_series import slerp

WIDTH, HEIGHT, FOCAL = 320, 240, 260.0
CENTRE = (159.5, 119.5)
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Right, down, ahead to ahead, left, up."""
_GRAINS_M = (0.05, 0.4)
_TEXELS = 512
_SEEN_M = 55.0
_SKY = 205.0


class Wall(NamedTuple):
    """An upright rectangle that stands on the ground: middle x, y m, its direction rad, length and height m."""

    x: float
    y: float
    along: float
    length: float
    height: float
    shift: float = 0.0
    """Of its texture, m."""


@dataclass(frozen=True)
class Poses:
    """Where the camera is at n times: t_ns (n,), pos_n (n, 3) m, rot_nb (n, 3, 3) of the box, rot_bc of the camera."""

    t_ns: np.ndarray
    pos_n: np.ndarray
    rot_nb: np.ndarray
    rot_bc: np.ndarray

    @classmethod
    def along(cls, reference: pa.Table, t_ns: np.ndarray, q_vs: np.ndarray, rot_bc: np.ndarray) -> Poses:
        """The camera sits at the origin of the IMU, whose attitude in the vehicle is q_vs."""
        known_ns = time_ns(reference)
        at_s, known_s = ((t - known_ns[0]) * 1e-9 for t in (t_ns, known_ns))
        pos_n = np.column_stack([np.interp(at_s, known_s, axis) for axis in matrix(reference, "pos").T])
        q_nv = slerp(t_ns, known_ns, matrix(reference, "q"))
        return cls(t_ns, pos_n, to_matrix(multiply(q_nv, q_vs)), rot_bc)

    def turns(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """(m, 3, 3), the box at rows `last` to the box at rows `first`."""
        return self.rot_nb[first].swapaxes(1, 2) @ self.rot_nb[last]

    def ways(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """(m, 3) m, how far it moved, in the axes of the box at rows `first`."""
        return np.einsum("mji,mj->mi", self.rot_nb[first], self.pos_n[last] - self.pos_n[first])


class Street:
    """What stands beside a way. ground : m, height of the road; everything follows from the seed."""

    def __init__(self, way_n: np.ndarray, ground: float, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._ground = ground
        fine = self._rng.uniform(0.0, 255.0, (_TEXELS, _TEXELS)).astype(np.float32)
        soft = cv2.blur(np.pad(fine, 4, mode="wrap"), (3, 3))[4:-4, 4:-4]
        self._texture = ((soft - soft.mean()) / soft.std() * 34.0).astype(np.float32)
        self.walls = self._beside(way_n[:, :2], float(np.ptp(way_n[:, 2])))
        rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
        plane = [(columns - CENTRE[0]) / FOCAL, (rows - CENTRE[1]) / FOCAL, np.ones((HEIGHT, WIDTH))]
        self._rays = np.stack(plane, axis=-1).reshape(-1, 3).astype(np.float32)

    def _beside(self, way: np.ndarray, rise: float) -> list[Wall]:
        """Walls and posts on both sides, none in the way; as much higher as the way rises above the ground."""
        moved = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
        walls, rng = [], self._rng
        spots = np.arange(-20.0, moved[-1] + 60.0, 7.0)
        for spot in spots:
            row = min(max(int(np.searchsorted(moved, spot)), 1), len(way) - 1)
            behind = way[max(int(np.searchsorted(moved, moved[row] - 1.0)) - 1, 0)]
            ahead = way[row] - behind
            ahead = ahead / max(np.linalg.norm(ahead), 1e-9)
            beyond = spot - float(np.clip(spot, 0.0, moved[-1]))
            for side in (1.0, -1.0):
                post = rng.random() < 0.4
                aside = side * rng.uniform(4.5, 8.0 if post else 14.0)
                x, y = way[row] + (beyond + rng.uniform(-3.0, 3.0)) * ahead + aside * np.array([-ahead[1], ahead[0]])
                along = np.arctan2(ahead[1], ahead[0]) + (np.pi / 2.0 if post else rng.uniform(-0.7, 0.7))
                length, height = (
                    (rng.uniform(0.2, 0.8), 5.0) if post else (rng.uniform(3.0, 9.0), rng.uniform(2.0, 7.0))
                )
                if np.hypot(*(way - (x, y)).T).min() > 3.0 + 0.5 * length * (not post):
                    walls.append(Wall(x, y, along, length, height + rise, rng.uniform(0.0, 100.0)))
        return walls

    def image(
        self, pos_n: np.ndarray, rot_nc: np.ndarray, moving: Sequence[Wall] = (), light: float = 1.0
    ) -> np.ndarray:
        """(240, 320) uint8, with the noise of a camera. moving : walls of other vehicles; light : 1 by day."""
        rays = self._rays @ rot_nc.T.astype(np.float32)
        far, x, y, grain = self._ground_under(pos_n, rays)
        for wall in [*self.walls, *moving]:
            if np.hypot(wall.x - pos_n[0], wall.y - pos_n[1]) < _SEEN_M:
                self._paint(wall, pos_n, rays, (far, x, y, grain))
        grey = np.full(len(rays), 110.0, dtype=np.float32)
        for size in _GRAINS_M:
            u, v = (np.mod(part / size, _TEXELS).reshape(HEIGHT, WIDTH) for part in (x, y))
            texture = cv2.remap(self._texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
            grey += texture.ravel() * np.clip(1.5 * size / grain - 0.5, 0.0, 1.0)
        grey[~np.isfinite(far)] = _SKY
        noisy = light * grey + self._rng.normal(0.0, 1.5, len(grey))
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8).reshape(HEIGHT, WIDTH)

    def _ground_under(self, pos_n: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, ...]:
        """Distance along the rays, place on the texture m, and size of a pixel m, of the ground."""
        down = np.where(rays[:, 2] < -1e-3, -rays[:, 2], np.nan)
        far = np.float32(pos_n[2] - self._ground) / down
        far = np.where(far < 400.0, far, np.inf).astype(np.float32)
        near = np.where(np.isfinite(far), far, 0.0)
        x, y = (np.float32(pos_n[axis]) + near * rays[:, axis] for axis in (0, 1))
        return far, x, y, np.maximum(near / FOCAL / np.sqrt(np.nan_to_num(down, nan=1.0)), 1e-4)

    def _paint(self, wall: Wall, pos_n: np.ndarray, rays: np.ndarray, onto: tuple[np.ndarray, ...]) -> None:
        """Onto what lies behind the wall."""
        far, x, y, grain = onto
        cos, sin = np.float32(np.cos(wall.along)), np.float32(np.sin(wall.along))
        east, north = np.float32(wall.x - pos_n[0]), np.float32(wall.y - pos_n[1])
        with np.errstate(divide="ignore", invalid="ignore"):
            away = (east * -sin + north * cos) / (rays[:, 0] * -sin + rays[:, 1] * cos)
        candidates = np.flatnonzero((away > 0.3) & (away < far))
        some, ray = away[candidates], rays[candidates]
        along = (some * ray[:, 0] - east) * cos + (some * ray[:, 1] - north) * sin
        up = np.float32(pos_n[2] - self._ground) + some * ray[:, 2]
        hit = (np.abs(along) < 0.5 * wall.length) & (up > 0.0) & (up < wall.height)
        rows = candidates[hit]
        far[rows], x[rows], y[rows] = some[hit], along[hit] + np.float32(wall.shift), up[hit]
        grain[rows] = some[hit] / np.float32(FOCAL)


def film(
    street: Street,
    poses: Poses,
    folder: Path,
    moving: Callable[[int], Sequence[Wall]] = lambda row: (),
    light: Callable[[int], float] = lambda row: 1.0,
) -> pa.Table:
    """Write the images of a camera along its poses, and tell them as the stream frames."""
    folder.mkdir(parents=True, exist_ok=True)
    names = [f"{row:05d}.png" for row in range(len(poses.t_ns))]
    for row, name in enumerate(names):
        image = street.image(poses.pos_n[row], poses.rot_nb[row] @ poses.rot_bc, moving(row), light(row))
        (folder / name).write_bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
    frames = build(FRAMES, time=poses.t_ns, index=np.arange(len(names)), file=pa.array(names))
    return with_meta(frames, time_scale="UTC", clock="absolute")
