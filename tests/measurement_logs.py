"""A small MDF 4 file, written by asammdf: an IMU at 100 Hz, wheels at 50 Hz, GNSS at 5 Hz, each in its own group."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

START: Final = datetime(2024, 5, 17, 8, 30, 0, tzinfo=UTC)
START_NS: Final = 1_715_934_600_000_000_000
ACCEL_G, GYRO_DEG, SPEED_KMH = (0.05, 0.02, 1.0), (1.0, -2.0, 3.0), 36.0
LAT, LON, HEIGHT = 44.5, 11.25, 54.5

CHANNELS: Final[dict[str, Any]] = {
    "imu": {
        "axes": "FLU",
        "accel": {"columns": ["AccX", "AccY", "AccZ"], "unit": "g"},
        "gyro": {"columns": ["RateX", "RateY", "RateZ"], "unit": "deg/s"},
    },
    "wheel": {"speed": {"column": "Speed@1", "unit": "km/h"}},
    "gnss": {
        "height_datum": "ellipsoid",
        "lat": {"column": "Lat"},
        "lon": {"column": "Lon"},
        "height": {"column": "Alt", "unit": "m"},
        "speed": {"column": "Speed@2", "unit": "km/h"},
    },
}


def mf4(path: Path, seconds: float = 1.0, start: datetime = START, version: Any = "4.10") -> Path:
    """Write the file; its groups are 0 the IMU, 1 the wheels, 2 the receiver."""
    from asammdf import MDF, Signal

    def group(rate: int, values: dict[str, tuple[float, str]]) -> list[Signal]:
        t_s = np.arange(round(seconds * rate)) / rate
        return [Signal(np.full(len(t_s), value), t_s, name=name, unit=unit) for name, (value, unit) in values.items()]

    accel = {f"Acc{axis}": (value, "g") for axis, value in zip("XYZ", ACCEL_G, strict=True)}
    gyro = {f"Rate{axis}": (value, "deg/s") for axis, value in zip("XYZ", GYRO_DEG, strict=True)}
    place = {"Lat": (LAT, "deg"), "Lon": (LON, "deg"), "Alt": (HEIGHT, "m"), "Speed": (SPEED_KMH, "km/h")}
    with MDF(version=version) as file:
        file.header.start_time = start
        file.append(group(100, {**accel, **gyro}))
        file.append(group(50, {"Speed": (SPEED_KMH, "km/h")}))
        file.append(group(5, place))
        file.save(path, overwrite=True)
    return path


def left_open(path: Path) -> Path:
    """The file as a recorder leaves it that loses its power: its last block has no length."""
    data = bytearray(path.read_bytes())
    groups, blocks = [], []
    group = int.from_bytes(data[88:96], "little")  # the header's first link
    while group:
        groups.append(group)
        group = int.from_bytes(data[group + 24 : group + 32], "little")
    for group in groups:  # data blocks behind all others, the last one without its length
        at = int.from_bytes(data[group + 40 : group + 48], "little")
        length = int.from_bytes(data[at + 8 : at + 16], "little")
        data += bytes(-len(data) % 8)
        data[group + 40 : group + 48] = len(data).to_bytes(8, "little")
        blocks.append(len(data))
        data += data[at : at + length]
    data[blocks[-1] + 8 : blocks[-1] + 16] = (24).to_bytes(8, "little")
    data[:8], data[60:62] = b"UnFinMF ", (4).to_bytes(2, "little")
    path.write_bytes(data)
    return path
