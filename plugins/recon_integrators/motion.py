"""Velocity and position by double integration of the acceleration, with the stops as zeros of the velocity.

    v_n(t) = v_n(0) + integral of R_nv a_v,    p_n(t) = p_n(0) + integral of v_n

At a stop the velocity is known to be zero, so what the integral shows there is error. A straight line through it over
each stop (its slope is the error of the acceleration then) joined by straight lines between stops is taken off:

    v_n(t) - c(t),    0 inside a stop,    c constant before the first and after the last stop

The line rather than the mean of the stop makes c meet the velocity where a long stop ends; a fit rather than the last
sample bears detectors that, with a late GNSS speed, tell the end of a stop some tenths of a second too late.

References
    Thesis, chapters 2.1 and 6.
"""

from __future__ import annotations

from collections.abc import Iterable

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
    seconds,
    setting,
    time_ns,
    warning,
    with_meta,
)
from recon.errors import NotEnoughData
from recon.numerics.integration import Rule, cumulative
from recon.numerics.rotation import Floats, rotate
from recon.placing import anchor_of, attitude_of, geolocate, rows_during

AT_START_S = 1.0
"""A stop that begins within this of the first record is one at which the record begins."""


class MotionParams(Params):
    """Parameters of integrator.motion."""

    rule: Rule = setting("parabola", doc="Quadrature of acceleration and velocity between samples.")
    zero_at_stops: bool = setting(True, doc="Take off what the velocity shows at stops; false integrates plainly.")


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
    Raises NotEnoughData where imu is empty, DataError where attitude is not given at the times of imu.
    """
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    t_s, accel_v, q_nv = seconds(imu), matrix(imu, "accel"), attitude_of(imu, attitude)
    stops = rows_during(imu, events, "standstill")
    vel_n = cumulative(t_s, rotate(q_nv, accel_v), params.rule)
    learnt: list[Metric] = []
    if not (len(stops) and (params.zero_at_stops or t_s[stops[0, 0]] <= AT_START_S)):
        vel_n, notes = _through_first_velocity(imu, vel_n, gnss)
        learnt += notes
    if params.zero_at_stops and len(stops):
        vel_n, largest = zero_at_stops(t_s, vel_n, stops)
        learnt.append(Metric("largest_velocity_error_at_a_stop", largest, "m/s", method=f"{len(stops)} stops"))
    pos_n = _through_first(imu, cumulative(t_s, vel_n, params.rule), gnss, "pos")
    if anchor_of(gnss) is None:
        learnt.append(warning("local frame: no place on the Earth is known, so lat, lon and height are null"))
    table = build(TRAJECTORY, time=time_ns(imu), pos=pos_n, vel=vel_n, q=q_nv, accel=accel_v, gyro=matrix(imu, "gyro"))
    return {"trajectory": geolocate(with_meta(table, **meta(imu)), gnss), "metrics": metrics(learnt)}


def zero_at_stops(t_s: Floats, vel_n: Floats, stops: NDArray[np.intp]) -> tuple[Floats, float]:
    """Velocity with zeros at the stops, and the length of the largest error that it showed at one.

    t_s : (n,) s; vel_n : (n, 3) m/s, local; stops : (m, 2) start and stop row of each stop, half-open
    returns : (n, 3) m/s, local; m/s
    """
    last = stops[:, 1] - 1
    nodes = np.column_stack([stops[:, 0], last])
    error_n = np.array([_line_ends(t_s[a:b], vel_n[a:b]) for a, b in stops])
    error_n = error_n.reshape(-1, 3)
    taken_off = np.column_stack([np.interp(t_s, t_s[nodes.ravel()], column) for column in error_n.T])
    corrected = vel_n - taken_off
    for start, stop in stops:
        corrected[start:stop] = 0.0
    return corrected, float(np.linalg.norm(error_n, axis=1).max())


def _line_ends(t_s: Floats, y: Floats) -> Floats:
    """Values at the first and last time of the straight line that fits y best: (2, k) of y (n, k)."""
    centred = t_s - t_s.mean()
    spread = float(centred @ centred)
    slope = centred @ y / spread if spread else np.zeros(y.shape[1])
    return np.asarray(y.mean(axis=0) + centred[[0, -1], None] * slope)


def _through_first_velocity(imu: pa.Table, vel_n: Floats, gnss: pa.Table | None) -> tuple[Floats, list[Metric]]:
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        return _through_first(imu, vel_n, gnss, "vel"), []
    return vel_n, [warning("neither a stop at the start nor GNSS tells the first velocity: it is taken as zero")]


def _through_first(imu: pa.Table, y: Floats, gnss: pa.Table | None, group: str) -> Floats:
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
            "attitude": ATTITUDE.need("q"),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
            "gnss": GNSS.need(maybe=["pos", "vel"], optional=True),
        },
        writes={"trajectory": TRAJECTORY},
        run=integrate_motion,
        references=("Thesis, sections 2.1 and 6",),
    )
