"""Small ROS logs, written by rosbags: a car that drives east at 10 m/s, with a camera that nobody reads."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

START_NS: Final = 1_700_000_000_123_456_789
RATES: Final = {"/imu/data": 100, "/fix": 5, "/odom": 20, "/mag": 20, "/baro": 10, "/camera": 10}
ACCEL, GYRO, FIELD = (0.5, -0.25, 9.8), (0.01, -0.02, 0.03), (20e-6, 5e-6, -40e-6)
LAT, LON, HEIGHT, SPEED, PRESSURE = 44.5, 11.35, 54.0, 10.0, 101_325.0
PACKAGES: Final = (
    *("std_msgs/msg/Header", "builtin_interfaces/msg/Time"),
    *(f"{package}_msgs/" for package in ("sensor", "geometry", "nav")),
)
LATE_NS: Final = 7_000_000
"""From measurement to recording."""


def messages(types: Any, seconds: float = 2.0, *, ros1: bool = False) -> Iterator[tuple[str, str, int, Any]]:
    """(topic, type, ns of measurement, message), topic by topic."""
    kinds = {name.rpartition("/")[2]: cls for name, cls in types.types.items() if name.startswith(PACKAGES)}
    vector, zeros = kinds["Vector3"], np.zeros(9)

    def header(t_ns: int) -> Any:
        seq = {"seq": 7} if ros1 else {}
        stamp = kinds["Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        return kinds["Header"](stamp=stamp, frame_id="a_frame", **seq)

    def still() -> Any:
        return kinds["Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)

    makers: dict[str, tuple[str, Callable[[int], Any]]] = {
        "/imu/data": (
            "Imu",
            lambda t: {
                "orientation": still(), "orientation_covariance": zeros, "angular_velocity": vector(*GYRO),
                "angular_velocity_covariance": zeros, "linear_acceleration": vector(*ACCEL),
                "linear_acceleration_covariance": zeros,
            },
        ),
        "/fix": (
            "NavSatFix",
            lambda t: {
                "status": kinds["NavSatStatus"](status=0, service=1), "latitude": LAT, "longitude": LON,
                "altitude": HEIGHT,
                "position_covariance": np.diag([1.0, 4.0, 9.0]).ravel(), "position_covariance_type": 2,
            },
        ),
        "/odom": (
            "Odometry",
            lambda t: {
                "child_frame_id": "base",
                "pose": kinds["PoseWithCovariance"](
                    pose=kinds["Pose"](position=kinds["Point"](SPEED * (t - START_NS) * 1e-9, 0.0, 0.0),
                                       orientation=still()), covariance=np.zeros(36),
                ),
                "twist": kinds["TwistWithCovariance"](
                    twist=kinds["Twist"](linear=vector(SPEED, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)),
                    covariance=np.zeros(36),
                ),
            },
        ),
        "/mag": ("MagneticField", lambda t: {"magnetic_field": vector(*FIELD), "magnetic_field_covariance": zeros}),
        "/baro": ("FluidPressure", lambda t: {"fluid_pressure": PRESSURE, "variance": 0.0}),
        "/camera": (
            "CompressedImage",
            lambda t: {"format": "jpeg", "data": np.full(3000 + t % 97, 7, dtype=np.uint8)},
        ),
    }  # fmt: skip
    for topic, (kind, make) in makers.items():
        name = next(full for full in types.types if full.endswith(f"/msg/{kind}"))
        for row in range(round(seconds * RATES[topic])):
            t_ns = START_NS + row * (10**9 // RATES[topic])
            yield topic, name, t_ns, kinds[kind](header=header(t_ns), **make(t_ns))


def write(
    path: Path,
    form: str,
    seconds: float = 2.0,
    *,
    packed: Literal["", "file", "message"] = "",
    stamped: Callable[[int], int] = lambda t_ns: t_ns,
) -> Path:
    """A bag at `path`: "bag" of ROS 1; a folder of "sqlite3" or "mcap" of ROS 2. Its file, or the folder.

    packed : what zstd packs of ROS 2; stamped : what a message of that ns of measurement is stamped with
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = form == "bag"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    written = sorted(messages(types, seconds, ros1=ros1), key=lambda each: each[2])
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    if packed:
        writer.set_compression(CompressionMode[packed.upper()], CompressionFormat.ZSTD)
    with writer as bag:
        bag.chunk_threshold = 20_000  # of ROS 1 alone
        topics: dict[str, Any] = {}
        for topic, name, t_ns, message in written:
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, name, typestore=types)
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamped(t_ns), 10**9)
            data = types.serialize_ros1(message, name) if ros1 else types.serialize_cdr(message, name)
            bag.write(topics[topic], t_ns + LATE_NS, data)
    return path
