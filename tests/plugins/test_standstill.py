from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.numerics.moving_window import moving_average
from recon.numerics.signals import changes
from recon.rows import spans, warnings_of
from recon.schema import GNSS, IMU
from recon.tables import Array, build
from recon_detectors.standstill import StandstillParams, declare_detectors, standstill

T0_NS = 1_700_000_000_000_000_000
RATE_HZ = 50.0
KMH = 1 / 3.6
STOPS = ((0.0, 30.0), (90.0, 110.0))
"""s; between them the car drives at 12 m/s."""


def speed_at(t_s: Array) -> Array:
    standing = [(t_s >= start) & (t_s <= end) for start, end in STOPS]
    return np.where(np.any(standing, axis=0), 0.0, 12.0)


def imu_of(t_s: Array) -> Any:
    """A box of 0.01 deg/s/sqrt(Hz) and 150 ug/sqrt(Hz), in motion shaken by 1 deg/s and 0.5 m/s^2, slowly and fast."""
    rng = np.random.default_rng(5)
    moving = (speed_at(t_s) > 0)[:, None]

    def noisy(density: float, road: float) -> Array:
        white, rattle, slow = rng.standard_normal((3, len(t_s), 3))
        return density * np.sqrt(RATE_HZ) * white + moving * road * (rattle + 3 * moving_average(slow, 9))

    accel = noisy(1.5e-3, 0.5) + np.array([0.0, 0.0, 9.8])
    return build(IMU, time=T0_NS + np.rint(t_s * 1e9).astype(np.int64), gyro=noisy(1.7e-4, 0.017), accel=accel)


def gnss_of(t_s: Array, **columns: Array) -> Any:
    return build(GNSS, time=T0_NS + np.rint(t_s * 1e9).astype(np.int64), **columns)


IMU_S = np.arange(0.0, 150.0, 1 / RATE_HZ)
GNSS_S = np.arange(0.3, 150.0, 1.0)


def found(imu: Any, gnss: Any, **params: Any) -> Array:
    """Standstills in s since the beginning."""
    streams = standstill(imu=imu, gnss=gnss, params=StandstillParams(**params))
    return np.array([(start - T0_NS, end - T0_NS) for start, end in spans(streams["events"], "standstill")]) * 1e-9


def assert_stops_of_the_car(stops: Array) -> None:
    assert len(stops) == 2
    starts, ends = stops.T
    true_starts, true_ends = np.array(STOPS).T
    # A window of 1.1 s about every block within 0.5 s must be quiet: 1.1 s at most, and as much as that is lost.
    assert (starts >= true_starts).all()
    assert (ends <= true_ends).all()
    assert (starts <= true_starts + np.array([0.0, 1.3])).all()
    assert (ends >= true_ends - 1.3).all()


def test_stops_of_a_car_are_found_by_imu_and_gnss() -> None:
    assert_stops_of_the_car(found(imu_of(IMU_S), gnss_of(GNSS_S, speed=speed_at(GNSS_S))))


def test_stops_of_a_car_are_found_without_gnss_and_it_is_said() -> None:
    imu = imu_of(IMU_S)
    assert_stops_of_the_car(found(imu, None))
    streams = standstill(imu=imu, gnss=None, params=StandstillParams())
    assert warnings_of(streams["metrics"]) == ["gnss tells no speed: only a car with clear stops is seen to stand"]


def test_velocity_stands_in_where_no_speed_is_reported() -> None:
    imu, speed = imu_of(IMU_S), speed_at(GNSS_S)
    vel = np.column_stack((0.6 * speed, -0.8 * speed, np.full(len(speed), 3.0)))
    missing = np.where(np.arange(len(speed)) % 2, np.nan, speed)
    expected = found(imu, gnss_of(GNSS_S, speed=speed))
    assert found(imu, gnss_of(GNSS_S, vel=vel)) == pytest.approx(expected, abs=1e-9)
    assert found(imu, gnss_of(GNSS_S, vel=vel, speed=missing)) == pytest.approx(expected, abs=1e-9)


def test_a_box_at_rest_in_what_gnss_says_is_moving_does_not_stand() -> None:
    t_s = IMU_S[IMU_S < 30.0]  # all of it is the first stop
    streams = standstill(
        imu=imu_of(t_s), gnss=gnss_of(GNSS_S, speed=np.full(len(GNSS_S), 8.0)), params=StandstillParams()
    )
    assert streams["events"].num_rows == 0
    assert warnings_of(streams["metrics"]) == ["no standstill: nothing is both quiet and slow enough for certain"]


def test_events_begin_and_end_at_rows_of_the_log() -> None:
    t_s = np.delete(IMU_S, slice(700, 850))  # a gap of 3 s in the first stop
    stops = found(imu_of(t_s), gnss_of(GNSS_S, speed=speed_at(GNSS_S)))
    assert len(stops) == 3
    assert np.abs(stops.ravel()[:, None] - t_s).min(axis=1).max() < 1e-6
    assert (stops[0] <= IMU_S[699]).all()
    assert (stops[1] >= IMU_S[850]).all()


def test_rows_that_miss_a_number_are_left_out() -> None:
    imu = imu_of(IMU_S)
    gyro = np.column_stack([imu[f"gyro_{axis}"].to_numpy() for axis in "xyz"])
    accel = np.column_stack([imu[f"accel_{axis}"].to_numpy() for axis in "xyz"])
    accel[3::7] = np.nan
    holed = build(IMU, time=imu["time"], gyro=gyro, accel=accel)
    assert_stops_of_the_car(found(holed, gnss_of(GNSS_S, speed=speed_at(GNSS_S))))


def test_a_standstill_shorter_than_asked_for_does_not_count() -> None:
    imu, gnss = imu_of(IMU_S), gnss_of(GNSS_S, speed=speed_at(GNSS_S))
    assert found(imu, gnss, min_duration=25.0) == pytest.approx(found(imu, gnss)[:1])
    assert len(found(imu, gnss, min_duration=40.0)) == 0


@pytest.mark.parametrize("rows", [0, 1, 30])
def test_a_log_of_next_to_nothing_ends_with_a_warning(rows: int) -> None:
    gnss = gnss_of(GNSS_S, speed=speed_at(GNSS_S))
    streams = standstill(imu=imu_of(IMU_S[:rows]), gnss=gnss, params=StandstillParams())
    assert streams["events"].num_rows == 0
    assert any(note.startswith("no standstill: ") for note in warnings_of(streams["metrics"]))


def test_metrics_tell_limits_and_noise() -> None:
    gnss = gnss_of(GNSS_S, speed=speed_at(GNSS_S))
    streams = standstill(imu=imu_of(IMU_S), gnss=gnss, params=StandstillParams())
    learnt = {row["name"]: row["value"] for row in streams["metrics"].to_pylist()}
    assert learnt["standstills"] == 2.0
    assert 45.0 < learnt["still_time"] < 50.0
    assert learnt["imu_decides_alone"] == 0.0  # it never creeps, so nobody knows how quiet it is then
    # Some 45 s of three axes: 1.5 * 45 * 3 degrees of freedom, 5 % sigma; four of them.
    assert learnt["gyro_noise"] == pytest.approx(np.degrees(1.7e-4), rel=0.2)
    assert learnt["accel_noise"] == pytest.approx(1.5e-3, rel=0.2)
    # The spread of ten means of 0.1 s of white noise, times two, three axes: 2 sqrt(3 * 10) N, less 20 % for the
    # percentile and the degree of freedom that the mean of a window takes.
    assert learnt["gyro_limit"] == pytest.approx(2 * np.sqrt(30) * np.degrees(1.7e-4), rel=0.3)


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_detectors()] == [[]]


def test_the_crash_log_stands_before_the_pull_away_and_after_the_crash() -> None:
    if "RECON_TEST_DATA" not in os.environ:
        pytest.skip("RECON_TEST_DATA does not name the folder of real logs")
    path = Path(os.environ["RECON_TEST_DATA"]) / "physycom_crash" / "crash_01.txt"
    log = np.loadtxt(path, skiprows=1)
    t_s, fresh = log[:, 9], changes(log[:, 1])
    imu = build(
        IMU,
        time=T0_NS + np.rint(t_s * 1e9).astype(np.int64),
        gyro=np.radians(log[:, 5:8]),
        accel=log[:, 2:5] * 9.80665,
    )
    stops = found(imu, gnss_of(t_s[fresh], speed=log[fresh, 1] * KMH))
    # By its accelerometer the car starts at 54.3 s, hits at 60.3 s and comes to rest at about 63 s.
    assert not ((stops[:, 0] < 63.0) & (stops[:, 1] > 54.3)).any()
    lasting = np.clip(stops[:, 1], None, 54.3) - stops[:, 0]
    assert lasting[lasting > 0].sum() > 40.0
    assert (stops[:, 0] > 63.0).any()
