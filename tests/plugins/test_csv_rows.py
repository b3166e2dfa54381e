"""Which rows of a table count, and the files of one drive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_logs import BOTH, IMU, ROWS, drive, read_text, refusal
from metric_rows import rows_named

from recon.joining import combine
from recon.recording import Recording
from recon.rows import warnings_of
from recon.tables import matrix, time_ns, vector


@pytest.mark.parametrize("blank", [True, False])
def test_a_receiver_is_read_at_its_own_rate(tmp_path: Path, blank: bool) -> None:
    streams = read_text(tmp_path, drive(blank=blank), BOTH)
    assert streams["imu"].num_rows == 400
    assert np.diff(time_ns(streams["gnss"])).tolist() == [200_000_000] * 19
    used = {row["method"]: row for row in rows_named(streams, "rows_used")}
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
    assert "3 not valid" in rows_named(streams, "rows_used")[0]["note"]


def test_rows_of_one_time_are_refused_unless_the_mapping_keeps_the_first(tmp_path: Path) -> None:
    text = ROWS.replace("0.02", "0.01")
    error = refusal(tmp_path, text)
    assert (error.line, error.column) == (4, 1)
    assert "same_time: first" in error.hint
    streams = read_text(tmp_path, text, IMU.replace("{time", "{same_time: first, time", 1))
    assert streams["imu"].num_rows == 2
    assert "1 of the time of an earlier one" in rows_named(streams, "rows_used")[0]["note"]


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
    assert rows_named(streams, "lines_left_out")[0]["value"] == 1


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
    assert rows_named(parts[0], "not_in_file")[0]["method"] == "gnss"


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
