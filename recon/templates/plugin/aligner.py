"""Levels the box by the first seconds of the log, in which it stands: what it feels then points up.

    v_level = R v_sensor,    R the shortest rotation with R mean(f) = (0, 0, |mean(f)|)

Where x and y point is left open: the result is in the frame `level`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import IMU, Aligner, Change, Metric, Params, Streams, hookimpl, matrix, metrics, quantity, replace, seconds
from recon.errors import NotEnoughData
from recon.numerics.rotation import rotate, shortest_arc


class LevelParams(Params):
    """Parameters of aligner.$name."""

    rest: float = quantity(2.0, "s", gt=0, doc="Time from the first row in which the vehicle stands.")


def level(*, imu: pa.Table, params: LevelParams) -> Streams:
    """The imu in the frame `level`; the metrics tell by how much it was tilted.

    imu : accel m/s^2 with gravity, gyro rad/s, sensor
    raises : NotEnoughData where nothing is felt at rest, DataError on missing values
    """
    accel = matrix(imu, "accel")
    at_rest = accel[seconds(imu) <= params.rest]
    up_s = at_rest.mean(axis=0) if len(at_rest) else np.zeros(3)
    if not up_s.any():
        raise NotEnoughData("gravity", needed="a row at rest", found="none")
    rot_ls = shortest_arc(up_s, (0.0, 0.0, 1.0))
    tilt = np.degrees(np.arccos(up_s[2] / np.linalg.norm(up_s)))
    turned = replace(imu, accel=rotate(rot_ls, accel), gyro=rotate(rot_ls, matrix(imu, "gyro")))
    return {"imu": turned, "metrics": metrics([Metric("tilt", float(tilt), "deg")])}


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """aligner.$name."""
    yield Aligner(
        name="$name",
        summary="Levels the box by the first seconds of the log.",
        params=LevelParams,
        run=level,
        reads={"imu": IMU.need("accel", "gyro", frame="sensor", quantity={"accel": "specific_force"})},
        writes={"imu": Change(frames={"accel": "level", "gyro": "level"})},
        rotation=True,
    )
