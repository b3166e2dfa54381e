"""The query side of a trajectory: pose at a time, movement between two, path length."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from html import escape
from typing import TYPE_CHECKING, Any, Final, TypeAlias, overload

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import DataError
from recon.knots import SIZE, Knots
from recon.moments import Moment, moment_ns
from recon.movement import Movement, Movements, movements
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate_angle
from recon.placing import EARTHS
from recon.scale_errors import between_knots
from recon.tables import Array, has, matrix, meta, time_ns, vector

if TYPE_CHECKING:
    from pyquaternion import Quaternion

Times: TypeAlias = Moment | list[Any] | NDArray[Any]

_FRAME: Final = re.compile(r"#[0-9]{1,18}")

_SAME_M: Final = 1e-6
"""m by which a knot may be apart from its trajectory."""


@dataclass(frozen=True)
class Pose:
    """Where the vehicle is at one time.

    time : UTC; position (3,) m and velocity (3,) m/s, local East-North-Up; attitude : vehicle to local
    lat, lon : deg; height : m; NaN where the trajectory has no anchor
    """

    time: np.datetime64
    position: Array
    velocity: Array
    attitude: Quaternion
    lat: float
    lon: float
    height: float


@dataclass(frozen=True)
class Poses:
    """Where the vehicle is at n times: as Pose, with an axis in front; attitude (n, 4), scalar first."""

    time: NDArray[np.datetime64]
    position: Array
    velocity: Array
    attitude: Array
    lat: Array
    lon: Array
    height: Array

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice) -> Poses:
        return Poses(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class Trajectory:
    """A trajectory table with questions answered.

    table : the stream `trajectory`; knots : the stream of that name, from which sigmas of changes come, unless they are
    those of another trajectory, which a later step has replaced; frames : the stream of that name, whose rows "#12"
    may name
    """

    table: pa.Table
    knots: pa.Table | None = None
    frames: pa.Table | None = None

    def __len__(self) -> int:
        return int(self.table.num_rows)

    @property
    def speed(self) -> Array:
        """Magnitude of the velocity: (n,) m/s."""
        return np.asarray(np.linalg.norm(matrix(self.table, "vel"), axis=1))

    @property
    def path_length(self) -> float:
        """Length of the path in m, summed over the rows."""
        return float(np.linalg.norm(np.diff(matrix(self.table, "pos"), axis=0), axis=1).sum())

    @property
    def duration(self) -> float:
        """From the first to the last row, in s."""
        t_ns = time_ns(self.table)
        return float((t_ns[-1] - t_ns[0]) * 1e-9) if len(t_ns) else 0.0

    @overload
    def at(self, times: Moment) -> Pose: ...
    @overload
    def at(self, times: list[Any] | NDArray[Any]) -> Poses: ...

    def at(self, times: Times) -> Pose | Poses:
        """The pose at one time, or at many: positions and velocities linear, attitudes spherical between rows.

        times : ISO text (UTC where it names no zone), datetime, numpy.datetime64, or after the first row: seconds, or
            text such as "100s"; "#12" is the time of the frame with the index 12; a list or array of these gives Poses

        Raises DataError for what is no time, for a time outside the trajectory, and for a frame that is not there.
        """
        if _several(times):
            return self._poses(self._ns(times))
        poses = self._poses(self._ns([times]))
        from pyquaternion import Quaternion

        attitude = Quaternion(poses.attitude[0])
        lat, lon, height = float(poses.lat[0]), float(poses.lon[0]), float(poses.height[0])
        return Pose(poses.time[0], poses.position[0], poses.velocity[0], attitude, lat, lon, height)

    @overload
    def between(self, start: Moment, stop: Moment) -> Movement: ...
    @overload
    def between(self, start: Times, stop: Times) -> Movement | Movements: ...

    def between(self, start: Times, stop: Times) -> Movement | Movements:
        """How the vehicle moved between two times, with sigmas where the fuser wrote the stream `knots`.

        start, stop : as in `at`; where one of them is a list or array, or both are of one length, it gives Movements

        Errors at two times have much in common, so that changes are known far better than the sigmas of the
        trajectory suggest; recon.knots tells how sigmas come about, and what is left out of them.

        Raises DataError as `at`.
        """
        several = _several(start) or _several(stop)
        starts, stops = np.broadcast_arrays(*(self._ns(t if _several(t) else [t]) for t in (start, stop)))
        poses = self._poses(np.concatenate([starts, stops]))
        spread = self._spread(starts, stops)
        along = self._way(stops) - self._way(starts)
        before, after = poses[: len(starts)], poses[len(starts) :]
        found = movements(before, after, np.abs(along), spread, EARTHS[meta(self.table).get("earth", "wgs84")])
        return found if several else found.only()

    def _spread(self, starts: NDArray[np.int64], stops: NDArray[np.int64]) -> Array:
        """Covariances of the errors at some times less those at others: (n, 9, 9), NaN where no knots tell them."""
        if self.knots is None or not self._passes(self.knots):
            return np.full((len(starts), SIZE, SIZE), np.nan)
        known = Knots.of(self.knots)
        before, after = np.split(between_knots(self.table, known.t_ns, np.concatenate([starts, stops])), 2)
        return known.covariance_of_change(starts, stops, after - before)

    def _passes(self, knots: pa.Table) -> bool:
        """Does the trajectory pass through the knots?"""
        _, here, there = np.intersect1d(time_ns(self.table), time_ns(knots), return_indices=True)
        apart = matrix(self.table, "pos", gaps=True)[here] - matrix(knots, "pos", gaps=True)[there]
        return not (np.abs(apart) > _SAME_M).any()

    def _ns(self, moments: Any) -> NDArray[np.int64]:
        """Many times, each in any form, as ns since 1970: (n,)."""
        own = time_ns(self.table)
        start = int(own[0]) if len(own) else 0
        return np.array(
            [self._of_frame(one) if _names_frame(one) else moment_ns(one, start) for one in moments], dtype=np.int64
        )

    def _of_frame(self, name: str) -> int:
        """Time of the frame "#12". Raises DataError where there is none."""
        if self.frames is None or not self.frames.num_rows:
            hint = "name the images or their list beside the log: recon run PIPELINE LOG IMAGES"
            raise DataError(f"there is no frame {name}: the run has no stream 'frames'", hint)
        index = vector(self.frames, "index")
        row = np.flatnonzero(index == int(name[1:]))
        if not len(row):
            raise DataError(f"there is no frame {name}; there are #{index.min():.0f} to #{index.max():.0f}")
        return int(time_ns(self.frames)[row[0]])

    def _way(self, t_ns: NDArray[np.int64]) -> Array:
        """Length of the path from the first row to each time inside: (n,) m."""
        pos = matrix(self.table, "pos", gaps=True)
        known = np.isfinite(pos).all(axis=1)
        own, steps = time_ns(self.table)[known], np.linalg.norm(np.diff(pos[known], axis=0), axis=1)
        if not len(own):
            return np.full(len(t_ns), np.nan)
        return np.asarray(np.interp((t_ns - own[0]) * 1e-9, (own - own[0]) * 1e-9, np.append(0.0, np.cumsum(steps))))

    def _poses(self, t_ns: NDArray[np.int64]) -> Poses:
        own = time_ns(self.table)
        if not len(own) or t_ns.min(initial=own[0]) < own[0] or t_ns.max(initial=own[-1]) > own[-1]:
            raise _outside(t_ns, own)
        since, at = (own - own[0]) * 1e-9, (t_ns - own[0]) * 1e-9

        def between(group: str) -> Array:
            values = matrix(self.table, group, gaps=True)
            return np.column_stack([np.interp(at, since, column) for column in values.T])

        lat, height = between("lat")[:, 0], between("height")[:, 0]
        lon = np.degrees(interpolate_angle(t_ns, own, np.radians(vector(self.table, "lon", gaps=True))))
        attitude = slerp(at, since, matrix(self.table, "q")) if has(self.table, "q") else np.full((len(at), 4), np.nan)
        return Poses(t_ns.view("datetime64[ns]"), between("pos"), between("vel"), attitude, lat, lon, height)

    def _facts(self) -> dict[str, str]:
        facts = {"rows": f"{len(self):,}", "duration": f"{self.duration:.1f} s", "path": f"{self.path_length:.1f} m"}
        if len(self):
            facts["top speed"] = f"{self.speed.max():.2f} m/s"
        return facts

    def __repr__(self) -> str:
        return f"Trajectory({', '.join(f'{key} {value}' for key, value in self._facts().items())})"

    def _repr_html_(self) -> str:
        cells = "".join(
            f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in self._facts().items()
        )
        return f"<table>{cells}</table>"


def speed_sigma(vel: Array, sigma: Array) -> Array:
    """Sigma (n,) of the magnitude of velocities (n, 3) m/s from those of their axes.

    Below the sigma itself, where directions mean nothing, that of one axis.
    """
    speed, one_axis = np.linalg.norm(vel, axis=1), np.linalg.norm(sigma, axis=1) / np.sqrt(3.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(speed > one_axis, np.linalg.norm(vel * sigma, axis=1) / speed, one_axis))


def _several(times: Times) -> bool:
    """Is it more than one time?"""
    return isinstance(times, list) or (isinstance(times, np.ndarray) and times.ndim > 0)


def _names_frame(one: Any) -> bool:
    return isinstance(one, str) and _FRAME.fullmatch(one) is not None


def _outside(t_ns: NDArray[np.int64], own: NDArray[np.int64]) -> DataError:
    if not len(own):
        return DataError("the trajectory has no rows, so no time lies inside")
    first = t_ns[(t_ns < own[0]) | (t_ns > own[-1])][0]
    asked, start, stop = (f"{moment.view('datetime64[ns]')} UTC" for moment in (first, own[0], own[-1]))
    lasts = f"{(own[-1] - own[0]) * 1e-9:.9f}".rstrip("0").rstrip(".")
    return DataError(
        f"the time {asked} lies outside the trajectory, which runs from {start} to {stop}",
        f"after its first row that is from '0s' to '{lasts}s'",
    )
