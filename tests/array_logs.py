"""Small logs in formats that keep each sensor as arrays: a car that drives east at 10 m/s; constant specific force."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
from scipy.io import savemat

LAT, LON, HEIGHT = 37.72, -122.47, 30.0
BOOT_S = 1000.0
WEEK, TIME_OF_WEEK_S = 2012, 404_106.0
"""2018-08-02T16:15:06 GPS."""
SPEED = 10.0
SECONDS = 4
ACCEL_FRD = (1.0, 0.5, -9.8)
GYRO_FRD = (0.1, 0.2, -0.3)
"""Along forward, right, down: braced forward, pushed to the right, held up; rolled right, pitched up, turned left."""


def save_sensor(folder: Path, t_s: np.ndarray, value: np.ndarray) -> None:
    """The two files of a sensor, with NumPy's format and without its ending."""
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / "t", t_s)
    save(folder / "value", value)


def save(path: Path, values: np.ndarray) -> None:
    with path.open("wb") as file:
        np.save(file, values)


def times(rate_hz: float) -> np.ndarray:
    """(n,) s after the start."""
    return np.arange(0.0, SECONDS, 1.0 / rate_hz)


def place(t_s: np.ndarray) -> tuple[np.ndarray, ...]:
    """Latitude and longitude in deg, height in m, of the car that drives east."""
    return pymap3d.enu2geodetic(SPEED * t_s, 0.0 * t_s, 0.0 * t_s, LAT, LON, HEIGHT)


def segment(folder: Path) -> Path:
    """A segment of comma2k19 with all that its reader reads."""
    log = folder / "processed_log"
    t_s = times(100.0)
    save_sensor(log / "IMU/accelerometer", BOOT_S + t_s, np.tile(ACCEL_FRD, (len(t_s), 1)))
    save_sensor(log / "IMU/gyro", BOOT_S + t_s, np.tile(GYRO_FRD, (len(t_s), 1)))
    t_s = times(10.0)
    save_sensor(log / "IMU/magnetometer", BOOT_S + t_s, np.tile((20.0, 5.0, 40.0), (len(t_s), 1)))
    lat, lon, height = place(t_s)
    utc_ms = 1e3 * (315_964_800 + WEEK * 604_800 + TIME_OF_WEEK_S - 18 + t_s)
    fixes = np.column_stack([lat, lon, np.full(len(t_s), SPEED), utc_ms, height, np.full(len(t_s), 90.0)])
    save_sensor(log / "GNSS/live_gnss_ublox", BOOT_S + 0.2 + t_s, fixes)
    save_sensor(log / "GNSS/live_gnss_qcom", BOOT_S + 0.2 + t_s[::5], fixes[::5])
    t_s = times(80.0)
    save_sensor(log / "CAN/speed", BOOT_S + t_s, np.full((len(t_s), 1), SPEED))
    save_sensor(log / "CAN/wheel_speed", BOOT_S + t_s, np.tile((9.0, 11.0, 9.5, 10.5), (len(t_s), 1)))
    save_sensor(log / "CAN/steering_angle", BOOT_S + t_s + 0.003, np.full(len(t_s), 90.0))
    _poses(folder / "global_pose")
    return folder


def _poses(folder: Path) -> None:
    """Poses of a camera that looks east: its axes forward, right, down are east, south, down."""
    folder.mkdir(parents=True)
    t_s = times(20.0)
    columns = [pymap3d.enu2uvw(*axis, LAT, LON) for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))]
    q = _quaternion(np.array(columns).T)
    save(folder / "frame_times", BOOT_S + t_s)
    save(folder / "frame_gps_times", np.column_stack([np.full(len(t_s), float(WEEK)), TIME_OF_WEEK_S + t_s]))
    save(folder / "frame_positions", np.column_stack(pymap3d.geodetic2ecef(*place(t_s))))
    save(folder / "frame_velocities", np.tile(SPEED * np.array(columns[0]), (len(t_s), 1)))
    save(folder / "frame_orientations", np.tile(q, (len(t_s), 1)))


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    """Scalar first, by the peer that keeps the scalar last."""
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(matrix).as_quat(), 1)


def navego_imu(rate_hz: float = 100.0) -> dict[str, Any]:
    """The structure of an IMU."""
    t_s = times(rate_hz)
    rows = {"fb": np.tile(ACCEL_FRD, (len(t_s), 1)), "wb": np.tile(GYRO_FRD, (len(t_s), 1))}
    return {"arw": np.zeros((1, 3)), "t": t_s[:, None], **rows, "freq": rate_hz}


def navego_gnss() -> dict[str, Any]:
    """The structure of a receiver, whose velocity north, east, down is that of a car that drives east."""
    t_s = times(5.0)
    lat, lon, height = place(t_s)
    return {
        "t": t_s[:, None],
        "lat": np.radians(lat)[:, None],
        "lon": np.radians(lon)[:, None],
        "h": height[:, None],
        "vel": np.tile((0.0, SPEED, 0.0), (len(t_s), 1)),
        "stdm": np.array([[1, 2, 3]], dtype=np.uint8),
        "stdv": np.array([[0.1, 0.2, 0.3]]),
        "larm": np.array([[1.0, 2.0, -3.0]]),
    }


def navego_ref() -> dict[str, Any]:
    """The structure of a reference: heading 60 deg from north, nose 5 deg up, rolled 10 deg to the right."""
    t_s = times(50.0)
    lat, lon, height = place(t_s)
    angles = {name: np.full((len(t_s), 1), np.radians(deg)) for name, deg in (("roll", 10), ("pitch", 5), ("yaw", 60))}
    position = {"lat": np.radians(lat)[:, None], "lon": np.radians(lon)[:, None], "h": height[:, None]}
    return {"t": t_s[:, None], **angles, "vel": np.tile((0.0, SPEED, 0.0), (len(t_s), 1)), **position}


def save_mat(path: Path, compressed: bool = True, **structures: Any) -> Path:
    """A .mat file of MATLAB 5."""
    path.parent.mkdir(parents=True, exist_ok=True)
    savemat(path, structures, do_compression=compressed)
    return path
