"""The canonical streams: which columns each of them has, in which units and frames.

What columns, needs and changes are says `recon.columns`; its names can be imported from here as well.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import pyarrow as pa

from recon.columns import (
    ANY,
    QUATERNION,
    SAME,
    Change,
    Column,
    Mismatch,
    Need,
    Schema,
    group_of,
    match,
    spread,
    vector,
)

__all__ = [
    "ANY",
    "APPENDED",
    "ATTITUDE",
    "BARO",
    "EVENTS",
    "FRAMES",
    "FURTHER_GNSS",
    "FURTHER_IMUS",
    "GNSS",
    "GROUND",
    "IMU",
    "IMU_TRUTH",
    "KNOTS",
    "MAG",
    "METRICS",
    "REFERENCE",
    "RESIDUALS",
    "SAME",
    "SCHEMA_NUMBER",
    "SEVERAL_AT_A_TIME",
    "STEP",
    "STREAMS",
    "STREAM_NAME",
    "TIME",
    "TIME_TYPE",
    "TRAJECTORY",
    "VISUAL",
    "WHEEL",
    "Change",
    "Column",
    "Mismatch",
    "Need",
    "Schema",
    "by_step",
    "group_of",
    "match",
    "spread",
    "unnumbered",
    "vector",
]

SCHEMA_NUMBER: Final = 1
STREAM_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_]*")
TIME_TYPE: Final = pa.timestamp("ns", tz="UTC")


def _optional(*columns: Column) -> tuple[Column, ...]:
    return tuple(replace(column, optional=True) for column in columns)


def _text(name: str, doc: str = "") -> Column:
    return Column(name, type=pa.string(), doc=doc)


_LIST: Final = pa.list_(pa.field("element", pa.float32()))
"""Parquet knows items of lists by that name alone."""


def _numbers(name: str, doc: str) -> Column:
    return Column(name, type=_LIST, doc=doc)


TIME: Final = Column("time", quantity="time", type=TIME_TYPE, doc="UTC unless the stream's time_scale says otherwise")
_ACCEL = vector("accel", "xyz", "m/s^2", "sensor", "specific_force")
_GYRO = vector("gyro", "xyz", "rad/s", "sensor", "angular_rate")
_POS = vector("pos", "enu", "m", "local", "position", "relative to the anchor")
_VEL = vector("vel", "enu", "m/s", "local", "velocity")
_Q = tuple(Column(name, frame="vehicle", quantity="rotation", doc="body to local") for name in QUATERNION)
_PLACE = (
    Column("lat", "deg", quantity="latitude"),
    Column("lon", "deg", quantity="longitude"),
    Column("height", "m", quantity="height", doc="above the stream's height_datum"),
)
_SIGMAS = (*vector("pos_std", "enu", "m", "local", "sigma"), *vector("vel_std", "enu", "m/s", "local", "sigma"))
_ATT_STD = tuple(Column(f"att_std_{name}", "rad", quantity="sigma") for name in ("roll", "pitch", "yaw"))
_TEMPERATURE = Column("temperature", "K", quantity="temperature", optional=True)

IMU: Final = Schema((TIME, *_ACCEL, *_GYRO, _TEMPERATURE))
IMU_TRUTH: Final = Schema(
    (
        TIME,
        *vector("accel_bias", "xyz", "m/s^2", "sensor", "specific_force", "that imu holds, known to a simulator alone"),
        *vector("gyro_bias", "xyz", "rad/s", "sensor", "angular_rate", "that imu holds, known to a simulator alone"),
    )
)
GNSS: Final = Schema(
    (
        TIME,
        *_optional(
            *_PLACE,
            Column("speed", "m/s", quantity="speed"),
            Column("course", "rad", quantity="course", doc="clockwise from the stream's heading_kind"),
            *_VEL,
            *_SIGMAS,
            Column("fix", type=pa.int32(), doc="0 none, 1 time only, 2 two-dimensional, 3 three-dimensional"),
            Column("satellites", type=pa.int32()),
            *_POS,
            *vector("acc", "enu", "m/s^2", "local", "acceleration"),
        ),
    )
)
MAG: Final = Schema((TIME, *vector("mag", "xyz", "T", "sensor", "magnetic_flux_density")))
BARO: Final = Schema((TIME, Column("pressure", "Pa", quantity="pressure"), _TEMPERATURE))
WHEEL: Final = Schema(
    (
        TIME,
        Column("speed", "m/s", quantity="speed"),
        *_optional(
            *(Column(f"speed_{w}", "m/s", quantity="speed") for w in ("front_left", "front_right")),
            *(Column(f"speed_{w}", "m/s", quantity="speed") for w in ("rear_left", "rear_right")),
            Column("steering_angle", "rad", quantity="angle"),
        ),
    )
)
ATTITUDE: Final = Schema((TIME, *_Q))
TRAJECTORY: Final = Schema(
    (
        TIME,
        *_POS,
        *_VEL,
        *_Q,
        *_PLACE,
        *_optional(
            *vector("accel", "xyz", "m/s^2", "vehicle", "acceleration", "bias and gravity removed"),
            *vector("gyro", "xyz", "rad/s", "vehicle", "angular_rate", "bias removed"),
        ),
        *_SIGMAS,
        *_ATT_STD,
    )
)
REFERENCE: Final = TRAJECTORY
KNOTS: Final = Schema(
    (
        TIME,
        *_POS,
        *_VEL,
        *_Q,
        *_optional(
            *vector("gyro_bias", "xyz", "rad/s", "sensor", "angular_rate"),
            *vector("accel_bias", "xyz", "m/s^2", "sensor", "specific_force"),
            *vector("drift", "enu", "m", "local", "position", "slow error of GNSS positions"),
        ),
        Column("gyro_noise", "rad/s^0.5", quantity="sigma", doc="density of white noise, from here to the next knot"),
        Column("accel_noise", "m/s^1.5", quantity="sigma", doc="density of white noise, from here to the next knot"),
        _numbers("root", "L of the covariance in recon.knots, its lower triangle row by row"),
        _numbers("chain", "D in recon.knots, row by row; empty at the last knot"),
        _numbers("shared", "T in recon.knots, row by row"),
    )
)
"""The states of a smoother, as `trajectory`, with what covariances between any two times follow from."""
RESIDUALS: Final = Schema(
    (
        TIME,
        _text("sensor"),
        _text("component"),
        Column("value"),
        Column("sigma"),
        Column("weight"),
        Column("accepted", type=pa.bool_()),
    )
)
EVENTS: Final = Schema(
    (
        TIME,
        Column("end_time", quantity="time", type=TIME_TYPE),
        _text("kind"),
        Column("value"),
        _text("unit"),
        _text("note"),
    )
)
METRICS: Final = Schema(
    (
        _text("name"),
        Column("value"),
        _text("unit"),
        Column("sigma"),
        Column("low"),
        Column("high"),
        _text("method"),
        _text("note"),
    )
)
FRAMES: Final = Schema((TIME, Column("index", type=pa.int64()), _text("file")))
GROUND: Final = Schema(
    (
        TIME,
        *_PLACE[:2],
        Column("height", "m", quantity="height", doc="of the ground there, above the stream's height_datum"),
        Column("slope_e", doc="rise of the ground per way to the east"),
        Column("slope_n", doc="rise of the ground per way to the north"),
        Column("height_std", "m", quantity="sigma"),
    )
)
"""What a map of heights says of the ground near the vehicle, at the times of its fixes."""
VISUAL: Final = Schema(
    (
        TIME,
        Column("end_time", quantity="time", type=TIME_TYPE),
        *(
            Column(name, frame="sensor", quantity="rotation", doc="body at the end to body at time")
            for name in QUATERNION
        ),
        *vector("direction", "xyz", "", "sensor", "direction", "of travel, unit vector in the body at time"),
        Column("rotation_std", "rad", quantity="sigma", doc="each axis"),
        Column("direction_std", "rad", quantity="sigma", doc="each way across; null where it does not move"),
    )
)
"""How a camera moved from image to image, in the axes of the box (imu) that it is fixed to."""

STREAMS: Final[Mapping[str, Schema]] = {
    "imu": IMU,
    "imu_truth": IMU_TRUTH,
    "gnss": GNSS,
    "mag": MAG,
    "baro": BARO,
    "wheel": WHEEL,
    "attitude": ATTITUDE,
    "trajectory": TRAJECTORY,
    "reference": REFERENCE,
    "knots": KNOTS,
    "residuals": RESIDUALS,
    "events": EVENTS,
    "metrics": METRICS,
    "frames": FRAMES,
    "ground": GROUND,
    "visual": VISUAL,
}

STEP: Final = _text("step", "the step that made the row; added by the runner")
APPENDED: Final = ("events", "metrics")
SEVERAL_AT_A_TIME: Final = ("residuals",)
"""Streams with a row for each component of a measurement: their times rise, but not strictly."""
FURTHER_IMUS: Final = ("imu_2", "imu_3", "imu_4")
"""Streams of the boxes that stages take beside `imu`."""
FURTHER_GNSS: Final = ("gnss_2", "gnss_3", "gnss_4")
"""Streams of the receivers that stages take beside `gnss`."""


def unnumbered(stream: str) -> str:
    """Name of a further sensor's stream without its number: "imu_2" -> "imu", "imu" -> "imu"."""
    base, _, number = stream.rpartition("_")
    return base if base and number.isdigit() else stream


def by_step(stream: str) -> Schema:
    """Schema of an appended stream as it is kept: with the column `step` in front."""
    return Schema((STEP, *STREAMS[stream].columns))
