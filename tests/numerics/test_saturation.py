from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.saturation import clipped, courses, hidden, impulses

T_S = np.arange(400) / 1000.0
PULSE = 250.0 * np.sin(np.pi * T_S / 0.4) ** 2


def seen(limit: float, sigma: float = 0.05) -> np.ndarray:
    return np.clip(PULSE + np.random.default_rng(0).normal(0.0, sigma, len(PULSE)), -limit, limit)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("limit", [80.0, 200.0, 240.0])
def test_a_clipped_plateau_is_found_to_its_last_sample(sign: float, limit: float) -> None:
    y = sign * seen(limit)
    np.testing.assert_array_equal(clipped(y[:, None])[:, 0], np.abs(y) >= limit)


@pytest.mark.parametrize("step", [0.01, 0.5, 5.0])
def test_the_top_of_a_quantised_pulse_is_not_clipped(step: float) -> None:
    y = np.round(PULSE / step) * step
    assert not clipped(y[:, None]).any()


def test_a_quantised_pulse_that_is_clipped_is_found() -> None:
    y = np.clip(np.round(PULSE / 0.5) * 0.5, -80.0, 80.0)
    assert clipped(y[:, None]).sum() == (y == 80.0).sum()


def test_a_given_range_is_believed() -> None:
    y = seen(80.0)
    np.testing.assert_array_equal(clipped(y[:, None], full_scale=80.0)[:, 0], y >= 79.92)


def test_what_was_cut_off_a_concave_top_lies_below_what_may_be_hidden() -> None:
    # From its half height on a haversine is concave.
    y = np.minimum(PULSE, 180.0)
    mask = y >= 180.0
    missing = hidden(T_S, y, mask)
    assert (missing[~mask] == 0.0).all()
    assert (missing[mask] >= (PULSE - y)[mask] - 1e-9).all()
    np.testing.assert_allclose(hidden(T_S, -y, mask), -missing)


def test_nothing_is_known_of_a_log_that_is_clipped_throughout() -> None:
    y = np.full(10, 80.0)
    assert (hidden(T_S[:10], y, y > 0.0) == 0.0).all()


@pytest.mark.parametrize(("quantum", "found"), [(0.005, [21, 22]), (1.0, [])])
def test_two_samples_are_clipped_where_they_are_hardly_the_same_by_chance(quantum: float, found: list[int]) -> None:
    """Of 24 g, which is no usual end of a range, in a log of 16 bits and in one of a decimal of g."""
    limit = np.round(24.1 * 9.80665 / quantum) * quantum
    y = np.random.default_rng(1).normal(0.0, 0.05, 50)
    y[20:25] = [120.0, 1.2 * limit, 1.5 * limit, 170.0, 10.0]
    cut = np.minimum(np.round(y / quantum) * quantum, limit)
    np.testing.assert_array_equal(np.flatnonzero(clipped(cut[:, None])[:, 0]), found)


@pytest.mark.parametrize("range_g", [8.0, 16.0])
def test_a_short_pulse_of_few_samples_is_clipped_where_a_range_usually_ends(range_g: float) -> None:
    limit = range_g * 9.80665
    y = np.random.default_rng(1).normal(0.0, 0.05, 50)
    y[20:25] = [40.0, 1.2 * limit, 1.5 * limit, 70.0, 10.0]
    cut = np.minimum(y, limit)
    np.testing.assert_array_equal(np.flatnonzero(clipped(cut[:, None])[:, 0]), [21, 22])
    assert not clipped(np.minimum(y, 1.3 * limit)[:, None]).any()  # a single sample elsewhere


@pytest.mark.parametrize("steep", [True, False])
def test_courses_have_an_impulse_of_one_and_share_it_between_plateaus(steep: bool) -> None:
    t_s = np.cumsum(np.random.default_rng(2).uniform(0.8e-3, 1.2e-3, 60))
    mask = np.zeros(60, dtype=bool)
    mask[10:16] = mask[40:44] = True
    most = np.where(mask, 30.0, 0.0) * np.r_[np.ones(30), 3.0 * np.ones(30)] * np.hanning(60) if steep else np.zeros(60)
    flat, peaked = courses(t_s, most, mask)
    step_s = np.gradient(t_s)
    assert (flat * step_s).sum() == pytest.approx(1.0)
    assert (peaked * step_s).sum() == pytest.approx(1.0)
    assert not flat[~mask].any()
    assert not peaked[~mask].any()
    for run in (slice(10, 16), slice(40, 44)):
        assert np.ptp(flat[run]) == 0.0
        assert (flat * step_s)[run].sum() == pytest.approx((peaked * step_s)[run].sum())


def test_impulses_are_those_of_all_samples_of_the_posterior() -> None:
    """Against weighted draws of the prior, in which a lost change of velocity along two axes is told to 0.3 m/s."""
    rng = np.random.default_rng(3)
    directions = np.array([[0.8, -0.6], [0.6, 0.8], [0.0, 0.0]])
    most, covariance = np.array([4.0, 1.0]), np.diag([0.09, 0.09, 1.0])
    lost = directions @ [3.0, 0.4]
    drawn = most / 2.0 + most * rng.standard_normal((400_000, 2))
    off = lost - drawn @ directions.T
    weight = np.exp(-0.5 * (off**2 / np.diag(covariance)).sum(axis=1))
    mean = weight @ drawn / weight.sum()
    found, spread = impulses(lost, covariance, directions, most)
    np.testing.assert_allclose(found, mean, atol=5e-3)
    np.testing.assert_allclose(spread, np.cov(drawn.T, aweights=weight), atol=3e-3)


def test_nothing_was_lost_where_less_than_nothing_would_fit() -> None:
    found, _ = impulses(np.array([-5.0, 0.0, 0.0]), 0.01 * np.eye(3), np.eye(3)[:, :1], np.array([2.0]))
    assert found == [0.0]
