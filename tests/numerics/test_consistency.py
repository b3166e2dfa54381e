from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.consistency import chi_square_limits, consistency, effective_samples

UNKNOWN = np.nan


def wandering(rows: int, correlation: float, seed: int, columns: int = 1) -> np.ndarray:
    """(rows, columns) standard normal numbers, each correlated with its neighbour: a stationary AR(1) process."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((rows, columns))
    fresh = np.sqrt(1.0 - correlation**2)
    for row in range(1, rows):
        z[row] = correlation * z[row - 1] + fresh * z[row]
    return z


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_samples_are_worth_what_the_theory_says(correlation):
    # rho_k = a^k: 1 + 2 sum a^2k = (1 + a^2) / (1 - a^2), Bartlett 1946
    expected = 20_000 * (1.0 - correlation**2) / (1.0 + correlation**2)
    # each of some 10 rho_k that count errs by 1/sqrt(20000) = 0.7 %; doubled twice in 2 rho^2: some 7 %; 3 of these
    assert effective_samples(wandering(20_000, correlation, seed=1)[:, 0]) == pytest.approx(expected, rel=0.2)


def test_correlated_honest_errors_are_not_refused():
    runs = wandering(1000, 0.9, seed=2, columns=400)
    found = [consistency(column[:, None], np.ones((1000, 1))) for column in runs.T]
    outside = sum(not one.honest for one in found if one)
    # expected 0.4 of 400; 5 or more have a probability of 1e-4 by Poisson
    assert outside < 5
    # with all samples as independent, the spread of the mean square is sqrt(1 / 0.105) = 3.1 times what is allowed
    alone = chi_square_limits(1000.0, 0.999)
    assert sum(not alone[0] <= one.nees <= alone[1] for one in found if one) > 50


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_sigmas_wrong_by_a_factor_are_told(scale):
    found = consistency(wandering(2000, 0.5, seed=3, columns=3), np.full((2000, 3), scale))
    assert found is not None
    assert not found.honest
    # chi-square with 3600 degrees of freedom: sigma of the mean square 2.4 %; 5 of these
    assert found.nees == pytest.approx(1.0 / scale**2, rel=0.12)


def test_coverage_of_honest_sigmas_is_that_of_the_normal_distribution():
    found = consistency(wandering(20_000, 0.0, seed=4), np.ones((20_000, 1)))
    assert found is not None
    for share, normal in zip(found.coverage, (0.6827, 0.9545, 0.9973), strict=True):
        assert share == pytest.approx(normal, abs=5.0 * np.sqrt(normal * (1.0 - normal) / 20_000))


def test_a_mean_excuses_the_errors_of_a_trajectory_but_not_residuals():
    z = wandering(2000, 0.0, seed=5) + 1.0
    errors, residuals = (consistency(z, np.ones((2000, 1)), white=white) for white in (False, True))
    assert errors is not None
    assert residuals is not None
    assert errors.honest  # one constant error of sqrt(2) sigma, seen 2000 times
    assert not residuals.honest


def test_what_has_no_error_or_no_sigma_is_left_out():
    error = np.array([[1.0, 9.0], [UNKNOWN, 9.0], [-1.0, 9.0], [5.0, 9.0]])
    sigma = np.array([[1.0, UNKNOWN], [1.0, UNKNOWN], [1.0, UNKNOWN], [0.0, UNKNOWN]])
    found = consistency(error, sigma)
    assert found is not None
    assert (found.nees, found.count) == (1.0, 2)
    assert consistency(error, np.zeros((4, 2))) is None
    assert consistency(np.empty((0, 3)), np.empty((0, 3))) is None


def test_errors_of_zero_count_as_too_small():
    found = consistency(np.zeros((100, 1)), np.ones((100, 1)))
    assert found is not None
    assert (found.nees, found.degrees, found.honest) == (0.0, 100.0, False)


def test_limits_are_those_of_tables():
    # chi-square with 10 degrees of freedom: 2.5 % 3.247, 97.5 % 20.483 (any textbook, three decimals)
    assert chi_square_limits(10.0, 0.95) == pytest.approx((0.3247, 2.0483), abs=5.1e-5)
