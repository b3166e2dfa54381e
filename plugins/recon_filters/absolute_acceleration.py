"""Acceleration along East, North and Up, from specific force and attitude.

    a_n = R_nb f_b - (0, 0, g)

The attitude is that of the body along whose axes the force is given, whichever that is; heading is from the north that
the attitude means. An error of the attitude by d (rad) leaves g sin d of gravity in the horizontal: 0.17 m/s^2 for each
degree of tilt, and turns what is there by an error of heading. g is by default what the accelerometer itself reads
while the vehicle stands: see _gravity.py.

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., eq. 5.47 and
    5.51, in a local frame that does not turn.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import ATTITUDE, EVENTS, GNSS, IMU, Change, Filter, Streams, hookimpl, matrix, metrics, replace
from recon.errors import DataError
from recon.numerics.rotation import rotate
from recon.placing import attitude_of
from recon.tables import schema_of
from recon_filters._gravity import GravityParams, gravity_of


def absolute_acceleration(
    *, imu: pa.Table, attitude: pa.Table, events: pa.Table | None, gnss: pa.Table | None, params: GravityParams
) -> Streams:
    """Turn the specific force to East, North, Up and take gravity off; gyro stays as it is.

    imu : accel m/s^2, specific force in any frame; attitude : at the times of imu, of that frame
    Raises DataError where attitude is not given at the times of imu, or is that of another body.
    """
    frame, body = schema_of(imu)["accel_x"].frame, schema_of(attitude)["qw"].frame
    if frame and body and frame != body:
        raise DataError(
            f"imu.accel is along the axes '{frame}' and attitude is that of '{body}'",
            "an integrator such as integrator.vqf gives the attitude of the sensor, integrator.attitude the vehicle's",
        )
    gravity = gravity_of(imu, events, gnss, params.magnitude)
    acceleration_n = rotate(attitude_of(imu, attitude), matrix(imu, "accel")) - [0.0, 0.0, gravity.magnitude]
    return {"imu": replace(imu, accel=acceleration_n), "metrics": metrics([gravity.as_metric()])}


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """Declare filter.absolute_acceleration."""
    yield Filter(
        name="absolute_acceleration",
        summary="Acceleration along East, North and Up by attitude, gravity removed.",
        params=GravityParams,
        reads={
            "imu": IMU.need("accel", quantity={"accel": "specific_force"}),
            "attitude": ATTITUDE.need("q"),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
            "gnss": GNSS.need(optional=True),
        },
        writes={"imu": Change(frames={"accel": "local"}, quantities={"accel": "acceleration"})},
        run=absolute_acceleration,
        references=("Groves (2013), eq. 5.47 and 5.51",),
    )
