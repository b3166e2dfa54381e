"""What steps learnt, in words."""

from __future__ import annotations

from typing import Any

from recon.learnt import legible, parameters_text


def row(name: str, value: float | None, note: str) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": "", "method": "reader.physycom", "note": note}


def test_how_sure_the_choice_of_a_reader_is_stands_in_words() -> None:
    told = legible(row("reader", 0.9, "first word"))
    assert (told["value"], told["note"]) == (None, "first word; the choice is 90 % sure")


def test_parameters_of_a_reader_are_no_json() -> None:
    assert legible(row("reader_parameters", None, '{"gravity": 9.80665, "sensor": null}'))["note"] == (
        "gravity = 9.80665, sensor = none"
    )
    assert legible(row("reader_parameters", None, "{}"))["note"] == "it has none"


def test_any_other_row_is_as_it_was() -> None:
    rate = row("assumed_rate", 100.0, "of the box")
    assert legible(rate) == rate


def test_parameters_are_rounded_and_parts_of_parameters_stand_in_brackets() -> None:
    params = {"window": 0.1 + 0.2, "on": True, "axes": "", "lever": [0.0, 1.5], "reader.csv": {"imu": {"time": "t"}}}
    assert parameters_text(params) == (
        "window = 0.3, on = yes, axes = none, lever = [0.0, 1.5], reader.csv = (imu = (time = t))"
    )
