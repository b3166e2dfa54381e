"""Delimiters, decimal commas, quotes and encodings of tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_logs import IMU, NS, ROWS, G, read_text, refusal

from recon.tables import matrix, time_ns


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
