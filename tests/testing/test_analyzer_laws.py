"""Every law of analyzers fails for an analyzer that is wrong in that one way."""

from __future__ import annotations

import numpy as np
from broken_laws import broken

from recon import REFERENCE, TRAJECTORY, Analyzer, Metric, matrix, metrics
from recon.schema import TIME, Column, Schema
from recon.testing.laws import analyzers

SPEEDS = Schema((TIME, Column("speed", "m/s", quantity="speed")))


def distance(trajectory, reference):
    """Root mean square of the distance, m."""
    return float(np.sqrt(np.mean((matrix(trajectory, "pos") - matrix(reference, "pos")) ** 2)))


def comparison_of(error, name="position_error"):
    """An analyzer that compares the trajectory with the reference."""
    return Analyzer(
        name="compare",
        summary="Error of the trajectory.",
        run=lambda trajectory, reference, params: {
            "metrics": metrics([Metric(name, error(trajectory, reference), "m"), Metric("rows", 1.0)])
        },
        reads={"trajectory": TRAJECTORY.need("pos"), "reference": REFERENCE.need("pos")},
        compares=("trajectory", "reference"),
    )


def adding(stream):
    """An analyzer that returns speeds as a stream of that name."""
    return Analyzer(
        name="speeds",
        summary="Speed over time.",
        run=lambda trajectory, params: {stream: trajectory.select(["time", "vel_e"]).rename_columns(["time", "speed"])},
        reads={"trajectory": TRAJECTORY.need("vel")},
        writes={stream: SPEEDS},
    )


def test_an_analyzer_that_is_what_it_declares_breaks_no_law():
    assert broken(analyzers, comparison_of(distance)) == {}
    assert broken(analyzers, adding("speeds")) == {}


def test_a_stream_of_a_name_that_others_use_breaks_the_law_of_names():
    assert broken(analyzers, adding("wheel")) == {
        "what_is_added_has_a_name_of_its_own": "it returns 'wheel', which other stages make; "
        "an analyzer adds streams under names of its own"
    }


def test_an_error_out_of_nothing_breaks_the_law_of_the_same_stream():
    assert broken(analyzers, comparison_of(lambda *streams: distance(*streams) + 0.5)) == {
        "a_stream_against_itself_shows_no_error": "of 'reference' against itself the metric 'position_error' is 0.5, "
        "where it must be 0"
    }


def test_an_error_that_is_always_zero_breaks_the_law_of_streams_that_differ():
    assert broken(analyzers, comparison_of(lambda *streams: 0.0)) == {
        "streams_that_differ_show_an_error": "'trajectory' drifts away from 'reference', "
        "but all of position_error are 0"
    }


def test_a_comparison_without_a_metric_of_an_error_compares_nothing():
    messages = {*broken(analyzers, comparison_of(distance, name="position")).values()}
    assert messages == {
        "its record says that it compares two streams, but it returns no metric named *_error with a value"
    }
