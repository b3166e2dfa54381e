"""Quadrature rules against the 3x3 systems that define them and against integrals in closed form."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics.integration import RULES, cumulative, increments

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
steps = st.lists(st.floats(0.5, 1.5), min_size=2, max_size=30).map(np.array)


def irregular_times(n: int, seed: int = 0) -> np.ndarray:
    return np.concatenate(([0.0], np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, n - 1))))


def smoothly_irregular_times(n: int) -> np.ndarray:
    """Times in [0, 1] whose steps vary by a factor of four, the same way however many there are."""
    u = np.linspace(0.0, 1.0, n)
    return u + 0.6 / (2 * np.pi) * np.sin(2 * np.pi * u)


def parabola_area(t: np.ndarray, y: np.ndarray, start: float, stop: float) -> float:
    """Thesis 2.1: solve for a, b, c, then integrate; in times about the first sample."""
    a, b, c = np.linalg.solve(np.vander(t - t[0], 3), y)
    u, v = start - t[0], stop - t[0]
    return a / 3 * (v**3 - u**3) + b / 2 * (v**2 - u**2) + c * (v - u)


def areas_by_definition(t: np.ndarray, y: np.ndarray, rule: str) -> np.ndarray:
    areas = []
    last = len(t) - 3
    for k in range(len(t) - 1):
        ahead, behind = min(k, last), max(k - 1, 0)
        first_samples = [ahead] if rule == "parabola" else [ahead, behind]
        areas.append(np.mean([parabola_area(t[i : i + 3], y[i : i + 3], t[k], t[k + 1]) for i in first_samples]))
    return np.array(areas)


@pytest.mark.parametrize("rule", ["parabola", "mean_parabola"])
@given(steps=steps, seed=st.integers(0, 2**32 - 1))
def test_parabola_rules_agree_with_their_defining_systems(rule, steps, seed):
    t = np.concatenate(([0.0], np.cumsum(steps)))
    y = np.random.default_rng(seed).uniform(-1.0, 1.0, len(t))
    # The systems have times up to 3 and steps of 0.5 at least, so a condition below 1000.
    assert_within(increments(t, y, rule), areas_by_definition(t, y, rule), atol=1000 * EPS)


DEGREE = {"rectangle": 0, "trapezoid": 1, "parabola": 2, "mean_parabola": 2}


@pytest.mark.parametrize("rule", RULES)
def test_rule_is_exact_for_polynomials_of_its_degree_and_no_higher(rule):
    t = irregular_times(40)
    for degree in range(4):
        exact = (t ** (degree + 1) - t[0] ** (degree + 1)) / (degree + 1)
        error = np.max(np.abs(cumulative(t, t**degree, rule) - exact))
        # Forty sums of numbers up to the last integral.
        rounding = 40 * EPS * exact[-1]
        assert error < rounding if degree <= DEGREE[rule] else error > 1e6 * rounding


# The two parabolas about an interval err with opposite signs, hence the higher order where steps change smoothly.
@pytest.mark.parametrize(("rule", "order"), [("rectangle", 1), ("trapezoid", 2), ("parabola", 3), ("mean_parabola", 4)])
def test_error_falls_with_the_order_of_the_rule(rule, order):
    def error(n: int) -> float:
        t = smoothly_irregular_times(n)
        exact = (np.exp(t) * (np.sin(5 * t) - 5 * np.cos(5 * t)) + 5) / 26
        return float(np.max(np.abs(cumulative(t, np.exp(t) * np.sin(5 * t), rule) - exact)))

    # The next term of the error is smaller by about 5 h = 0.025, and so shifts the order by log2(1 +- 0.025).
    assert_within(np.log2(error(201) / error(401)), order, atol=0.1)


def test_mean_of_two_parabolas_errs_several_times_less_on_jittered_times():
    jitter = np.random.default_rng(0).uniform(-0.1, 0.1, 4000)
    t = 0.01 * (np.arange(4000) + jitter)
    error = {rule: np.max(np.abs(cumulative(t, np.cos(t), rule) - np.sin(t) + np.sin(t[0]))) for rule in RULES}
    assert 3 * error["mean_parabola"] < error["parabola"] < error["trapezoid"] < error["rectangle"]


@pytest.mark.parametrize("rule", RULES)
def test_columns_are_integrated_one_by_one(rule):
    t, y = irregular_times(20), np.random.default_rng(3).normal(size=(20, 3))
    assert_array_equal(cumulative(t, y, rule), np.stack([cumulative(t, column, rule) for column in y.T], axis=1))


@pytest.mark.parametrize("rule", RULES)
def test_large_times_lose_nothing(rule):
    # Multiples of 2^-10 s are exact beside 2^30 s, so only differences of times can enter.
    t = np.cumsum(np.random.default_rng(4).integers(1, 9, 100)) / 1024
    y = np.sin(t)
    assert_array_equal(increments(t + 2.0**30, y, rule), increments(t, y, rule))


@pytest.mark.parametrize("rule", RULES)
def test_cumulative_begins_with_zero_and_sums_the_increments(rule):
    t, y = irregular_times(30), np.random.default_rng(5).normal(size=(30, 2))
    total = cumulative(t, y, rule)
    assert_array_equal(total[0], [0.0, 0.0])
    # Sums of thirty numbers of magnitude one to five.
    assert_within(np.diff(total, axis=0), increments(t, y, rule), atol=30 * 5 * EPS)


@pytest.mark.parametrize("rule", RULES)
def test_no_sample_and_one_sample_give_zeros(rule):
    assert increments([], [], rule).shape == cumulative([], [], rule).shape == (0,)
    assert increments([2.0], [[1.0, 2.0]], rule).shape == (0, 2)
    assert_array_equal(cumulative([2.0], [[1.0, 2.0]], rule), [[0.0, 0.0]])


@pytest.mark.parametrize(("rule", "area"), [("rectangle", 2), ("trapezoid", 4), ("parabola", 4), ("mean_parabola", 4)])
def test_two_samples_give_a_trapezoid(rule, area):
    assert_array_equal(increments([0.0, 2.0], [1.0, 3.0], rule), [area])


@pytest.mark.parametrize("rule", ["parabola", "mean_parabola"])
@pytest.mark.parametrize("gap", [4.0, 5.0, 1000.0])
def test_a_gap_is_bridged_by_the_trapezoid(rule, gap):
    t = np.concatenate((np.arange(5.0), 4.0 + gap + np.arange(5.0)))
    y = np.random.default_rng(6).normal(size=10)
    assert increments(t, y, rule)[4] == increments(t, y, "trapezoid")[4]
    assert increments(t, y, rule)[3] != increments(t, y, "trapezoid")[3]


@pytest.mark.parametrize("rule", ["trapezoid", "parabola", "mean_parabola"])
@given(steps=st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=30).map(np.array), seed=st.integers(0, 2**32 - 1))
def test_an_error_of_the_samples_is_at_most_doubled_whatever_the_steps(rule, steps, seed):
    t = np.concatenate(([0.0], np.cumsum(steps)))
    y = np.random.default_rng(seed).uniform(-1.0, 1.0, len(t))
    # Cumulated times of up to 3e4 leave steps of 1e-3 at 4e-9 of themselves.
    assert np.all(np.abs(increments(t, y, rule)) <= 2.0 * np.diff(t) * (1.0 + 1e-8))


def test_the_integral_is_held_in_the_intervals_named():
    t, y = np.arange(5.0), np.array([1.0, 1.0, 1.0, 7.0, 7.0])
    held = np.array([False, True, False, True])
    assert_array_equal(cumulative(t, y, "trapezoid", held=held), [0.0, 1.0, 1.0, 5.0, 5.0])


@pytest.mark.parametrize("t", [[0.0, 1.0, 1.0], [0.0, 2.0, 1.0], [0.0, np.nan, 1.0]])
def test_times_that_do_not_increase_are_refused(t):
    with pytest.raises(ValueError, match="strictly increase"):
        increments(t, [1.0, 2.0, 3.0], "trapezoid")


def test_times_that_do_not_match_and_unknown_rules_are_refused():
    with pytest.raises(ValueError, match=r"\(2,\) do not match values of shape \(3,\)"):
        increments([0.0, 1.0], [1.0, 2.0, 3.0], "trapezoid")
    with pytest.raises(ValueError, match="no integration rule 'simpson'; there are rectangle"):
        increments([0.0, 1.0], [1.0, 2.0], "simpson")  # type: ignore[arg-type]
