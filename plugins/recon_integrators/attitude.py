"""Attitude by composition of the turns between samples.

    q_nv[k+1] = q_nv[k] (x) exp(phi_k / 2),    phi_k = integral of omega_v + h^2 / 12 omega_v[k] x omega_v[k+1]

The integral follows the chosen rule; the second term (Bortz) is what the turning of the axis of rotation within the
step adds, without which no rule is better than order 2.

Over a gap longer than `max_gap` the turn is unknown: the attitude is held, and a warning tells where.

References
    Thesis, sections 2.1 and 5.1.
    Bortz (1971), "A new mathematical formulation for strapdown inertial navigation", IEEE Trans. AES 7(1), 61-66.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import (
    ATTITUDE,
    IMU,
    Integrator,
    Metric,
    Params,
    Streams,
    build,
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
from recon.errors import DataError, NotEnoughData
from recon.numerics.integration import Rule, increments
from recon.numerics.rotation import Floats, from_euler, from_rotvec, yaw_from_heading
from recon.numerics.rotation_series import compose
from recon.placing import silence_warnings, silent_steps


class AttitudeParams(Params):
    """Parameters of integrator.attitude."""

    rule: Rule = setting("parabola", doc="Quadrature of the angular rate between samples.")
    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="Over a longer gap in imu the attitude is held.")
    longest_gap: float = quantity(10.0, "min", gt=0, le=1e6, doc="A log with a longer gap is refused: cut it there.")


def integrate_attitude(*, imu: pa.Table, attitude: pa.Table | None, params: AttitudeParams) -> Streams:
    """Attitude of the vehicle at every row of imu, from the one at the first row.

    attitude : its first row is where the integration starts; None starts level and facing north
    Raises NotEnoughData where imu is empty, DataError where attitude does not start with imu or where imu has a gap
    longer than longest_gap.
    """
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    silent = silent_steps(imu, params.max_gap, params.longest_gap)
    q_start, notes = first_attitude(imu, attitude)
    notes += silence_warnings(imu, silent, "the attitude is held")
    turns = _turns(seconds(imu), matrix(imu, "gyro"), params.rule)
    turns[silent] = 0.0
    table = build(ATTITUDE, time=time_ns(imu), q=compose(from_rotvec(turns), q_start))
    return {"attitude": with_meta(table, **meta(imu)), "metrics": metrics(notes)}


def first_attitude(imu: pa.Table, attitude: pa.Table | None) -> tuple[Floats, list[Metric]]:
    """Attitude at the first row of imu: (4,), and what had to be assumed."""
    if attitude is None or not attitude.num_rows:
        note = "no initial attitude: the vehicle is taken to start level and facing north (heading 0)"
        return from_euler(yaw_from_heading(0.0), 0.0, 0.0), [warning(note)]
    if time_ns(attitude)[0] != time_ns(imu)[0]:
        raise DataError(
            "the initial attitude is not that of the first row of imu",
            "put the aligner that gives it after the last step that changes the times of imu",
        )
    return matrix(attitude.slice(0, 1), "q")[0], []


def _turns(t_s: Floats, gyro_v: Floats, rule: Rule) -> Floats:
    """Rotation vector of each step: (n-1, 3) rad. t_s : (n,) s; gyro_v : (n, 3) rad/s, vehicle."""
    step = np.diff(t_s)[:, None]
    return increments(t_s, gyro_v, rule) + step**2 / 12.0 * np.cross(gyro_v[:-1], gyro_v[1:])


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """Declare integrator.attitude."""
    yield Integrator(
        name="attitude",
        summary="Attitude at every row of imu by composition of its angular rates.",
        params=AttitudeParams,
        reads={
            "imu": IMU.need("gyro", frame="vehicle"),
            "attitude": ATTITUDE.need("q", frame="vehicle", optional=True),
        },
        writes={"attitude": ATTITUDE},
        run=integrate_attitude,
        order=3,
        references=("Thesis, section 5.1", "Bortz (1971), IEEE Trans. AES 7(1), 61-66"),
    )
