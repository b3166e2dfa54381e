"""The size of the noise, from the drive itself: the most likely one with log-normal priors.

What the fixes and the IMU err by maximises the marginal likelihood; how wheels and roads depart from the model follows
in closed form from what they left.

References
    Koch (1999), "Parameter estimation and hypothesis testing in linear models", section 3.6 (variance components).
    Chung, Rabe-Hesketh, Dorie, Gelman, Liu (2013), "A nondegenerate penalized likelihood estimator for variance
    parameters in multilevel models", Psychometrika 78(4), 685-709 (a gamma prior of shape 2 on a small sigma).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.constraints import Road
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.likelihood import SIZES, Likelihood, scaled_noise
from recon.numerics.smoothing.model import Noise
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.solved import Solved

_PRIOR: Final = np.array([0.35, 0.35, 0.35, 0.7, 0.7, 0.7, 0.7, 1.0, 1.0, 0.5, 0.5])
"""Sigma of the logarithms. Ten minutes hardly tell how large an error is that changes in two, and how long it lasts."""
_SLOW, _TAIL = slice(0, 2), 3.0
"""The size of the slow error of GNSS, and the degrees of freedom of its prior: a short drive leaves it where it was, a
receiver of centimetres takes it down two orders.
"""
_RAISED: Final = np.array([0.0] * 9 + [1.0] * 2)
"""Slope of the log-prior by the logarithm. What tells a walk is so little that its likeliest size is well below that
which is right on average; this avoids the boundary at zero (Chung et al. 2013).
"""
_LOW: Final = -np.array([7.0, 7.0, 2.5, 7.0, 7.0, 7.0, 7.0, 2.5, 2.5, 2.5, 2.5])
_HIGH: Final = 2.5
"""Bounds of the logarithms: a receiver that was taken for one of metres may be one of centimetres."""
_STILL_FACTOR: Final = 1.25
"""The moving car is at least so much noisier than the standing one."""
_ALIASING_HZ: Final = 15.0
"""An IMU that is sampled faster sees enough of a vibration for it to average out."""
_SIGMA_OF_MEDIAN: Final = 1.4826
"""Of normal errors, by the median of their size."""
_LASTING_S: Final = 20.0
_ACROSS: Final = np.array([0.05, 0.02])
"""m/s, sideways and upwards; what is expected of motion across the track."""
_BELIEVED: Final = np.array([1.0, 2.5])
"""How many times its size is the sigma. What a body heaves the accelerometer feels, too, so that it looks like a scale
error of the one that points up, which a smaller sigma would believe.
"""
_ACROSS_LEAST, _ACROSS_MOST = 0.01, 0.3
"""m/s."""
_BANK: Final = float(np.radians(1.5))
"""rad; what is expected of the bank of a stretch."""
_OF_PLACES: Final = 0.65
"""Sigma of the logarithm of what is expected of roads and wheels: half, or twice as large, is usual."""
_GRID: Final = np.linspace(-12.0, 8.0, 2001)
"""Sigmas of a logarithm over which it is integrated."""
_STRETCHES: Final = 5.0
"""Least number in a mean."""
_SLOW_CURVATURE: Final = np.array([[0.2, 0.0, -0.09], [0.0, 0.1, -0.045], [-0.09, -0.045, 0.07]])
_WALKS: Final = np.array([0.8, 0.05, 0.1, 0.05])
"""Second derivatives of -log L a second of drive, slow error, and an interval between knots, noise and walks of the
IMU: means of drives.
"""
_STEPS: Final = 25
_ENOUGH: Final = 0.2
"""Decrease of -log L that a further step must promise."""
_SETTLED: Final = 5.0
"""The walks of the biases wait until the other sizes promise less: they would explain whatever is not yet explained."""
_OF_WALKS: Final = np.arange(11) >= 9
_FARTHEST: Final = 1.0
"""Longest step of a logarithm."""


def at_least_still(noise: Noise, still: tuple[float | None, float | None]) -> Noise:
    """The noise, that of the IMU no smaller than what it is at stops (arguments as of `likely_noise`)."""
    return replace(
        noise,
        gyro=max(noise.gyro, _STILL_FACTOR * (still[0] or 0.0)),
        accel=max(noise.accel, _STILL_FACTOR * (still[1] or 0.0)),
    )


def at_least_aliased(noise: Noise, samples: Samples) -> Noise:
    """The noise to begin the search with, that of a slow IMU no smaller than what it jumps from sample to sample.

    Below _ALIASING_HZ nothing of a vehicle's motion is so fast, but vibration that no filter took out is aliased to
    it, tens of times the noise of a data sheet; from there the search would take it for walks of the biases. Second
    differences of white noise have six times its variance; the median is not that of stops and bumps.
    """
    step_s = float(np.median(np.diff(samples.t_s)))
    if step_s < 1.0 / _ALIASING_HZ:
        return noise
    gyro, accel = (
        float(np.median(np.abs(np.diff(samples_s, 2, axis=0)))) * _SIGMA_OF_MEDIAN * np.sqrt(step_s / 6.0)
        for samples_s in (samples.gyro_s, samples.accel_s)
    )
    return replace(noise, gyro=max(noise.gyro, gyro), accel=max(noise.accel, accel))


def likely_noise(smoother: Smoother, solved: Solved, still: tuple[float | None, float | None]) -> Noise:
    """The noise of largest posterior likelihood about a solution.

    still : densities of gyro and accelerometer at stops, which bound those of the moving car; None or 0 where unknown:
        then those at hand are not made smaller, for loose constraints would take their place
    """
    likelihood = Likelihood(smoother, solved)
    low, high = _LOW.copy(), np.full(len(SIZES), _HIGH)
    for index, floor, now in ((7, still[0], solved.noise.gyro), (8, still[1], solved.noise.accel)):
        low[index] = 0.0 if not floor else min(0.0, float(np.log(_STILL_FACTOR * floor / now)))
    unseen = np.flatnonzero(likelihood.counts == 0.0) + 3
    low[unseen] = high[unseen] = 0.0
    found = scaled_noise(solved.noise, _least(posterior(likelihood), _curvature(likelihood), low, high))
    if not smoother.model.wheels:
        return found
    sideways, upwards, bank = on_wheels(smoother, solved)
    return replace(found, sideways=sideways, upwards=upwards, bank=bank)


def on_wheels(smoother: Smoother, solved: Solved) -> tuple[float, float, float]:
    """Motion of the wheels across their track as of `across_track`, and bank of the roads, which a solution shows."""
    residual, (t_s, seconds) = smoother.sideways(solved)
    so_far = np.array([solved.noise.sideways, solved.noise.upwards])
    sideways, upwards = across_track(residual, t_s, seconds, so_far)
    lies = smoother.road(solved.state, GravityField.around(solved.state.pos_n, smoother.drive.anchor))
    return float(sideways), float(upwards), bank_of_roads(lies)


def bank_of_roads(lies: Road) -> float:
    """Sigma of the bank of a stretch of road: rad.

    What counts is how well a drive's mean is known, so means of _STRETCHES tell it, in which what lasts longer counts
    in full; of n stretches those of sqrt(n), for the longer the drive, the more what lasts shows (Flegal, Jones 2010).
    Their own mean is not seen, for the mounting takes it up.
    """
    along = np.cumsum(lies.stretches)
    batch = max(_STRETCHES, float(np.sqrt(lies.stretches.sum())))
    block = np.floor(along / batch).astype(np.intp)
    rolled = np.bincount(block, lies.stretches)
    counted = rolled > 0.5 * batch
    mean = np.bincount(block, lies.stretches * lies.bank)[counted] / rolled[counted]
    size = float((mean**2 * rolled[counted]).sum())
    seen = max(int(counted.sum()) - 1, 0)
    return float(np.sqrt(expected_variance(size, seen, _BANK)))


def expected_variance(size: float, count: int, usual: float) -> float:
    """Posterior mean of a variance whose root is log-normal beforehand, with usual^2 for the mean of the variance.

    An inverse gamma prior of the same width all but forbids what is much smaller than usual. The mean, and not the
    likeliest one, makes squared errors in units of their sigma one on average, as of Student's form.

    size : sum of `count` squares of normal values
    """
    logs = np.log(usual) + _OF_PLACES * (_GRID - _OF_PLACES)
    chance = -count * logs - 0.5 * size * np.exp(-2.0 * logs) - 0.5 * _GRID**2
    weight = np.exp(chance - chance.max())
    return float(weight @ np.exp(2.0 * logs) / weight.sum())


def lasting_drift(smoother: Smoother, solved: Solved) -> float:
    """How many times its likeliest size the slow error of GNSS has over a stretch of _LASTING_S, 1 at least.

    A receiver that smooths its positions errs alike from second to second, which no process of first order does: the
    likelihood sees how little the error changes in an interval, and would believe as little of a tunnel. Sums of its
    steps count what lasts in full, of intervals with fixes in which the vehicle moves: at stops many receivers hold
    their position. Smoothed steps are no larger than the true ones, so that little is found in white ones.
    """
    epochs, length, noise = solved.epochs, smoother.length, solved.noise
    good = (epochs.fix >= 0) & (solved.pos_weight > 0.5)
    good &= np.isfinite(smoother.drive.fixes.pos_sigma[:, epochs.fix]).any(axis=0)
    seen = np.bincount(epochs.interval[good], minlength=len(length)).astype(bool) & ~smoother.still_intervals
    kept = np.exp(-length / noise.drift_tau)
    steps = solved.state.drift_n[:, 1:] - kept * solved.state.drift_n[:, :-1]
    steps = steps[:, seen] / (noise.drift[:, None] * np.sqrt(1.0 - kept[seen] ** 2))
    block = np.floor(np.cumsum(length)[seen] / _LASTING_S).astype(np.intp)
    counted = np.bincount(block, length[seen]) > 0.5 * _LASTING_S
    sums = np.array([np.bincount(block, axis) for axis in steps])[:, counted]
    square = sums**2 / np.bincount(block)[counted]
    return float(np.sqrt(max(expected_variance(float(square.sum()), square.size, 1.0), 1.0)))


def across_track(residual: Floats, t_s: Floats, seconds: Floats, so_far: Floats) -> Floats:
    """Sigmas of motion across the wheels' track, sideways and upwards: (2,) m/s at one second.

    Camber and load make it last, so that the likelihood, which takes it for white, would believe it too small; a mean
    over _LASTING_S counts what lasts in full.

    residual : (2, n) in sigmas so_far (2,) m/s of the time that each stands for; t_s, seconds : (n,) when and how long
    """
    block = np.floor(t_s / _LASTING_S).astype(np.intp)
    rolled = np.bincount(block, seconds) if len(block) else np.zeros(0)
    counted = rolled > 0.5 * _LASTING_S
    sums = np.array([np.bincount(block, axis * np.sqrt(seconds)) for axis in residual]).reshape(2, -1)[:, counted]
    size = so_far**2 * (sums**2 / rolled[counted]).sum(axis=1)
    seen = sums.shape[1]
    found = np.sqrt([expected_variance(float(s), seen, float(usual)) for s, usual in zip(size, _ACROSS, strict=True)])
    return np.asarray(np.clip(_BELIEVED * found, _ACROSS_LEAST, _ACROSS_MOST))


def posterior(likelihood: Callable[[Floats], tuple[float, Floats]]) -> Callable[[Floats], tuple[float, Floats]]:
    """Half of -2 log L plus the prior, and its gradient."""

    def objective(logs: Floats) -> tuple[float, Floats]:
        value, gradient = likelihood(logs)
        doubt, slope = _prior(logs)
        return 0.5 * value + doubt, 0.5 * gradient + slope

    return objective


def _prior(logs: Floats) -> tuple[float, Floats]:
    """-log of the prior, and its gradient: normal, of Student's form for the slow error."""
    away = logs / _PRIOR
    doubt, slope = 0.5 * away**2, away / _PRIOR
    far = away[_SLOW]
    doubt[_SLOW] = 0.5 * (_TAIL + 1.0) * np.log1p(far**2 / _TAIL)
    slope[_SLOW] *= (_TAIL + 1.0) / (_TAIL + far**2)
    return float(doubt.sum() - _RAISED @ logs), slope - _RAISED


def _curvature(likelihood: Likelihood) -> Floats:
    """Rough second derivatives of the objective, (11, 11): what n residuals tell of their size, 2 n, less what others
    explain. Of the slow error a drive tells best how fast it wanders, so that a larger one looks like a shorter one.
    """
    length = likelihood.smoother.length
    rough = np.diag(
        np.concatenate([np.zeros(3), likelihood.counts * [1.0, 1.0, 2.0, 2.0], _WALKS * len(length)]) + 1.0 / _PRIOR**2
    )
    rough[:3, :3] += float(length.sum()) * _SLOW_CURVATURE
    return rough


def _least(objective: Callable[[Floats], tuple[float, Floats]], curvature: Floats, low: Floats, high: Floats) -> Floats:
    """The least value within bounds, to a tenth of its unit of likelihood: quasi-Newton (BFGS).

    Nocedal and Wright (2006), 2nd ed., eq. 6.19. Four or five values suffice from a fair first curvature, where a
    library that must find it takes fifteen; each value is a whole factorisation.
    """
    hessian = curvature
    here = np.clip(np.zeros_like(low), low, high)
    value, gradient = objective(here)
    for _ in range(_STEPS):
        held = ((here <= low) & (gradient > 0.0)) | ((here >= high) & (gradient < 0.0))
        step = _newton(hessian, gradient, ~held & ~_OF_WALKS)
        if -gradient @ step < _SETTLED:
            step = _newton(hessian, gradient, ~held)
            if -gradient @ step < _ENOUGH:
                break
        step *= min(1.0, _FARTHEST / float(np.abs(step).max()))
        there = np.clip(here + step, low, high)
        try:
            value_there, gradient_there = objective(there)
        except np.linalg.LinAlgError:  # too far off for a factorisation
            hessian = 2.0 * hessian
            continue
        change, moved = gradient_there - gradient, there - here
        if change @ moved > 0.0:
            pushed = hessian @ moved
            hessian = hessian + np.outer(change, change) / (change @ moved)
            hessian = hessian - np.outer(pushed, pushed) / (moved @ pushed)
        if value_there < value:
            here, value, gradient = there, value_there, gradient_there
        else:
            hessian = 2.0 * hessian
    return here


def _newton(hessian: Floats, gradient: Floats, free: NDArray[np.bool_]) -> Floats:
    """Newton's step in the free unknowns."""
    index = np.flatnonzero(free)
    step = np.zeros_like(gradient)
    step[index] = -np.linalg.solve(hessian[np.ix_(index, index)], gradient[index])
    return step
