"""Every law of detectors fails for a detector that is wrong in that one way."""

from __future__ import annotations

import numpy as np
import pytest
from broken_laws import broken

from recon import EVENTS, IMU, Detector, Event, events, matrix, time_ns
from recon.testing.laws import detectors

SECOND = 1_000_000_000


def detector_of(find):
    """A detector whose events a function makes from the times and accelerations of imu."""
    return Detector(
        name="find",
        summary="Finds something.",
        run=lambda imu, params: {"events": find(time_ns(imu), matrix(imu, "accel"))},
        reads={"imu": IMU.need("accel")},
        writes={"events": EVENTS},
    )


def spans(*seconds, kind="stop"):
    """A function that gives events between seconds after the first row."""
    return lambda t, accel: events([Event(int(t[0] + a * SECOND), int(t[0] + b * SECOND), kind) for a, b in seconds])


def test_events_that_follow_each_other_break_no_law():
    assert broken(detectors, detector_of(spans((0.0, 1.0), (1.0, 2.0), (65.0, 65.49)))) == {}


def test_kinds_may_overlap_each_other():
    def two_kinds(t, accel):
        return events([Event(int(t[0]), int(t[9]), "stop"), Event(int(t[5]), int(t[7]), "crash")])

    assert broken(detectors, detector_of(two_kinds)) == {}


@pytest.mark.parametrize(("span", "words"), [((-0.1, 1.0), "begin before"), ((60.0, 65.51), "end after")])
def test_an_event_outside_of_the_record_breaks_the_law_of_the_span(span, words):
    ((name, message),) = broken(detectors, detector_of(spans(span))).items()
    assert name == "events_lie_inside_what_was_read"
    assert words in message


def test_an_event_about_a_burst_that_sticks_out_is_found_on_the_violent_drive():
    def padded(t, accel):
        loud = t[np.linalg.norm(accel, axis=1) > 30.0]
        return events([Event(int(loud[0]) - SECOND, int(loud[0]), "crash")] if len(loud) else [])

    assert [*broken(detectors, detector_of(padded))] == ["events_lie_inside_what_was_read"]


def test_events_out_of_order_break_the_law_of_order():
    reverse = spans((0.0, 1.0), (2.0, 3.0))
    ((name, message),) = broken(detectors, detector_of(lambda t, accel: reverse(t, accel).take([1, 0]))).items()
    assert name == "events_are_sorted_by_time"
    assert message == "event 1 begins before the one above it; `recon.events` sorts them"


def test_an_event_that_ends_before_it_begins_breaks_its_law():
    assert broken(detectors, detector_of(spans((3.0, 2.0)))) == {
        "no_event_ends_before_it_begins": "event 0 ends before it begins"
    }


def test_two_events_at_once_break_the_law_of_overlaps():
    assert broken(detectors, detector_of(spans((1.0, 9.0), (2.0, 3.0), (4.0, 5.0)))) == {
        "events_of_one_kind_do_not_overlap": "2 events of kind 'stop' begin before the one above them ends"
    }
