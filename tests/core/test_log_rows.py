"""Rows of the log that a number is about: which events are meant."""

from __future__ import annotations

from recon.log_rows import _narrowed
from recon.schema import by_step
from recon.tables import build, times


def test_of_several_crashes_the_severest_is_meant_and_of_trips_the_one_of_the_note():
    """analyzer.crash finds an `impact` for each crash; its numbers are those of the largest."""
    kinds = ["crash", "crash", "impact", "impact", "trip", "trip"]
    found = build(
        by_step("events"),
        step=["d", "d", "a", "a", "d", "d"],
        time=times([1, 5, 1, 5, 0, 4]),
        end_time=times([2, 6, 2, 6, 3, 9]),
        kind=kinds,
        value=[9.0, 8.0, 20.0, 30.0, 100.0, 200.0],
        unit=[""] * 6,
        note=[""] * 6,
    )
    assert _narrowed(found, [0, 1], {"step": "a", "note": ""}) == [1]
    assert _narrowed(found, [4, 5], {"step": "b", "note": "trip 2; beyond 0.3 g"}) == [5]
    assert _narrowed(found, [0, 1], {"step": "d", "note": ""}) == [0, 1]
