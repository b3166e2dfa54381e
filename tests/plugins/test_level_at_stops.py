from __future__ import annotations

import numpy as np
import pytest
from metric_rows import values_by_name

from recon import IMU, Event, build, events, matrix
from recon.errors import DataError, NotEnoughData
from recon.numerics.rotation import conjugate, from_euler, rotate
from recon.rows import warnings_of
from recon_aligners.level_at_stops import LevelParams, declare_aligners, level

G = 9.80665
STOP = events([Event(0, 10**9, "standstill")])
# Rotations of unit quaternions take some ten operations: rounding of 1e-15 relative, 1e-14 m/s^2 of g.
ROUNDING = 1e-13


def still_imu(force_s, rows=11):
    """A still box at 10 Hz that feels force_s (3,) or (rows, 3)."""
    force_s = np.broadcast_to(force_s, (rows, 3)).copy()
    return build(IMU, time=np.arange(rows) * 100_000_000, accel=force_s, gyro=np.tile([0.1, 0.2, 0.3], (rows, 1)))


def test_a_level_box_is_not_turned_at_all():
    imu = still_imu([0.0, 0.0, G])
    result = level(imu=imu, events=STOP, params=LevelParams())
    assert np.array_equal(matrix(result["imu"], "accel"), matrix(imu, "accel"))
    assert np.array_equal(matrix(result["imu"], "gyro"), matrix(imu, "gyro"))


@pytest.mark.parametrize("force", [[0.0, 0.0, -G], [1e-9, 0.0, -G], [G, 0.0, 0.0], [0.0, -G, 0.0], [3.0, -4.0, 7.0]])
def test_gravity_points_up_whichever_way_the_box_lies(force):
    result = level(imu=still_imu(force), events=STOP, params=LevelParams())
    up = np.tile([0.0, 0.0, np.linalg.norm(force)], (11, 1))
    np.testing.assert_allclose(matrix(result["imu"], "accel"), up, atol=ROUNDING)


def test_the_tilt_of_the_mount_is_told_as_roll_and_pitch():
    q_ls = from_euler(0.0, np.radians(-12.0), np.radians(25.0))
    result = level(imu=still_imu(rotate(conjugate(q_ls), [0.0, 0.0, 1.01 * G])), events=STOP, params=LevelParams())
    assert values_by_name(result)["mount_roll"] == pytest.approx(25.0, abs=1e-12)
    assert values_by_name(result)["mount_pitch"] == pytest.approx(-12.0, abs=1e-12)
    assert values_by_name(result)["gravity_measured"] == pytest.approx(1.01 * G, abs=ROUNDING)


def test_gyroscopes_turn_with_the_accelerometers():
    imu = still_imu([3.0, -4.0, 7.0])
    turned = level(imu=imu, events=STOP, params=LevelParams())["imu"]
    for group in ("accel", "gyro"):
        before, after = (np.sum(matrix(t, group) * matrix(t, "accel"), axis=1) for t in (imu, turned))
        np.testing.assert_allclose(after, before, atol=1e-12)


def test_only_the_first_stop_levels_and_a_later_one_that_disagrees_is_named():
    force = np.tile([0.0, 0.0, G], (41, 1))
    force[20:] = rotate(from_euler(0.0, np.radians(5.0), 0.0), [0.0, 0.0, G])
    stops = events([Event(0, 10**9, "standstill"), Event(25 * 10**8, 4 * 10**9, "standstill")])
    result = level(imu=still_imu(force, 41), events=stops, params=LevelParams())
    assert np.array_equal(matrix(result["imu"], "accel"), force)
    (note,) = warnings_of(result["metrics"])
    assert "2.5 s" in note
    assert "5.0 deg" in note


def test_a_later_stop_within_the_tolerance_gives_no_warning():
    force = np.tile([0.0, 0.0, G], (41, 1))
    force[20:] = rotate(from_euler(0.0, np.radians(2.9), 0.0), [0.0, 0.0, G])
    stops = events([Event(0, 10**9, "standstill"), Event(25 * 10**8, 4 * 10**9, "standstill")])
    assert warnings_of(level(imu=still_imu(force, 41), events=stops, params=LevelParams())["metrics"]) == []


def test_many_stops_that_disagree_are_counted_after_the_first_three():
    force = np.tile([0.0, 0.0, G], (101, 1))
    force[5:] = [G, 0.0, 0.0]
    stops = events([Event(k * 10**9, k * 10**9 + 400_000_000, "standstill") for k in range(8)])
    notes = warnings_of(level(imu=still_imu(force, 101), events=stops, params=LevelParams())["metrics"])
    assert len(notes) == 4
    assert "4 more of 8 stops" in notes[-1]


def test_without_a_stop_there_is_nothing_to_level_by():
    with pytest.raises(NotEnoughData, match="not enough stops"):
        level(imu=still_imu([0.0, 0.0, G]), events=events([]), params=LevelParams())


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_a_log_of_few_rows_is_called_that(rows):
    with pytest.raises(NotEnoughData, match=f"not enough rows in imu: needs at least 10, found {rows}"):
        level(imu=still_imu([0.0, 0.0, G], rows), events=events([]), params=LevelParams())


def test_standstills_at_another_time_than_the_imu_are_called_that():
    late = events([Event(3600 * 10**9, 3660 * 10**9, "standstill")])
    with pytest.raises(DataError, match=r"1 standstills were found, none while imu runs: imu from 0\.0 s to 1\.0 s"):
        level(imu=still_imu([0.0, 0.0, G]), events=late, params=LevelParams())


@pytest.mark.parametrize("rows", [1, 2])
def test_a_stop_of_a_row_or_two_is_enough(rows):
    result = level(imu=still_imu([0.0, 0.0, -G], rows), events=STOP, params=LevelParams())
    np.testing.assert_allclose(matrix(result["imu"], "accel"), np.tile([0.0, 0.0, G], (rows, 1)), atol=ROUNDING)


def test_a_box_that_feels_no_gravity_is_refused():
    with pytest.raises(DataError, match="must feel gravity"):
        level(imu=still_imu([0.01, -0.02, 0.05]), events=STOP, params=LevelParams())


def test_the_record_is_without_faults():
    (record,) = declare_aligners()
    assert record.faults() == []
