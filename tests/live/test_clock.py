"""Rows of a live log whose times jump, or go back."""

from __future__ import annotations

import numpy as np
import pytest

from recon import GNSS, build, time_ns
from recon.live.clock import Clock

NS = 1_000_000_000
HOUR = 3600


def piece(*at_s):
    """A row at each of these times."""
    t_ns = np.round(np.array(at_s, dtype=float) * NS).astype(np.int64)
    return {"gnss": build(GNSS, time=t_ns, speed=np.ones(len(t_ns)))}


def taken(clock, *at_s):
    return (time_ns(clock.fresh(piece(*at_s), False)["gnss"]) / NS).tolist()


def test_a_row_is_taken_once():
    clock = Clock()
    assert taken(clock, 1, 2, 3) == [1, 2, 3]
    assert taken(clock, 2, 3, 4) == [4]
    assert not clock.wrong


def test_a_row_far_ahead_waits_and_is_left_out_where_the_rows_go_on_as_before():
    clock = Clock()
    assert taken(clock, 1, 2, HOUR) == [1, 2]
    assert not clock.wrong
    assert taken(clock, 2, 3, 4) == [3, 4]
    assert clock.wrong == ["a row of 1970-01-01 01:00:00 is far ahead of those around it and is left out"]


def test_a_pause_is_believed_once_rows_follow_it():
    clock = Clock()
    assert taken(clock, 1, 2, HOUR) == [1, 2]
    assert taken(clock, 2, HOUR, HOUR + 1) == []
    assert taken(clock, 2, HOUR, HOUR + 1, HOUR + 2) == [HOUR, HOUR + 1, HOUR + 2]
    assert not clock.wrong


@pytest.mark.parametrize("first_s", [1, 20 * 365 * 86_400])
def test_the_first_row_may_be_of_any_time(first_s):
    assert taken(Clock(), first_s, first_s + 1) == [first_s, first_s + 1]


def test_of_what_follows_a_clock_that_was_set_back_nothing_is_taken_until_it_has_caught_up():
    clock = Clock()
    taken(clock, HOUR, HOUR + 1)
    assert taken(clock, HOUR - 600, HOUR - 599) == []
    assert taken(clock, HOUR - 599, HOUR - 598) == []
    assert taken(clock, HOUR, HOUR + 1, HOUR + 2) == [HOUR + 2]
    assert clock.wrong == ["the clock was set back by 10 min: no row is taken until it has passed 1970-01-01 01:00:01"]


def test_what_is_still_held_back_at_the_end_is_told():
    clock = Clock()
    taken(clock, 1, 2, HOUR)
    clock.end()
    assert len(clock.wrong) == 1
