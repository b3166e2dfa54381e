"""A barometer's climbs against rows written out, a dense solution for its reference, and drives with truth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Linearised, Log, check_rows, height_error, linearised, simulate

from recon.numerics.smoothing.climbs import Climb, walked
from recon.numerics.smoothing.state import BARO

SEEDS = range(1, 11)


@pytest.fixture(scope="module")
def drive() -> Linearised:
    return linearised(Log(seconds=30.0, kind="nonstop", rest_s=3.0), off=0.01)


def test_a_barometer_without_white_noise_tells_the_rise_between_knots(drive):
    t_s = np.arange(0.05, 20.0, 0.1)
    aid = Climb(t_s, 100.0 + 0.3 * np.sin(t_s), 1e-6, 0.05)

    def rows(factors, state):
        k = factors.k
        pull = drive.gravity.value_n[:, k]
        up = -pull / np.linalg.norm(pull, axis=0)
        rise = (up * (state.pos_n[:, k + 1] - state.pos_n[:, k])).sum(axis=0)
        return ((rise - (1.0 + state.common[BARO]) * np.diff(factors.height)[k]) / np.sqrt(factors.walk))[None]

    check_rows(drive, aid, rows)


def test_what_walks_is_told_from_what_is_white_as_a_dense_solution_does():
    """Ten knots, two of them without samples between; the steps are small, so that all weights are nearly one."""
    rng = np.random.default_rng(3)
    seen, white, walk = 0.001 * rng.standard_normal(10), 0.04, np.full(7, 0.01)
    k = np.array([0, 1, 2, 5, 6, 7, 8])
    change = np.zeros((7, 10))
    change[np.arange(7), k], change[np.arange(7), k + 1] = -1.0, 1.0
    level = np.linalg.solve(np.eye(10) / white + change.T @ change / 0.01, seen / white)
    found, weight = walked(k, 10, change @ seen, white, walk)
    assert_allclose(weight, 1.0, atol=1e-4)
    assert_allclose(found, change @ level, atol=1e-4 * np.abs(change @ level).max())


def test_a_door_is_a_jump_of_the_reference_that_hardly_counts():
    """Ten metres where noise is 0.1 m: Cauchy's weight c^2 / (c^2 + e^2 / walk), of whatever surrounds it."""
    moved = np.zeros(40)
    moved[20] = 10.0
    found, weight = walked(np.arange(40), 41, moved, 0.01, np.full(40, 0.001))
    assert found[20] == pytest.approx(10.0, abs=0.1)
    assert weight[20] < 1e-3
    assert np.delete(weight, 20).min() > 0.9


def test_a_barometer_tells_how_heights_change_to_its_own_walk_and_its_jumps_do_no_harm():
    """What all heights have in common GNSS alone can tell. Noise, a walk, and half a minute in a tunnel.

    Over 400 s a walk of 0.02 m/sqrt(s) has a standard deviation about its mean of 0.02 sqrt(400 / 6) = 0.16 m (of the
    Brownian motion about its mean); twice that in all but one of ten drives.
    """
    without, with_it = [], []
    for seed in SEEDS:
        sim = simulate(Log(seconds=400.0, seed=seed, drift=3.0, gnss_hz=0.5))
        rng = np.random.default_rng(seed)
        t_s = np.arange(0.0, 400.0, 0.2)
        height = sim.motion.at(t_s).height + 0.3 * rng.standard_normal(len(t_s))
        height += np.cumsum(0.02 * np.sqrt(0.2) * rng.standard_normal(len(t_s)))
        height[(t_s > 100.0) & (t_s < 130.0)] += 8.0
        for found, aids in ((without, ()), (with_it, (Climb(t_s, height, 0.1, 0.02),))):
            found.append(height_error(sim, aids).std())
    assert np.median(with_it) < 0.16
    assert np.median(with_it) < 0.6 * np.median(without)
    assert np.sort(with_it)[-2] < 0.32
