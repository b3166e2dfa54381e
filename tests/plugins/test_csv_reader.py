from __future__ import annotations

import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_logs import IMU, ROWS, metrics_of, ns, params_of, read_text, refusal

import recon
from recon.check import check
from recon.cli import main
from recon.errors import DataError, UnknownFormat
from recon.joining import combine
from recon.overrides import Override
from recon.parameters import bind
from recon.pipeline import Pipeline
from recon.problems import Where
from recon.recording import Recording
from recon.registry import Registry
from recon.rows import warnings_of
from recon.tables import Streams, conform, matrix, meta, time_ns, vector
from recon.yaml_nodes import Node, load, load_file
from recon_readers.csv import CsvParams, declare_readers, propose, read, sniff

MAPPINGS = Path(__file__).parent / "csv_mappings"
G = 9.80665
NS = 1_000_000_000


# --- values ---------------------------------------------------------------------------------------------------------


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


# --- times ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time", "fields", "expected"),
    [
        ("{column: 1, format: unix}", "1711303746.530951712999", "2024-03-24T18:09:06.530951712"),
        ("{column: 1, format: unix, unit: ms}", "1395837505119.146001", "2014-03-26T12:38:25.119146001"),
        ("{column: 1, format: unix, unit: us}", "1395837505119146.001", "2014-03-26T12:38:25.119146001"),
        ("{column: 1, format: unix, unit: ns}", "1691185677581023001", "2023-08-04T21:47:57.581023001"),
        ("{column: 1, format: unix}", "1.395837505E9", "2014-03-26T12:38:25"),
        ("{column: 1, format: unix, scale: GPS}", "1756402240.961", "2025-08-28T17:30:22.961"),
        ("{column: 1, format: relative}", "2.784654166E-2", "1970-01-01T00:00:00.027846541"),
        ("{column: 1, format: relative}", "0.0000000001234567890123", "1970-01-01T00:00:00"),
        ("{column: 1, format: relative, unit: ms, start: 2026-06-08T12:00:00Z}", "1500", "2026-06-08T12:00:01.5"),
        ("{column: 1, format: relative, start: 2026-06-08T12:00:00+02:00}", "-0.5", "2026-06-08T09:59:59.5"),
        ("{column: 1, format: iso}", "2017-08-03T12:22:10.123456789Z", "2017-08-03T12:22:10.123456789"),
        ("{column: 1, format: iso}", "2017-08-03 12:22:10.5+02:00", "2017-08-03T10:22:10.5"),
        ("{column: 1, format: iso}", "2017-08-03T12:22:10-0530", "2017-08-03T17:52:10"),
        ("{column: 1, format: iso, zone: '+02:00'}", "2017-08-03 12:22:10", "2017-08-03T10:22:10"),
        ("{column: 1, format: iso, zone: '+02:00'}", "2017-08-03 12:22:10Z", "2017-08-03T12:22:10"),
        ("{column: 1, format: day_first}", "14/05/2016 11:17:09", "2016-05-14T11:17:09"),
        ("{column: 1, format: month_first}", "05/14/2016 11:17:09.25", "2016-05-14T11:17:09.25"),
        ("{columns: [1, 2], format: iso}", "2025/08/28,17:30:39.749", "2025-08-28T17:30:39.749"),
        ("{columns: [1, 2], format: iso, scale: GPS}", "2025/08/28,17:30:39.749", "2025-08-28T17:30:21.749"),
        ("{columns: [1, 2], format: gps_week}", "2381,408639.75", "2025-08-28T17:30:21.75"),
        ("{columns: [1, 2], format: gps_week, unit: ms}", "2381,408639750", "2025-08-28T17:30:21.75"),
        ("{column: 1, format: time_of_day, start: 2026-06-08}", "14:54:08.1", "2026-06-08T14:54:08.1"),
        ("{column: 1, format: time_of_day, start: 2026-06-08}", "145408.1", "2026-06-08T14:54:08.1"),
    ],
)
def test_every_format_of_time_comes_out_as_utc_to_the_nanosecond(
    tmp_path: Path, time: str, fields: str, expected: str
) -> None:
    accel = [3, 4, 5] if fields.count(",") else [2, 3, 4]
    mapping = f"imu: {{time: {time}, accel: {{columns: {accel}, unit: g}}}}"
    imu = read_text(tmp_path, f"{fields},0,0,1\n", mapping)["imu"]
    assert str(time_ns(imu)[0].view("datetime64[ns]")) == str(np.datetime64(expected, "ns"))
    assert meta(imu).get("time_scale") == ("UTC" if meta(imu)["clock"] == "absolute" else None)


@pytest.mark.parametrize(
    ("gps", "seconds"),
    [
        ("1980-01-06T00:00:00", 0),
        ("1981-07-01T00:00:00", 0),  # 1981-06-30T23:59:60 UTC, the leap second itself
        ("1981-07-01T00:00:01", 1),
        ("2016-12-31T23:59:59", 17),
        ("2017-01-01T00:00:17", 17),
        ("2017-01-01T00:00:18", 18),
        ("2026-01-01T00:00:00", 18),
    ],
)
def test_leap_seconds_are_those_of_bulletin_c(tmp_path: Path, gps: str, seconds: int) -> None:
    mapping = "imu: {time: {column: 1, format: iso, scale: GPS}, accel: {columns: [2, 3, 4], unit: g}}"
    streams = read_text(tmp_path, f"{gps},0,0,1\n", mapping)
    assert ns(gps) - time_ns(streams["imu"])[0] == seconds * NS
    assert metrics_of(streams, "leap_seconds")[0]["value"] == seconds


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    mapping = "imu: {time: {column: 1, format: time_of_day}, accel: {columns: [2, 3, 4], unit: g}}"
    imu = read_text(tmp_path, "23:59:59.9,0,0,1\n00:00:00.1,0,0,1\n00:00:00.3,0,0,1\n", mapping)["imu"]
    assert np.diff(time_ns(imu)).tolist() == [200_000_000, 200_000_000]


def test_a_wrong_unit_of_time_is_a_warning(tmp_path: Path) -> None:
    mapping = IMU.replace("relative", "unix")
    streams = read_text(tmp_path, "t,ax,ay,az\n13958,0,0,1\n13959,0,0,1\n", mapping)
    assert "outside 1980 to 2100" in warnings_of(streams["metrics"])[0]


# --- text -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize("header", [True, False])
def test_the_delimiter_is_found(tmp_path: Path, separator: str, header: bool) -> None:
    text = ROWS if header else ROWS.partition("\n")[2]
    mapping = IMU if header else IMU.replace("[ax, ay, az]", "[2, 3, 4]").replace("column: t", "column: 1")
    imu = read_text(tmp_path, text.replace(",", separator), mapping)["imu"]
    np.testing.assert_allclose(matrix(imu, "accel")[2], [0.2 * G, 0.2 * G, G], rtol=1e-15)


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_the_decimal_comma_is_found_and_can_be_told(tmp_path: Path, separator: str) -> None:
    text = ROWS.replace(",", separator).replace(".", ",")
    for form in ({}, {"decimal": "comma"}):
        imu = read_text(tmp_path, text, **form)["imu"]
        assert time_ns(imu).tolist() == [0, 10_000_000, 20_000_000]
        np.testing.assert_allclose(matrix(imu, "accel")[1], [0.1 * G, 0.3 * G, G], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "form"),
    [
        (ROWS.replace("\n", "\r\n"), {}),
        (ROWS.replace("\n", "\r"), {}),
        ("\ufeff" + ROWS, {}),
        (ROWS.encode("utf-16"), {}),
        (ROWS.replace("t,", "t,").replace("az\n", "az\n").encode("cp1252") + b"# caf\xe9\n", {}),
        (ROWS.encode("utf-16-le"), {"encoding": "utf-16-le"}),
        ("Logger 3\nstarted, by me\n\n" + ROWS, {}),
        ("Logger 3,1\n" + ROWS, {"header": 2}),
        (ROWS.replace("t,ax", "# t,ax"), {}),
        (ROWS.replace("0.01,", "# a comment\n0.01,"), {}),
        (ROWS.replace("0.01,", "% a comment\n0.01,"), {"comment": "%"}),
        (ROWS.replace("\n", ",\n"), {}),
        (ROWS.replace("1.0\n", "1.0,\n"), {}),
        (ROWS.replace(",", " , "), {}),
        (ROWS.replace("t,ax,ay,az", '"t","ax","ay","az"').replace("0.01,0.1", '"0.01","0.1"'), {}),
        (ROWS.replace("\n", '"\n', 1).replace("t,ax", 't,"ax').replace('az"', "az").replace('"ax', "ax"), {}),
        (ROWS.rstrip("\n"), {}),
        (ROWS + "\n\n  \n", {}),
    ],
)
def test_texts_of_many_makes_give_the_same(tmp_path: Path, text: str | bytes, form: dict[str, Any]) -> None:
    imu = read_text(tmp_path, text, **form)["imu"]
    assert time_ns(imu).tolist() == [0, 10_000_000, 20_000_000]
    np.testing.assert_allclose(matrix(imu, "accel")[:, 1], np.array([0.2, 0.3, 0.2]) * G, rtol=1e-15)


def test_quoted_fields_may_hold_delimiters_and_line_ends(tmp_path: Path) -> None:
    rows = "".join(f'{i},"$A,1\r\n","say ""no""",0,0,1\n' for i in range(5))
    imu = read_text(tmp_path, f"t,raw,note,ax,ay,az\n{rows}")["imu"]
    assert time_ns(imu).tolist() == [i * NS for i in range(5)]
    error = refusal(tmp_path, f"t,raw,note,ax,ay,az\n{rows}".replace("3,", "x,", 1))
    assert (error.line, error.column) == (8, 1)


# --- which rows -----------------------------------------------------------------------------------------------------

BOTH = """
imu:
  time: {column: t, format: relative}
  accel: {columns: [ax, ay, az], unit: m/s^2}
  gyro: {columns: [gx, gy, gz], unit: rad/s}
gnss:
  time: {column: t, format: relative}
  lat: {column: lat}
  lon: {column: lon}
  speed: {column: v, unit: m/s}
"""


def drive(n: int = 400, every: int = 20, *, blank: bool = False) -> str:
    """An IMU at 100 Hz and a receiver at 5 Hz whose values are repeated or blank in between."""
    rng = np.random.default_rng(1)
    lines = ["t,ax,ay,az,gx,gy,gz,lat,lon,v"]
    for row in range(n):
        last = row // every * every
        place = f"{44.5 + 1e-5 * last:.6f},{11.3 + 1e-5 * last:.6f},{10 + 0.01 * last:.2f}"
        values = ",".join(f"{value:.5f}" for value in [*(rng.normal([0, 0, 9.8])), *rng.normal(size=3) / 10])
        lines.append(f"{row / 100:.2f},{values},{place if row == last or not blank else ',,'}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("blank", [True, False])
def test_a_receiver_is_read_at_its_own_rate(tmp_path: Path, blank: bool) -> None:
    streams = read_text(tmp_path, drive(blank=blank), BOTH)
    assert streams["imu"].num_rows == 400
    assert np.diff(time_ns(streams["gnss"])).tolist() == [200_000_000] * 19
    used = {row["method"]: row for row in metrics_of(streams, "rows_used")}
    assert (used["imu"]["value"], used["gnss"]["value"]) == (400, 20)
    assert ("380 blank" if blank else "380 repeated") in used["gnss"]["note"]


def test_keep_decides_over_repeated_rows(tmp_path: Path) -> None:
    everything = read_text(tmp_path, drive(), BOTH.replace("gnss:", "gnss:\n  keep: all"))
    assert everything["gnss"].num_rows == 400
    text = ROWS.replace("0.01,0.1,0.3", "0.01,0.1,0.2")
    changes = read_text(tmp_path, text, IMU.replace("{time", "{keep: changes, time", 1))
    assert time_ns(changes["imu"]).tolist() == [0, 20_000_000]


def test_rows_that_a_column_calls_invalid_are_left_out_and_counted(tmp_path: Path) -> None:
    mapping = (
        "gnss: {time: {column: 1, format: relative}, valid: {column: 3, values: [1, A]}, speed: {column: 2, unit: m/s}}"
    )
    streams = read_text(tmp_path, "0,5,1\n1,6,0\n2,7,A\n3,8,1.0\n4,9,V\n5,9,\n", mapping)
    assert vector(streams["gnss"], "speed").tolist() == [5, 7, 8]
    assert "3 not valid" in metrics_of(streams, "rows_used")[0]["note"]


def test_rows_of_one_time_are_refused_unless_the_mapping_keeps_the_first(tmp_path: Path) -> None:
    text = ROWS.replace("0.02", "0.01")
    error = refusal(tmp_path, text)
    assert (error.line, error.column) == (4, 1)
    assert "same_time: first" in error.hint
    streams = read_text(tmp_path, text, IMU.replace("{time", "{same_time: first, time", 1))
    assert streams["imu"].num_rows == 2
    assert "1 of the time of an earlier one" in metrics_of(streams, "rows_used")[0]["note"]


def test_a_single_row_out_of_order_is_dropped_with_a_warning(tmp_path: Path) -> None:
    rows = [f"{i / 100:.2f},0.{i % 7},0,1" for i in range(300)]
    rows[150] = "0.10,0,0,1"
    streams = read_text(tmp_path, "t,ax,ay,az\n" + "\n".join(rows) + "\n")
    assert streams["imu"].num_rows == 299
    assert "line 152" in warnings_of(streams["metrics"])[0]


@pytest.mark.parametrize("end", ["0.03,0.1,0.", "0.03,0.1", "0", '0.03,0.1,"0.2,1', "0.03,0.10,0.20,1"])
def test_a_cut_off_last_row_is_left_out_with_a_warning(tmp_path: Path, end: str) -> None:
    streams = read_text(tmp_path, ROWS + end)
    assert streams["imu"].num_rows == 3
    assert "line 5, was cut off" in warnings_of(streams["metrics"])[0]


def test_a_quote_that_is_never_closed_swallows_no_rows(tmp_path: Path) -> None:
    error = refusal(tmp_path, ROWS.replace("0.01,", '"0.01,'))
    assert (error.line, error.what) == (3, "a quote is opened in this line and never closed")


def test_a_file_that_begins_in_the_middle_of_a_line_says_so(tmp_path: Path) -> None:
    mapping = IMU.replace("[ax, ay, az]", "[2, 3, 4]").replace("column: t", "column: 1")
    streams = read_text(tmp_path, "0.1,1.0\n" + ROWS.partition("\n")[2], mapping)
    assert streams["imu"].num_rows == 3
    assert metrics_of(streams, "lines_left_out")[0]["value"] == 1


# --- files of one drive ---------------------------------------------------------------------------------------------


def test_one_mapping_serves_all_files_of_a_drive(tmp_path: Path) -> None:
    mapping = """
imu:
  time: {column: t, format: relative}
  accel: {columns: [x, y, z], unit: m/s^2, file: "acc*"}
  gyro: {columns: [x, y, z], unit: rad/s, file: "gyr*"}
gnss: {time: {column: t, format: relative}, speed: {column: v, unit: m/s}}
"""
    text = "t,x,y,z\n0,1,2,9\n1,1,2,9\n"
    parts = [read_text(tmp_path, text, mapping, "acc.csv"), read_text(tmp_path, text, mapping, "gyro.csv")]
    parts.append(read_text(tmp_path, "t,v\n0,3\n1,4\n", mapping, "gps.csv"))
    drive, _ = combine([Recording(part) for part in parts])
    assert matrix(drive["imu"], "accel")[1].tolist() == [1, 2, 9]
    assert matrix(drive["imu"], "gyro")[1].tolist() == [1, 2, 9]
    assert drive["gnss"].num_rows == 2
    assert metrics_of(parts[0], "not_in_file")[0]["method"] == "gnss"


@pytest.mark.parametrize(
    ("mapping", "words", "line"),
    [
        (IMU.replace("az]", "azz]"), "imu: there is no column 'azz'; did you mean 'az'?", 1),
        (IMU.replace("column: t", "column: time"), "there is no column 'time'", 1),
        (IMU.replace("[ax, ay, az]", "[u, v, w]"), "it holds none of the streams of the mapping", 1),
        (IMU.replace("[ax, ay, az]", "[2, 3, 9]"), "there is no column 9: it has 4", 1),
    ],
)
def test_a_column_that_is_not_there_is_named(tmp_path: Path, mapping: str, words: str, line: int) -> None:
    error = refusal(tmp_path, ROWS, mapping)
    assert words in error.message
    assert error.line == line


def test_names_without_a_header_and_names_given_twice_are_refused(tmp_path: Path) -> None:
    assert "no header" in refusal(tmp_path, ROWS.partition("\n")[2]).message
    assert "'ax' 2 times" in refusal(tmp_path, ROWS.replace("ay", "ax")).message


# --- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words", "line", "column"),
    [
        (ROWS.replace("0.3", "abc"), "ay is 'abc', which is no number", 3, 10),
        (ROWS.replace("0.01", "soon"), "t is 'soon', which is no number", 3, 1),
        (ROWS.replace("0.3,", ""), "a row of 3 columns among rows of 4", 3, None),
        (ROWS.replace("0.3", "0.3,7"), "a row of 5 columns among rows of 4", 3, None),
        (ROWS.replace(",", ";").replace("0.3", "0,3"), "'0,3' has a decimal comma", 3, 10),
        (ROWS.replace("0.01", "1e17"), "t is beyond any clock", 3, 1),
        (ROWS.replace("0.01", "1e300"), "t is '1e300', which is no number", 3, 1),
        (ROWS.replace("0.3", "1e300"), "accel of", 3, 10),
        (ROWS.replace("0.3", "inf"), "accel of inf", 3, 10),
        ("", "the file is empty", None, None),
        ("\n \n", "the file is empty", None, None),
        (b"PK\x03\x04" + bytes(range(256)), "this is not a text file", None, None),
        ("t,ax,ay,az\n", "it has no whole row that holds a number", None, None),
        ("just a few words\nand some more of them here\n", "it has no whole row that holds a number", None, None),
        ("1\n2\n3\n", "no delimiter", 1, None),
        ("t,ax,ay,az\n0.01,0.", "it has no whole row that holds a number", None, None),
        ("t,ax,ay,az\n0,,,\n1,,,\n", "no row holds a measurement", None, None),
    ],
)
def test_bad_input_is_refused_in_one_sentence_with_its_place(
    tmp_path: Path, text: str | bytes, words: str, line: int | None, column: int | None
) -> None:
    error = refusal(tmp_path, text)
    assert words in error.message
    assert (error.line, error.column) == (line, column)


@pytest.mark.parametrize(
    ("time", "field"),
    [
        ("iso", "2017-02-30T12:00:00Z"),
        ("iso", "2017-08-03T25:00:00Z"),
        ("iso", "03/08/2017 12:00"),
        ("day_first", "05/14/2016 11:17:09"),
        ("time_of_day", "24:00:00"),
    ],
)
def test_a_text_that_is_no_time_is_refused(tmp_path: Path, time: str, field: str) -> None:
    mapping = f"imu: {{time: {{column: t, format: {time}}}, accel: {{columns: [ax, ay, az], unit: g}}}}"
    error = refusal(tmp_path, f"t,ax,ay,az\n{field},0,0,1\n{field},0,0,1\n", mapping)
    assert "which is no time" in error.message
    assert error.line == 2


def test_a_wrong_encoding_is_refused(tmp_path: Path) -> None:
    assert "cannot be read as utf-8" in refusal(tmp_path, ROWS.encode() + b"\xe9", encoding="utf-8").message
    assert "no such encoding" in refusal(tmp_path, ROWS, encoding="klingon").message


@pytest.mark.parametrize(
    ("mapping", "line", "words"),
    [
        ("imu:\n  accel: {columns: [1, 2, 3], unit: g}", 3, "'time' is missing"),
        ("imus: {}", 2, "did you mean 'imu'?"),
        ("imu:\n  time: {column: 1, format: unix}\n  accel: {columns: [1, 2, 3]}", 4, "'unit' is missing"),
        ("imu:\n  time: {column: 1, format: unix}\n  accel: {columns: [1, 2, 3], unit: deg}", 4, "cannot convert"),
        ("imu:\n  time: {column: 1, format: unix}\n  acel: {columns: [1, 2, 3], unit: g}", 3, "did you mean 'accel'?"),
        ("imu:\n  time: {column: 1, format: unix}\n  axes: FRX", 4, "three letters such as FLU"),
        ("imu:\n  time: {column: 1, format: unix}\n  axes: FBU", 4, "three letters such as FLU"),
        ("imu:\n  time: {column: 1, format: unix}", 3, "no column of 'imu' is named"),
        ("imu:\n  time: {column: 0, format: unix}", 3, "counts from 1"),
        ("imu:\n  time: {column: 1, format: gps_week}", 3, "columns: [week, seconds]"),
        ("imu:\n  time: {column: 1, format: unix, zone: CET}", 3, "write it as +02:00"),
        ("imu:\n  time: {column: 1, format: relative, start: today}", 3, "no ISO 8601 time"),
        ("gnss:\n  time: {column: 1, format: unix}\n  height: {column: 2, unit: m}", 3, "'height_datum' is missing"),
        ("gnss:\n  time: {column: 1, format: unix}\n  vel: {columns: [1, 2, 3], unit: m/s}", 3, "axes of the Earth"),
        ("{}", 1, "no stream is named"),
        ("[1, 2]", 1, "a mapping is expected"),
    ],
)
def test_mistakes_of_the_mapping_are_found_before_any_file_is_read(mapping: str, line: int, words: str) -> None:
    node = load("columns:\n  " + mapping.replace("\n", "\n  "), "m.yaml")
    _, problems = bind(CsvParams, node, "reader.csv")
    assert words in " ".join(problem.text for problem in problems)
    assert all(abs(problem.where.line - line) <= 1 for problem in problems if problem.where)


def test_parameters_survive_the_way_through_text() -> None:
    for path in MAPPINGS.glob("*.yaml"):
        params = params_of(path.read_text(encoding="utf-8"))
        again, problems = bind(CsvParams, Node.of(params.as_text(), Where("x")), "reader.csv")
        assert (again, problems) == (params, [])


# --- in the framework -----------------------------------------------------------------------------------------------


def test_the_record_keeps_the_rules_of_its_role(tmp_path: Path) -> None:
    (reader,) = declare_readers()
    assert reader.faults() == []
    planned = reader.outputs({}, params_of(BOTH))
    for name, table in read_text(tmp_path, drive(), BOTH).items():
        assert conform(table, planned[name], stream=name, step="reader").num_rows == table.num_rows


def test_a_sensor_that_the_mapping_lacks_is_missed_before_any_file_is_read() -> None:
    mapping = load(IMU, "m.yaml").plain()
    override = Override.from_data("reader.csv.columns", mapping)
    _, problems = check(Pipeline.of("p", "reader.csv", "filter.gyro_offset"), Registry.installed(), [override])
    assert any("gyro" in problem.text for problem in problems)


@pytest.mark.parametrize("text", [ROWS, drive(), ROWS.partition("\n")[2]])
def test_no_text_is_claimed_for_sure(tmp_path: Path, text: str) -> None:
    found = sniff(tmp_path / "log.csv", text.encode())
    assert 0 < found.confidence < 0.5
    assert f"recon inspect {tmp_path / 'log.csv'}" in found.reason


@pytest.mark.parametrize("head", [b"", b"\x89MCAP0\r\n", b'{"a": 1}\n', b"hello\n", bytes(range(256))])
def test_what_is_no_delimited_text_is_disclaimed(tmp_path: Path, head: bytes) -> None:
    assert sniff(tmp_path / "log.csv", head).confidence == 0


def test_auto_declines_an_unknown_text_and_takes_it_with_a_mapping(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(drive(), encoding="utf-8")
    with pytest.raises(UnknownFormat, match=rf"recon inspect \S*{path.name}' proposes"):
        recon.read(path)
    mapping = load(BOTH, "m.yaml").plain()
    assert recon.read(path, **{"reader.csv.columns": mapping})["imu"].num_rows == 400


def test_inspect_proposes_a_mapping_that_reads_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(drive(), encoding="utf-8")
    assert main(["inspect", "log.csv"]) == 0
    proposed = capsys.readouterr().out
    assert "--set reader.csv.columns=@mapping.yaml" in proposed
    Path("mapping.yaml").write_text(proposed, encoding="utf-8")
    assert main(["inspect", "log.csv", "--set", "reader.csv.columns=@mapping.yaml"]) == 0
    shown = capsys.readouterr().out
    assert "imu: 400 rows" in shown
    assert "gnss: 20 rows" in shown
    assert "ax, ay, az, in m/s^2" in shown


def test_inspect_still_refuses_what_nobody_knows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)))
    assert main(["inspect", str(tmp_path / "noise.bin")]) == DataError.exit_code
    assert "no reader knows this file" in capsys.readouterr().err


# --- real logs ------------------------------------------------------------------------------------------------------

REAL = [
    ("dresden_car", "balzer82_dresden/2014-03-26-000-Data.csv", {"imu": 10_800, "gnss": 2_121}),
    ("dresden_car", "balzer82_dresden/2014-02-14-data_from_karanchawla.csv", {"imu": 1_500, "gnss": 301}),
    ("dresden_motorbike", "balzer82_dresden/2016-08-09-Motorbike.csv", {"imu": 5_353, "gnss": 107, "mag": 2_765}),
    ("boston_car", "neu_boston_car/first_test/town_imu.csv", {"imu": 26_857, "mag": 26_857}),
    ("boston_car", "neu_boston_car/first_test/town_gps.csv", {"gnss": 664}),
    ("boston_car2", "neu_boston_car2/circle_data_0_imu.csv", {"imu": 2_530, "mag": 2_530}),
    ("boston_car2", "neu_boston_car2/circle_data_0_gps.csv", {"gnss": 66}),
    ("driver_behavior", "driver_behavior_br/17/acelerometro_terra.csv", {"imu": 20_675}),
    ("driver_behavior", "driver_behavior_br/17/campoMagnetico_terra.csv", {"mag": 20_675}),
    ("walk", "rtklibexplorer_walk/imu_1730_sf.csv", {"imu": 20_455}),
    ("walk", "rtklibexplorer_walk/gnss_1730_sf.pos", {"gnss": 536}),
    ("walk_raw", "rtklibexplorer_walk/imu_1730.csv", {"imu": 20_455}),
    ("urban", "sim_urban_gnssinssim/imu.csv", {"imu": 25_587, "mag": 25_587, "wheel": 25_587}),
    ("urban", "sim_urban_gnssinssim/gnss.csv", {"gnss": 2_049}),
    ("scooter", "accidetec_scooter/Crashtest.tsv", {"imu": 29_767}),
    ("phyphox", "formats/phyphox/data/Acceleration without g 2024-01-20 17-52-51/Raw Data.csv", {"imu": 3_273}),
    ("sensor_logger_location", "formats/sensor_logger/Location_head600.csv", {"gnss": 599}),
    (
        "sensor_logger_merged",
        "formats/sensor_logger/2025-06-11_20-34-24.csv",
        {"imu": 456, "gnss": 1_648, "mag": 448, "baro": 448},
    ),
]


@pytest.mark.parametrize(("mapping", "file", "rows"), REAL)
def test_a_real_log_is_read_by_its_mapping(logs: Path, mapping: str, file: str, rows: dict[str, int]) -> None:
    """Rows are those that the logs' README counts; of repeated GNSS those whose position differs from the last one."""
    params = params_of((MAPPINGS / f"{mapping}.yaml").read_text(encoding="utf-8"))
    streams = read(path=logs / file, params=params)
    assert {name: table.num_rows for name, table in streams.items() if name != "metrics"} == rows
    for table in (table for name, table in streams.items() if name != "metrics"):
        assert (np.diff(time_ns(table)) > 0).all()


@pytest.mark.parametrize("file", [file for _, file, _ in REAL])
def test_a_real_log_gets_a_proposal_that_reads_it(logs: Path, file: str) -> None:
    text = propose([logs / file])
    assert text is not None
    change = "\n  same_time: first\n  time:"
    streams = read(path=logs / file, params=params_of(text.replace("\n  time:", change)))
    assert {"imu", "gnss", "mag"} & set(streams)


def test_the_dresden_car_feels_gravity_upwards_and_turns_left_positive(logs: Path) -> None:
    params = params_of((MAPPINGS / "dresden_car.yaml").read_text(encoding="utf-8"))
    streams = read(path=logs / "balzer82_dresden" / "2014-03-26-000-Data.csv", params=params)
    assert warnings_of(streams["metrics"]) == []
    # The README: az about -9.6 as logged, so about +9.6 as specific force.
    assert np.median(matrix(streams["imu"], "accel")[:, 2]) == pytest.approx(9.6, abs=0.1)
    first = datetime(2014, 3, 26, 12, 38, 25, tzinfo=UTC).timestamp()
    assert time_ns(streams["imu"])[0] == int(first) * NS + 119_146_000


# --- damage ---------------------------------------------------------------------------------------------------------

FUZZED = 200


def damaged(text: bytes, chance: random.Random) -> bytes:
    """One to four changes: cut off, flip bits, delete, duplicate, or put in bytes that mean something."""
    data = bytearray(text)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(data) or 1)
        span = chance.randint(1, 200)
        match chance.randrange(5):
            case 0:
                del data[at:]
            case 1 if data:
                data[at] ^= 1 << chance.randrange(8)
            case 2:
                del data[at : at + span]
            case 3:
                data[at:at] = data[at : at + span]
            case _:
                data[at:at] = chance.choice(
                    [b'"', b"\n", b",", b";", b"\t", b"1e999", b"\0", b"nan", b"#", b"\r", b"-"]
                )
    return bytes(data)


def outcome(path: Path) -> tuple[Streams, DataError | None]:
    try:
        return read(path=path, params=params_of(BOTH)), None
    except DataError as error:
        return {}, error


@pytest.mark.parametrize("seed", range(FUZZED))
def test_a_damaged_text_gives_rows_or_an_error_of_ours(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    text = drive(60, 10, blank=bool(seed % 2))
    if seed % 3 == 0:
        text = text.replace(",", "\t" if seed % 2 else ";")
    if seed % 5 == 0:
        text = text.replace("\n", '\t"a\nb"\n' if "\t" in text else ',"a\nb"\n')
    path = tmp_path / "log.csv"
    path.write_bytes(damaged(text.encode(), chance))
    streams, error = outcome(path)
    if error is not None:
        assert error.hint
        assert "\n" not in error.message
    else:
        for name in streams.keys() - {"metrics"}:
            assert (np.diff(time_ns(streams[name])) > 0).all()
        (total,) = metrics_of(streams, "rows_read")
        for row in metrics_of(streams, "rows_used"):
            assert row["value"] <= total["value"]
    sniff(path, path.read_bytes()[:65536])
    text_or_none = propose([path])
    if text_or_none is not None:
        params_of(text_or_none)


def test_mappings_are_all_used() -> None:
    assert {path.stem for path in MAPPINGS.iterdir()} == {mapping for mapping, _, _ in REAL}
    assert all(load_file(path).plain() for path in MAPPINGS.iterdir())


def test_a_start_beyond_the_clock_of_a_log_is_refused() -> None:
    time = {"column": "t", "format": "relative", "start": "9019-01-01"}
    with pytest.raises(ValueError, match="is no ISO 8601 time of a log"):
        CsvParams(columns={"wheel": {"time": time, "speed": {"column": "v", "unit": "m/s"}}})
