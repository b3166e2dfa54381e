"""_decimate: few points that look like all of them."""

from __future__ import annotations

import numpy as np

from recon_exporters._decimate import band, envelope, extremes, gaps, pieces, scattered

N = 100_000
T_NS = np.arange(N) * 10_000_000
VALUES = np.random.default_rng(3).normal(0.0, 1.0, N)
WHOLE = gaps(T_NS, 1.0)


def test_few_rows_are_all_kept():
    assert extremes(T_NS[:400], VALUES[:400], WHOLE[:400], 200).tolist() == list(range(400))


def test_every_span_keeps_its_lowest_and_highest_value():
    rows = extremes(T_NS, VALUES, WHOLE, 1000)
    kept = np.full(N, np.nan)
    kept[rows] = VALUES[rows]
    for span in range(1000):
        inside = T_NS * 1000 // (T_NS[-1] + 1) == span
        if inside.any():
            assert np.nanmin(kept[inside]) <= VALUES[inside][5:-5].min()
            assert np.nanmax(kept[inside]) >= VALUES[inside][5:-5].max()
    assert len(rows) <= 2 * 1001 + 2


def test_one_peak_of_one_row_is_never_lost():
    values = np.zeros(N)
    values[77_777] = 50.0
    assert 77_777 in extremes(T_NS, values, WHOLE)


def test_first_and_last_row_of_each_piece_are_kept():
    t_ns = T_NS + (np.arange(N) >= 50_000) * 5_000_000_000
    begins = gaps(t_ns, 2.0)
    assert np.flatnonzero(begins).tolist() == [0, 50_000]
    rows = extremes(t_ns, VALUES, begins, 500)
    assert {0, 49_999, 50_000, N - 1} <= set(rows.tolist())
    first, second = pieces(rows, begins)
    assert rows[first].max() == 49_999
    assert rows[second].min() == 50_000


def test_slow_measurements_have_no_gaps():
    assert gaps(np.arange(10) * 5_000_000_000, 2.0).sum() == 1


def test_no_row_has_no_gap():
    assert gaps(np.zeros(0, dtype=np.int64), 2.0).tolist() == []


def test_a_band_holds_all_that_it_stands_for():
    low, high = VALUES - 1.0, VALUES + 1.0
    rows, bottom, top = envelope(T_NS, low, high, WHOLE, 100)
    which = np.searchsorted(rows, np.arange(N), side="right") - 1
    assert (bottom[which] <= low).all()
    assert (top[which] >= high).all()
    assert len(rows) <= 101


def test_a_cloud_keeps_points_inside_of_it():
    rows = scattered(T_NS, VALUES, WHOLE, 500)
    assert np.mean(np.abs(VALUES[rows]) < 1.0) > 0.2
    assert len(rows) <= 2 * 501 + 2 + 4 * 500 + 1


def test_a_band_is_two_sigmas_wide_and_ends_where_none_is_known():
    t_ns = np.array([0, 1, 2, 3, 60, 61]) * 1_000_000_000
    sigma = np.array([1.0, 2.0, np.nan, 1.0, 1.0, 1.0])
    times, low, high, parts = band(t_ns, np.full(6, 10.0), sigma, 5.0)
    assert times.tolist() == t_ns[[0, 1, 3, 4, 5]].tolist()
    assert low.tolist() == [8.0, 6.0, 8.0, 8.0, 8.0]
    assert high.tolist() == [12.0, 14.0, 12.0, 12.0, 12.0]
    assert parts == [slice(0, 3), slice(3, 5)]
