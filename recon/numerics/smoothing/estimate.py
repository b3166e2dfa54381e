"""From what was logged to the best trajectory: start, noise, outliers, sigmas.

    1. closed-form start
    2. Cauchy's loss on twenty minutes of the drive at most, and the noise that is most likely there
    3. truncated least squares on the whole drive with that noise, and once more where the slow error lasts
    4. stops far from any fix, where the trajectory shows that what looks quiet does stand: once more with these

Noise comes before hard rejection: an IMU believed too good makes outliers of good fixes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from recon.numerics.signals import runs
from recon.numerics.smoothing.alignment import flip_needed
from recon.numerics.smoothing.band import Inverse, global_covariances, marginals
from recon.numerics.smoothing.constraints import LEANING, leans
from recon.numerics.smoothing.earth import GravityField, level_rotation
from recon.numerics.smoothing.model import Drive, Model, Noise
from recon.numerics.smoothing.noise import at_least_aliased, at_least_still, lasting_drift, likely_noise
from recon.numerics.smoothing.robust import OPEN, SHARPEST
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.soa import Floats, mm, mmt, mtv
from recon.numerics.smoothing.solved import Solved
from recon.numerics.smoothing.start import start_state
from recon.numerics.smoothing.state import (
    CLOCK,
    COMMON_SIZE,
    KNOT_SIZE,
    LAG,
    MOUNT,
    POSITION,
    ROTATION,
    VELOCITY,
    State,
)
from recon.numerics.smoothing.stops import SLOW, Mask

NOISE_FROM_S: Final = 1200.0
"""s of the drive from which the noise is estimated: more does not tell it better than the priors do."""

_MOST_ROUNDS: Final = 4
_SURE, _AT_REST = 3.0, 0.05
"""Sigmas; m/s by which the speed of a vehicle at rest may come out wrong beyond them."""
_MOST_REJECTED: Final = 0.15
"""Share of the fixes."""
_GROWN_FIXES, _GROWN_MOTION = 1.2, 2.0
"""Growth of a size of noise after which it is estimated again."""
_WORTH_IT: Final = 1.1
"""Growth of the slow error from which the drive is solved once more."""
_OF_MOTION: Final = ("gyro", "accel", "gyro_walk", "accel_walk", "sideways", "upwards")


@dataclass(frozen=True)
class Estimate:
    """The solution of a whole drive and its covariances.

    covariance : (N, 18, 18) of the knots; covariance_common : (21, 21); cross : (N, 18, 21) of knots with what is
    common; inverse : from which covariances between any two knots follow
    """

    smoother: Smoother
    solved: Solved
    inverse: Inverse
    covariance: Floats
    covariance_common: Floats
    cross: Floats


def estimate(drive: Drive, model: Model, noise: Noise, learn_noise: bool = True) -> Estimate:
    """The best trajectory. Raises numpy.linalg.LinAlgError where the data do not determine it."""
    smoother = Smoother(drive, model)
    state, near = start_state(smoother), False
    if learn_noise:
        noise, state, near = _learnt(smoother, state, noise)
    rough = bool(smoother.quiet.any())
    solved = _without_outliers(smoother, state, noise, near, rough)
    if _found_leaning(smoother, solved):
        solved = smoother.solve(solved.state, noise, "tls", SHARPEST)
        rough = False
    lasts = lasting_drift(smoother, solved) if learn_noise else 1.0
    if lasts > _WORTH_IT:
        noise = replace(noise, drift=noise.drift * lasts)
        solved = smoother.solve(solved.state, noise, "tls", SHARPEST)
        rough = False
    if model.mounting is None and flip_needed(forward_speed(solved.state)):
        turned = np.diag([-1.0, -1.0, 1.0])
        smoother.datum = smoother.datum.mounted(turned @ smoother.datum.rot_vs)
        solved = smoother.solve(replace(solved.state, rot_vs=turned @ solved.state.rot_vs), noise, "tls")
        rough = False
    return with_stops_in_silence(smoother, solved, rough)


def with_stops_in_silence(smoother: Smoother, solved: Solved, rough: bool = False) -> Estimate:
    """A solution that the smoother found last, with the stops that no fix tells: those of which the trajectory leaves
    no doubt, and then, if the IMU may decide alone, those that it does not contradict. Raises LinAlgError.

    rough : the solution has not settled yet, which it need not do before it has them
    """
    for _ in range(_MOST_ROUNDS):
        standing = _standing(smoother, solved, SLOW)
        if smoother.alone and not standing.any():
            standing = _standing(smoother, solved, np.inf)
        if standing.any():
            smoother.believe(standing)
        elif not rough:
            break
        solved = smoother.solve(solved.state, solved.noise, "tls", SHARPEST)
        rough = False
    return with_covariances(smoother, smoother.anew(solved))


def _standing(smoother: Smoother, solved: Solved, highest: float) -> Mask:
    """Quiet stretches without fixes whose speed is none for all that is known, and less than the highest: (B,) blocks.

    highest : m/s; that of a queue, unless the IMU may decide where the trajectory cannot
    """
    t_s, knots = smoother.blocks.t_s, smoother.drive.samples.knot_times
    speed = np.sqrt((solved.state.vel_n**2).sum(axis=0))
    standing = np.zeros(len(t_s), dtype=bool)
    for first, stop in runs(smoother.quiet):
        k = np.flatnonzero((knots > t_s[first]) & (knots < t_s[stop - 1]))
        if not len(k) or speed[k].max() >= highest:
            continue
        doubt = _SURE * np.sqrt(np.linalg.eigvalsh(marginals(solved.inverse, k)[:, VELOCITY, VELOCITY])[:, -1])
        standing[first:stop] = bool(((speed[k] < doubt + _AT_REST) & (speed[k] + doubt < highest)).all())
    return standing


def with_covariances(smoother: Smoother, solved: Solved) -> Estimate:
    """A solution that the smoother found last, with its covariances."""
    inverse, free = solved.inverse, smoother.free
    common = np.zeros((COMMON_SIZE, COMMON_SIZE))
    common[np.ix_(free, free)] = solved.solution.covariance_global
    cross = np.zeros((solved.state.knots, KNOT_SIZE, COMMON_SIZE))
    cross[..., free] = global_covariances(inverse)
    return Estimate(smoother, solved, inverse, marginals(inverse), common, cross)


def _without_outliers(smoother: Smoother, start: State, noise: Noise, near: bool, rough: bool) -> Solved:
    """Truncated least squares from a fair start; where that puts much aside, or fails, from Cauchy's solution.

    near : the start is Cauchy's solution with much the same noise; rough : it need not settle
    """
    try:
        solved = smoother.solve(start, noise, "tls", OPEN if near else None, rough)
        if (solved.converged or rough) and solved.rejected < _MOST_REJECTED:
            return solved
    except np.linalg.LinAlgError:
        pass
    fair = smoother.solve(start, noise, "cauchy")
    try:
        return smoother.solve(fair.state, noise, "tls")
    except np.linalg.LinAlgError:  # it leaves no position that ties the drive to a place
        return replace(fair, converged=False)


def forward_speed(state: State) -> Floats:
    """Along the vehicle's x axis at the knots: (N,) m/s."""
    return np.asarray(state.rot_vs[0] @ mtv(state.rot_ns, state.vel_n))


def _learnt(smoother: Smoother, start: State, noise: Noise) -> tuple[Noise, State, bool]:
    """The likely noise, the start with what has been learnt on the way, and whether that is a solution of the whole.

    Where it comes out far from what was assumed, more fixes are believed with it, and it is estimated once more.
    """
    chosen = _most_motion(smoother)
    whole = chosen == slice(0, smoother.drive.samples.intervals)
    part = smoother if whole else _part(smoother, chosen, start)
    part.datum = part.datum.mounted(smoother.datum.rot_vs)
    state = start if whole else knots_of(start, chosen)
    noise = at_least_aliased(at_least_still(noise, smoother.still_noise), smoother.drive.samples)
    for _ in range(_MOST_ROUNDS):
        solved = part.solve(state, noise, "cauchy")
        if _found_leaning(part, solved):
            solved = part.solve(solved.state, noise, "cauchy")
        before, noise, state = noise, likely_noise(part, solved, smoother.still_noise), solved.state
        if not _grown(before, noise):
            break
    if whole:
        return noise, state, True
    smoother.model = part.model
    smoother.move_stamps(part.moved_lag - smoother.moved_lag)
    later = state.common[CLOCK] * (smoother.epochs.middle_s - part.epochs.middle_s)
    state = state.with_common(LAG, state.common[LAG] + later)
    return noise, replace(start, rot_vs=state.rot_vs, common=state.common), False


def _found_leaning(smoother: Smoother, solved: Solved) -> bool:
    """Does a solution show, and did none before, that the vehicle has two wheels? From now on the smoother knows it."""
    if not smoother.model.wheels or smoother.model.lean:
        return False
    gravity = GravityField.around(solved.state.pos_n, smoother.drive.anchor)
    found = leans(smoother.road(solved.state, gravity), solved.noise.bank)
    if found:
        smoother.model = replace(smoother.model, lean=LEANING)
    return found


def _grown(before: Noise, after: Noise) -> bool:
    """Has a size grown so much that residuals which were put aside must be looked at again?"""
    of_fixes = np.concatenate([after.position / before.position, after.velocity / before.velocity])
    of_motion = [getattr(after, name) / getattr(before, name) for name in _OF_MOTION]
    return bool(of_fixes.max() > _GROWN_FIXES or max(of_motion) > _GROWN_MOTION)


def _most_motion(smoother: Smoother) -> slice:
    """The intervals of NOISE_FROM_S in which the most distance is covered with fixes, or all."""
    count = smoother.drive.samples.intervals
    window = int(np.ceil(NOISE_FROM_S / float(np.median(smoother.length))))
    if count <= window:
        return slice(0, count)
    fixes = smoother.drive.fixes
    vel_n = np.einsum("jim,jm->im", fixes.vel_rows, fixes.vel)
    which = np.clip(np.searchsorted(smoother.drive.samples.knot_times, fixes.t_s) - 1, 0, count - 1)
    moved = np.bincount(which, np.minimum(np.hypot(vel_n[0], vel_n[1]), 50.0), minlength=count)
    total = np.concatenate([[0.0], np.cumsum(moved)])
    first = int(np.argmax(total[window:] - total[:-window]))
    return slice(first, first + window)


def _part(smoother: Smoother, intervals: slice, start: State) -> Smoother:
    """For some intervals, whose samples are summed up already."""
    increments = smoother.increments(start).part(intervals)
    return Smoother(part_of(smoother.drive, intervals), smoother.model, increments=increments)


def part_of(drive: Drive, intervals: slice) -> Drive:
    """The drive in some of its intervals; times stay."""
    samples, m = drive.samples, drive.samples.per_interval
    steps, rows = slice(intervals.start * m, intervals.stop * m), slice(intervals.start * m, intervals.stop * m + 1)
    cut = Samples(
        samples.t_s[rows], samples.gyro_s[rows], samples.accel_s[rows], samples.filled[steps], samples.row[rows], m
    )
    return replace(drive, samples=cut)


def knots_of(state: State, intervals: slice) -> State:
    """The knots of some intervals, one more than these."""
    k = slice(intervals.start, intervals.stop + 1)
    return replace(
        state,
        rot_ns=state.rot_ns[..., k],
        vel_n=state.vel_n[:, k],
        pos_n=state.pos_n[:, k],
        gyro_bias=state.gyro_bias[:, k],
        accel_bias=state.accel_bias[:, k],
        drift_n=state.drift_n[:, k],
    )


def sigmas(found: Estimate) -> Floats:
    """Standard deviations at the knots: position and velocity e, n, u in m, m/s; roll, pitch, yaw in rad: (9, N).

    The attitude of the vehicle is that of the sensor times the mounting, whose doubt it shares: its error is
    d - R_nv m, d that of the sensor about axes n, m that of the mounting about axes v.
    """
    state = found.solved.state
    rot_ln = level_rotation(state.pos_n, found.smoother.drive.anchor)
    to_level = np.moveaxis(rot_ln, -1, 0)
    out = np.empty((9, state.knots))
    for rows, part in ((slice(0, 3), POSITION), (slice(3, 6), VELOCITY)):
        out[rows] = _deviations(to_level, found.covariance[:, part, part])
    rot_nv = mmt(state.rot_ns, state.rot_vs[..., None])
    turn = np.moveaxis(rot_nv, -1, 0)
    shared = found.cross[:, ROTATION, MOUNT] @ turn.swapaxes(1, 2)
    own = turn @ found.covariance_common[MOUNT, MOUNT] @ turn.swapaxes(1, 2)
    doubt = found.covariance[:, ROTATION, ROTATION] - shared - shared.swapaxes(1, 2) + own
    ahead = mm(rot_ln, rot_nv)[:2, 0]
    ahead = ahead / np.maximum(np.sqrt((ahead**2).sum(axis=0)), 1e-12)
    axes = np.zeros((3, 3, state.knots))
    axes[0, 0], axes[0, 1], axes[1, 0], axes[1, 1], axes[2, 2] = ahead[0], ahead[1], -ahead[1], ahead[0], 1.0
    out[6:] = _deviations(np.moveaxis(mm(axes, rot_ln), -1, 0), doubt)
    return out


def _deviations(axes: Floats, covariance: Floats) -> Floats:
    """Square roots of the diagonal of axes C axes^T: (3, N) of (N, 3, 3) both."""
    turned = np.einsum("nij,njk,nik->in", axes, covariance, axes, optimize=True)
    return np.asarray(np.sqrt(np.maximum(turned, 0.0)))
