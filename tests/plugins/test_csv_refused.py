"""Tables and mappings that are refused, in one sentence with its place."""

from __future__ import annotations

from pathlib import Path

import pytest
from csv_logs import MAPPINGS, ROWS, params_of, refusal

from recon.parameters import bind
from recon.problems import Where
from recon.yaml_nodes import Node, load
from recon_readers.csv import CsvParams


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
        ("t,ax,ay,az\n", "it holds a line of words, perhaps a header, and no row of numbers", None, None),
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
