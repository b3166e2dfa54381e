from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.smoothing.robust import cauchy_weights, tls_start, tls_weights

C2 = 16.0


@pytest.mark.parametrize("mu", [1e-3, 0.3, 1.0, 50.0, 1e6])
def test_truncated_weights_are_one_under_the_lower_bound_and_zero_over_the_upper(mu: float) -> None:
    low, high = C2 * mu / (mu + 1), C2 * (mu + 1) / mu
    assert tls_weights([0.0, 0.999 * low], C2, mu).tolist() == [1.0, 1.0]
    assert tls_weights([1.001 * high, 1e12], C2, mu).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("mu", [1e-3, 0.3, 1.0, 50.0])
def test_truncated_weights_minimise_the_cost_with_its_outlier_process(mu: float) -> None:
    # Yang et al. 2020, eqs. 8 and 12: w minimises w r^2 + mu (1 - w) / (mu + w) c^2 over [0, 1].
    w = np.linspace(0, 1, 100_001)
    for squared in C2 * np.array([0.3, 0.8, 1.0, 1.3, 4.0, 300.0]):
        cost = w * squared + mu * (1 - w) / (mu + w) * C2
        # Half the step of the grid, and the grid's minimum of a flat parabola may be one step off.
        assert tls_weights(squared, C2, mu) == pytest.approx(w[cost.argmin()], abs=1.5e-5)


def test_a_large_control_parameter_keeps_or_drops() -> None:
    # The bounds are c^2 (1 -+ 1 / mu) to first order.
    assert tls_weights([C2 * (1 - 2e-6), C2 * (1 + 2e-6)], C2, 1e6).tolist() == [1.0, 0.0]


def test_at_the_start_the_largest_residual_still_counts() -> None:
    squared = np.array([1.0, 30.0, 1e4])
    mu = tls_start(squared, C2)
    assert mu == pytest.approx(C2 / (2e4 - C2))
    assert (tls_weights(squared, C2, mu) > 0).all()


@pytest.mark.parametrize("squared", [np.array([]), np.zeros(3), np.array([0.5 * C2]), np.array([C2])])
def test_without_outliers_the_schedule_starts_at_one(squared: np.ndarray) -> None:
    assert tls_start(squared, C2) == 1.0


def test_the_schedule_finds_the_mean_of_the_inliers() -> None:
    rng = np.random.default_rng(1)
    values = np.concatenate((rng.normal(5.0, 1.0, 60), rng.uniform(20.0, 80.0, 40)))
    weights, mu = np.ones(100), 0.0
    for _ in range(12):
        squared = (values - np.average(values, weights=weights)) ** 2
        mu = 4.0 * mu if mu else tls_start(squared, C2)
        weights = tls_weights(squared, C2, mu)
    assert weights.tolist() == [1.0] * 60 + [0.0] * 40


def test_cauchy_weights_are_the_slope_of_their_cost() -> None:
    squared = np.array([0.0, 1.0, C2, 500.0])
    step = 1e-4
    slope = C2 * (np.log1p((squared + step) / C2) - np.log1p((squared - step) / C2)) / (2 * step)
    # Central difference: step^2 / 6 times the third derivative, 2 / c^4 at most, is 1e-11; rounding 1e-16 c^2 / step.
    assert cauchy_weights(squared, C2) == pytest.approx(slope, abs=1e-9)
    assert cauchy_weights(C2, C2) == 0.5
