"""Numbers as people read them."""

from __future__ import annotations

import math

import pytest

from recon.rounding import counted, in_a_sentence, milliseconds, occasions, rounded, with_interval, with_unit


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (11.9093584, 0.0992526, "11.909"),
        (1234.5678, 12.0, "1235"),
        (-0.0004, 0.01, "0.000"),
        (0.2777777777777778, None, "0.2778"),
        (40065.0, None, "40065"),
        (0.0, None, "0"),
        (3600.0, None, "3600"),
        (12_345_678.0, None, "12345678"),
        (12_345_678.5, None, "1.235e+07"),
        (1.5e-7, None, "1.500e-07"),
        (2.5, 0.0, "2.5"),
        (2.5, math.inf, "2.5"),
        (math.nan, None, "nan"),
    ],
)
def test_a_number_is_shown_to_what_it_means(value: float, sigma: float | None, text: str) -> None:
    assert rounded(value, sigma) == text


def test_a_unit_stands_behind_its_number() -> None:
    assert [with_unit("2", unit) for unit in ("km/h", "°", "1", "", None)] == ["2 km/h", "2°", "2", "2", "2"]


def test_a_row_in_a_sentence_has_one_digit_of_its_sigma_and_its_interval() -> None:
    row = {"value": 12.195198, "sigma": 0.1082187, "low": 11.959945, "high": 12.384154}
    assert with_interval(row, "km/h") == "12.2 km/h (95 %: 12.0 to 12.4 km/h)"
    assert with_interval({**row, "low": None}, "km/h") == "12.2 km/h"
    assert in_a_sentence({"value": 0.29999, "sigma": None}) == "0.3"


def test_times_and_counts_are_told_as_people_do() -> None:
    assert milliseconds("2024-05-01T08:00:05.123456789Z") == "2024-05-01 08:00:05.123"
    assert [counted(number, "row") for number in (0, 1, 1234)] == ["0 rows", "1 row", "1,234 rows"]
    assert [occasions(number) for number in (1, 2)] == ["once", "2 times"]
