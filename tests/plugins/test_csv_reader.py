"""Tables read by a mapping of their columns: values in SI, axes, signs and gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_logs import IMU, ROWS, G, params_of, read_text

from recon.rows import warnings_of
from recon.tables import conform, matrix, meta, time_ns, vector
from recon_readers.csv import declare_readers


def test_columns_come_in_si(tmp_path: Path) -> None:
    mapping = """
imu:
  time: {column: t, format: relative, unit: ms}
  accel: {columns: [ax, ay, az], unit: g}
  gyro: {columns: [gx, gy, gz], unit: deg/s}
  temperature: {column: temp, unit: degC}
gnss:
  time: {column: t, format: relative, unit: ms}
  height_datum: ellipsoid
  lat: {column: la}
  lon: {column: lo}
  height: {column: h, unit: ft}
  speed: {column: v, unit: km/h}
  course: {column: c, unit: deg}
  fix: {column: fix}
"""
    text = "t,ax,ay,az,gx,gy,gz,temp,la,lo,h,v,c,fix\n5,0,0.5,1,180,0,-90,20,44.5,11.3,100,36,-90,3\n"
    streams = read_text(tmp_path, text, mapping)
    imu, gnss = streams["imu"], streams["gnss"]
    np.testing.assert_allclose(matrix(imu, "accel"), [[0, 0.5 * G, G]], rtol=1e-15)
    np.testing.assert_allclose(matrix(imu, "gyro"), [[np.pi, 0, -np.pi / 2]], rtol=1e-15)
    assert vector(imu, "temperature").tolist() == [293.15]
    assert [vector(gnss, name)[0] for name in ("lat", "lon", "speed", "fix")] == [44.5, 11.3, 10.0, 3]
    assert vector(gnss, "height")[0] == pytest.approx(30.48, rel=1e-15)
    assert vector(gnss, "course")[0] == pytest.approx(1.5 * np.pi, rel=1e-15)
    assert time_ns(imu).tolist() == [5_000_000]
    assert meta(gnss)["height_datum"] == "ellipsoid"
    assert meta(gnss)["heading_kind"] == "course_true"
    assert meta(gnss)["clock"] == "relative"


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ("FLU", [1, 2, 3]),
        ("FRD", [1, -2, -3]),
        ("RFU", [2, -1, 3]),
        ("BRU", [-1, -2, 3]),
        ("UFL", [2, 3, 1]),
        ("ENU", [1, 2, 3]),
        ("NED", [2, 1, -3]),
    ],
)
def test_axes_turn_into_forward_left_up_or_east_north_up(tmp_path: Path, axes: str, expected: list[float]) -> None:
    mapping = f"""
imu:
  time: {{column: 1, format: relative}}
  axes: {axes}
  accel: {{columns: [2, 3, 4], unit: m/s^2}}
  gyro: {{columns: [2, 3, 4], unit: rad/s}}
"""
    imu = read_text(tmp_path, "0,1,2,3\n1,1,2,3\n", mapping)["imu"]
    assert matrix(imu, "accel")[0].tolist() == expected
    assert matrix(imu, "gyro")[0].tolist() == expected


def test_an_accelerometer_that_shows_gravity_is_turned_over_and_its_gyroscope_is_not(tmp_path: Path) -> None:
    mapping = """
imu:
  time: {column: 1, format: relative}
  accel: {columns: [2, 3, 4], unit: g, at_rest: down}
  gyro: {columns: [2, 3, 4], unit: rad/s}
"""
    imu = read_text(tmp_path, "0,0,0,-1\n1,0,0,-1\n", mapping)["imu"]
    assert matrix(imu, "accel")[0].tolist() == [0, 0, G]
    assert matrix(imu, "gyro")[0].tolist() == [0, 0, -1]


def test_acceleration_without_gravity_is_planned_and_read_as_such(tmp_path: Path) -> None:
    params = params_of(IMU.replace("unit: g", "unit: g, at_rest: zero"))
    (reader,) = declare_readers()
    planned = reader.outputs({}, params)["imu"]
    assert planned["accel_x"].quantity == "acceleration"
    assert "gyro_x" not in planned
    streams = read_text(tmp_path, ROWS, IMU.replace("unit: g", "unit: g, at_rest: zero"))
    assert conform(streams["imu"], planned, stream="imu", step="reader").num_rows == 3
    assert warnings_of(streams["metrics"]) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("unit: m/s^2", "check the unit of accel"),
        ("unit: g, axes: FRD", "at_rest: down"),
        ("unit: g, axes: ENU", "axes of the Earth"),
    ],
)
def test_accelerations_that_contradict_the_mapping_are_a_warning(tmp_path: Path, change: str, words: str) -> None:
    streams = read_text(tmp_path, ROWS, IMU.replace("unit: g", change))
    assert words in " ".join(warnings_of(streams["metrics"]))


def test_raw_counts_are_scaled_and_invalid_numbers_are_blank(tmp_path: Path) -> None:
    change = "unit: g, scale: 6.103515625e-05, invalid: [-9999]"
    imu = read_text(tmp_path, "t,ax,ay,az\n0,0,0,16384\n1,-9999,0,16384\n", IMU.replace("unit: g", change))["imu"]
    assert matrix(imu, "accel", gaps=True)[0].tolist() == [0, 0, G]
    assert np.isnan(matrix(imu, "accel", gaps=True)[1]).tolist() == [True, False, False]


def test_velocity_and_its_sigma_come_as_east_north_up(tmp_path: Path) -> None:
    mapping = """
gnss:
  time: {column: 1, format: relative}
  vel: {columns: [2, 3, 4], unit: m/s, axes: NED}
  vel_std: {columns: [5, 6, 7], unit: m/s, axes: NED}
"""
    gnss = read_text(tmp_path, "0,1,2,3,0.1,0.2,0.3\n1,1,2,3,0.1,0.2,0.3\n", mapping)["gnss"]
    assert matrix(gnss, "vel")[0].tolist() == [2, 1, -3]
    assert matrix(gnss, "vel_std")[0].tolist() == [0.2, 0.1, 0.3]


def test_a_position_of_zero_zero_is_no_position(tmp_path: Path) -> None:
    mapping = "gnss: {time: {column: 1, format: relative}, lat: {column: 2}, lon: {column: 3}, fix: {column: 4}}"
    gnss = read_text(tmp_path, "0,0,0,0\n1,44.5,11.3,3\n", mapping)["gnss"]
    assert np.isnan(vector(gnss, "lat", gaps=True)).tolist() == [True, False]
