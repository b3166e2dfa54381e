"""How the rows of a Physycom log are filled: GNSS held or interpolated, sensors in turn, values missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from metric_rows import row_named
from physycom_logs import (
    HELD_ROWS,
    T0_UTC_NS,
    G,
    counts,
    held,
    motion,
    read_text,
    text_of,
)

from recon.rows import warnings_of
from recon.tables import Array, has, matrix, time_ns


def test_interpolated_gnss_is_kept_on_every_row(tmp_path: Path) -> None:
    assert read_text(tmp_path, text_of(motion()))["gnss"].num_rows == 400


def test_held_gnss_is_kept_where_it_changes(tmp_path: Path) -> None:
    rows = held(motion())
    streams = read_text(tmp_path, text_of(rows))
    assert streams["imu"].num_rows == 400
    assert (time_ns(streams["gnss"]) - T0_UTC_NS).tolist() == [100_000_000 * k for k in range(400 // HELD_ROWS)]
    assert "repeated" in row_named(streams, "gnss_fill")["note"]
    assert row_named(streams, "gnss_period")["value"] == pytest.approx(0.1, abs=1e-12)


def test_a_constant_speed_at_standstill_is_no_gap(tmp_path: Path) -> None:
    rows = held(motion(1000, place=False))
    rows[300:700, 1] = 0.0
    gnss = read_text(tmp_path, text_of(rows))["gnss"]
    assert np.diff(time_ns(gnss)).tolist() == [100_000_000] * 49


def test_a_frozen_speed_in_motion_is_an_outage(tmp_path: Path) -> None:
    rows = held(motion(1000, place=False))
    rows[300:700, 1] = rows[300, 1]
    gnss = read_text(tmp_path, text_of(rows))["gnss"]
    steps = np.diff(time_ns(gnss))
    assert sorted(set(steps.tolist())) == [100_000_000, 2_000_000_000]
    assert (steps == 2_000_000_000).sum() == 1


def test_a_gap_of_the_log_at_standstill_stays_a_gap(tmp_path: Path) -> None:
    rows = held(motion(1000, place=False))
    rows[300:700, 1] = 0.0
    gnss = read_text(tmp_path, text_of(np.delete(rows, np.arange(400, 600), axis=0)))["gnss"]
    assert np.diff(time_ns(gnss)).max() >= 1_000_000_000


def test_gnss_that_never_changes_is_one_row_and_a_warning(tmp_path: Path) -> None:
    rows = motion(place=False)
    rows[:, 1] = 0.0
    streams = read_text(tmp_path, text_of(rows))
    assert streams["gnss"].num_rows == 1
    assert "GNSS" in warnings_of(streams["metrics"])[0]


def test_a_position_of_zero_zero_is_null(tmp_path: Path) -> None:
    rows = motion()
    rows[:10, 1:3] = 0.0
    gnss = read_text(tmp_path, text_of(rows))["gnss"]
    assert [gnss[name].null_count for name in ("lat", "lon", "height", "speed")] == [10, 10, 10, 0]


def alternating(fill: str) -> tuple[Array, Array]:
    """Rows that update in turn accelerometer, gyroscope, accelerometer, gyroscope, GNSS; and which one it was."""
    rows = motion(500)
    sensor = np.resize([0, 1, 0, 1, 2], len(rows))
    groups = ([6, 7, 8, 12], [9, 10, 11], [1, 2, 3, 4, 5])
    out = np.full_like(rows, np.nan)
    out[:, [0, 13]] = rows[:, [0, 13]]
    for number, columns in enumerate(groups):
        own = np.flatnonzero(sensor == number)
        out[np.ix_(own, columns)] = rows[np.ix_(own, columns)]
        if fill == "repeated":
            last = np.maximum.accumulate(np.where(sensor == number, np.arange(len(rows)), 0))
            out[:, columns] = rows[np.ix_(last, columns)]
    return out, sensor


@pytest.mark.parametrize(("fill", "blank"), [("repeated", ""), ("blank", ""), ("blank", "NaN"), ("blank", "nan")])
def test_rows_that_update_one_sensor_leave_the_others_null(tmp_path: Path, fill: str, blank: str) -> None:
    rows, sensor = alternating(fill)
    streams = read_text(tmp_path, text_of(rows, blank=blank))
    imu, gnss = streams["imu"], streams["gnss"]
    own = sensor[sensor != 2]
    # The first row of a repeating file holds all sensors and counts for all of them.
    start = 1
    assert imu.num_rows == len(own)
    has_accel = np.isfinite(matrix(imu, "accel", gaps=True)).all(axis=1)
    has_gyro = np.isfinite(matrix(imu, "gyro", gaps=True)).all(axis=1)
    np.testing.assert_array_equal(has_accel[start:], own[start:] == 0)
    np.testing.assert_array_equal(has_gyro[start:], own[start:] == 1)
    np.testing.assert_allclose(
        matrix(imu, "accel", gaps=True)[has_accel], rows[np.flatnonzero(sensor == 0)][:, 6:9] * G, atol=0.5e-6
    )
    late = time_ns(gnss) > T0_UTC_NS
    np.testing.assert_array_equal(time_ns(gnss)[late], T0_UTC_NS + np.flatnonzero(sensor == 2) * 5_000_000)
    assert counts(streams) == (500, 500, 0)


def test_rows_that_update_gnss_alone_are_no_imu_rows(tmp_path: Path) -> None:
    rows = motion(place=False)
    alone = np.arange(len(rows)) % 5 == 4
    rows[alone, 2:9] = rows[np.flatnonzero(alone) - 1, 2:9]
    rows[:, 1] = rows[np.maximum.accumulate(np.where(alone, np.arange(len(rows)), 0)), 1]
    streams = read_text(tmp_path, text_of(rows))
    assert streams["imu"].num_rows == 320
    assert np.isfinite(matrix(streams["imu"], "accel")).all()
    assert counts(streams) == (400, 400, 0)


def test_a_coarse_sensor_at_rest_is_not_taken_for_a_repeated_one(tmp_path: Path) -> None:
    rows = motion(place=False)
    rng = np.random.default_rng(2)
    rows[:, 2:8] = [0, 0, 1, 0, 0, 0] + 0.01 * (rng.random((len(rows), 6)) < 0.05)
    rows[:, 8] = np.linalg.norm(rows[:, 2:5], axis=1)
    streams = read_text(tmp_path, text_of(rows))
    assert streams["imu"].num_rows == 400
    assert np.isfinite(matrix(streams["imu"], "gyro")).all()


def test_rows_of_one_time_that_complement_each_other_become_one(tmp_path: Path) -> None:
    rows, sensor = alternating("blank")
    rows = rows[sensor != 2]
    rows[1::2, 0] = rows[::2, 0]
    imu = read_text(tmp_path, text_of(rows))["imu"]
    assert imu.num_rows == 200
    assert has(imu, "accel")
    assert np.isfinite(np.column_stack([matrix(imu, "accel"), matrix(imu, "gyro")])).all()


@pytest.mark.parametrize(("count", "warned"), [(1, False), (4, False), (5, True), (100, True)])
def test_values_missing_in_one_axis_are_null_and_counted(tmp_path: Path, count: int, warned: bool) -> None:
    rows = motion()
    rows[7 : 7 + count, 6] = np.nan
    streams = read_text(tmp_path, text_of(rows, blank="NaN"))
    imu = streams["imu"]
    assert imu["accel_x"].null_count == count
    assert imu["accel_y"].null_count == 0
    assert imu.num_rows == 400
    missing = row_named(streams, "values_missing")
    assert (missing["method"], missing["value"]) == ("ax", count)
    assert missing["note"] == f"ax is missing in {count} of 400 rows of accel, first in line 9"
    # More than 1 % of the rows is more than a few.
    assert warnings_of(streams["metrics"]) == [missing["note"]] * warned


def test_a_column_without_any_value_is_warned_of(tmp_path: Path) -> None:
    rows = motion(place=False)
    rows[:, 1] = np.nan
    streams = read_text(tmp_path, text_of(rows, blank="NaN"))
    assert "gnss" not in streams
    assert warnings_of(streams["metrics"]) == ["speed is missing in 400 of 400 rows of gnss, first in line 2"]
