"""Text files of a phone, one for each sensor, and the times of its images, as one recording."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from benchmarks import smartphone as benchmark

import recon
from recon.tables import Array, matrix, time_ns, vector

MAPPING = """
imu:
  time: {column: t, format: unix}
  accel: {columns: [ax, ay, az], unit: m/s^2, file: "accelerometer*"}
  gyro: {columns: [gx, gy, gz], unit: rad/s, file: "gyroscope*"}
mag:
  time: {column: t, format: unix}
  mag: {columns: [mx, my, mz], unit: uT}
gnss:
  time: {column: t, format: unix}
  height_datum: ellipsoid
  lat: {column: lat}
  lon: {column: lon}
  height: {column: height, unit: m}
  speed: {column: speed, unit: m/s}
  course: {column: course, unit: deg}
"""


def save(path: Path, names: str, t_ns: np.ndarray, columns: Sequence[Array]) -> Path:
    rows = zip(t_ns.tolist(), *(column.tolist() for column in columns), strict=True)
    lines = [f"{ns // 10**9}.{ns % 10**9:09d}," + ",".join(f"{v:.9f}" for v in values) for ns, *values in rows]
    path.write_text("\n".join([f"t,{names}", *lines, ""]), encoding="utf-8")
    return path


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """The gyroscope has times of its own, 3 ms after those of the accelerometer."""
    made = benchmark.drive("nine_axes", 1).recording
    imu, mag, gnss = made["imu"], made["mag"], made["gnss"]
    start_ns, accel, gyro = time_ns(imu), matrix(imu, "accel"), matrix(imu, "gyro")
    place = [vector(gnss, name, gaps=True) for name in ("lat", "lon", "height", "speed")]
    course = np.degrees(np.nan_to_num(vector(gnss, "course", gaps=True)))
    saved = [
        save(tmp_path / "accelerometer.csv", "ax,ay,az", start_ns, accel.T),
        save(tmp_path / "gyroscope.csv", "gx,gy,gz", start_ns + 3_000_000, gyro.T),
        save(tmp_path / "magnetometer.csv", "mx,my,mz", time_ns(mag), 1e6 * matrix(mag, "mag").T),
        save(tmp_path / "gps.csv", "lat,lon,height,speed,course", time_ns(gnss), [*place, course]),
    ]
    images = tmp_path / "images.txt"
    stamps = (start_ns[0] + np.arange(20, 80, 2) * 10**9).tolist()
    images.write_text("".join(f"{ns} {number:05d}.png\n" for number, ns in enumerate(stamps)), encoding="utf-8")
    return [*saved, images]


def test_a_text_file_for_each_sensor_is_one_recording(files: list[Path]) -> None:
    run = recon.run("smartphone", files, **{"reader.csv.columns": yaml.safe_load(MAPPING)})
    truth = benchmark.drive("nine_axes", 1)
    # These fixes err slowly alone, which no filter takes off, and the tables tell no sigmas: as good as they are.
    assert benchmark.horizontal(run.recording, truth) < 1.02 * benchmark.raw(truth)
    # as where all is in one table; 3 ms at 30 deg/s are 0.1 deg
    assert benchmark.heading_error(run, truth) < 4.5
    (method,) = (row["method"] for row in run.metrics.to_pylist() if row["name"] == "heading")
    assert method == "magnetometer and course"
    moved = run.trajectory.between("#5", "#15")
    assert moved.duration == pytest.approx(20.0)
    assert moved.ground_distance_sigma > 0.0
