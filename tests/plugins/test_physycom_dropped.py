"""Rows and values of a Physycom log that are dropped or doubted, counted and told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from metric_rows import row_named
from physycom_logs import (
    HELD_ROWS,
    T0,
    G,
    counts,
    held,
    motion,
    read_text,
    refusal,
    text_of,
)

from recon.rows import warnings_of
from recon.tables import meta, time_ns


@pytest.mark.parametrize("lost", [1, 2, 5, 40, 100])
def test_a_cut_last_row_is_dropped_counted_and_told(tmp_path: Path, lost: int) -> None:
    text = text_of(motion(60))
    # Losing the line end and one digit, or more, leaves the row without its last number as it was written.
    streams = read_text(tmp_path, text[: -1 - lost])
    assert streams["imu"].num_rows == 59
    assert counts(streams) == (60, 59, 1)
    assert "line 61" in row_named(streams, "rows_dropped")["note"]
    assert "cut off" in warnings_of(streams["metrics"])[0]


@pytest.mark.parametrize("shift", [-3, 0])
def test_a_few_rows_out_of_time_are_dropped_counted_and_told(tmp_path: Path, shift: int) -> None:
    rows = motion(400)
    rows[300, 0] = rows[299 + shift, 0]
    streams = read_text(tmp_path, text_of(rows))
    assert streams["imu"].num_rows == 399
    assert counts(streams) == (400, 399, 1)
    (told,) = warnings_of(streams["metrics"])
    assert "1 of 400 rows" in told
    assert "line 302" in told


@pytest.mark.parametrize("row", [0, 1, 200, 398, 399])
@pytest.mark.parametrize("years", [-16, 10, 200])
def test_one_row_years_away_is_dropped_alone(tmp_path: Path, row: int, years: int) -> None:
    rows = motion(400, place=False)
    text = text_of(rows).splitlines()
    text[row + 1] = text[row + 1].replace(str(T0), str(T0 + years * 31_557_600)).replace(str(T0 + 1), "0")
    streams = read_text(tmp_path, "\n".join(text) + "\n")
    # Beside the first or the last row, nothing tells which of the two is the stray one.
    beside = row in (1, 398)
    assert counts(streams)[2] in ((1, 2) if beside else (1,))
    assert time_ns(streams["imu"])[-1] - time_ns(streams["imu"])[0] <= 1_995_000_000
    told = warnings_of(streams["metrics"])[-1]
    assert f"line {row + 2}" in told or beside


def test_a_pause_of_years_at_standstill_is_kept_and_told_and_costs_nothing(tmp_path: Path) -> None:
    rows = held(motion(1000, place=False))
    rows[300:700, 1] = 0.0
    lines = text_of(rows).splitlines()
    years = 16 * 31_557_600  # with one report each 0.1 s these would be 5e9 rows
    late = [f"{int(line[:9]) + years}{line[9:]}" for line in lines[501:]]
    streams = read_text(tmp_path, "\n".join(lines[:501] + late) + "\n")
    assert streams["imu"].num_rows == 1000
    assert 40 <= streams["gnss"].num_rows <= 51  # 5 s at 10 Hz; a pause may cost or add a report at its ends
    told = warnings_of(streams["metrics"])
    assert told[0] == "no rows for 16 years after line 501: are these several drives?"


def test_a_dropped_row_does_not_make_news_of_held_gnss(tmp_path: Path) -> None:
    rows = held(motion(400))
    rows[305] = rows[5]
    assert read_text(tmp_path, text_of(rows))["gnss"].num_rows == 400 // HELD_ROWS


def test_a_log_whose_time_runs_backwards_is_refused_with_its_first_line(tmp_path: Path) -> None:
    rows = motion(400)
    rows[200:, 0] -= 0.5
    error = refusal(tmp_path, text_of(rows))
    assert (error.line, error.column) == (202, 1)
    assert "100 of 400" in error.message


def test_blank_rows_are_dropped_and_counted(tmp_path: Path) -> None:
    rows = motion(400)
    rows[100, 1:] = np.nan
    streams = read_text(tmp_path, text_of(rows))
    assert counts(streams) == (400, 399, 1)
    assert "line 102" in row_named(streams, "rows_dropped")["note"]


def test_a_module_that_contradicts_its_components_is_warned_of(tmp_path: Path) -> None:
    rows = motion(400)
    rows[100:120, 12] += 0.1
    assert warnings_of(read_text(tmp_path, text_of(rows))["metrics"])[0].startswith("|a| differs")


def test_relative_times_that_contradict_the_timestamps_are_warned_of(tmp_path: Path) -> None:
    rows = motion(400)
    rows[300:, 13] += 1.0
    assert warnings_of(read_text(tmp_path, text_of(rows))["metrics"])[0].startswith("timestamp_rel differs")


def scaled(factor: float) -> str:
    rows = motion(400)
    rows[:, 6:9] *= factor
    rows[:, 12] *= factor
    return text_of(rows)


def test_accelerations_that_are_not_in_g_are_warned_of(tmp_path: Path) -> None:
    assert any("'gravity'" in told for told in warnings_of(read_text(tmp_path, scaled(G))["metrics"]))
    told = warnings_of(read_text(tmp_path, scaled(G), gravity=1.0)["metrics"])
    assert not any("'gravity'" in text for text in told)


def test_accelerations_that_no_vehicle_survives_are_another_unit(tmp_path: Path) -> None:
    error = refusal(tmp_path, scaled(1000.0))
    assert "az 100" in error.message
    assert "'gravity'" in error.hint
    told = warnings_of(read_text(tmp_path, scaled(1000.0), gravity=0.001 * G)["metrics"])
    assert not any("'gravity'" in text or "outside" in text for text in told)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        (6, 90_000.0, "ax 90000 lies outside -1000 to 1000 g"),
        (5, 1400.0, "speed 1400 lies outside 0 to 600 km/h"),
        (5, -3.0, "speed -3 lies outside"),
        (3, 99_999.0, "height 99999 lies outside -1000 to 10000 m"),
        (9, np.inf, "gx inf lies outside"),
    ],
)
def test_a_value_that_cannot_be_is_null_counted_and_told(tmp_path: Path, column: int, value: float, says: str) -> None:
    rows = motion(400)
    sound = read_text(tmp_path, text_of(rows))
    rows[300, column] = value
    streams = read_text(tmp_path, text_of(rows))
    assert row_named(streams, "values_outside_limits")["value"] == 1.0
    (told,) = warnings_of(streams["metrics"])
    assert f"{says}" in told
    assert "in 1 of 400 rows, first in line 302" in told
    # All other values are those of the sound log, and there is no other one instead.
    nulls = sum(column.null_count for name in ("imu", "gnss") for column in streams[name].columns)
    assert nulls == 1
    assert time_ns(streams["imu"]).tolist() == time_ns(sound["imu"]).tolist()


def test_limits_count_in_the_unit_that_the_parameters_tell(tmp_path: Path) -> None:
    rows = motion(400)
    rows[300, 5] = 300.0  # m/s: 1080 km/h
    assert warnings_of(read_text(tmp_path, text_of(rows))["metrics"]) == []
    assert "speed 1080" in warnings_of(read_text(tmp_path, text_of(rows), speed_unit="m/s")["metrics"])[0]


def test_times_that_count_from_1970_are_warned_of(tmp_path: Path) -> None:
    rows = motion(60)
    text = text_of(rows).replace(str(T0), "1600000000").replace(str(T0 + 1), "1600000001")
    assert any("1970" in told for told in warnings_of(read_text(tmp_path, text)["metrics"]))


def test_a_clock_that_was_not_set_is_not_absolute(tmp_path: Path) -> None:
    streams = read_text(tmp_path, "# timestamp ax ay az\n0.00\t0\t0\t1\n0.01\t0\t0\t1\n")
    assert meta(streams["imu"])["clock"] == "relative"
    assert "not set" in warnings_of(streams["metrics"])[0]
