from __future__ import annotations

import json
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from physycom_logs import (
    GOOD,
    HEAD,
    HELD_ROWS,
    RECORDS,
    T0,
    T0_UTC_NS,
    counts,
    held,
    metric,
    motion,
    read_text,
    refusal,
    text_of,
)

from recon.errors import DataError, ReadFailed
from recon.joining import combine
from recon.recording import Recording
from recon.rows import warnings_of
from recon.tables import Array, conform, has, matrix, meta, time_ns, vector
from recon_readers.physycom import PhysycomParams, declare_readers, read

G = 9.80665


# --- what comes out ---------------------------------------------------------------------------------------------------


def test_a_fullinertial_file_gives_imu_and_gnss_in_si(tmp_path: Path) -> None:
    rows = motion()
    streams = read_text(tmp_path, text_of(rows))
    imu, gnss = streams["imu"], streams["gnss"]
    # The text has 7 decimals: half a unit of the last one, times the factor of the unit.
    np.testing.assert_allclose(matrix(imu, "accel"), rows[:, 6:9] * G, atol=0.5e-7 * G + 1e-12)
    np.testing.assert_allclose(matrix(imu, "gyro"), np.deg2rad(rows[:, 9:12]), atol=0.5e-7)
    np.testing.assert_allclose(vector(gnss, "speed"), rows[:, 5] / 3.6, atol=0.5e-7)
    np.testing.assert_allclose(vector(gnss, "course"), np.deg2rad(rows[:, 4]), atol=0.5e-7)
    for name, column in (("lat", 1), ("lon", 2), ("height", 3)):
        np.testing.assert_allclose(vector(gnss, name), rows[:, column], atol=0.51e-7)
    assert warnings_of(streams["metrics"]) == []
    assert counts(streams) == (400, 400, 0)


def test_streams_fit_what_the_reader_declares(tmp_path: Path) -> None:
    (reader,) = declare_readers()
    assert reader.faults() == []
    planned = reader.outputs({}, PhysycomParams())
    for name, table in read_text(tmp_path, text_of(motion())).items():
        assert conform(table, planned[name], stream=name, step="reader").num_rows == table.num_rows


def test_streams_say_clock_datum_and_north(tmp_path: Path) -> None:
    streams = read_text(tmp_path, text_of(motion()))
    assert meta(streams["gnss"]) == {
        "time_scale": "UTC",
        "clock": "absolute",
        "height_datum": "mean_sea_level",
        "heading_kind": "course_true",
        "format": "physycom fullinertial",
    }
    other = read_text(tmp_path, text_of(motion()), heading="magnetic", height_datum="ellipsoid")
    assert meta(other["gnss"])["heading_kind"] == "magnetic"
    assert meta(other["gnss"])["height_datum"] == "ellipsoid"


def test_what_was_assumed_is_told_with_its_unit(tmp_path: Path) -> None:
    streams = read_text(tmp_path, text_of(motion()))
    assert "km/h" in metric(streams, "assumed_speed_unit")["note"]
    assert "true north" in metric(streams, "assumed_heading")["note"]
    assert metric(streams, "assumed_height_datum")["note"] == "mean_sea_level"
    assert metric(streams, "assumed_gravity")["value"] == G
    assert (metric(streams, "assumed_clock_offset")["value"], metric(streams, "assumed_clock_offset")["unit"]) == (
        3600.0,
        "s",
    )


def test_parameters_override_what_is_assumed(tmp_path: Path) -> None:
    text = text_of(motion())
    plain = read_text(tmp_path, text)
    other = read_text(tmp_path, text, speed_unit="m/s", gravity=9.81, clock_offset=7200.0)
    np.testing.assert_allclose(vector(other["gnss"], "speed"), 3.6 * vector(plain["gnss"], "speed"), rtol=1e-15)
    np.testing.assert_allclose(matrix(other["imu"], "accel"), 9.81 / G * matrix(plain["imu"], "accel"), rtol=1e-15)
    assert (time_ns(plain["imu"]) - time_ns(other["imu"]) == 3_600_000_000_000).all()


def test_timestamps_count_from_2000_in_utc_plus_1_and_lose_no_digit(tmp_path: Path) -> None:
    fractions = ["0000000", "1001034", "100103401", "100103402999", "25"]
    lines = [f"{T0}.{fraction}\t0\t0\t1" for fraction in fractions]
    streams = read_text(tmp_path, "# timestamp ax ay az\n" + "\n".join(lines) + "\n")
    since = (time_ns(streams["imu"]) - T0_UTC_NS).tolist()
    assert since == [0, 100_103_400, 100_103_401, 100_103_402, 250_000_000]


def test_the_real_crash_comes_out_at_the_rates_of_its_sensors(logs: Path) -> None:
    streams = read(path=logs / "physycom_crash" / "crash_01.txt", params=PhysycomParams())
    imu, gnss = streams["imu"], streams["gnss"]
    assert imu.num_rows == 40_065
    assert counts(streams) == (40_065, 40_065, 0)
    assert warnings_of(streams["metrics"]) == []
    start = int(datetime(2017, 8, 3, 12, 21, 18, tzinfo=UTC).timestamp()) * 1_000_000_000
    assert time_ns(imu)[0] == start + 152_100_000
    assert time_ns(imu)[-1] - time_ns(imu)[0] == 97_552_300_000
    assert gnss.column_names == ["time", "speed"]
    # 975 or 976 periods of 0.1 s in 97.55 s; the car stood for most of them and lost four reports in motion.
    assert 970 <= gnss.num_rows <= 977
    assert metric(streams, "gnss_period")["value"] == pytest.approx(0.1, abs=0.0024)
    t_ns, speed = time_ns(gnss), vector(gnss, "speed")
    slow = speed[:-1] < 1 / 3.6
    # At rest no report is missing: a step is a period give or take the row period of 2.4 ms on either side.
    assert np.diff(t_ns)[slow].max() < 0.1075e9
    assert np.diff(t_ns)[~slow].max() > 0.19e9
    rest = time_ns(imu) < time_ns(imu)[0] + 50_000_000_000
    np.testing.assert_allclose(
        matrix(imu, "accel")[rest].mean(axis=0) / G, [0.008, 0.016, 1.010], atol=0.0015
    )  # g, the last digit of the README


# --- how the rows are filled ------------------------------------------------------------------------------------------


def test_interpolated_gnss_is_kept_on_every_row(tmp_path: Path) -> None:
    assert read_text(tmp_path, text_of(motion()))["gnss"].num_rows == 400


def test_held_gnss_is_kept_where_it_changes(tmp_path: Path) -> None:
    rows = held(motion())
    streams = read_text(tmp_path, text_of(rows))
    assert streams["imu"].num_rows == 400
    assert (time_ns(streams["gnss"]) - T0_UTC_NS).tolist() == [100_000_000 * k for k in range(400 // HELD_ROWS)]
    assert "repeated" in metric(streams, "gnss_fill")["note"]
    assert metric(streams, "gnss_period")["value"] == pytest.approx(0.1, abs=1e-12)


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
    missing = metric(streams, "values_missing")
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


# --- how the text is written ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [10, 14])
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda text: text.replace("#\t", "", 1), id="header without #"),
        pytest.param(lambda text: text.partition("\n")[2], id="no header"),
        pytest.param(lambda text: "#  " + text[2:].replace("\t", " # ", 1), id="header parted by #"),
        pytest.param(lambda text: "# Filter Data\n#\n\n" + text, id="more comments"),
        pytest.param(lambda text: text.replace("\t", " "), id="spaces"),
        pytest.param(lambda text: "\n".join("  " + line.replace("\t", "    ") for line in text.split("\n")), id="runs"),
        pytest.param(lambda text: text.replace("\t", " \t  "), id="padded tabs"),
        pytest.param(lambda text: text.replace("\t", "   ", 60), id="tabs and spaces mixed"),
        pytest.param(lambda text: text.replace("\n", "\r\n"), id="line ends of Windows"),
        pytest.param(lambda text: text.replace("\n", "\t\n"), id="a tab at each end"),
        pytest.param(lambda text: text.replace("\n", "\t\n", 9), id="a tab at some ends"),
        pytest.param(lambda text: text.replace("\n", "\n\n"), id="blank lines"),
        pytest.param(lambda text: text[:-1], id="no last line end"),
        pytest.param(lambda text: text + "# end of drive\n", id="comment at the end"),
        pytest.param(lambda text: "\ufeff" + text, id="byte order mark"),
        pytest.param(lambda text: text + "\0" * 5000, id="zeros of a lost cluster"),
    ],
)
def test_every_way_of_writing_gives_the_same_streams(tmp_path: Path, width: int, change: Any) -> None:
    text = text_of(motion(60, place=width == 14))
    wanted, found = read_text(tmp_path, text), read_text(tmp_path, change(text))
    for name in ("imu", "gnss"):
        assert found[name].equals(wanted[name])
    assert counts(found) == (60, 60, 0)


def test_decimal_exponents_are_numbers(tmp_path: Path) -> None:
    streams = read_text(tmp_path, f"# timestamp ax ay az\n{T0 / 1e8:.8f}e8\t1e-2\t-2.5E-1\t+.1e+1\n")
    assert time_ns(streams["imu"]).tolist() == [T0_UTC_NS]
    np.testing.assert_allclose(matrix(streams["imu"], "accel"), [[0.01 * G, -0.25 * G, G]], rtol=1e-15)


@pytest.mark.parametrize(
    "header", ["#  timestamp(s)  #  acc_x (g)  #  acc_y (g)  #  acc_z (g)  #", "timestamp\tax\tay\taz"]
)
def test_a_header_tells_an_accelerometer(tmp_path: Path, header: str) -> None:
    imu = read_text(tmp_path, f"{header}\n{T0}.0\t0\t0\t1\n")["imu"]
    assert imu.column_names == ["time", "accel_x", "accel_y", "accel_z"]


@pytest.mark.parametrize(
    "header", ["#  timestamp(s)  #  w_x (dps)  #  w_y (dps)  #  w_z (dps)  #", "# timestamp gx gy gz"]
)
def test_a_header_tells_a_gyroscope(tmp_path: Path, header: str) -> None:
    imu = read_text(tmp_path, f"{header}\n{T0}.0\t0\t0\t90\n")["imu"]
    assert imu.column_names == ["time", "gyro_x", "gyro_y", "gyro_z"]
    assert vector(imu, "gyro_z")[0] == pytest.approx(np.pi / 2, rel=1e-15)


def test_four_columns_without_a_header_ask_for_the_sensor(tmp_path: Path) -> None:
    text = f"{T0}.0\t0\t0\t1\n{T0}.1\t0\t0\t1\n"
    with pytest.raises(DataError, match="accelerometer or a gyroscope") as caught:
        read_text(tmp_path, text)
    assert "'sensor'" in caught.value.hint
    assert "gyro_x" in read_text(tmp_path, text, sensor="gyroscope")["imu"].column_names
    assert "accel_x" in read_text(tmp_path, text, sensor="accelerometer")["imu"].column_names


def test_a_header_weighs_more_than_the_parameter(tmp_path: Path) -> None:
    text = f"# timestamp gx gy gz\n{T0}.0\t0\t0\t1\n"
    assert "gyro_x" in read_text(tmp_path, text, sensor="accelerometer")["imu"].column_names


def test_accelerometer_and_gyroscope_files_combine_to_one_stream(tmp_path: Path) -> None:
    parts = []
    for words in ("ax ay az", "gx gy gz"):
        streams = read_text(tmp_path, f"# timestamp {words}\n{T0}.0\t0\t0\t1\n{T0}.1\t0\t0\t1\n")
        parts.append(Recording(streams))
    imu = combine(parts)[0]["imu"]
    assert imu.num_rows == 2
    assert np.isfinite(np.column_stack([matrix(imu, "accel"), matrix(imu, "gyro")])).all()


@pytest.mark.parametrize("rows", [1, 2])
def test_very_few_rows_are_given_as_they_are(tmp_path: Path, rows: int) -> None:
    streams = read_text(tmp_path, text_of(motion(rows)))
    assert (streams["imu"].num_rows, streams["gnss"].num_rows) == (rows, rows)


# --- what is dropped, and counted -------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [1, 2, 5, 40, 100])
def test_a_cut_last_row_is_dropped_counted_and_told(tmp_path: Path, lost: int) -> None:
    text = text_of(motion(60))
    # Losing the line end and one digit, or more, leaves the row without its last number as it was written.
    streams = read_text(tmp_path, text[: -1 - lost])
    assert streams["imu"].num_rows == 59
    assert counts(streams) == (60, 59, 1)
    assert "line 61" in metric(streams, "rows_dropped")["note"]
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
    assert "line 102" in metric(streams, "rows_dropped")["note"]


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
    assert metric(streams, "values_outside_limits")["value"] == 1.0
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


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bad", "line", "column", "says"),
    [
        pytest.param(GOOD.replace("0.2", "oops", 1), 2, 17, "ay is 'oops'", id="text for a number"),
        pytest.param(GOOD.replace("0.1\t", "0,1\t", 1), 2, 13, "decimal comma", id="decimal comma"),
        pytest.param(GOOD.replace(f"{T0}.1", "12:30:00"), 3, 1, "time is '12:30:00'", id="another time"),
        pytest.param(GOOD.replace("\t", ","), 2, None, "commas", id="commas"),
        pytest.param(GOOD.replace("\t", ";"), 2, None, "semicolons", id="semicolons"),
        pytest.param(GOOD.replace("0.2\t", "", 1), 2, None, "3 columns among rows of 4", id="too few columns"),
        pytest.param(GOOD.replace("0.2\t", "0.2\t7\t", 1), 2, None, "5 columns among rows of 4", id="too many columns"),
        pytest.param(GOOD.replace("\t1.0", "\t1\t2\t3"), 2, None, "6 columns", id="unknown width"),
        pytest.param(GOOD.replace("0.2", "inf", 1), 2, 17, "inf lies outside", id="infinity"),
        pytest.param(GOOD.replace(f"{T0}.1", "99999999999.1"), 3, 1, "time lies outside", id="time beyond 2100"),
        pytest.param(GOOD.replace(f"{T0}.1", "9" * 25), 3, 1, "time lies outside|no number", id="absurd time"),
        pytest.param(GOOD.replace(f"{T0}.1", ""), 3, 1, "time is missing", id="no time"),
        pytest.param("", None, None, "no rows", id="no rows"),
        pytest.param(f"{T0}.0\t0.1", 2, None, "3 columns|2 columns|cut off", id="nothing but a cut row"),
    ],
)
def test_a_bad_line_is_refused_by_line_and_column(
    tmp_path: Path, bad: str, line: int | None, column: int | None, says: str
) -> None:
    error = refusal(tmp_path, HEAD + bad)
    assert (error.line, error.column) == (line, column)
    assert any(part in error.message for part in says.split("|"))


@pytest.mark.parametrize("width", [14])
def test_a_latitude_beyond_the_pole_is_refused(tmp_path: Path, width: int) -> None:
    rows = motion(50)
    rows[20, 1] = 90.5
    error = refusal(tmp_path, text_of(rows))
    assert error.line == 22
    assert "lat 90.5 lies outside -90 to 90 deg" in error.message


def test_line_numbers_count_comments_and_blank_lines(tmp_path: Path) -> None:
    lines = GOOD.splitlines()
    text = "\n".join(["# a", "", "# b", lines[0], "", "# c", lines[1], lines[2].replace("0.2", "x"), lines[2]])
    error = refusal(tmp_path, text + "\n", sensor="accelerometer")
    assert (error.line, error.column) == (8, 17)


def test_a_header_with_columns_in_another_order_is_refused(tmp_path: Path) -> None:
    rows = motion(20, place=False)
    error = refusal(tmp_path, text_of(rows, header="# timestamp ax ay az speed gx gy gz |a| timestamp_rel"))
    assert "column 2 ax, where the format inertial has speed" in error.message


@pytest.mark.parametrize(
    ("content", "says"),
    [
        pytest.param(b"", "empty", id="empty"),
        pytest.param(b" \n\n", "nothing but blanks", id="blank"),
        pytest.param(bytes(1000), "empty|not a text", id="zeros"),
        pytest.param(np.random.default_rng(3).bytes(5000), "not a text", id="random bytes"),
        pytest.param((HEAD + GOOD).encode("utf-16"), "UTF-16", id="utf-16"),
        pytest.param((HEAD + GOOD).encode("utf-16-be"), "UTF-16", id="utf-16 without mark"),
        pytest.param(b"It was a dark night.\n" * 500, "no number", id="prose"),
        pytest.param(b"7" * 3_000_000, "columns", id="one endless line"),
        pytest.param(b"[" * 200_000, "JSON|nested", id="endless brackets"),
    ],
)
def test_what_is_no_table_is_refused_in_one_sentence(tmp_path: Path, content: bytes, says: str) -> None:
    assert any(part in refusal(tmp_path, content).message for part in says.split("|"))


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReadFailed, match="No such file"):
        read(path=tmp_path / "absent.txt", params=PhysycomParams())
    with pytest.raises(ReadFailed, match="folder"):
        read(path=tmp_path, params=PhysycomParams())


@pytest.mark.parametrize("seed", range(8))
def test_damaged_files_are_read_or_refused_and_never_crash(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = [b"\t", b"\n", b" ", b",", b"#", b"nan", b"inf", b"1e999", b"\0", b"\xff", b"\r", b'"', b"9" * 40, b"["]
    sound = [text_of(motion(40)).encode(), text_of(motion(40, place=False)).encode(), json.dumps(RECORDS).encode()]
    for number in range(100):
        damaged = bytearray(sound[number % 3])
        for _ in range(rng.integers(1, 5)):
            start = int(rng.integers(0, len(damaged)))
            stop = start + int(rng.integers(0, 60))
            piece = pieces[rng.integers(len(pieces))]
            damaged[start:stop] = (b"", piece, rng.bytes(stop - start), damaged[:stop])[rng.integers(4)]
        with suppress(DataError):
            read_rows, used, dropped = counts(read_text(tmp_path, bytes(damaged)))
            assert read_rows == used + dropped
