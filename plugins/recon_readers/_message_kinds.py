"""Messages of ROS and Foxglove that hold what recon reads: where in them it stands, and as columns of which stream.

Units are those of the messages, which are SI. `sensor_msgs` and `foxglove` vectors are along x forward, y left, z up of
the sensor's housing (REP 103, REP 145); accelerations are specific force, +g upwards at rest. A covariance whose first
element is -1 says that a quantity is not measured, one of zeros that its sigma is not known.

References: ROS REP 103 (units and axes), REP 145 (IMU); sensor_msgs, geometry_msgs, nav_msgs; docs.foxglove.dev/docs/
visualization/message-schemas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np

from recon.numerics.rotation import rotate
from recon.tables import Array
from recon_readers._arrays import unit_quaternions

Columns: TypeAlias = dict[str, Array]


@dataclass(frozen=True)
class Kind:
    """What one type of message gives one stream.

    stamp : path of the time of measurement
    columns : path of the number by column; beside : paths that `finish` needs too
    finish : columns from the numbers by column and by path of `beside`
    facts : metadata of the stream
    asked : why the messages are taken for this stream only where a parameter names their topic; "" where always
    """

    stream: str
    stamp: str
    columns: Mapping[str, str]
    beside: tuple[str, ...] = ()
    finish: Callable[[Columns], Columns] = lambda columns: columns
    facts: Mapping[str, Any] = field(default_factory=dict)
    asked: str = ""


def _xyz(group: str, path: str, axes: str = "xyz") -> dict[str, str]:
    return {f"{group}_{axis}": f"{path}.{xyz}" for axis, xyz in zip(axes, "xyz", strict=True)}


def _quaternion(path: str) -> dict[str, str]:
    return {f"q{part}": f"{path}.{part}" for part in "wxyz"}


def _imu(columns: Columns) -> Columns:
    for group, path in (("accel", _ACCEL_KNOWN), ("gyro", _GYRO_KNOWN)):
        absent = columns.pop(path) == -1.0
        for axis in "xyz":
            if absent.any() and f"{group}_{axis}" in columns:
                columns[f"{group}_{axis}"][absent] = np.nan
    return columns


def _fix(columns: Columns) -> Columns:
    """Of a NavSatFix: nothing where there is no fix; sigmas from variances, unknown where they are not above zero."""
    status = columns.pop("status.status")
    lost = status == -1.0
    columns = _place(columns)
    for name in _PLACE:
        if name in columns:
            columns[name][lost] = np.nan
    if "fix" in columns:
        flat = ~np.isfinite(columns["height"]) if "height" in columns else np.zeros(len(lost), dtype=bool)
        columns["fix"] = np.where(lost, 0.0, np.where(status < -1.0, np.nan, np.where(flat, 2.0, 3.0)))
    return columns


def _place(columns: Columns) -> Columns:
    unknown = columns.pop("position_covariance_type") == 0.0
    for name in _VARIANCES:
        if name in columns:
            variance = columns[name]
            columns[name] = np.sqrt(np.where(unknown | ~(variance > 0.0), np.nan, variance))
    if {"lat", "lon"} <= columns.keys():
        nowhere = (columns["lat"] == 0.0) & (columns["lon"] == 0.0)
        for name in _PLACE:
            if name in columns:
                columns[name][nowhere] = np.nan
    return columns


def _pose(columns: Columns) -> Columns:
    names = [f"q{part}" for part in "wxyz"]
    if set(names) <= columns.keys():
        columns.update(zip(names, unit_quaternions(np.column_stack([columns[n] for n in names])).T, strict=True))
    return columns


def _odometry(columns: Columns) -> Columns:
    """The twist of an Odometry is in the frame of the body; the stream's velocity is local."""
    columns = _pose(columns)
    velocity = [columns.get(f"vel_{axis}") for axis in "enu"]
    known = [values for values in velocity if values is not None]
    q = [columns[name] for name in ("qw", "qx", "qy", "qz") if name in columns]
    for axis in "enu":
        columns.pop(f"vel_{axis}", None)
    if len(known) == 3 and len(q) == 4:
        turned = rotate(np.column_stack(q), np.column_stack(known))
        columns |= {f"vel_{axis}": turned[:, index] for index, axis in enumerate("enu")}
    return columns


_ACCEL_KNOWN: Final = "linear_acceleration_covariance[0]"
_GYRO_KNOWN: Final = "angular_velocity_covariance[0]"
_PLACE: Final = ("lat", "lon", "height")
_COVARIANCE: Final = {f"pos_std_{axis}": f"position_covariance[{4 * n}]" for n, axis in enumerate("enu")}
_VARIANCES: Final = tuple(_COVARIANCE)
_LOCATION: Final = {"lat": "latitude", "lon": "longitude", "height": "altitude", **_COVARIANCE}
_FLU: Final = {"axes": "FLU"}
_WHICH_ODOMETRY: Final = "its twist may be of the wheels (wheel) or its pose an estimate (reference)"
_WHICH_TWIST: Final = "it may be a velocity east, north, up (gnss) or of the wheels, along x (wheel)"
_WHICH_POSE: Final = "it may be an estimate of the vehicle's pose (reference)"

_IMU_KIND: Final = Kind(
    "imu",
    "header.stamp",
    {**_xyz("accel", "linear_acceleration"), **_xyz("gyro", "angular_velocity")},
    (_ACCEL_KNOWN, _GYRO_KNOWN),
    _imu,
    _FLU,
)
_LOCATION_KIND: Final = Kind("gnss", "timestamp", _LOCATION, ("position_covariance_type",), _place)


def _twist(path: str) -> tuple[Kind, ...]:
    return (
        Kind("gnss", "header.stamp", _xyz("vel", f"{path}.linear", "enu"), asked=_WHICH_TWIST),
        Kind("wheel", "header.stamp", {"speed": f"{path}.linear.x"}, asked=_WHICH_TWIST),
    )


def _posed(stamp: str, position: str, orientation: str) -> tuple[Kind, ...]:
    columns = {**_xyz("pos", position, "enu"), **_quaternion(orientation)}
    return (Kind("reference", stamp, columns, finish=_pose, asked=_WHICH_POSE),)


def _odometries(stamp: str, pose: str, twist: str) -> tuple[Kind, ...]:
    columns = {**_xyz("pos", f"{pose}.position", "enu"), **_quaternion(f"{pose}.orientation")}
    return (
        Kind("wheel", stamp, {"speed": f"{twist}.x"}, asked=_WHICH_ODOMETRY),
        Kind("reference", stamp, {**columns, **_xyz("vel", twist, "enu")}, finish=_odometry, asked=_WHICH_ODOMETRY),
    )


_FOXGLOVE: Final[Mapping[str, tuple[Kind, ...]]] = {
    "LocationFix": (_LOCATION_KIND,),
    "PoseInFrame": _posed("timestamp", "pose.position", "pose.orientation"),
    "FrameTransform": _posed("timestamp", "translation", "rotation"),
    "Odometry": _odometries("timestamp", "pose", "linear_velocity"),
}
KINDS: Final[Mapping[str, tuple[Kind, ...]]] = {
    "sensor_msgs/msg/Imu": (_IMU_KIND,),
    "sensor_msgs/msg/NavSatFix": (
        Kind(
            "gnss",
            "header.stamp",
            {**_LOCATION, "fix": "status.status"},
            ("status.status", "position_covariance_type"),
            _fix,
            {"height_datum": "ellipsoid"},
        ),
    ),
    "sensor_msgs/msg/MagneticField": (Kind("mag", "header.stamp", _xyz("mag", "magnetic_field"), facts=_FLU),),
    "sensor_msgs/msg/FluidPressure": (Kind("baro", "header.stamp", {"pressure": "fluid_pressure"}),),
    "nav_msgs/msg/Odometry": _odometries("header.stamp", "pose.pose", "twist.twist.linear"),
    "geometry_msgs/msg/TwistStamped": _twist("twist"),
    "geometry_msgs/msg/TwistWithCovarianceStamped": _twist("twist.twist"),
    "geometry_msgs/msg/PoseStamped": _posed("header.stamp", "pose.position", "pose.orientation"),
    **{f"foxglove_msgs/msg/{name}": kinds for name, kinds in _FOXGLOVE.items()},
    **{f"foxglove.{name}": kinds for name, kinds in _FOXGLOVE.items()},
}
"""By type of message: ROS types by their ROS 2 names, Foxglove's as in Protobuf and JSON."""
_SHORT: Final = sorted({name.rpartition("/")[2].rpartition(".")[2] for name in KINDS})


def may_hold(name: str, definition: str) -> bool:
    """Can a message type hold one that is read? Most definitions need not be parsed."""
    return any(short in name or short in definition for short in _SHORT)
