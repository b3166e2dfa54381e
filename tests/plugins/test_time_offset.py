from __future__ import annotations

import numpy as np
import pytest

import recon
from recon import GNSS, IMU, build, matrix, time_ns, vector
from recon.errors import NotEnoughData
from recon.rows import warnings_of
from recon.tables import replace
from recon_aligners.time_offset import TimeOffsetParams, declare_aligners, shift_gnss
from recon_simulators.drive import DriveParams, simulate_drive

PARAMS = TimeOffsetParams()
NO_IMU = build(IMU, time=np.zeros(0, dtype=np.int64), accel=np.zeros((0, 3)), gyro=np.zeros((0, 3)))


def drive(lag_s=0.0, **given):
    """Ten minutes with a box of the consumer's class and a fix each second, late by lag_s."""
    return simulate_drive(DriveParams(**{"motion": "mixed", "duration": 600.0, "gnss_lag": lag_s, **given}))


def shifted(streams, params=PARAMS):
    return shift_gnss(imu=streams["imu"], gnss=streams["gnss"], params=params)


def delay(result):
    """The lag that was found and its sigma, s."""
    (row,) = [row for row in result["metrics"].to_pylist() if row["name"] == "gnss_delay"]
    return row["value"], row["sigma"]


def moved_s(streams, result):
    return (time_ns(result["gnss"]) - time_ns(streams["gnss"])) * 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_the_lag_of_a_simulated_receiver_is_found(seed):
    lag_s = 0.25 * seed
    value, sigma = delay(shifted(drive(lag_s, seed=seed, route=seed)))
    assert abs(value - lag_s) < 3.0 * sigma
    assert sigma < 0.05


@pytest.mark.parametrize("sensors", ["study_one", "study_two"])
def test_antennas_ahead_and_bodies_that_lean_do_not_mislead(sensors):
    value, sigma = delay(shifted(drive(0.4, sensors=sensors)))
    assert abs(value - 0.4) < 3.0 * sigma


def test_every_stamp_moves_by_the_lag_and_nothing_else_changes():
    streams = drive(0.7)
    result = shifted(streams)
    value, _ = delay(result)
    np.testing.assert_array_equal(moved_s(streams, result), -round(value * 1e9) * 1e-9)
    assert result["gnss"].drop_columns("time").equals(streams["gnss"].drop_columns("time"))
    assert result["gnss"].schema.equals(streams["gnss"].schema, check_metadata=True)
    assert set(result) == {"gnss", "metrics"}


def test_a_second_run_finds_nothing_more_to_shift():
    streams = drive(0.7)
    again = shifted({**streams, "gnss": shifted(streams)["gnss"]})
    # Only the place of the stamps on the grid of lags differs: a few percent of its step of 0.1 s.
    assert delay(again)[0] == pytest.approx(0.0, abs=0.005)


def test_velocities_serve_where_there_is_no_speed():
    streams = drive(0.5)
    gnss = streams["gnss"].drop_columns(["speed", "course"])
    value, sigma = delay(shifted({**streams, "gnss": gnss}))
    assert abs(value - 0.5) < 3.0 * sigma


def test_a_box_in_the_frame_of_the_vehicle_serves_as_well():
    streams = drive(0.5)
    accel = matrix(streams["imu"], "accel") @ np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    value, sigma = delay(shifted({**streams, "imu": replace(streams["imu"], accel=accel)}))
    assert abs(value - 0.5) < 3.0 * sigma


def left_alone(streams, params=PARAMS):
    """The one warning of a run that shifts nothing."""
    result = shifted(streams, params)
    assert result["gnss"].equals(streams["gnss"])
    (text,) = warnings_of(result["metrics"])
    return text


def test_a_standing_vehicle_is_told_and_nothing_is_shifted():
    assert "no lag up to 2 s" in left_alone(drive(0.5, motion="rest", duration=120.0))


def test_a_lag_beyond_the_largest_is_told_and_nothing_is_shifted():
    assert "no lag up to 0.5 s" in left_alone(drive(1.5), TimeOffsetParams(largest=0.5))


def test_without_speeds_nothing_is_shifted():
    streams = drive(motion="straight", duration=40.0)
    gnss = build(GNSS, time=time_ns(streams["gnss"]), lat=vector(streams["gnss"], "lat", gaps=True))
    assert "no speed" in left_alone({**streams, "gnss": gnss})


def test_a_log_of_a_few_rows_is_left_alone():
    streams = drive(motion="straight", duration=40.0)
    assert "too few" in left_alone({**streams, "imu": streams["imu"].slice(0, 5)})


def test_an_empty_imu_is_not_enough():
    with pytest.raises(NotEnoughData, match="rows in imu"):
        shifted({**drive(motion="straight", duration=40.0), "imu": NO_IMU})


def test_on_a_real_crash_log_the_speed_is_late(logs):
    streams = recon.read(logs / "physycom_crash" / "crash_01.txt").streams
    value, sigma = delay(shifted(streams))
    # Pulling away, 4 m/s are reached 0.40 s later by GNSS than by the integral of the accelerometer.
    assert abs(value - 0.4) < 2.0 * sigma
    assert value > 0.1


def test_it_declares_itself():
    (record,) = declare_aligners()
    assert record.key == "aligner.time_offset"
    assert not record.faults()


def test_a_lag_that_is_known_and_grows_is_taken_off():
    streams = drive()
    result = shifted(streams, TimeOffsetParams(shift=18.0, drift=1e-3))
    since_s = (time_ns(streams["gnss"]) - time_ns(streams["imu"])[0]) * 1e-9
    # Times are whole nanoseconds.
    np.testing.assert_allclose(moved_s(streams, result), -18.0 - 1e-3 * (since_s - 18.0), rtol=0.0, atol=1e-9)
    assert delay(result)[0] == 18.0
