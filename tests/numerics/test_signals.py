"""Signals against plain loops that follow the definitions, and against NumPy where it has the same function."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics import signals
from recon.numerics.integration import cumulative

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
values = st.floats(-100.0, 100.0, allow_subnormal=False)
series = st.integers(1, 60).flatmap(lambda n: arrays(float, n, elements=values))
held_values = st.sampled_from([0.0, 1.0, 2.0, np.nan])


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_lies_in_the_half_open_turn_and_on_the_same_ray(angle):
    wrapped = signals.wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    # A turn is known to 2.4e-16 rad, and 1e6 rad hold 1.6e5 of them.
    assert_within(np.exp(1j * wrapped), np.exp(1j * angle), atol=1.6e5 * 2.5e-16 + 4 * EPS)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, 3 * np.pi, -3 * np.pi])
def test_half_turn_is_wrapped_to_plus_pi(angle):
    assert signals.wrap_angle(angle) == np.pi


def test_angle_inside_the_turn_is_returned_bit_for_bit():
    inside = np.array([0.0, 1e-300, -1e-20, 3.0, np.nextafter(-np.pi, 0.0), np.pi])
    assert_array_equal(signals.wrap_angle(inside), inside)


def test_derivative_of_a_parabola_is_exact_at_irregular_times():
    t = np.cumsum(np.random.default_rng(0).uniform(0.1, 1.0, 50))
    y = np.stack((3 * t**2 - 2 * t + 1, -(t**2)), axis=1)
    # Values up to 3 * 50^2 are rounded and divided by steps of 0.1, with weights of up to ten.
    assert_within(signals.differentiate(t, y), np.stack((6 * t - 2, -2 * t), axis=1), atol=10 * 7500 * EPS / 0.1)


def test_derivative_of_few_samples():
    assert_array_equal(signals.differentiate([0.0, 2.0], [1.0, 5.0]), [2.0, 2.0])
    assert_array_equal(signals.differentiate([0.0], [1.0]), [np.nan])
    assert signals.differentiate([], []).shape == (0,)


@given(series, st.integers(0, 2**32 - 1))
def test_interpolation_is_that_of_numpy_inside_the_span(y, seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.1, 1.0, len(y)))
    t_new = np.concatenate((rng.uniform(t[0], t[-1], 50), t))
    # The fraction is known to eps * t / step = 600 eps, of differences up to 200.
    assert_within(signals.interpolate(t_new, t, y), np.interp(t_new, t, y), atol=600 * 200 * EPS)
    assert_array_equal(signals.interpolate(t, t, y), y)


def test_nothing_is_invented_outside_the_span():
    assert_array_equal(signals.interpolate([-0.1, 0.0, 1.0, 1.1], [0.0, 1.0], [5.0, 6.0]), [np.nan, 5.0, 6.0, np.nan])
    assert_array_equal(signals.interpolate([0.0, 1.0], np.zeros(0), np.zeros((0, 2))), np.full((2, 2), np.nan))
    assert_array_equal(signals.interpolate([0.0, 1.0, 2.0], [1.0], [7.0]), [np.nan, 7.0, np.nan])


def test_nothing_is_invented_inside_long_gaps_but_samples_beside_them_stay():
    t, y = np.array([0, 10, 30, 40]), np.array([0.0, 1.0, 3.0, 4.0])
    t_new = np.array([5, 10, 15, 25, 30, 35])
    assert_array_equal(signals.interpolate(t_new, t, y, max_gap=10), [0.5, 1.0, np.nan, np.nan, 3.0, 3.5])
    assert_array_equal(signals.interpolate(t_new, t, y, max_gap=20), [0.5, 1.0, 1.5, 2.5, 3.0, 3.5])


def test_nan_samples_are_skipped_column_by_column():
    t = np.array([0.0, 1.0, 2.0, 3.0])
    y = np.array([[0.0, np.nan], [np.nan, 1.0], [4.0, 2.0], [6.0, np.nan]])
    t_new = np.array([0.5, 1.5, 2.5])
    assert_array_equal(signals.interpolate(t_new, t, y), [[1.0, np.nan], [3.0, 1.5], [5.0, np.nan]])
    assert_array_equal(signals.interpolate(t_new, t, y, max_gap=1.0)[:, 0], [np.nan, np.nan, 5.0])
    assert np.all(np.isnan(signals.interpolate(t_new, t, np.full(4, np.nan))))


def test_nanoseconds_since_the_epoch_lose_nothing():
    t = 1_700_000_000_000_000_000 + np.array([0, 10, 20])  # a double resolves 256 of these
    assert_array_equal(signals.interpolate(t[:1] + np.arange(0, 21, 5), t, [0.0, 1.0, 3.0]), [0.0, 0.5, 1.0, 2.0, 3.0])


def test_times_of_two_types_are_refused():
    with pytest.raises(TypeError, match="both float seconds or both integer nanoseconds, not float64 and int64"):
        signals.interpolate(np.array([0.5]), np.array([0, 1]), [1.0, 2.0])


@pytest.mark.parametrize("turns", [0.0, 2 * np.pi, -6 * np.pi])
def test_angle_is_interpolated_the_shorter_way(turns):
    angle = np.array([3.0, np.nan, -3.0, 0.0]) + turns
    result = signals.interpolate_angle([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 4.0], np.stack((angle, -angle), axis=1))
    expected = np.array([3.0, np.pi, -3.0, -1.5])
    # pi may come out on either side of the cut; six turns are rounded to 4e-15.
    difference = signals.wrap_angle(result - np.stack((expected, -expected), axis=1))
    assert_within(difference, 0.0, atol=1e-14)
    assert np.all(np.abs(result) <= np.pi)


def test_angles_leave_their_argument_alone():
    angle = np.array([3.0, -3.0])
    signals.interpolate_angle([0.5], [0.0, 1.0], angle)
    assert_array_equal(angle, [3.0, -3.0])


@given(st.lists(st.booleans(), max_size=40))
def test_runs_rebuild_the_mask_and_never_touch(mask):
    found = signals.runs(mask)
    rebuilt = np.zeros(len(mask), dtype=bool)
    for start, stop in found:
        assert start < stop
        rebuilt[start:stop] = True
    assert_array_equal(rebuilt, mask)
    assert np.all(found[1:, 0] > found[:-1, 1])


def test_runs_of_nothing_have_two_columns():
    assert signals.runs([]).shape == signals.runs([False, False]).shape == (0, 2)


@given(st.lists(st.tuples(held_values, held_values), max_size=30))
def test_changes_are_numbers_that_differ_from_the_last_of_their_column(rows):
    last: list[float | None] = [None, None]
    expected = []
    for row in rows:
        news = False
        for column, value in enumerate(row):
            if not np.isnan(value):
                news |= last[column] is None or value != last[column]
                last[column] = value
        expected.append(news)
    y = np.array(rows, dtype=float).reshape(-1, 2)
    assert_array_equal(signals.changes(y), np.array(expected, dtype=bool))


def test_held_value_is_reported_once():
    assert_array_equal(signals.changes([4.0, 4.0, np.nan, 4.0, 5.0, np.nan]), [1, 0, 0, 0, 1, 0])
    assert_array_equal(signals.changes(np.array([7, 7, 8])), [True, False, True])


def test_median_rate_does_not_feel_a_gap():
    t_ns = 1_700_000_000_000_000_000 + np.array([0, 10, 20, 30, 9000, 9010]) * 1_000_000
    assert signals.median_rate(t_ns) == 100.0
    assert np.isnan(signals.median_rate(t_ns[:1]))


def test_interval_means_pass_a_straight_line_and_conserve_the_integral():
    rng = np.random.default_rng(12)
    t_ns = np.sort(rng.integers(0, 10**10, 2000))
    t_ns = np.unique(np.concatenate(([0], t_ns, [10**10])))
    grid = np.arange(5 * 10**7, 10**10, 10**8)
    line = 3.0 - 0.2e-9 * t_ns
    # Areas of up to 30 are subtracted and divided by 0.1 s: 300 roundings of 1e-16.
    assert signals.interval_mean(grid, t_ns, line, 0.1, 1.0) == pytest.approx(3.0 - 0.2e-9 * grid, abs=1e-12)
    y = rng.normal(size=(len(t_ns), 2))
    total = cumulative(t_ns * 1e-9, y, "trapezoid")[-1]
    assert signals.interval_mean(grid, t_ns, y, 0.1, 1.0).sum(axis=0) * 0.1 == pytest.approx(total, abs=1e-11)


def test_interval_means_end_at_gaps_and_at_the_ends():
    t_ns = np.array([0, 1, 2, 10, 11, 12]) * 10**9
    y = np.array([0.0, 1.0, 2.0, 5.0, 5.0, 5.0])
    found = signals.interval_mean(np.array([-1, 0, 1, 2, 5, 10, 11, 12, 13]) * 10**9, t_ns, y, 4.0, 2.0)
    expected = [np.nan, 0.0, 1.0, 2.0, np.nan, 5.0, 5.0, 5.0, np.nan]
    assert found == pytest.approx(expected, abs=1e-12, nan_ok=True)


def test_interval_means_skip_samples_that_are_no_numbers():
    t_ns = np.arange(5) * 10**9
    y = np.array([0.0, np.nan, 2.0, 3.0, 4.0])
    assert signals.interval_mean(t_ns[1:2], t_ns, y, 1.0, 5.0) == pytest.approx([1.0], abs=1e-12)
    assert np.isnan(signals.interval_mean(t_ns[1:2], t_ns, y, 1.0, 1.5)).all()
