"""Names on a drawing: none over another, over a point, or over the edge."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from recon_exporters._labels import LETTER, Label, placed

WIDTH, HEIGHT = 400.0, 300.0
PLACES = st.tuples(st.floats(0.0, WIDTH), st.floats(0.0, HEIGHT))
LETTER_HEIGHT = 10.0
"""A capital of 13 px with its halo; lines are 16 px apart."""


def box(label: Label) -> tuple[float, float, float, float]:
    return label.x, label.y - LETTER_HEIGHT, label.x + LETTER * len(label.text), label.y


def meet(one: tuple[float, float, float, float], other: tuple[float, float, float, float]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


@given(st.lists(PLACES, max_size=12), st.sampled_from(["end", "harsh acceleration"]))
def test_no_name_lies_over_another_or_over_a_point_or_is_cut(points, text):
    labels = placed([(text, point) for point in points], points, WIDTH, HEIGHT)
    boxes = [box(label) for label in labels]
    assert not [pair for pair in combinations(boxes, 2) if meet(*pair)]
    assert not [(b, p) for b in boxes for p in points if meet(b, (*p, *p))]
    assert all(b[0] >= 0.0 and b[1] >= 0.0 and b[2] <= WIDTH and b[3] <= HEIGHT for b in boxes)


def test_a_name_stands_beside_its_point():
    ((text, x, y, point),) = placed([("start", (100.0, 100.0))], [(100.0, 100.0)], WIDTH, HEIGHT)
    assert (text, point) == ("start", (100.0, 100.0))
    assert 100.0 < x < 120.0
    assert 80.0 < y < 120.0


def test_what_comes_first_has_the_best_place_and_what_has_none_is_left_out():
    everywhere = [("same", (200.0, 150.0))] * 40
    labels = placed(everywhere, [(200.0, 150.0)], WIDTH, HEIGHT)
    off = [abs(label.y - 4.0 - 150.0) for label in labels]
    assert 4 < len(labels) < 40
    assert off == sorted(off)
