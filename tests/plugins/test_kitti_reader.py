"""reader.kitti: packets of the OXTS become imu, gnss and reference. No real file was at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fuzz import log_files

import recon
from recon.errors import ReadFailed
from recon.numerics.rotation import to_euler
from recon.rows import warnings_of
from recon.tables import matrix, time_ns, vector

ROWS = 30


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, content in log_files.kitti(ROWS).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_a_drive_comes_back_as_it_was_written(folder: Path) -> None:
    recording, gnss, imu = recon.read(folder), log_files.gnss(ROWS), log_files.imu(ROWS)
    for name in ("imu", "gnss", "reference"):
        np.testing.assert_array_equal(time_ns(recording[name]), time_ns(gnss))
    np.testing.assert_allclose(matrix(recording["imu"], "accel"), matrix(imu, "accel"), rtol=1e-12)  # 13 digits
    np.testing.assert_allclose(matrix(recording["imu"], "gyro"), matrix(imu, "gyro"), rtol=1e-12)
    np.testing.assert_allclose(vector(recording["reference"], "lat"), vector(gnss, "lat"), rtol=1e-12)
    speed, course = vector(gnss, "speed"), vector(gnss, "course")
    vel = np.column_stack([speed * np.sin(course), speed * np.cos(course), 0 * speed])
    np.testing.assert_allclose(matrix(recording["gnss"], "vel"), vel, rtol=0, atol=1e-11)
    yaw = to_euler(matrix(recording["reference"], "q"))[0]
    np.testing.assert_allclose(np.sin(yaw), np.cos(course), rtol=0, atol=1e-11)  # yaw counts from east
    assert matrix(recording["gnss"], "pos_std")[0].tolist() == [0.05] * 3


def test_the_folder_oxts_itself_may_be_named_and_the_clock_be_set(folder: Path) -> None:
    recording = recon.read(folder / "oxts", **{"reader.kitti.clock_offset": "2 h"})
    assert time_ns(recording["gnss"])[0] == time_ns(log_files.gnss())[0] - 2 * 3600 * 10**9


def test_absent_and_damaged_packets_are_left_out_and_counted(folder: Path) -> None:
    (folder / "oxts/data/0000000003.txt").unlink()
    (folder / "oxts/data/0000000007.txt").write_text("49.0 8.4 nonsense")
    recording = recon.read(folder)
    assert recording["imu"].num_rows == ROWS - 2
    (count,) = [row["value"] for row in recording["metrics"].to_pylist() if row["name"] == "packets_left_out"]
    assert count == 2


def test_a_folder_without_packets_says_so(folder: Path) -> None:
    for file in (folder / "oxts/data").iterdir():
        file.unlink()
    with pytest.raises(ReadFailed, match="no packet holds a place"):
        recon.read(folder)


def test_packets_behind_the_last_time_are_told(folder: Path) -> None:
    times = folder / "oxts" / "timestamps.txt"
    times.write_text("\n".join(times.read_text().splitlines()[:20]) + "\n")
    recording = recon.read(folder)
    assert recording["imu"].num_rows == 20
    assert any(
        text.startswith("10 packets are not read, for timestamps.txt has 20 lines only")
        for text in warnings_of(recording["metrics"])
    )
