"""Velocity and position by double integration of the acceleration, with the stops as zeros of the velocity.

    v_n(t) = v_n(0) + integral of R_nv a_v,    p_n(t) = p_n(0) + integral of v_n

At a stop the velocity is known to be zero, so what the integral shows there is error. A straight line through it over
each stop (its slope is the error of the acceleration then) joined by straight lines between stops is taken off:

    v_n(t) - c(t),    0 inside a stop,    c constant before the first and after the last stop

The line rather than the mean of the stop makes c meet the velocity where a long stop ends; a fit rather than the last
sample bears detectors that, with a late GNSS speed, tell the end of a stop some tenths of a second too late.

What a vehicle does in a gap longer than `max_gap` is unknown: the velocity is held, the position goes on with it, and
a warning tells where. Where the next stop shows that the velocity was wrong, a second of a gap takes as much of the
blame as twenty seconds of the record: an unknown acceleration is of the order of 1 m/s^2, the error of a measured one
of 0.05 m/s^2. A gap between two stops that adjoin it is part of the stop.

References
    Thesis, chapters 2.1 and 6.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    ATTITUDE,
    EVENTS,
    GNSS,
    IMU,
    TRAJECTORY,
    Integrator,
    Metric,
    Params,
    Streams,
    build,
    has,
    hookimpl,
    matrix,
    meta,
    metrics,
    quantity,
    seconds,
    setting,
    time_ns,
    warning,
    with_meta,
)
from recon.errors import NotEnoughData
from recon.numerics.integration import Rule, cumulative
from recon.numerics.rotation import Floats, rotate
from recon.placing import anchor_of, attitude_of, geolocate, rows_during, silence_warnings, silent_steps

BESIDE_S = 1.0
"""A stop within this of the first record, or of a gap, is one at which the record begins, or breaks off."""
BLAME = 20.0
"""Error of velocity that a second in a gap brings, relative to a second of the record."""


class MotionParams(Params):
    """Parameters of integrator.motion."""

    rule: Rule = setting("parabola", doc="Quadrature of acceleration and velocity between samples.")
    zero_at_stops: bool = setting(True, doc="Take off what the velocity shows at stops; false integrates plainly.")
    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="Over a longer gap in imu the velocity is held.")
    longest_gap: float = quantity(10.0, "min", gt=0, le=1e6, doc="A log with a longer gap is refused: cut it there.")


def integrate_motion(
    *,
    imu: pa.Table,
    attitude: pa.Table,
    events: pa.Table | None,
    gnss: pa.Table | None,
    params: MotionParams,
) -> Streams:
    """Trajectory of the origin of the IMU.

    gnss : its first position and, where the record does not begin with a stop, its first velocity are passed through
    Raises NotEnoughData where imu is empty, DataError where attitude is not given at the times of imu or where imu
    has a gap longer than longest_gap.
    """
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    silent = silent_steps(imu, params.max_gap, params.longest_gap)
    t_s, accel_v, q_nv = seconds(imu), matrix(imu, "accel"), attitude_of(imu, attitude)
    stops = rows_during(imu, events, "standstill")
    vel_n = cumulative(t_s, rotate(q_nv, accel_v), params.rule, held=silent)
    learnt = silence_warnings(imu, silent, "the velocity is held")
    if not (len(stops) and (params.zero_at_stops or t_s[stops[0, 0]] <= BESIDE_S)):
        vel_n, notes = through_first_velocity(imu, vel_n, gnss)
        learnt += notes
    if params.zero_at_stops and len(stops):
        vel_n, largest = zero_at_stops(t_s, vel_n, stops, silent)
        learnt.append(Metric("largest_velocity_error_at_a_stop", largest, "m/s", method=f"{len(stops)} stops"))
    pos_n = through_first(imu, cumulative(t_s, vel_n, params.rule), gnss, "pos")
    if anchor_of(gnss) is None:
        learnt.append(warning("local frame: no place on the Earth is known, so lat, lon and height are null"))
    table = build(TRAJECTORY, time=time_ns(imu), pos=pos_n, vel=vel_n, q=q_nv, accel=accel_v, gyro=matrix(imu, "gyro"))
    return {"trajectory": geolocate(with_meta(table, **meta(imu)), gnss), "metrics": metrics(learnt)}


def zero_at_stops(
    t_s: Floats, vel_n: Floats, stops: NDArray[np.intp], silent: NDArray[np.bool_]
) -> tuple[Floats, float]:
    """Velocity with zeros at the stops, and the length of the largest error that it showed at one.

    t_s : (n,) s; vel_n : (n, 3) m/s, local; stops : (m, 2) start and stop row of each stop, half-open
    silent : (n-1,) bool, steps in which the velocity was held
    returns : (n, 3) m/s, local; m/s
    """
    stops = _split(stops, np.flatnonzero(silent) + 1)
    first, last = stops[:, 0], stops[:, 1] - 1
    told_s = _since_first(np.where(silent, 0.0, np.diff(t_s)))
    blame_s = told_s + BLAME * (t_s - t_s[0] - told_s)
    error_n = np.array([_line_ends(t_s[a:b], vel_n[a:b]) for a, b in stops]).reshape(-1, 3)
    nodes = np.column_stack([first, last]).ravel()
    taken_off = np.column_stack([np.interp(blame_s, blame_s[nodes], column) for column in error_n.T])
    gaps = _since_first(silent)
    through = (told_s[first[1:]] - told_s[last[:-1]] <= BESIDE_S) & (gaps[first[1:]] > gaps[last[:-1]])
    corrected = vel_n - taken_off
    for start, stop in (*stops, *zip(last[:-1][through], first[1:][through], strict=True)):
        corrected[start:stop] = 0.0
    return corrected, float(np.linalg.norm(error_n, axis=1).max())


def _split(stops: NDArray[np.intp], cuts: NDArray[np.intp]) -> NDArray[np.intp]:
    """The runs of rows (m, 2), each cut where it holds a row of `cuts`: the line of a stop does not cross a gap."""
    inside = [[start, *cuts[(cuts > start) & (cuts < stop)], stop] for start, stop in stops]
    return np.array([piece for edges in inside for piece in pairwise(edges)], dtype=np.intp)


def _since_first(steps: NDArray[Any]) -> NDArray[Any]:
    """Sum (n,) of the steps (n-1,) before each row."""
    return np.concatenate(([0], np.cumsum(steps)))


def _line_ends(t_s: Floats, y: Floats) -> Floats:
    """Values at the first and last time of the straight line that fits y best: (2, k) of y (n, k)."""
    centred = t_s - t_s.mean()
    spread = float(centred @ centred)
    slope = centred @ y / spread if spread else np.zeros(y.shape[1])
    return np.asarray(y.mean(axis=0) + centred[[0, -1], None] * slope)


def through_first_velocity(imu: pa.Table, vel_n: Floats, gnss: pa.Table | None) -> tuple[Floats, list[Metric]]:
    """Velocity (n, 3) m/s, local, shifted to pass through the first of GNSS, and a warning where there is none."""
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        return through_first(imu, vel_n, gnss, "vel"), []
    return vel_n, [warning("neither a stop at the start nor GNSS tells the first velocity: it is taken as zero")]


def through_first(imu: pa.Table, y: Floats, gnss: pa.Table | None, group: str) -> Floats:
    """y shifted, column by column, to pass through the first value that GNSS gives while the imu runs.

    y : (n, 3) at the times of imu; a column for which GNSS has nothing is left alone
    """
    shifted = y.copy()
    if gnss is None or f"{group}_e" not in gnss.column_names:
        return shifted
    t_ns, fix_ns = time_ns(imu), time_ns(gnss)
    inside = (fix_ns >= t_ns[0]) & (fix_ns <= t_ns[-1])
    for column, values in enumerate(matrix(gnss, group, gaps=True).T):
        known = np.flatnonzero(inside & np.isfinite(values))
        if len(known):
            first = known[0]
            since_s = (t_ns - fix_ns[first]) * 1e-9
            shifted[:, column] += values[first] - np.interp(0.0, since_s, y[:, column])
    return shifted


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.motion."""
    yield Integrator(
        name="motion",
        summary="Trajectory by double integration of acceleration, with the velocity zero at stops.",
        params=MotionParams,
        reads={
            "imu": IMU.need("accel", "gyro", frame="vehicle", quantity={"accel": "acceleration"}),
            "attitude": ATTITUDE.need("q", frame="vehicle"),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
            "gnss": GNSS.need(maybe=["pos", "vel"], optional=True),
        },
        writes={"trajectory": TRAJECTORY},
        run=integrate_motion,
        order=3,
        references=("Thesis, sections 2.1 and 6",),
    )
