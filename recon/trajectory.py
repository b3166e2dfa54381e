"""The query side of a trajectory: pose at a time, change between two, path length, deviation from a reference."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import TYPE_CHECKING, Any, Final, TypeAlias, overload

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import DataError
from recon.knots import ATTITUDE, POSITION, SIZE, VELOCITY, Knots
from recon.numerics.geodesy import geodetic_to_enu
from recon.numerics.rotation import angle, conjugate, rotate, shortest_arc, slerp, to_euler
from recon.numerics.signals import interpolate_angle, wrap_angle
from recon.placing import EARTHS, anchor_of
from recon.problems import shortened
from recon.tables import Array, has, matrix, meta, time_ns, vector

if TYPE_CHECKING:
    from pyquaternion import Quaternion

OneTime: TypeAlias = str | float | datetime | np.datetime64
Times: TypeAlias = OneTime | list[Any] | NDArray[Any]

LAST_NS: Final = 2**63 - 1
"""Greatest int64."""

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


@dataclass(frozen=True)
class Movement:
    """How the vehicle moved from one time to another; sigmas and covariances are NaN where they are not known.

    start, stop : UTC; duration : s
    displacement (3,) m, local East-North-Up, with displacement_covariance (3, 3) m^2; distance : m, its length
    velocity_change (3,) m/s, local, with velocity_covariance (3, 3) (m/s)^2; delta_v : m/s, its length
    heading_change : rad, clockwise, in (-pi, pi]; heading_sigma : rad

    Sigmas of lengths are those along the vector, and of use where the length is well above them.
    """

    start: np.datetime64
    stop: np.datetime64
    duration: float
    displacement: Array
    displacement_covariance: Array
    distance: float
    distance_sigma: float
    velocity_change: Array
    velocity_covariance: Array
    delta_v: float
    delta_v_sigma: float
    heading_change: float
    heading_sigma: float


@dataclass(frozen=True)
class Trajectory:
    """A trajectory table with questions answered.

    table : the stream `trajectory`; knots : the stream of that name, from which sigmas of changes come, unless they are
    those of another trajectory, which a later step has replaced
    """

    table: pa.Table
    knots: pa.Table | None = None

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
    def at(self, times: OneTime) -> Pose: ...
    @overload
    def at(self, times: list[Any] | NDArray[Any]) -> Poses: ...

    def at(self, times: Times) -> Pose | Poses:
        """The pose at one time, or at many: positions and velocities linear, attitudes spherical between rows.

        times : ISO text (UTC where it names no zone), datetime, numpy.datetime64, or seconds after the first row;
            a list or array of these gives Poses

        Raises DataError for what is no time, and for a time outside the trajectory.
        """
        if isinstance(times, list) or (isinstance(times, np.ndarray) and times.ndim):
            return self._poses(self._ns(times))
        poses = self._poses(self._ns([times]))
        from pyquaternion import Quaternion

        attitude = Quaternion(poses.attitude[0])
        lat, lon, height = float(poses.lat[0]), float(poses.lon[0]), float(poses.height[0])
        return Pose(poses.time[0], poses.position[0], poses.velocity[0], attitude, lat, lon, height)

    def between(self, start: OneTime, stop: OneTime) -> Movement:
        """How the vehicle moved between two times, with sigmas where the fuser wrote the stream `knots`.

        Errors at two times have much in common, so that changes are known far better than the sigmas of the
        trajectory suggest; recon.knots tells how sigmas come about, and what is left out of them.

        Raises DataError as `at`.
        """
        t_ns = self._ns([start, stop])
        poses = self._poses(t_ns)
        known = self.knots is not None and self._passes(self.knots)
        spread = Knots.of(self.knots).covariance_of_change(*t_ns.tolist()) if known else np.full((SIZE, SIZE), np.nan)
        moved, faster = np.diff(poses.position, axis=0)[0], np.diff(poses.velocity, axis=0)[0]
        yaw = to_euler(poses.attitude)[0]
        return Movement(
            start=poses.time[0],
            stop=poses.time[1],
            duration=float(t_ns[1] - t_ns[0]) * 1e-9,
            displacement=moved,
            displacement_covariance=spread[POSITION, POSITION],
            distance=float(np.linalg.norm(moved)),
            distance_sigma=_sigma_along(moved, spread[POSITION, POSITION]),
            velocity_change=faster,
            velocity_covariance=spread[VELOCITY, VELOCITY],
            delta_v=float(np.linalg.norm(faster)),
            delta_v_sigma=_sigma_along(faster, spread[VELOCITY, VELOCITY]),
            heading_change=float(wrap_angle(yaw[0] - yaw[1])),
            heading_sigma=float(np.sqrt(np.maximum(spread[ATTITUDE, ATTITUDE][2, 2], 0.0))),
        )

    def _passes(self, knots: pa.Table) -> bool:
        """Does the trajectory pass through the knots?"""
        _, here, there = np.intersect1d(time_ns(self.table), time_ns(knots), return_indices=True)
        apart = matrix(self.table, "pos", gaps=True)[here] - matrix(knots, "pos", gaps=True)[there]
        return not (np.abs(apart) > _SAME_M).any()

    def _ns(self, moments: Any) -> NDArray[np.int64]:
        """Many times, each in any form, as ns since 1970: (n,)."""
        own = time_ns(self.table)
        start = int(own[0]) if len(own) else 0
        return np.array([_since_1970(one, start) for one in moments], dtype=np.int64)

    def _poses(self, t_ns: NDArray[np.int64]) -> Poses:
        own = time_ns(self.table)
        if not len(own) or t_ns.min(initial=own[0]) < own[0] or t_ns.max(initial=own[-1]) > own[-1]:
            span = f"from {self.table['time'][0]} to {self.table['time'][-1]}" if len(own) else "over no row"
            raise DataError(f"a time lies outside the trajectory, which runs {span}")
        since, at = (own - own[0]) * 1e-9, (t_ns - own[0]) * 1e-9

        def between(group: str) -> Array:
            values = matrix(self.table, group, gaps=True)
            return np.column_stack([np.interp(at, since, column) for column in values.T])

        lat, height = between("lat")[:, 0], between("height")[:, 0]
        lon = np.degrees(interpolate_angle(t_ns, own, np.radians(vector(self.table, "lon", gaps=True))))
        attitude = slerp(at, since, matrix(self.table, "q"))
        return Poses(t_ns.view("datetime64[ns]"), between("pos"), between("vel"), attitude, lat, lon, height)

    def _repr_html_(self) -> str:
        facts = {"rows": f"{len(self):,}", "duration": f"{self.duration:.1f} s", "path": f"{self.path_length:.1f} m"}
        if len(self):
            facts["top speed"] = f"{self.speed.max():.2f} m/s"
        cells = "".join(f"<tr><td>{escape(key)}</td><td>{escape(value)}</td></tr>" for key, value in facts.items())
        return f"<table>{cells}</table>"


def _sigma_along(vector: Array, covariance: Array) -> float:
    """Sigma of the length of a vector (3,), to first order; root mean square of that of one without length."""
    length = np.linalg.norm(vector)
    if length == 0.0:
        return float(np.sqrt(np.maximum(np.trace(covariance), 0.0)))
    along = vector / length
    return float(np.sqrt(np.maximum(along @ covariance @ along, 0.0)))


def _since_1970(one: Any, start: int) -> int:
    """A time in ns since 1970; seconds count from `start` in ns. Raises DataError for what is no time."""
    try:
        found = _nanoseconds(one, start)
    except (TypeError, ValueError, OverflowError) as error:
        hint = "give seconds after the first row, ISO text, a datetime or a numpy.datetime64"
        raise DataError(f"{shortened(repr(one))} is no time", hint) from error
    return min(max(found, -LAST_NS), LAST_NS)  # what int64 cannot hold is outside of every trajectory


def _nanoseconds(one: Any, start: int) -> int:
    if isinstance(one, int | float | np.integer | np.floating):
        return start + round(float(one) * 1e9)
    if isinstance(one, str):
        one = datetime.fromisoformat(one)
    if isinstance(one, datetime):
        aware = one if one.tzinfo else one.replace(tzinfo=UTC)
        since = aware - datetime(1970, 1, 1, tzinfo=UTC)
        return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
    moment = np.datetime64(one, "ns")
    if np.isnat(moment):
        raise ValueError("not a time")
    return int(moment.astype(np.int64))


@dataclass(frozen=True)
class Deviation:
    """How far a trajectory is from a reference, nothing aligned: root mean squares over the common time.

    horizontal, vertical : m; velocity : m/s; heading, tilt : deg, of x and of z of the vehicle; final : m, horizontal,
    at the end
    """

    horizontal: float
    vertical: float
    velocity: float
    heading: float
    tilt: float
    final: float


def deviation(trajectory: pa.Table, reference: pa.Table) -> Deviation:
    """Compare at the trajectory's times inside the reference, both as logged, without any alignment.

    Where both know their place on the Earth, the reference is seen from the anchor of the trajectory; else positions
    are compared as they are. East, north and up of the two anchors are taken as parallel: 0.2 mrad in a kilometre.

    Raises DataError where they have no time in common.
    """
    t_ns, t_ref = time_ns(trajectory), time_ns(reference)
    inside = (t_ns >= t_ref[0]) & (t_ns <= t_ref[-1]) if len(t_ref) else np.zeros(len(t_ns), dtype=bool)
    if not inside.any():
        raise DataError("the trajectory and the reference have no time in common")
    truth = Trajectory(reference)._poses(t_ns[inside])
    error = matrix(trajectory, "pos")[inside] - _seen_from(trajectory, truth)
    speed_error = matrix(trajectory, "vel")[inside] - truth.velocity
    q = matrix(trajectory, "q")[inside]
    yaw_error = wrap_angle(to_euler(q)[0] - to_euler(truth.attitude)[0])
    tilt = angle(shortest_arc(_up(q), _up(truth.attitude)), [1.0, 0.0, 0.0, 0.0])
    horizontal = np.hypot(error[:, 0], error[:, 1])
    return Deviation(
        _rms(horizontal),
        _rms(error[:, 2]),
        _rms(np.linalg.norm(speed_error, axis=1)),
        float(np.degrees(_rms(yaw_error))),
        float(np.degrees(_rms(tilt))),
        float(horizontal[-1]),
    )


def _seen_from(trajectory: pa.Table, truth: Poses) -> Array:
    """Positions of the truth in the local frame of the trajectory: (n, 3) m."""
    anchor = anchor_of(trajectory)
    if anchor is None or not np.isfinite(truth.lat + truth.lon + truth.height).all():
        return truth.position
    return geodetic_to_enu(truth.lat, truth.lon, truth.height, anchor, EARTHS[meta(trajectory).get("earth", "wgs84")])


def _up(q: Array) -> Array:
    """Direction of up in the vehicle: (n, 3)."""
    return rotate(conjugate(q), [0.0, 0.0, 1.0])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def summarize(trajectory: pa.Table | None, gnss: pa.Table | None) -> dict[str, float]:
    """Distance in m, duration in s and top speed in m/s of a trajectory, or as far as GNSS alone tells them."""
    if trajectory is not None and trajectory.num_rows:
        found = Trajectory(trajectory)
        return {"distance": found.path_length, "duration": found.duration, "top_speed": float(found.speed.max())}
    if gnss is not None and has(gnss, "speed"):
        return {"top_speed": float(np.nanmax(vector(gnss, "speed", gaps=True)))}
    return {}
