"""Attitude from the turn rates, beginning level.

    q_(k+1) = q_k (x) exp(dt (gyro_k + gyro_(k+1)) / 4)

Its error falls with the square of the step, but for the bias of the gyroscope.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import ATTITUDE, IMU, Integrator, Params, Streams, build, hookimpl, matrix, quantity, seconds, time_ns
from recon.errors import NotEnoughData
from recon.numerics.rotation import from_euler, from_rotvec
from recon.numerics.rotation_series import compose


class TurnParams(Params):
    """Parameters of integrator.$name."""

    yaw: float = quantity(0.0, "deg", doc="First yaw, counter-clockwise from east.")


def turn(*, imu: pa.Table, params: TurnParams) -> Streams:
    """The stream `attitude` at the times of the imu.

    imu : gyro rad/s, vehicle
    raises : NotEnoughData without a row, DataError on missing values
    """
    if not imu.num_rows:
        raise NotEnoughData("imu", needed="1 row", found="none")
    gyro = matrix(imu, "gyro")
    rotvec = np.diff(seconds(imu))[:, None] * (gyro[:-1] + gyro[1:]) / 2.0
    q_nv = compose(from_rotvec(rotvec), from_euler(params.yaw, 0.0, 0.0))
    return {"attitude": build(ATTITUDE, time=time_ns(imu), q=q_nv)}


@hookimpl
def declare_integrators() -> Iterable[Integrator]:
    """integrator.$name."""
    yield Integrator(
        name="$name",
        summary="Attitude from the turn rates.",
        params=TurnParams,
        run=turn,
        reads={"imu": IMU.need("gyro", frame="vehicle")},
        writes={"attitude": ATTITUDE},
        order=2,
    )
