"""Acceleration from specific force.

    a_v = f_v + R_vn g_n,    g_n = (0, 0, -g)

g is by default what the accelerometer itself reads while the vehicle stands: see _gravity.py.

References
    Thesis, section 4.4. NIMA TR8350.2 (2000), eq. 4-1 (normal gravity).
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import ATTITUDE, EVENTS, GNSS, IMU, Change, Filter, Streams, hookimpl, matrix, metrics, replace
from recon.numerics.rotation import conjugate, rotate
from recon.placing import attitude_of
from recon_filters._gravity import GravityParams, gravity_of


def remove_gravity(
    *, imu: pa.Table, attitude: pa.Table, events: pa.Table | None, gnss: pa.Table | None, params: GravityParams
) -> Streams:
    """Take gravity off the specific force. Raises DataError where attitude is not given at the times of imu."""
    up_v = rotate(conjugate(attitude_of(imu, attitude)), [0.0, 0.0, 1.0])
    gravity = gravity_of(imu, events, gnss, params.magnitude)
    accel = matrix(imu, "accel") - gravity.magnitude * up_v
    return {"imu": replace(imu, accel=accel), "metrics": metrics([gravity.as_metric()])}


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """Declare filter.remove_gravity."""
    yield Filter(
        name="remove_gravity",
        summary="Acceleration from specific force, with gravity as measured at stops or normal.",
        params=GravityParams,
        reads={
            "imu": IMU.need("accel", frame="vehicle", quantity={"accel": "specific_force"}),
            "attitude": ATTITUDE.need("q", frame="vehicle"),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
            "gnss": GNSS.need(optional=True),
        },
        writes={"imu": Change(quantities={"accel": "acceleration"})},
        run=remove_gravity,
        references=("Thesis, section 4.4", "NIMA TR8350.2 (2000), eq. 4-1"),
    )
