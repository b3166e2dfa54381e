"""The filter of position and velocity against the textbook's, a step for each sample, and against its own claims."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from recon.numerics.constant_velocity import FIRST_SPEED, Fusion, Innovations, Motion
from recon.numerics.constant_velocity_pushes import pushes
from recon.numerics.rotation import Floats

RATE_HZ = 50.0
DENSITY, SIGMA, GATE = 0.4, 2.0, 1e6


def drive(seed: int, duration_s: float = 60.0, density: float = DENSITY) -> tuple[Floats, Floats, Floats, Floats]:
    """Times (n,), measured accelerations (n, 2), true position and velocity (n, 2): the model itself drives.

    The acceleration is a straight line between samples, the noise on it is held over each step.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    acc = np.column_stack([np.sin(t_s / 5.0), np.cos(t_s / 3.0)])
    h = 1.0 / RATE_HZ
    pushed = 0.5 * (acc[:-1] + acc[1:]) + density * np.sqrt(RATE_HZ) * rng.standard_normal((len(t_s) - 1, 2))
    vel = np.vstack([np.zeros(2), np.cumsum(h * pushed, axis=0)])
    pos = np.vstack([np.zeros(2), np.cumsum(h * vel[:-1] + h**2 * pushed / 2.0, axis=0)])
    return t_s, acc, pos, vel


def run(t_s: Floats, acc: Floats, fix_s: Floats, fix: Floats, **settings: Any) -> tuple[Motion, Innovations]:
    fusion, told = made(t_s, acc, fix_s, fix, **settings)
    return fusion.estimate(np.full(fix.shape[1], told["density"]), smooth=told["smooth"])


def made(t_s: Floats, acc: Floats, fix_s: Floats, fix: Floats, **settings: Any) -> tuple[Fusion, dict[str, Any]]:
    held = settings.pop("held", np.zeros(len(t_s) - 1, dtype=bool))
    told = {"density": DENSITY, "held_density": 2.0, "gate": GATE, "patience": 10.0, "smooth": False, **settings}
    ready = {name: told[name] for name in ("held_density", "gate", "patience")}
    return Fusion.of(t_s, acc, held, fix_s, fix, np.full(fix.shape, SIGMA**2), **ready), told


def textbook(t_s: Floats, acc: Floats, rows: Floats, fix: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Means (n, 2) and covariances (n, 2, 2), filtered and smoothed, of one axis: every sample is a step of matrices.

    rows : at which samples the fixes are
    """
    h = 1.0 / RATE_HZ
    move, noise = np.array([[1.0, h], [0.0, 1.0]]), DENSITY**2 * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    x, cov = np.array([fix[0], 0.0]), np.diag([SIGMA**2, FIRST_SPEED**2])
    means, covs, priors = [x], [cov], [(x, cov)]
    where = dict(zip(rows.tolist(), fix, strict=True))
    for k in range(1, len(t_s)):
        push = np.array([h**2 * (acc[k - 1] / 3.0 + acc[k] / 6.0), h * (acc[k - 1] + acc[k]) / 2.0])
        x, cov = move @ x + push, move @ cov @ move.T + noise
        priors.append((x, cov))
        if k in where:
            gain = cov[:, 0] / (cov[0, 0] + SIGMA**2)
            x, cov = x + gain * (where[k] - x[0]), cov - np.outer(gain, cov[0])
        means.append(x)
        covs.append(cov)
    smooth, smooth_covs = [means[-1]], [covs[-1]]
    for k in range(len(t_s) - 2, -1, -1):
        gain = covs[k] @ move.T @ np.linalg.inv(priors[k + 1][1])
        smooth.append(means[k] + gain @ (smooth[-1] - priors[k + 1][0]))
        smooth_covs.append(covs[k] + gain @ (smooth_covs[-1] - priors[k + 1][1]) @ gain.T)
    return np.array(means), np.array(covs), np.array(smooth[::-1]), np.array(smooth_covs[::-1])


@pytest.mark.parametrize("smooth", [False, True])
def test_it_is_the_textbook_filter_that_steps_from_sample_to_sample(smooth: bool) -> None:
    t_s, acc, pos, _ = drive(1)
    rows = np.array([0, 50, 77, 78, 300, 1500, 2400])
    fix = pos[rows] + SIGMA * np.random.default_rng(2).standard_normal((len(rows), 2))
    found, _ = run(t_s, acc, t_s[rows], fix, smooth=smooth)
    for axis in range(2):
        means, covs, smoothed, smooth_covs = textbook(t_s, acc[:, axis], rows, fix[:, axis])
        wanted, spread = (smoothed, smooth_covs) if smooth else (means, covs)
        # Sums of 3000 steps, and inverses of covariances that are alike to 1e-5 in the textbook's smoother.
        np.testing.assert_allclose(found.pos[:, axis], wanted[:, 0], rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(found.vel[:, axis], wanted[:, 1], rtol=0.0, atol=1e-6)
        np.testing.assert_allclose(found.pos_var[:, axis], spread[:, 0, 0], rtol=1e-5)
        np.testing.assert_allclose(found.vel_var[:, axis], spread[:, 1, 1], rtol=1e-5)


@pytest.mark.parametrize("smooth", [False, True])
def test_errors_are_as_large_as_the_sigmas_say(smooth: bool) -> None:
    squares = []
    for seed in range(60):
        t_s, acc, pos, vel = drive(seed, 30.0)
        rows = np.arange(0, len(t_s), 50)
        fix = pos[rows] + SIGMA * np.random.default_rng(1000 + seed).standard_normal((len(rows), 2))
        found, _ = run(t_s, acc, t_s[rows], fix, smooth=smooth)
        at = len(t_s) // 2 + 13  # between two fixes
        squares.append((found.pos[at] - pos[at]) ** 2 / found.pos_var[at])
        squares.append((found.vel[at] - vel[at]) ** 2 / found.vel_var[at])
    # 240 squares of mean 1; those of position and velocity of one drive have something in common: sigma sqrt(4 / 240).
    assert np.mean(squares) == pytest.approx(1.0, abs=4.0 * np.sqrt(4.0 / 240.0))


def test_innovations_are_white_and_as_large_as_they_say() -> None:
    t_s, acc, pos, _ = drive(3, 400.0)
    rows = np.arange(0, len(t_s), 50)
    fix = pos[rows] + SIGMA * np.random.default_rng(4).standard_normal((len(rows), 2))
    _, seen = run(t_s, acc, t_s[rows], fix)
    normed = (seen.value / np.sqrt(seen.variance))[5:]
    limit = 4.0 / np.sqrt(normed.size)
    assert (normed**2).mean() == pytest.approx(1.0, abs=np.sqrt(2.0) * limit)
    assert abs((normed[1:] * normed[:-1]).mean()) < limit
    np.testing.assert_array_equal(seen.weight, 1.0)


@pytest.mark.parametrize("density", [0.1, 0.14, 0.57, 0.8])
def test_the_noise_of_the_acceleration_is_found_from_the_innovations(density: float) -> None:
    t_s, acc, pos, _ = drive(11, 600.0, density)
    rows = np.arange(0, len(t_s), 50)
    fix = pos[rows] + SIGMA * np.random.default_rng(12).standard_normal((len(rows), 2))
    fix[100] += 1e4
    fusion, _ = made(t_s, acc, t_s[rows], fix, gate=5.0)
    # Of 1200 innovations, one drive to the other by 7 %.
    found = fusion.likeliest([0, 1], [0.1 * 2.0**power for power in range(5, -4, -1)])
    assert found == pytest.approx(density, rel=0.2)


def test_without_noise_the_motion_comes_back_at_every_sample() -> None:
    t_s, acc, pos, vel = drive(5, density=0.0)
    exact, _ = pushes(t_s, acc, np.zeros(len(t_s) - 1, dtype=bool), t_s)
    rows = np.arange(0, len(t_s), 50)
    found, seen = run(t_s, acc, t_s[rows], exact.twice[rows], smooth=True)
    np.testing.assert_allclose(found.pos, exact.twice, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.vel, exact.once, rtol=0.0, atol=1e-9)
    assert np.abs(seen.value).max() < 1e-9
    # A step of the simulated motion holds the mean of its two ends: off by h^2 / 12 of the change of acceleration.
    assert np.abs(exact.twice - pos).max() < 1e-3
    assert np.abs(exact.once - vel).max() < 1e-6


def test_a_fix_between_two_samples_is_taken_where_it_is() -> None:
    t_s = np.array([0.0, 1.0, 3.0, 4.0])
    acc = np.array([[0.0], [2.0], [2.0], [0.0]])
    at = np.array([0.0, 0.5, 1.0, 2.0, 3.5])
    _, there = pushes(t_s, acc, np.zeros(3, dtype=bool), at)
    # a = 2 t until 1 s: v = t^2, p = t^3 / 3; then a = 2: v = 1 + 2 (t - 1), p = 1/3 + (t - 1) + (t - 1)^2.
    np.testing.assert_allclose(there.once[:4, 0], [0.0, 0.25, 1.0, 3.0])
    np.testing.assert_allclose(there.twice[:4, 0], [0.0, 1 / 24, 1 / 3, 1 / 3 + 2.0])
    # a = 2 - 2 (t - 3) after 3 s, where v = 5 and p = 19 / 3.
    np.testing.assert_allclose([there.once[4, 0], there.twice[4, 0]], [5.75, 19 / 3 + 2.5 + 0.25 - 1 / 24])


def test_an_outlier_pulls_little_and_is_told() -> None:
    t_s, acc, pos, _ = drive(6)
    rows = np.arange(0, len(t_s), 50)
    fix = pos[rows] + SIGMA * np.random.default_rng(7).standard_normal((len(rows), 2))
    clean, _ = run(t_s, acc, np.delete(t_s[rows], 30), np.delete(fix, 30, axis=0), gate=5.0)
    fix[30] += 500.0
    found, seen = run(t_s, acc, t_s[rows], fix, gate=5.0)
    # Weighed so that it lies at five sigmas, it pulls by P g^2 / e: of 2 m^2 and 500 m some 0.1 m.
    assert np.abs(found.pos - clean.pos).max() < 0.5
    assert (seen.weight[29] < 1e-3).all()
    plain, _ = run(t_s, acc, t_s[rows], fix, gate=1e9)
    assert np.abs(plain.pos - clean.pos).max() > 100.0


def test_a_filter_that_went_astray_comes_back() -> None:
    """An acceleration that is wrong all the time outruns what the filter thinks of itself, as t^2 outruns t^1.5."""
    t_s, acc, pos, _ = drive(8)
    rows = np.arange(0, len(t_s), 50)
    wrong = acc + np.where(t_s < 30.0, 0.0, 8.0)[:, None]
    lost, _ = run(t_s, wrong, t_s[rows], pos[rows], gate=5.0, patience=1e9)
    found, _ = run(t_s, wrong, t_s[rows], pos[rows], gate=5.0, patience=5.0)
    assert np.abs(lost.pos[-1] - pos[-1]).min() > 1000.0
    assert np.abs(found.pos[-1] - pos[-1]).max() < 0.1 * np.abs(lost.pos[-1] - pos[-1]).min()


def test_fixes_that_are_moved_for_good_are_believed_after_a_while() -> None:
    t_s, acc, pos, _ = drive(8)
    rows = np.arange(0, len(t_s), 50)
    moved = pos[rows] + np.where(np.arange(len(rows)) < 20, 0.0, 200.0)[:, None]
    found, seen = run(t_s, acc, t_s[rows], moved, gate=5.0, patience=10.0)
    assert (seen.weight[19:29] < 0.1).all()
    assert (seen.weight[29] == 1.0).all()
    assert np.abs(found.pos[-1] - pos[-1] - 200.0).max() < 5.0 * SIGMA


def test_steps_of_which_nothing_is_known_hold_the_velocity_and_raise_the_sigma() -> None:
    t_s = np.array([0.0, 1.0, 11.0, 12.0])
    acc, held = np.full((4, 1), 3.0), np.array([False, True, False])
    here, _ = pushes(t_s, acc, held, t_s)
    np.testing.assert_allclose(here.once[:, 0], [0.0, 3.0, 3.0, 6.0])
    known, _ = run(t_s, acc, np.zeros(1), np.zeros((1, 1)))
    found, _ = run(t_s, acc, np.zeros(1), np.zeros((1, 1)), held=held, held_density=50.0)
    assert found.pos_var[-1, 0] > known.pos_var[-1, 0] + 50.0**2 * 10.0**3 / 12.0


def test_a_step_of_which_nothing_is_known_after_the_last_fix_counts_in_full() -> None:
    t_s, held = np.array([0.0, 1.0, 3.0]), np.array([False, True])
    fix = np.zeros((2, 1))
    found, _ = run(t_s, np.zeros((3, 1)), t_s[:2], fix, held=held, held_density=2.0)
    # white noise of the density added to that of the known acceleration, for 2 s
    added = (2.0**2 + DENSITY**2) * 2.0
    assert found.vel_var[2, 0] - found.vel_var[1, 0] == pytest.approx(added)


def test_rows_before_the_first_fix_are_left_out_and_rows_after_the_last_are_predicted() -> None:
    t_s, acc, pos, _ = drive(9)
    rows = np.arange(500, 2000, 50)
    for smooth in (False, True):
        found, _ = run(t_s, acc, t_s[rows], pos[rows], smooth=smooth)
        assert len(found.pos) == len(t_s) - 500
        after = found.pos_var[1950 - 500 :, 0]
        assert (np.diff(after) > 0.0).all()


def test_one_fix_alone_is_enough_for_a_start() -> None:
    found, seen = run(np.array([0.0, 1.0]), np.zeros((2, 1)), np.array([0.5]), np.array([[7.0]]), smooth=True)
    assert (found.pos.tolist(), seen.value.shape) == ([[7.0]], (0, 1))


def test_an_hour_at_100_hz_takes_less_than_half_a_second() -> None:
    t_s = np.arange(360_000) / 100.0
    acc = np.random.default_rng(10).standard_normal((len(t_s), 3))
    fix_s = np.arange(0.0, 3599.0)
    fix = np.zeros((len(fix_s), 3))
    taken = []
    for _ in range(3):
        before = time.process_time()
        run(t_s, acc, fix_s, fix)
        taken.append(time.process_time() - before)
    assert min(taken) < 0.5
