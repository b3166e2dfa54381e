"""The marginal likelihood: its gradient against its values, and noise that was told wrong is found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from smoothing_drives import Log, Simulated, simulate

from recon.numerics.smoothing import Model, Noise, Smoother
from recon.numerics.smoothing.constraints import Road
from recon.numerics.smoothing.likelihood import Likelihood, scaled_noise
from recon.numerics.smoothing.noise import across_track, bank_of_roads, likely_noise, posterior
from recon.numerics.smoothing.start import start_state

Floats = np.ndarray
NAMES = ("drift across", "drift up", "tau", "position across", "position up", "velocity across", "velocity up")
NAMES = (*NAMES, "gyro", "accel", "gyro walk", "accel walk")
ROLLING = Log(seconds=240.0, outliers=0.03)
CLEAN = Log(seconds=600.0)


def likelihood_of(sim: Simulated, noise: Noise) -> tuple[Smoother, Likelihood]:
    smoother = Smoother(sim.drive, Model())
    return smoother, Likelihood(smoother, smoother.solve(start_state(smoother), noise, "cauchy"))


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
    sim = simulate(replace(ROLLING, outliers=0.0))
    told = replace(sim.log.noise, gyro=10.0 * sim.log.gyro, accel=10.0 * sim.log.accel)
    smoother, likelihood = likelihood_of(sim, told)
    floor = 5.0 * sim.log.gyro, 5.0 * sim.log.accel
    found = likely_noise(smoother, likelihood.solved, floor)
    assert found.gyro >= 1.25 * floor[0] * (1.0 - 1e-12)
    assert found.accel >= 1.25 * floor[1] * (1.0 - 1e-12)


def test_what_no_fix_measures_keeps_its_sigma():
    sim = simulate(replace(ROLLING, outliers=0.0))
    fixes = replace(sim.drive.fixes, vel_sigma=np.full_like(sim.drive.fixes.vel_sigma, np.inf))
    blind = replace(sim, drive=replace(sim.drive, fixes=fixes))
    smoother, likelihood = likelihood_of(blind, sim.log.noise)
    assert_array_equal(likelihood.counts[2:], 0.0)
    found = likely_noise(smoother, likelihood.solved, smoother.still_noise)
    assert_array_equal(found.velocity, sim.log.noise.velocity)


def test_outliers_do_not_count():
    sim = simulate(replace(ROLLING, outliers=0.1))
    _, likelihood = likelihood_of(sim, sim.log.noise)
    clean = int((~sim.outlier).sum())
    # Cauchy's weight is under a half beyond 3 sigma of three components: 2.9 % of the clean positions, and as many of
    # the velocities, which take theirs along. Each of the rest counts 0.918, its mean square.
    assert 2 * 0.918 * 0.91 * clean < likelihood.counts[0] <= 2 * 0.918 * clean


def rolled(sigma: float, lasts_s: int, seed: int = 3) -> np.ndarray:
    """Residuals of an hour in sigmas of 0.05 m/s, of motion across that changes every so many seconds: (3600,)."""
    return np.repeat(np.random.default_rng(seed).normal(0.0, sigma / 0.05, 3600 // lasts_s), lasts_s)


def across(sideways: np.ndarray, upwards: np.ndarray) -> np.ndarray:
    t_s = 0.5 + np.arange(len(sideways))
    return across_track(np.stack([sideways, upwards]), t_s, np.ones_like(t_s), np.full(2, 0.05))


def test_motion_across_that_lasts_counts_in_full():
    # 180 means of 20 s tell a sigma to 5 %, and the prior is worth 2 of them. What lasts for 10 s is in a second as
    # uncertain as a white one of sqrt(10) times its size. Upwards it is believed 2.5 times less.
    sideways, upwards = across(rolled(0.04, 1), rolled(0.02, 10))
    assert_allclose(sideways, 0.04, rtol=0.15)
    assert_allclose(upwards, 2.5 * 0.02 * np.sqrt(10.0), rtol=0.15)


def test_motion_across_is_believed_small_where_much_says_so():
    calm = rolled(0.001, 1)
    assert_allclose(across(calm, calm), [0.01, 0.01], rtol=1e-12)
    few = across(calm[:40], calm[:40])  # 2 means, and the prior of 2 more: its square by half
    assert_allclose(few, np.array([0.05, 2.5 * 0.02]) / np.sqrt(2.0), rtol=5e-3)
    nothing = across(calm[:5], calm[:5])
    assert_allclose(nothing, [0.05, 0.05], rtol=1e-12)
    assert_allclose(across(rolled(1.0, 1), rolled(1.0, 1)), [0.3, 0.3], rtol=1e-12)


def banked(sigma: float, stretches: int, lasts: int = 1) -> Road:
    """Roads whose bank has a sigma in deg and lasts for so many stretches, four knots in each."""
    bank = np.radians(np.random.default_rng(5).normal(0.0, sigma, stretches // lasts))
    bank = np.repeat(bank, 4 * lasts)
    none = np.zeros((3, len(bank)))
    return Road(np.arange(len(bank)), np.full(len(bank), 0.25), np.zeros(len(bank)), none, none, bank)


@pytest.mark.parametrize("sigma", [0.3, 4.0])
def test_the_bank_of_roads_is_that_which_their_mean_has(sigma):
    # 400 means of five stretches tell a sigma to 3.5 %, next to a prior that is worth two; what lasts for five
    # stretches is in each of them as uncertain as a bank of its own that is sqrt(5) times as large.
    found = np.degrees([bank_of_roads(banked(sigma, 2000, lasts)) for lasts in (1, 5)])
    expected = np.sqrt((2.0 * 1.5**2 + 399.0 * sigma**2 * np.array([1.0, 5.0])) / 401.0)
    assert_allclose(found, expected, rtol=0.12)


@pytest.mark.parametrize("stretches", [0, 2, 5])
def test_a_bank_is_what_is_expected_of_roads_where_they_are_too_few(stretches):
    # The mean of a single one is the roll of the mounting, which nothing else tells.
    assert bank_of_roads(banked(0.0, stretches)) == pytest.approx(np.radians(1.5), rel=1e-12)


def test_a_road_without_bank_is_found_to_be_one():
    # Sigmas of the prior, 1.5 deg, and of what is seen, 0: two means and seven.
    assert bank_of_roads(banked(0.0, 40)) == pytest.approx(np.radians(1.5) * np.sqrt(2.0 / 9.0), rel=1e-12)
