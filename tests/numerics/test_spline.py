from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.numerics.spline import smoothing_spline
from recon.tables import Array

RNG = np.random.default_rng(7)
T_S = np.cumsum(RNG.uniform(0.5, 1.5, 60))
NOTHING = np.full(60, np.inf)


def spline(z: Array, **given: Any) -> tuple[Array, Array]:
    usual = {
        "rate": np.zeros(60),
        "white": np.full(60, 0.5),
        "rate_sigma": NOTHING,
        "bend": np.full(59, 0.3),
        "slow": 1e-6,
        "correlation_s": 100.0,
    }
    return smoothing_spline(T_S, z, **{**usual, **given})


def test_without_a_slow_error_it_is_the_smoothing_spline_of_scipy() -> None:
    from scipy.interpolate import make_smoothing_spline

    z, white, bend = RNG.normal(size=60), RNG.uniform(0.3, 0.8, 60), 0.3
    expected = make_smoothing_spline(T_S, z, 1.0 / white**2, lam=1.0 / bend**2)
    value, derivative = spline(z, white=white)
    # A slow error of 1e-6 moves values by (1e-6 / 0.3)^2 of themselves; the condition of both systems, some 1e6, loses
    # as many digits of the 16.
    assert value == pytest.approx(expected(T_S), abs=1e-8)
    assert derivative == pytest.approx(expected.derivative()(T_S), abs=1e-8)


def test_a_straight_line_passes_whatever_the_sigmas() -> None:
    value, derivative = spline(1e4 + 20.0 * T_S, rate=np.full(60, 20.0), rate_sigma=np.full(60, 0.1))
    # Values of 1e3 about the middle, the condition 1e6: 1e-7 would be all of the digits lost that can be.
    assert value == pytest.approx(1e4 + 20.0 * T_S, abs=1e-7)
    assert derivative == pytest.approx(np.full(60, 20.0), abs=1e-7)


def test_the_solution_is_the_minimum_of_the_sum_that_it_is_said_to_be() -> None:
    z, rate = np.sin(T_S), np.cos(T_S) + RNG.normal(0.0, 0.1, 60)
    given = {"white": np.full(60, 0.2), "rate_sigma": np.full(60, 0.1), "bend": np.full(59, 0.4)}
    value, derivative = spline(z, rate=rate, slow=0.5, correlation_s=20.0, **given)
    # By another road: the covariance of all that is measured under the model, with diffuse start, and its regression.
    lag = np.minimum(T_S[:, None], T_S[None, :]) - T_S[0]
    late = np.maximum(T_S[:, None], T_S[None, :]) - T_S[0]
    pp = 0.4**2 * lag**2 * (late - lag / 3.0) / 2.0
    vv = 0.4**2 * lag
    after = (T_S - T_S[0])[:, None] >= (T_S - T_S[0])[None, :]
    since = np.where(after, (T_S - T_S[0])[None, :], (T_S - T_S[0])[:, None])
    pv = 0.4**2 * np.where(after, (T_S - T_S[0])[:, None] * since - since**2 / 2.0, since**2 / 2.0)
    motion = np.block([[pp, pv], [pv.T, vv]])
    mm = 0.5**2 * np.exp(-np.abs(T_S[:, None] - T_S[None, :]) / 20.0)
    errors = np.zeros((120, 120))
    errors[:60, :60], errors[60:, 60:] = mm + 0.2**2 * np.eye(60), 0.1**2 * np.eye(60)
    free = np.block([[np.ones((60, 1)), (T_S - T_S[0])[:, None]], [np.zeros((60, 1)), np.ones((60, 1))]])
    seen, inverse = np.concatenate((z, rate)), np.linalg.inv(motion + errors)
    start = np.linalg.solve(free.T @ inverse @ free, free.T @ inverse @ seen)
    expected = free @ start + motion @ inverse @ (seen - free @ start)
    assert np.concatenate((value, derivative)) == pytest.approx(expected, abs=1e-7)  # the condition of `motion`


def test_where_nothing_is_measured_the_curve_goes_on_smoothly() -> None:
    white = np.where((T_S > 20.0) & (T_S < 30.0), np.inf, 1e-3)
    z = np.where(np.isinf(white), np.nan, 3.0 * T_S)
    assert spline(z, white=white)[0] == pytest.approx(3.0 * T_S, abs=1e-6)
