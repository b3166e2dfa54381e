"""A drive smoothed in two windows ends as one that is smoothed at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Log, dense, simulate

from recon.numerics.smoothing import Model, estimate
from recon.numerics.smoothing.arrival import Arrival
from recon.numerics.smoothing.estimate import knots_of, part_of, with_covariances
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.state import COMMON_SIZE, KNOT_SIZE, POSITION, ROTATION, VELOCITY


@pytest.fixture(scope="module")
def sim():
    return simulate(Log(seconds=240.0))


@pytest.fixture(scope="module")
def whole(sim):
    return estimate(sim.drive, Model(), sim.log.noise, learn_noise=False)


def arrival_of(found):
    state = found.solved.state
    last = slice(state.knots - 1, state.knots - 1)
    return Arrival.of(
        knots_of(state, last), found.covariance[-1], found.cross[-1], found.covariance_common, found.smoother.free,
        found.solved.moved_lag,
    )  # fmt: skip


def test_two_windows_end_where_one_does(sim, whole):
    half = sim.drive.samples.intervals // 2
    first = estimate(part_of(sim.drive, slice(0, half)), Model(), sim.log.noise, learn_noise=False)
    second = part_of(sim.drive, slice(half, sim.drive.samples.intervals))
    smoother = Smoother(second, Model(), arrival_of(first))
    start = replace(
        knots_of(whole.solved.state, slice(half, sim.drive.samples.intervals)),
        common=first.solved.state.common,
        rot_vs=first.solved.state.rot_vs,
    )
    found = with_covariances(smoother, smoother.solve(start, sim.log.noise, "tls"))
    assert found.solved.converged
    sigma, expected = (np.sqrt(np.diagonal(one.covariance[-1])) for one in (found, whole))
    # The first window is linearised where its own half of the fixes put it: second order in its errors.
    for part in (POSITION, VELOCITY, ROTATION):
        assert_allclose(sigma[part], expected[part], rtol=0.05)
    away = found.solved.state.pos_n[:, -1] - whole.solved.state.pos_n[:, -1]
    assert_allclose(away / expected[POSITION], 0.0, atol=0.3)


def test_information_is_the_inverse_of_the_covariance(whole):
    arrival = arrival_of(whole)
    used = np.concatenate([np.ones(KNOT_SIZE, bool), arrival.free])
    joint = np.block(
        [[whole.covariance[-1], whole.cross[-1]], [whole.cross[-1].T, whole.covariance_common]]
    )[np.ix_(used, used)]  # fmt: skip
    sigma = np.sqrt(np.diag(joint))
    product = arrival.information[np.ix_(used, used)] * np.outer(sigma, sigma) @ (joint / np.outer(sigma, sigma))
    # Eigenvalues down to 1e-9 of the largest are kept: rounding of 1e-16 grows by 1e9.
    assert_allclose(product, np.eye(len(product)), atol=1e-5)


def test_at_its_mean_it_pulls_nowhere(whole):
    arrival = arrival_of(whole)
    last = slice(whole.solved.state.knots - 1, whole.solved.state.knots - 1)
    normal = Normal(1)
    arrival.add(normal, knots_of(whole.solved.state, last))
    matrix, right = dense(normal)
    assert_allclose(right, 0.0, atol=1e-6 * np.sqrt(np.abs(arrival.information).max()))
    assert normal.cost == pytest.approx(0.0, abs=1e-9)
    assert_allclose(matrix, arrival.information, rtol=1e-12)
    assert matrix.shape == (KNOT_SIZE + COMMON_SIZE,) * 2
