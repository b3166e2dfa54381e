"""Logs of the Physycom box: what comes out of them, however their text is written."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from metric_rows import row_named
from physycom_logs import (
    T0,
    T0_UTC_NS,
    G,
    counts,
    motion,
    read_text,
    text_of,
)

from recon.errors import DataError
from recon.joining import combine
from recon.recording import Recording
from recon.rows import warnings_of
from recon.tables import conform, matrix, meta, time_ns, vector
from recon_readers.physycom import PhysycomParams, declare_readers, read


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
    assert "km/h" in row_named(streams, "assumed_speed_unit")["note"]
    assert "true north" in row_named(streams, "assumed_heading")["note"]
    assert row_named(streams, "assumed_height_datum")["note"] == "mean_sea_level"
    assert row_named(streams, "assumed_gravity")["value"] == G
    assert (
        row_named(streams, "assumed_clock_offset")["value"],
        row_named(streams, "assumed_clock_offset")["unit"],
    ) == (
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
    assert row_named(streams, "gnss_period")["value"] == pytest.approx(0.1, abs=0.0024)
    t_ns, speed = time_ns(gnss), vector(gnss, "speed")
    slow = speed[:-1] < 1 / 3.6
    # At rest no report is missing: a step is a period give or take the row period of 2.4 ms on either side.
    assert np.diff(t_ns)[slow].max() < 0.1075e9
    assert np.diff(t_ns)[~slow].max() > 0.19e9
    rest = time_ns(imu) < time_ns(imu)[0] + 50_000_000_000
    np.testing.assert_allclose(
        matrix(imu, "accel")[rest].mean(axis=0) / G, [0.008, 0.016, 1.010], atol=0.0015
    )  # g, the last digit of the README


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
