"""The smoother as a chain against the same problem as one dense system of equations."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.constant_velocity import FIRST_SPEED, Fusion
from recon.numerics.constant_velocity_chain import Chain, chain
from recon.numerics.rotation import Floats

DENSITY, SIGMA = 0.4, 2.0
END_S = 12.3


def made(fix_s: Floats, seed: int = 1) -> Fusion:
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, END_S + 1e-9, 0.1)
    acc, fix = rng.standard_normal((len(t_s), 2)), rng.standard_normal((len(fix_s), 2))
    held, sigmas = np.zeros(len(t_s) - 1, dtype=bool), np.full(fix.shape, SIGMA**2)
    return Fusion.of(t_s, acc, held, fix_s, fix, sigmas, held_density=2.0, gate=1e6, patience=10.0)


def dense(t_s: Floats, measured: Floats) -> Floats:
    """Covariance (2 n, 2 n) of position and velocity at n times, of which some are measured."""
    n = len(t_s)
    information = np.zeros((2 * n, 2 * n))
    information[1, 1] = 1.0 / FIRST_SPEED**2
    for k in range(n):
        information[2 * k, 2 * k] += measured[k] / SIGMA**2
    for k, h in enumerate(np.diff(t_s)):
        step = np.zeros((2, 2 * n))
        step[:, 2 * k : 2 * k + 4] = [[-1.0, -h, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]
        noise = DENSITY**2 * np.array([[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]])
        information += step.T @ np.linalg.inv(noise) @ step
    return np.asarray(np.linalg.inv(information))


def between(found: Chain, i: int, j: int) -> Floats:
    """Covariance (2, 2) of the states at two knots, on the first axis."""
    whole = found.covariance[:, :, j, 0]
    for k in range(j - 1, i - 1, -1):
        whole = found.gains[:, :, k, 0] @ whole
    return np.asarray(whole)


@pytest.mark.parametrize("step_s", [1.0, 0.2])
def test_covariances_are_those_of_the_dense_system(step_s: float) -> None:
    fix_s = np.arange(0.4, 11.5, step_s)
    found = chain(made(fix_s), np.full(2, DENSITY))
    t_s = np.append(fix_s, END_S)
    whole = dense(t_s, np.append(np.ones(len(fix_s)), 0.0))
    rows = np.searchsorted(t_s, found.t_s - 1e-9)
    assert len(rows) <= 14  # one in 0.9 s, and the end
    for i in range(len(rows)):
        for j in range(i, len(rows)):
            a, b = 2 * rows[i], 2 * rows[j]
            # the dense matrix is inverted with a condition of 1e8
            np.testing.assert_allclose(between(found, i, j), whole[a : a + 2, b : b + 2], rtol=0.0, atol=1e-6)


def test_the_states_are_those_of_the_smoother() -> None:
    fix_s = np.arange(0.4, 11.5, 1.0)
    fusion = made(fix_s)
    found, (wanted, _) = chain(fusion, np.full(2, DENSITY)), fusion.estimate(np.full(2, DENSITY), smooth=True)
    rows = np.rint((found.t_s - 0.4) / 0.1).astype(int)
    np.testing.assert_allclose(found.pos, wanted.pos[rows], atol=1e-9)
    np.testing.assert_allclose(found.covariance[1, 1], wanted.vel_var[rows], rtol=1e-9)


def test_one_fix_and_the_end_are_two_knots() -> None:
    found = chain(made(np.array([3.0])), np.full(2, DENSITY))
    assert found.t_s.tolist() == pytest.approx([3.0, END_S])
    assert found.fix.tolist() == [0, 0]


def test_a_last_fix_at_the_end_is_the_last_knot() -> None:
    found = chain(made(np.array([3.0, 4.0, END_S])), np.full(2, DENSITY))
    assert found.fix.tolist() == [0, 1, 2]
