"""Sets right the axes, signs and sizes of an IMU that are known to be wrong, as `recon doctor` finds them.

    v_new = P S k v

with the factor k of the sensor, the signs S of its axes, and the order P of where x, y, z of the log point. A box that
is merely mounted at an angle needs none of this: fuser.map, aligner.mount and aligner.forward find the angle.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

import numpy as np
import pyarrow as pa
from pydantic import field_validator

from recon import IMU, SAME, Aligner, Array, Params, Streams, has, hookimpl, matrix, replace, setting
from recon.numerics.axes import is_earth, turn

Channel = Literal["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"]
_XYZ: Final = "xyz"


class AxesParams(Params):
    """Parameters of aligner.axes."""

    axes: str = setting(
        "FLU",
        doc="Where x, y, z point, of F B L R U D (forward, back, left, right, up, down); two that are swapped, as LFU.",
    )
    at_rest: Literal["up", "down"] = setting(
        "up", doc="What the accelerometer shows at rest: up, +g upwards; down, -g, as some phones do."
    )
    inverted: tuple[Channel, ...] = setting((), doc="Axes with the wrong sign, as they are called in the log.")
    accel_scale: float = setting(1.0, gt=0, doc="By what accelerations are multiplied.")
    gyro_scale: float = setting(1.0, gt=0, doc="By what turn rates are multiplied.")

    @field_validator("axes")
    @classmethod
    def _of_the_box(cls, value: str) -> str:
        turn(value)
        if is_earth(value):
            raise ValueError(f"'{value}' names directions of the Earth; an IMU turns with the vehicle")
        return value


def set_axes(*, imu: pa.Table, params: AxesParams) -> Streams:
    """imu with its axes in the order forward, left, up, right signs and sizes."""
    scales = {"accel": params.accel_scale * (-1.0 if params.at_rest == "down" else 1.0), "gyro": params.gyro_scale}
    order, signs = turn(params.axes)
    for group, scale in scales.items():
        if not has(imu, group):
            continue
        own = np.array([-1.0 if f"{group}_{axis}" in params.inverted else 1.0 for axis in _XYZ])
        values: Array = matrix(imu, group, gaps=True) * (scale * own)
        imu = replace(imu, **{group: np.ascontiguousarray(values[:, list(order)] * np.array(signs))})
    return {"imu": imu}


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.axes."""
    yield Aligner(
        name="axes",
        summary="Sets right axes, signs and sizes of the IMU that are known to be wrong, as recon doctor finds them.",
        params=AxesParams,
        reads={"imu": IMU.need(maybe=["accel", "gyro"])},
        writes={"imu": SAME},
        run=set_axes,
    )
