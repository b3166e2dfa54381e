"""Noise that was told wrong is found by its likelihood, and what tells nothing of it keeps what was told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize
from scipy.stats import chi2
from smoothing_drives import Log, likelihood_of, simulate

from recon.numerics.smoothing import Noise
from recon.numerics.smoothing.constraints import Road
from recon.numerics.smoothing.noise import (
    across_track,
    at_least_aliased,
    bank_of_roads,
    expected_variance,
    likely_noise,
    posterior,
)
from recon.numerics.smoothing.samples import Samples, regular_samples

Floats = np.ndarray
CLEAN = Log(seconds=600.0)
ROLLING = Log(seconds=240.0)


def test_the_posterior_adds_the_prior_to_value_and_gradient():
    def flat(logs: Floats) -> tuple[float, Floats]:
        return 3.0, np.zeros(11)

    objective: Callable[[Floats], tuple[float, Floats]] = posterior(flat)
    logs = np.linspace(-1.0, 1.0, 11)
    value, gradient = objective(logs)
    assert objective(np.zeros(11))[0] == pytest.approx(1.5)
    assert value > 1.5
    step = 1e-6
    for index in range(11):
        change = np.eye(11)[index] * step
        slope = (objective(logs + change)[0] - objective(logs - change)[0]) / (2.0 * step)
        assert gradient[index] == pytest.approx(slope, abs=1e-8)


def told_wrong(log: Log = CLEAN, **factors: float) -> tuple[Noise, Noise]:
    """The true noise of a drive of 10 minutes, and what is found where it was told wrong by factors."""
    sim = simulate(log)
    true = sim.log.noise
    told = replace(true, **{name: getattr(true, name) * factor for name, factor in factors.items()})
    smoother, likelihood = likelihood_of(sim, told)
    return true, likely_noise(smoother, likelihood.solved, (0.01 * true.gyro, 0.01 * true.accel))


def test_velocity_sigmas_told_too_large_are_found():
    true, found = told_wrong(velocity=3.0)
    # 1200 residuals across and 600 up tell sigma to 1 / sqrt(2 n) = 2 and 3 %, less what the prior of exp(0.7) holds,
    # next to nothing. The quasi-Newton search stops 0.2 of a unit of likelihood away, sqrt(0.4) sigma.
    assert_allclose(found.velocity, true.velocity, rtol=0.12)


@pytest.mark.parametrize("factor", [0.33, 0.5])
def test_velocity_sigmas_told_too_small_grow_as_far_as_fixes_still_count(factor):
    true, found = told_wrong(velocity=factor)
    # Fixes count up to a squared residual of 9, in the sigmas told. Of three Gaussian components the rest has the
    # variance E[x; x < c] / 3 = P5(c) / P3(c), c = 9 factor^2, P the chi-square distribution of 5 and 3 components.
    cut = 9.0 * factor**2
    rest = np.sqrt(chi2.cdf(cut, 5) / chi2.cdf(cut, 3))
    assert (found.velocity > rest * 0.9 * true.velocity).all()
    assert (found.velocity > 1.25 * factor * true.velocity).all()
    assert (found.velocity < 1.12 * true.velocity).all()


def test_a_receiver_of_centimetres_taken_for_one_of_metres_is_found():
    true, found = told_wrong(replace(CLEAN, white=0.01, drift=0.01), position=100.0, drift=200.0)
    # Between fixes a second apart the IMU moves by 2 mm more or less, so that 1200 residuals across and 600 up tell the
    # white noise; drift and motion over a minute are told apart by velocities of 0.1 m/s alone, some decimetres.
    assert_allclose(found.position, true.position, rtol=0.3)
    assert (found.drift < 0.2).all()


def logs_of(found: Noise, told: Noise) -> Floats:
    """The logarithms that `scaled_noise` made of what was told."""
    axes = [(name, axis) for name in ("drift", "position", "velocity") for axis in (0, 2)]
    ratios = {(n, a): getattr(found, n)[a] / getattr(told, n)[a] for n, a in axes}
    singles = [getattr(found, n) / getattr(told, n) for n in ("gyro", "accel", "gyro_walk", "accel_walk")]
    between = [ratios["drift", 0], ratios["drift", 2], found.drift_tau / told.drift_tau]
    return np.log([*between, *(ratios[key] for key in axes[2:]), *singles])


def test_the_search_ends_where_one_without_a_first_guess_ends():
    sim = simulate(replace(CLEAN, white=0.01, drift=0.01))
    told = replace(sim.log.noise, position=100.0 * sim.log.noise.position, drift=200.0 * sim.log.noise.drift)
    smoother, likelihood = likelihood_of(sim, told)
    ends = logs_of(likely_noise(smoother, likelihood.solved, (0.01 * told.gyro, 0.01 * told.accel)), told)
    objective = posterior(likelihood)
    bounds = [(-2.5 if index in (2, 7, 8, 9, 10) else -7.0, 2.5) for index in range(11)]
    least = minimize(objective, ends, jac=True, method="L-BFGS-B", bounds=bounds)
    # From 200 times too large it is a long way; a promise of 0.2 ends it, by a curvature that is rough there. One is
    # sqrt(2) sigmas of what the drive tells.
    assert objective(ends)[0] - least.fun < 1.0


@pytest.mark.parametrize("factor", [0.33, 3.0], ids=["too small", "too large"])
def test_the_noise_of_the_imu_told_wrong_is_found(factor):
    # That of the data sheet, 2 mm/s in an interval, hides behind GNSS velocities of 0.1 m/s; that of a car on a rough
    # road does not: 0.04 m/s^2/sqrt(Hz) is 0.06 m/s.
    true, found = told_wrong(replace(CLEAN, accel=0.04, gyro=np.radians(0.1)), gyro=factor, accel=factor)
    # 300 intervals with three components each: half of what was wrong must go at least, which the prior of exp(1) and
    # the velocities of GNSS, which tell the same, leave.
    for name in ("gyro", "accel"):
        left = np.log(getattr(found, name) / getattr(true, name)) / np.log(factor)
        assert abs(left) < 0.5, name


@pytest.mark.parametrize("factor", [0.2, 5.0], ids=["too small", "too large"])
def test_walks_of_the_biases_told_wrong_are_found(factor):
    # Walks of 2e-3 deg/s/sqrt(s) and 2 mm/s^2/sqrt(s) turn the heading by a degree, and move by a metre, in a minute,
    # far beyond the noise: half of what was wrong must go at least, whatever the prior of exp(0.5) leaves.
    log = replace(CLEAN, gyro_walk=np.radians(2e-3), accel_walk=2e-3)
    true, found = told_wrong(log, gyro_walk=factor, accel_walk=factor)
    for name in ("gyro_walk", "accel_walk"):
        left = np.log(getattr(found, name) / getattr(true, name)) / np.log(factor)
        assert abs(left) < 0.5, name


def test_noise_told_right_stays():
    true, found = told_wrong()
    # Sigmas of the logarithms: 2 to 3 % where residuals are many; ten minutes tell drift and tau to 25 %, the prior
    # holds them at 35 %. Three of them.
    assert_allclose(found.velocity, true.velocity, rtol=0.12)
    assert_allclose(found.position, true.position, rtol=0.25)
    for name in ("drift", "drift_tau", "gyro", "accel", "gyro_walk", "accel_walk"):
        ratio = np.asarray(getattr(found, name)) / getattr(true, name)
        assert (np.abs(np.log(ratio)) < 0.75).all(), name


def test_a_moving_imu_is_noisier_than_a_standing_one():
    sim = simulate(ROLLING)
    told = replace(sim.log.noise, gyro=10.0 * sim.log.gyro, accel=10.0 * sim.log.accel)
    smoother, likelihood = likelihood_of(sim, told)
    floor = 5.0 * sim.log.gyro, 5.0 * sim.log.accel
    found = likely_noise(smoother, likelihood.solved, floor)
    assert found.gyro >= 1.25 * floor[0] * (1.0 - 1e-12)
    assert found.accel >= 1.25 * floor[1] * (1.0 - 1e-12)


def test_what_no_fix_measures_keeps_its_sigma():
    sim = simulate(ROLLING)
    fixes = replace(sim.drive.fixes, vel_sigma=np.full_like(sim.drive.fixes.vel_sigma, np.inf))
    blind = replace(sim, drive=replace(sim.drive, fixes=fixes))
    smoother, likelihood = likelihood_of(blind, sim.log.noise)
    assert_array_equal(likelihood.counts[2:], 0.0)
    found = likely_noise(smoother, likelihood.solved, smoother.still_noise)
    assert_array_equal(found.velocity, sim.log.noise.velocity)


def rolled(sigma: float, lasts_s: int, seed: int = 3) -> np.ndarray:
    """Residuals of an hour in sigmas of 0.05 m/s, of motion across that changes every so many seconds: (3600,)."""
    return np.repeat(np.random.default_rng(seed).normal(0.0, sigma / 0.05, 3600 // lasts_s), lasts_s)


def across(sideways: np.ndarray, upwards: np.ndarray) -> np.ndarray:
    t_s = 0.5 + np.arange(len(sideways))
    return across_track(np.stack([sideways, upwards]), t_s, np.ones_like(t_s), np.full(2, 0.05))


def test_motion_across_that_lasts_counts_in_full():
    # 180 means of 20 s tell a sigma to 5 %, and the prior hardly counts beside them. What lasts for 10 s is in a second
    # as uncertain as a white one of sqrt(10) times its size. Upwards it is believed 2.5 times less.
    sideways, upwards = across(rolled(0.04, 1), rolled(0.02, 10))
    assert_allclose(sideways, 0.04, rtol=0.15)
    assert_allclose(upwards, 2.5 * 0.02 * np.sqrt(10.0), rtol=0.15)


def test_motion_across_is_believed_small_where_much_says_so():
    calm = rolled(0.001, 1)
    assert_allclose(across(calm, calm), [0.01, 0.01], rtol=1e-12)
    few = across(calm[:40], calm[:40])  # 2 means, next to nothing: a log-normal prior tilted by -2
    assert_allclose(few, np.array([0.05, 2.5 * 0.02]) * np.exp(-(0.65**2) * 2.0), rtol=0.05)
    nothing = across(calm[:5], calm[:5])
    assert_allclose(nothing, [0.05, 0.05], rtol=1e-9)
    assert_allclose(across(rolled(1.0, 1), rolled(1.0, 1)), [0.3, 0.3], rtol=1e-12)


def banked(sigma: float, stretches: int, lasts: int = 1) -> Road:
    """Roads whose bank has a sigma in deg and lasts for so many stretches, four knots in each."""
    bank = np.radians(np.random.default_rng(5).normal(0.0, sigma, stretches // lasts))
    bank = np.repeat(bank, 4 * lasts)
    none = np.zeros((3, len(bank)))
    return Road(np.arange(len(bank)), np.full(len(bank), 0.25), np.zeros(len(bank)), none, none, bank)


@pytest.mark.parametrize("sigma", [0.3, 4.0])
def test_the_bank_of_roads_is_that_which_their_mean_has(sigma):
    # 90 means of 89 stretches tell a sigma to 7.5 %, three of which are allowed; what lasts for 20 stretches is in each
    # of them as uncertain as a bank of its own that is sqrt(20) times as large.
    found = np.degrees([bank_of_roads(banked(sigma, 8000, lasts)) for lasts in (1, 20)])
    assert_allclose(found, sigma * np.sqrt([1.0, 20.0]), rtol=0.23)


@pytest.mark.parametrize("stretches", [0, 2, 5])
def test_a_bank_is_what_is_expected_of_roads_where_they_are_too_few(stretches):
    # The mean of a single one is the roll of the mounting, which nothing else tells.
    assert bank_of_roads(banked(0.0, stretches)) == pytest.approx(np.radians(1.5), rel=1e-9)


def test_a_road_without_bank_is_found_to_be_one():
    banks = [bank_of_roads(banked(0.0, stretches)) for stretches in (20, 40, 200)]
    # Six means of sqrt(40) stretches, five without their own mean, tilt the log-normal density by exp(-5 log sigma).
    assert banks[1] == pytest.approx(np.radians(1.5) * np.exp(-(0.65**2) * 5.0), rel=1e-6)
    assert banks[0] > banks[1] > banks[2]


@pytest.mark.parametrize("count", [3, 8, 40])
def test_squared_errors_in_units_of_an_expected_variance_are_one_on_average(count):
    # Sizes drawn as they are expected; values of them, of which `count` tell the size, and another one is judged.
    rng = np.random.default_rng(3)
    draws = 4000
    sigma = 1.5 * np.exp(0.65 * rng.normal(size=draws) - 0.65**2)
    told = ((sigma[:, None] * rng.normal(size=(draws, count))) ** 2).sum(axis=1)
    variance = np.array([expected_variance(float(size), count, 1.5) for size in told])
    judged = (sigma * rng.normal(size=draws)) ** 2 / variance
    # Given what is told, a squared error is the variance on average, so that the ratio is one; its scatter is some
    # twice that, and four sigmas of the mean are 4 * 2 / sqrt(4000).
    assert judged.mean() == pytest.approx(1.0, abs=0.13)


def shaken(rate_hz: float, gyro: float, accel: float) -> Samples:
    """Ten minutes of slow motion with white noise of sigmas rad/s and m/s^2."""
    rng = np.random.default_rng(5)
    t_s = np.arange(0.0, 600.0, 1.0 / rate_hz)
    slow = np.sin(0.5 * t_s)[:, None] * np.ones(3)
    white = rng.normal(size=(2, len(t_s), 3))
    return regular_samples(t_s, 0.1 * slow + gyro * white[0], slow + accel * white[1])


def test_a_slow_imu_begins_with_the_noise_that_its_samples_show():
    found = at_least_aliased(ROLLING.noise, shaken(10.0, 0.02, 0.5))
    # Of 18 000 second differences the median tells sigma to some per cent; the motion adds (0.5 * 0.1)^2 = 0.0025 of
    # its size, nothing beside the noise.
    assert found.gyro == pytest.approx(0.02 / np.sqrt(10.0), rel=0.05)
    assert found.accel == pytest.approx(0.5 / np.sqrt(10.0), rel=0.05)


@pytest.mark.parametrize(("rate_hz", "gyro", "accel"), [(100.0, 0.02, 0.5), (10.0, 1e-5, 1e-4)])
def test_a_fast_imu_and_a_quiet_one_begin_with_the_noise_that_is_told(rate_hz, gyro, accel):
    found = at_least_aliased(ROLLING.noise, shaken(rate_hz, gyro, accel))
    assert (found.gyro, found.accel) == (ROLLING.noise.gyro, ROLLING.noise.accel)
