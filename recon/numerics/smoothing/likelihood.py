"""How likely the sizes of the noise are, given a drive: the marginal likelihood about a solution, and its gradient.

At a linearisation the problem is linear and Gaussian, so that the unknowns can be integrated out,

    -2 log L = min cost + log det H + sum log det (covariances of the factors) + const,

with H the bordered matrix of the normal equations, whose determinant falls out of its factor. The gradient needs
no derivative of H: by Fisher's identity it is the expectation of the gradient of the complete-data likelihood, which
takes second moments of neighbouring knots only. Fixes that a robust loss puts aside do not count.

References
    Bar-Shalom, Li, Kirubarajan (2001), section 1.4; Särkkä (2013), "Bayesian filtering and smoothing", section 12.2.3
    (Fisher's identity, eq. 12.32).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from recon.numerics.smoothing.band import (
    cross_covariances,
    factor,
    global_covariances,
    marginals,
    selected_inverse,
    solve_bordered,
)
from recon.numerics.smoothing.constraints import add_drift, add_walks
from recon.numerics.smoothing.inertial import HERE, THERE, add_inertial, whitening
from recon.numerics.smoothing.model import Noise
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.solved import Solved
from recon.numerics.smoothing.state import ACCEL_BIAS, COMMON_SIZE, DRIFT, GYRO_BIAS, KNOT_SIZE, SCALES

SIZES: Final = (
    "drift_h", "drift_v", "tau", "position_h", "position_v", "velocity_h", "velocity_v", "gyro", "accel",
    "gyro_walk", "accel_walk",
)  # fmt: skip
"""Of the noise, in the order of their logarithms."""
_KEPT: Final = np.array([1.0, 0.9733, 0.9494, 0.9178])
"""Mean square of what is left of normal residuals of 0 to 3 components where those whose squares sum up to more than 9
are put aside, as half a Cauchy weight does: P(chi^2_k+2 < 9) / P(chi^2_k < 9).
"""


@dataclass(frozen=True)
class Moments:
    """Second moments of the step about the linearisation: x x^T + covariance.

    own : (N, 18, 18); next : (N-1, 18, 18) of knots k and k+1; common : (29, N, 18); both_common : (29, 29)
    step : (N, 18), step_common : (29,)
    """

    own: Floats
    next: Floats
    common: Floats
    both_common: Floats
    step: Floats
    step_common: Floats

    def squares(self, part: Normal) -> float:
        """Expected sum of squared residuals of the factors in part."""
        blocks = part.blocks
        quadratic = np.einsum("nij,nij->", blocks[:, :, :KNOT_SIZE], self.own)
        quadratic += 2.0 * np.einsum("nij,nij->", blocks[:-1, :, KNOT_SIZE:], self.next)
        quadratic += 2.0 * np.vdot(part.border[:-1], self.common)
        quadratic += (part.corner[:-1, :-1] * self.both_common).sum()
        linear = (part.border[-1] * self.step).sum() + part.corner[:-1, -1] @ self.step_common
        return float(part.cost - 2.0 * linear + quadratic)


class Likelihood:
    """The marginal likelihood of the sizes of the noise, about one solution."""

    def __init__(self, smoother: Smoother, solved: Solved) -> None:
        self.smoother, self.solved, self.noise = smoother, solved, solved.noise
        self.parts = smoother.parts(solved)
        self.total = Normal(smoother.normal.knots)
        epochs = solved.epochs
        inlier_p, inlier_v = solved.pos_weight > 0.5, solved.vel_weight > 0.5
        sigma_p, sigma_v = smoother.drive.fixes.pos_sigma, smoother.drive.fixes.vel_sigma
        fixed = epochs.fix >= 0
        p = np.isfinite(sigma_p[:, epochs.fix]) & fixed & inlier_p
        v = np.isfinite(sigma_v[:, epochs.fix]) & fixed & inlier_v & ~smoother.drive.fixes.small_only[epochs.fix]
        share = smoother.drive.fixes.share[epochs.fix]
        p, v = (seen * share * _KEPT[seen.sum(axis=0)] for seen in (p, v))
        self.counts = np.array([p[:2].sum(), p[2].sum(), v[:2].sum(), v[2].sum()])

    def __call__(self, logs: Floats) -> tuple[float, Floats]:
        """-2 log L (up to a constant) and its gradient for logarithms (11,) of factors on the noise so far."""
        noise = scaled_noise(self.noise, logs)
        white = whitening(self.solved.increments, *self.smoother.disturbed.densities(noise))
        total, weights = self.total, np.exp(-2.0 * logs[3:7])
        total.clear()
        total.add(1.0, self.parts.fixed)
        for weight, part in zip(weights, self.parts.fixes, strict=True):
            total.add(weight, part)
        drift, length = self.solved.state.drift_n, self.smoother.length
        add_drift(total, drift, length, noise.drift, noise.drift_tau)
        add_walks(total, self.solved.state, self.smoother.disturbed.walk_s, noise.gyro_walk, noise.accel_walk)
        add_inertial(total, self.parts.inertial, white)
        cost, right, right_common = total.cost, total.border[-1].copy(), total.corner[:-1, -1].copy()
        moments, log_determinant = self._moments()
        variance = self._drift_variance(noise)
        value = cost - float((right * moments.step).sum() + right_common @ moments.step_common) + log_determinant
        value += float(2.0 * self.counts @ logs[3:7] + np.log(variance).sum() + 2.0 * np.log(noise.drift).sum())
        value -= float(2.0 * np.log(np.einsum("kii->ki", white)).sum())
        value += 6.0 * len(length) * float(logs[9] + logs[10])
        gradient = np.zeros(len(SIZES))
        squares = np.array([moments.squares(part) for part in self.parts.fixes])
        gradient[3:7] = 2.0 * self.counts - 2.0 * weights * squares
        gradient[0:3] = self._drift_gradient(noise, variance, moments)
        gradient[7:9] = self._inertial_gradient(noise, white, moments)
        gradient[9:11] = self._walk_gradient(noise, moments)
        return value, gradient

    def _moments(self) -> tuple[Moments, float]:
        free = self.smoother.free
        keep = np.append(free, True)
        border = self.total.border[keep].reshape(int(keep.sum()), -1).T
        system = factor(self.total.buffer, self.total.knots, KNOT_SIZE)
        found = solve_bordered(system, border, self.total.corner[np.ix_(keep, keep)])
        inverse = selected_inverse(system, found)
        step = found.step
        common = np.zeros((COMMON_SIZE, *step.shape))
        common[free] = np.moveaxis(global_covariances(inverse), -1, 0)
        step_common = np.zeros(COMMON_SIZE)
        step_common[free] = found.step_global
        both = np.zeros((COMMON_SIZE, COMMON_SIZE))
        both[np.ix_(free, free)] = found.covariance_global
        return Moments(
            own=marginals(inverse) + step[:, :, None] * step[:, None, :],
            next=cross_covariances(inverse) + step[:-1, :, None] * step[1:, None, :],
            common=common + step * step_common[:, None, None],
            both_common=both + np.outer(step_common, step_common),
            step=step,
            step_common=step_common,
        ), found.log_determinant

    def _drift_variance(self, noise: Noise) -> Floats:
        """Of the steps of the drift: (3, K) m^2."""
        kept = np.exp(-self.smoother.length / noise.drift_tau)
        return np.asarray((1.0 - kept**2) * noise.drift[:, None] ** 2)

    def _drift_gradient(self, noise: Noise, variance: Floats, moments: Moments) -> Floats:
        """With respect to the logarithms of sigma across, sigma up and tau: (3,)."""
        i = np.arange(DRIFT.start, DRIFT.stop)
        now = self.solved.state.drift_n
        mean = now + moments.step[:, i].T
        spread = moments.own[:, i, i].T - moments.step[:, i].T ** 2
        square = mean**2 + spread
        across = moments.next[:, i, i].T - moments.step[:-1, i].T * moments.step[1:, i].T + mean[:, :-1] * mean[:, 1:]
        length = self.smoother.length
        kept = np.exp(-length / noise.drift_tau)
        error = square[:, 1:] - 2.0 * kept * across + kept**2 * square[:, :-1]
        by_sigma = (2.0 - 2.0 * error / variance).sum(axis=1) + 2.0 - 2.0 * square[:, 0] / noise.drift**2
        d_kept = kept * length / noise.drift_tau
        d_variance = -2.0 * kept * d_kept * noise.drift[:, None] ** 2
        by_tau = (-2.0 * across + 2.0 * kept * square[:, :-1]) * d_kept / variance
        by_tau += d_variance / variance - error * d_variance / variance**2
        return np.array([by_sigma[:2].sum(), by_sigma[2], by_tau.sum()])

    def _walk_gradient(self, noise: Noise, moments: Moments) -> Floats:
        """With respect to the logarithms of the walks of gyro and accelerometer: (2,)."""
        state, walk_s = self.solved.state, self.smoother.disturbed.walk_s
        found = []
        for part, now, walk in (
            (GYRO_BIAS, state.gyro_bias, noise.gyro_walk),
            (ACCEL_BIAS, state.accel_bias, noise.accel_walk),
        ):
            i = np.arange(part.start, part.stop)
            own, moved = moments.own[:, i, i].T, moments.step[:, part].T
            square = own[:, 1:] + own[:, :-1] - 2.0 * moments.next[:, i, i].T
            square = square + np.diff(now) ** 2 + 2.0 * np.diff(now) * np.diff(moved)
            found.append(2.0 * square.size - 2.0 * float((square / walk_s).sum()) / walk**2)
        return np.array(found)

    def _inertial_gradient(self, noise: Noise, white: Floats, moments: Moments) -> Floats:
        """With respect to the logarithms of the densities of gyro and accelerometer: (2,)."""
        tall = self.parts.inertial
        here, there, size = HERE.stop - HERE.start, THERE.stop - THERE.start, tall.shape[2]
        both = here + there
        z = np.empty((len(tall), size, size))
        z[:, :here, :here] = moments.own[:-1, HERE, HERE]
        z[:, :here, here:both] = moments.next[:, HERE, THERE]
        z[:, here:both, here:both] = moments.own[1:, THERE, THERE]
        z[:, :here, both:-1] = np.moveaxis(moments.common[SCALES, :-1, HERE], 0, -1)
        z[:, here:both, both:-1] = np.moveaxis(moments.common[SCALES, 1:, THERE], 0, -1)
        z[:, both:-1, both:-1] = moments.both_common[SCALES, SCALES]
        z[:, :here, -1], z[:, here:both, -1] = -moments.step[:-1, HERE], -moments.step[1:, THERE]
        z[:, both:-1, -1], z[:, -1, -1] = -moments.step_common[SCALES], 1.0
        for a, b in ((slice(here, both), slice(0, here)), (slice(both, size - 1), slice(0, both))):
            z[:, a, b] = z[:, b, a].swapaxes(1, 2)
        z[:, -1, :-1] = z[:, :-1, -1]
        weighted = white @ tall
        residual = weighted @ z @ weighted.swapaxes(1, 2)
        increments = self.solved.increments
        found = []
        for density, unit in ((noise.gyro, increments.covariance_gyro), (noise.accel, increments.covariance_accel)):
            change = 2.0 * density**2 * (white @ unit @ white.swapaxes(1, 2))
            found.append(np.einsum("kii->", change) - np.einsum("kij,kji->", change, residual))
        return np.array(found)


def scaled_noise(noise: Noise, logs: Floats) -> Noise:
    """The noise with its sizes multiplied by exp(logs): (11,), as named in SIZES."""
    f = np.exp(logs)
    return replace(
        noise,
        drift=noise.drift * f[[0, 0, 1]],
        drift_tau=noise.drift_tau * float(f[2]),
        position=noise.position * f[[3, 3, 4]],
        velocity=noise.velocity * f[[5, 5, 6]],
        gyro=noise.gyro * float(f[7]),
        accel=noise.accel * float(f[8]),
        gyro_walk=noise.gyro_walk * float(f[9]),
        accel_walk=noise.accel_walk * float(f[10]),
    )
