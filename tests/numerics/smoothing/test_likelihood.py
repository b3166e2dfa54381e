"""The marginal likelihood: its gradient against its values, and what its logarithms scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Log, likelihood_of, simulate

from recon.numerics.smoothing.likelihood import Likelihood, scaled_noise

NAMES = ("drift across", "drift up", "tau", "position across", "position up", "velocity across", "velocity up")
NAMES = (*NAMES, "gyro", "accel", "gyro walk", "accel walk")
ROLLING = Log(seconds=240.0, outliers=0.03)


@pytest.fixture(scope="module")
def likelihood() -> Likelihood:
    sim = simulate(ROLLING)
    return likelihood_of(sim, sim.log.noise)[1]


@pytest.mark.parametrize("index", range(11), ids=NAMES)
@pytest.mark.parametrize("where", ["as told", "elsewhere"])
def test_the_gradient_is_that_of_the_values(likelihood, index, where):
    logs = (
        np.zeros(11) if where == "as told" else np.array([0.4, -0.3, 0.5, -0.6, 0.4, 0.3, -0.4, 0.6, -0.5, 0.7, -0.4])
    )
    step = np.zeros(11)
    step[index] = 1e-3
    up, down = (likelihood(logs + sign * step)[0] for sign in (1.0, -1.0))
    value, gradient = likelihood(logs)
    # Third derivatives are of the size of the counts, some thousand, times 1e-6 / 6; values of 1e4 are rounded by the
    # condition of the normal equations, to some 1e-8, over 2e-3.
    size = float(likelihood.counts.sum()) + abs(value)
    assert gradient[index] == pytest.approx((up - down) / 2e-3, abs=8.0 * size * 1e-6 / 6.0 + 1e-4)


def test_logarithms_scale_what_they_are_named_for():
    noise = ROLLING.noise
    found = scaled_noise(noise, np.log([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0]))
    assert_allclose(found.drift / noise.drift, [2.0, 2.0, 3.0])
    assert found.drift_tau / noise.drift_tau == pytest.approx(5.0)
    assert_allclose(found.position, [7.0, 7.0, 11.0])
    assert_allclose(found.velocity, [13.0, 13.0, 17.0])
    assert found.gyro / noise.gyro == pytest.approx(19.0)
    assert found.accel / noise.accel == pytest.approx(23.0)
    assert found.gyro_walk / noise.gyro_walk == pytest.approx(29.0)
    assert found.accel_walk / noise.accel_walk == pytest.approx(31.0)


def test_outliers_do_not_count():
    sim = simulate(replace(ROLLING, outliers=0.1))
    _, likelihood = likelihood_of(sim, sim.log.noise)
    clean = int((~sim.outlier).sum())
    # Cauchy's weight is under a half beyond 3 sigma of three components: 2.9 % of the clean positions, and as many of
    # the velocities, which take theirs along. Each of the rest counts 0.918, its mean square.
    assert 2 * 0.918 * 0.91 * clean < likelihood.counts[0] <= 2 * 0.918 * clean
