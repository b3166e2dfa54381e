from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from exporter_tables import START_NS, happened

from recon.rows import Metric, metrics
from recon_exporters._blender_events import ROWS, captions, force, happenings, markers
from recon_exporters._blender_film import SceneParams, film_of

FPS = 25


def film(seconds=20.0, crashes=(), **params):
    t_ns = START_NS + np.arange(0, round(seconds * 1e9) + 1, 40_000_000)
    return film_of(t_ns, list(crashes), SceneParams(fps=FPS, **params))


def told(*tables, **params):
    shown = film(**params)
    return captions(happenings(pa.concat_tables(tables), [], shown), shown, FPS)


def pdof(*angles):
    return {"metrics": metrics([Metric("pdof", angle, "deg") for angle in angles])}


def test_a_caption_stays_while_its_event_lasts():
    assert told(happened((2.0, 6.0), kind="harsh_braking")) == [
        {"text": "harsh braking", "row": 0, "spans": [[1 + 50, 1 + 150]]}
    ]


def test_a_short_event_is_captioned_for_two_seconds():
    (caption,) = told(happened((2.0, 2.2), kind="impact", value=12.4, unit="km/h"))
    assert caption == {"text": "impact, delta-V 12 km/h", "row": 0, "spans": [[51, 101]]}


def test_captions_at_a_time_stand_over_each_other_and_a_row_that_is_free_is_used_again():
    rows = told(
        happened((1.0, 9.0), kind="harsh_braking"),
        happened((2.0, 5.0), kind="speeding"),
        happened((6.0, 8.0), kind="saturation"),
    )
    assert [(one["text"], one["row"]) for one in rows] == [
        ("harsh braking", 0),
        ("speeding", 1),
        ("sensor at its range", 1),
    ]


def test_what_has_no_row_left_is_a_marker_alone():
    events = happened(*((1.0, 9.0) for _ in range(ROWS + 1)), kind="speeding")
    assert len(told(events)) == ROWS
    shown = film()
    assert len(markers(happenings(events, [], shown), shown)) == ROWS + 1


def test_a_text_that_comes_again_is_one_caption():
    (caption,) = told(happened((1.0, 4.0), (6.0, 9.0), kind="speeding"))
    assert caption["spans"] == [[26, 101], [151, 226]]


def test_what_happens_all_the_time_has_no_caption():
    assert told(happened((1.0, 2.0), kind="standstill"), happened((3.0, 4.0), kind="trip")) == []


def test_an_outage_is_captioned():
    shown = film()
    outage = (START_NS + 3_000_000_000, START_NS + 7_000_000_000)
    found = captions(happenings(None, [outage], shown), shown, FPS)
    assert [(one["text"], one["spans"]) for one in found] == [("no GNSS", [[76, 176]])]


@pytest.mark.parametrize(("clockwise", "left"), [(0.0, 0.0), (90.0, -np.pi / 2), (-45.0, np.pi / 4)])
def test_the_force_comes_from_where_the_metric_says(clockwise, left):
    """Clockwise from the front (SAE J1733) is to the right; angles of the scene turn to the left (ISO 8855)."""
    shown = film()
    found = happenings(happened((2.0, 2.2), kind="impact", value=12.0, unit="km/h"), [], shown)
    arrow = force(found, shown, FPS, pdof(clockwise))
    assert arrow == {"angle": pytest.approx(left, abs=1e-15), "span": [51, 101]}


def test_the_force_is_that_of_the_severest_impact():
    shown = film()
    events = pa.concat_tables(
        [happened((2.0, 2.2), kind="impact", value=5.0), happened((8.0, 8.2), kind="impact", value=9.0)]
    )
    arrow = force(happenings(events, [], shown), shown, FPS, pdof(10.0))
    assert arrow is not None
    assert arrow["span"] == [201, 251]


@pytest.mark.parametrize("streams", [{}, pdof(), pdof(1.0, 2.0), pdof(None)])
def test_there_is_no_arrow_where_no_step_or_several_told_a_direction(streams):
    shown = film()
    found = happenings(happened((2.0, 2.2), kind="impact", value=12.0), [], shown)
    assert force(found, shown, FPS, streams) is None


def test_there_is_no_arrow_where_the_film_does_not_show_the_impact():
    shown = film(start=5.0)
    found = happenings(happened((2.0, 2.2), kind="impact", value=12.0), [], shown)
    assert force(found, shown, FPS, pdof(0.0)) is None


def test_the_name_of_a_marker_is_in_words():
    shown = film()
    events = happened((2.0, 6.0), kind="harsh_acceleration", value=4.13, unit="m/s^2")
    assert [mark["name"] for mark in markers(happenings(events, [], shown), shown)] == ["harsh acceleration 4.1 m/s²"]
