"""A log that comes in bits is cut into small logs of whole lines."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.live.pieces import Pieces

LOG = b"# time ax ay\n# m/s^2\n1.0\t2\t3\n1.1\t2\t3\n1.2\t2\t3\n"
HEADER = b"# time ax ay\n# m/s^2\n"


@given(st.lists(st.integers(0, len(LOG)), max_size=8))
def test_every_row_comes_once_behind_the_header_however_the_bytes_come(cuts):
    edges = sorted({0, *cuts, len(LOG)})
    pieces = Pieces()
    made = [pieces.cut(LOG[a:b]) for a, b in pairwise(edges)]
    rows = b""
    for piece in filter(None, made):
        assert piece.startswith(HEADER)
        rows += piece.removeprefix(HEADER)
    assert rows == LOG.removeprefix(HEADER)


def test_a_log_without_a_header_has_none():
    pieces = Pieces()
    assert pieces.cut(b"1.0 2 3\n1.1 2") == b"1.0 2 3\n"
    assert pieces.cut(b" 3\n") == b"1.1 2 3\n"


def test_a_line_without_an_end_is_the_last_piece():
    pieces = Pieces()
    assert pieces.cut(b"a,b\n1,2\n3,4") == b"a,b\n1,2\n"
    assert pieces.last() == b"a,b\n3,4\n"
    assert pieces.last() == b""


def test_it_tells_where_in_the_log_the_rows_of_a_piece_begin_and_goes_on_there():
    pieces = Pieces()
    pieces.cut(LOG[:30])
    pieces.cut(LOG[30:])
    assert LOG[pieces.begins :].startswith(b"1.1")
    again = Pieces.going_on(LOG, pieces.begins)
    assert again.cut(LOG[pieces.begins :]) == HEADER + LOG[pieces.begins :]
    assert again.begins == pieces.begins


def test_rows_of_earlier_pieces_stand_before_new_ones_as_far_as_they_are_asked_for():
    pieces = Pieces(overlap=15)
    assert pieces.cut(LOG[:30]) == LOG[:29]
    assert not pieces.overlaps
    assert pieces.cut(LOG[30:37]) == LOG[:37]
    assert pieces.overlaps
    assert pieces.cut(LOG[37:]) == HEADER + b"1.1\t2\t3\n1.2\t2\t3\n"
    assert LOG[pieces.begins :] == b"1.2\t2\t3\n"
    assert [pieces.line(number) for number in (1, 3, 4, None)] == [1, 4, 5, None]


def test_a_line_that_is_taken_out_stays_out_and_the_others_keep_their_numbers():
    pieces = Pieces(overlap=100)
    pieces.cut(LOG[:37])
    assert pieces.without(4) == HEADER + b"1.0\t2\t3\n"
    assert pieces.cut(LOG[37:]) == HEADER + b"1.0\t2\t3\n1.2\t2\t3\n"
    assert [pieces.line(number) for number in (2, 3, 4)] == [2, 3, 5]
    with pytest.raises(IndexError):
        pieces.without(2)
    with pytest.raises(IndexError):
        pieces.without(5)
