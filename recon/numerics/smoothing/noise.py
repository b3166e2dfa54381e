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

from recon.numerics.smoothing.constraints import Road
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.likelihood import SIZES, Likelihood, scaled_noise
from recon.numerics.smoothing.model import Noise
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
_LASTING_S: Final = 20.0
_ACROSS, _ACROSS_LIKE = np.array([0.05, 0.02]), 2.0
"""m/s, sideways and upwards; what is expected of motion across the track, and how many means that is worth."""
_BELIEVED: Final = np.array([1.0, 2.5])
"""How many times its size is the sigma. What a body heaves the accelerometer feels, too, so that it looks like a scale
error of the one that points up, which a smaller sigma would believe.
"""
_ACROSS_LEAST, _ACROSS_MOST = 0.01, 0.3
"""m/s."""
_BANK, _BANK_LIKE = float(np.radians(1.5)), 2.0
"""rad; what is expected of the bank of a stretch, and how many means that is worth."""
_STRETCHES: Final = 5.0
_STEPS: Final = 12
_ENOUGH: Final = 0.2
"""Decrease of -log L that a further step must promise."""
_FARTHEST: Final = 1.0
"""Longest step of a logarithm."""


def at_least_still(noise: Noise, still: tuple[float | None, float | None]) -> Noise:
    """The noise, that of the IMU no smaller than what it is at stops (arguments as of `likely_noise`)."""
    return replace(
        noise,
        gyro=max(noise.gyro, _STILL_FACTOR * (still[0] or 0.0)),
        accel=max(noise.accel, _STILL_FACTOR * (still[1] or 0.0)),
    )


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
    residual, (t_s, seconds) = smoother.sideways(solved)
    so_far = np.array([solved.noise.sideways, solved.noise.upwards])
    sideways, upwards = across_track(residual, t_s, seconds, so_far)
    lies = smoother.road(solved.state, GravityField.around(solved.state.pos_n, smoother.drive.anchor))
    return replace(found, sideways=float(sideways), upwards=float(upwards), bank=bank_of_roads(lies))


def bank_of_roads(lies: Road) -> float:
    """Sigma of the bank of a stretch of road: rad.

    What counts is how well a drive's mean is known, so means of _STRETCHES tell it, in which what lasts longer counts
    in full. Their own mean is not seen, for the mounting takes it up. The prior is that of _BANK_LIKE means.
    """
    block = np.floor(np.cumsum(lies.stretches) / _STRETCHES).astype(np.intp)
    rolled = np.bincount(block, lies.stretches)
    counted = rolled > 0.5 * _STRETCHES
    mean = np.bincount(block, lies.stretches * lies.bank)[counted] / rolled[counted]
    size = float((mean**2 * rolled[counted]).sum())
    seen = max(int(counted.sum()) - 1, 0)
    return float(np.sqrt((_BANK_LIKE * _BANK**2 + size) / (_BANK_LIKE + seen)))


def across_track(residual: Floats, t_s: Floats, seconds: Floats, so_far: Floats) -> Floats:
    """Sigmas of motion across the wheels' track, sideways and upwards: (2,) m/s at one second.

    Camber and load make it last, so that the likelihood, which takes it for white, would believe it too small; a mean
    over _LASTING_S counts what lasts in full. The prior is that of so many means, an inverse gamma one.

    residual : (2, n) in sigmas so_far (2,) m/s of the time that each stands for; t_s, seconds : (n,) when and how long
    """
    block = np.floor(t_s / _LASTING_S).astype(np.intp)
    rolled = np.bincount(block, seconds) if len(block) else np.zeros(0)
    counted = rolled > 0.5 * _LASTING_S
    sums = np.array([np.bincount(block, axis * np.sqrt(seconds)) for axis in residual]).reshape(2, -1)[:, counted]
    size = so_far**2 * (sums**2 / rolled[counted]).sum(axis=1)
    found = np.sqrt((_ACROSS_LIKE * _ACROSS**2 + size) / (_ACROSS_LIKE + sums.shape[1]))
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
    """Rough second derivatives of the objective: what n residuals tell of their size, 2 n, less what others explain."""
    length = likelihood.smoother.length
    fixes = likelihood.counts * [1.0, 1.0, 2.0, 2.0]
    slow = float(length.sum()) * np.array([0.2, 0.1, 0.07])
    return np.concatenate([slow, fixes, np.array([0.8, 0.05, 0.1, 0.05]) * len(length)]) + 1.0 / _PRIOR**2


def _least(objective: Callable[[Floats], tuple[float, Floats]], curvature: Floats, low: Floats, high: Floats) -> Floats:
    """The least value within bounds, to a tenth of its unit of likelihood: quasi-Newton (BFGS).

    Nocedal and Wright (2006), 2nd ed., eq. 6.19. Four or five values suffice from a fair first curvature, where a
    library that must find it takes fifteen; each value is a whole factorisation.
    """
    hessian = np.diag(curvature)
    here = np.clip(np.zeros_like(low), low, high)
    value, gradient = objective(here)
    for _ in range(_STEPS):
        held = ((here <= low) & (gradient > 0.0)) | ((here >= high) & (gradient < 0.0))
        free = np.flatnonzero(~held)
        step = np.zeros_like(here)
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        if -gradient @ step < _ENOUGH:
            break
        step *= min(1.0, _FARTHEST / float(np.abs(step).max()))
        there = np.clip(here + step, low, high)
        value_there, gradient_there = objective(there)
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
