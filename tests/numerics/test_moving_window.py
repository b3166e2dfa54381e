"""Means and deviations in moving windows against sums over each window."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics.moving_window import moving_average, rolling_std

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
values = st.floats(-100.0, 100.0, allow_subnormal=False)
series = st.integers(1, 60).flatmap(lambda n: arrays(float, n, elements=values))
windows = st.integers(0, 20).map(lambda half: 2 * half + 1)


@given(series, windows)
def test_moving_average_is_the_mean_of_the_symmetric_window(y, window):
    n, half = len(y), window // 2
    reach = [min(half, i, n - 1 - i) for i in range(n)]
    expected = [np.mean(y[i - r : i + r + 1]) for i, r in enumerate(reach)]
    # Sixty sums of numbers up to 100.
    assert_within(moving_average(y, window), expected, atol=60 * 100 * EPS)


@given(windows, st.floats(-1e9, 1e9), st.integers(1, 300))
def test_constant_passes_the_moving_average_bit_for_bit(window, constant, n):
    y = np.full((n, 2), constant)
    assert_array_equal(moving_average(y, window), y)


def test_straight_line_passes_the_moving_average():
    line = np.linspace([0.0, -1.0], [1e6, 5.0], 100_000)
    # Nothing drifts: the error stays at a few roundings of the value, however long the signal.
    assert_within(moving_average(line, 401), line, atol=20 * EPS * 1e6)


def test_nan_touches_only_the_windows_that_hold_it():
    y = np.ones(50)
    y[20] = np.nan
    assert_array_equal(np.flatnonzero(np.isnan(moving_average(y, 5))), [18, 19, 20, 21, 22])
    assert_array_equal(np.flatnonzero(np.isnan(rolling_std(y, 5))), [18, 19, 20, 21, 22])


@given(series, windows)
def test_rolling_std_is_that_of_the_nearest_full_window(y, window):
    n, size = len(y), min(window, len(y))
    starts = np.clip(np.arange(n) - window // 2, 0, n - size)
    expected = [np.var(y[start : start + size]) for start in starts]
    # Compared as variances, for the root is steep at 0: sixty sums of numbers up to 100^2.
    assert_within(rolling_std(y, window) ** 2, expected, atol=60 * 1e4 * EPS)


def test_rolling_std_does_not_feel_a_large_offset():
    # Multiples of 2^-20 beside 2^27 are exact. A difference of mean squares would leave an error of about 1.
    y = np.round(np.random.default_rng(0).normal(0.0, 0.01, 500) * 2**20) / 2**20
    # The means of the blocks are rounded to eps 2^27 = 3e-8 each, in a handful of joins.
    assert_within(rolling_std(y + 2.0**27, 21), rolling_std(y, 21), atol=5 * EPS * 2**27)


def test_averages_of_nothing_are_nothing():
    assert moving_average(np.zeros((0, 3)), 5).shape == (0, 3)
    assert rolling_std(np.zeros((0, 3)), 5).shape == (0, 3)


@pytest.mark.parametrize("window", [0, -3, 4])
def test_window_must_be_odd_and_positive(window):
    for function in (moving_average, rolling_std):
        with pytest.raises(ValueError, match=f"odd, positive number of samples, not {window}"):
            function(np.ones(9), window)
