"""Further receivers in the vehicle: their antennas and clocks, found against a solution, and all fixes in one list.

    velocity   T (v + R (w x (l + o)) + (R f + g) (d + x + y (t - t_m)))  - z_v        T axes of what is reported
    position   p + R (l + o) + c + v (d + x + y (t - t_m))                - z_p

of a further receiver, with everything but its antenna's offset o from that of the first (l), its lag x and its drift y
as the solution of the first has it. With these its fixes stand beside those of the first, as of one receiver whose
antenna is elsewhere (`Fixes.offset_s`), so that two antennas of a known base line tell the heading.

Receivers see the same satellites through the same air: their errors are not independent. What is common to velocities
is measured: fixes of one moment give the sum of both variances and, by their difference, which the motion does not
touch, what both share. Of n fixes of one moment each then counts as one whose variance is 1 + (n - 1) r as large. A
position errs by what it shares with the first, which is the solution's own slow error, and by what it does not share:
that lasts, and a mean over a block of time counts what lasts in full.

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sections
    9.3 (errors that receivers share), 14.3 (lever arm).
    Holland, Welsch (1977), Communications in Statistics A6(9) (Cauchy's weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.epochs import locate, place_epochs
from recon.numerics.smoothing.estimate import Estimate, with_stops_in_silence
from recon.numerics.smoothing.lag import find_lag
from recon.numerics.smoothing.measurements import Fixes, Measured, at_epochs, position_rows, velocity_rows
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.smoother import Smoother
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.start import fix_motion
from recon.numerics.smoothing.state import LAG, LEVER

_ROUNDS: Final = 6
"""Of finding antenna and clock: each moves the stamps, and weighs fixes anew."""
_PRIOR: Final = np.array([1.5, 1.5, 1.5, 1.0, 1e-4])
"""Sigmas of the offset m, lag s and drift before anything is known."""
_FEWEST: Final = 20
_C2: Final = 9.0
_MAD: Final = 1.4826
"""Standard deviation of normal values by their median absolute deviation."""
_LASTING_S: Final = 100.0
_TOGETHER_S: Final = 0.5
"""s; fixes no further apart are of one moment."""
_SHARED_UNKNOWN: Final = 0.3
"""Correlation of velocities where receivers report other components, or never at one moment."""
_SAME_AXES: Final = 0.2
_MOST_SHARED: Final = 0.99


@dataclass(frozen=True)
class Receiver:
    """How a further receiver stands to the first, and its fixes.

    offset_s : (3,) m, from the antenna of the first to its own, sensor; offset_sigma : (3,) m
    lag : s, what its stamps show more than those of the first for the same moment, in mid-drive; drift : 1, what they
        gain; lag_sigma, drift_sigma
    shared : correlation of its velocity errors with those of the first
    fixes : in the clock of the first, with its offset, and with sigmas as found against the motion
    """

    offset_s: Floats
    offset_sigma: Floats
    lag: float
    lag_sigma: float
    drift: float
    drift_sigma: float
    shared: float
    fixes: Fixes


@dataclass(frozen=True)
class _Against:
    """The fixes of a receiver that lie in the drive, against its motion: rows of both kinds at E epochs.

    fix : (E,) which; t_s : (E,) s; share, speed_only, axes : (E,), (E,), (3, 3, E) as of the fixes
    velocity_sigma : (3, E) m/s, NaN where none is told, or only that it is small
    position_sigma : (3, E) m, NaN where none is told
    """

    fix: NDArray[np.intp]
    t_s: Floats
    share: Floats
    speed_only: NDArray[np.bool_]
    axes: Floats
    position: Measured
    velocity: Measured
    velocity_sigma: Floats
    position_sigma: Floats

    def velocity_error(self) -> Floats:
        """In the sigmas that are reported: (3, E), NaN where none is told."""
        return np.where(np.isfinite(self.velocity_sigma), self.velocity.residual / np.sqrt(self.share), np.nan)

    def position_error(self) -> Floats:
        """(3, E) m, NaN where none is told."""
        return np.asarray(self.position.residual / np.sqrt(self.share) * self.position_sigma)


def find_receiver(
    found: Estimate, fixes: Fixes, slow: Floats, offset_s: Floats | None, offset_sigma: float
) -> Receiver:
    """Where the antenna of a further receiver is, how its clock stands, and how large its errors are.

    found : the solution of the first receiver; fixes : of the further one, in its own clock, sigmas as reported
    slow : (3,) m, sigma of the slow error of its positions
    offset_s : (3,) m, sensor, where it is known, with its sigma m; None : found
    raises : ValueError where too few of its fixes lie in the drive
    """
    blocks, moved = found.smoother.blocks, found.solved.moved_lag
    late = find_lag(blocks, *fix_motion(fixes))
    free = np.array([offset_s is None] * 3 + [True, True])
    shift = -late.seconds if np.isfinite(late.sigma) else moved
    place = np.append(np.zeros(3) if offset_s is None else offset_s, [shift, 0.0])
    sigma = np.where(free, _PRIOR, offset_sigma)
    since = fixes.t_s - 0.5 * float(blocks.t_s[0] + blocks.t_s[-1])
    for _ in range(_ROUNDS):
        stamps = fixes.t_s + place[3] + place[4] * since
        placed = replace(fixes, t_s=stamps, offset_s=np.repeat(place[:3, None], len(stamps), axis=1))
        seen = _against(found, placed)
        velocity, lasting = _velocity_factors(seen), _lasting(seen, slow, sigma[:3])
        step, sigma[free] = _step(seen, place, since[seen.fix], velocity, lasting, free)
        place[free] += step
    weighed = replace(
        placed,
        t_s=placed.t_s - moved,
        pos_sigma=np.where(np.isfinite(fixes.pos_sigma), lasting[:, None], np.inf),
        vel_sigma=np.where(fixes.small_only, 1.0, velocity[:, None]) * fixes.vel_sigma,
    )
    return Receiver(
        place[:3], sigma[:3], moved - float(place[3]), float(sigma[3]), -float(place[4]), float(sigma[4]),
        _shared(found, seen, velocity), weighed
    )  # fmt: skip


def _against(found: Estimate, fixes: Fixes) -> _Against:
    solved, samples = found.solved, found.smoother.drive.samples
    epochs = place_epochs(samples, found.smoother.blocks, fixes.t_s)
    at = np.flatnonzero(epochs.fix >= 0)
    if len(at) < _FEWEST:
        raise ValueError(f"{len(at)} of its fixes lie in the drive, {_FEWEST} are needed")
    epochs = replace(
        epochs, t_s=epochs.t_s[at], interval=epochs.interval[at], fix=epochs.fix[at], gyro_s=epochs.gyro_s[:, at],
        accel_s=epochs.accel_s[:, at]
    )  # fmt: skip
    inside = locate(epochs, samples, solved.increments)
    here = at_epochs(solved.state, solved.ends, epochs, inside)
    fix = epochs.fix
    return _Against(
        fix=fix,
        t_s=epochs.t_s,
        share=fixes.share[fix],
        speed_only=fixes.speed_only[fix],
        axes=fixes.vel_rows[..., fix],
        position=position_rows(here, solved.state, fixes, epochs, np.zeros((3, 1))),
        velocity=velocity_rows(here, solved.state, fixes, epochs),
        velocity_sigma=_told(np.where(fixes.small_only[fix], np.inf, fixes.vel_sigma[:, fix])),
        position_sigma=_told(fixes.pos_sigma[:, fix]),
    )


def _told(sigma: Floats) -> Floats:
    return np.where(np.isfinite(sigma), sigma, np.nan)


def _spread(errors: Floats) -> float:
    """Root mean square of those that are no outliers; 1 where there are none at all."""
    errors = np.abs(errors[np.isfinite(errors)])
    if not len(errors):
        return 1.0
    inside = errors[errors <= 3.0 * _MAD * float(np.median(errors))]
    return max(float(np.sqrt(np.mean(inside**2))), float(np.finfo(float).tiny))


def _velocity_factors(seen: _Against) -> Floats:
    """Of the errors on the sigmas that are reported: (3,), one for both horizontal components."""
    errors = seen.velocity_error()
    across = _spread(errors[:2])
    return np.array([across, across, _spread(errors[2])])


def _lasting(seen: _Against, slow: Floats, offset_sigma: Floats) -> Floats:
    """Sigma of one position, as if it were white, by the means of blocks: (3,) m, infinite where none is told.

    What lasts makes a mean of n err by more than a sigma over the root of n, and the offset's own error lasts as well.
    At most it is the slow error, all of which would be the receiver's own: of two near antennas with corrections of a
    base the motion is known less well than what tells them apart.
    """
    block = np.floor(seen.t_s / _LASTING_S).astype(np.intp)
    variance = np.full(3, np.inf)
    for axis, errors in enumerate(seen.position_error()):
        told = np.isfinite(errors)
        parts = [told & (block == b) for b in np.unique(block[told])]
        counts = np.array([seen.share[part].sum() for part in parts])
        means = np.array([np.median(errors[part]) for part in parts])
        if len(parts):
            seen_to_last = max(float(np.mean(counts * means**2)), _spread(errors) ** 2)
            at_most = counts.mean() * slow[axis] ** 2 + np.nanmedian(seen.position_sigma[axis]) ** 2
            variance[axis] = min(seen_to_last, at_most) + counts.mean() * offset_sigma.max() ** 2
    return np.sqrt([*np.full(2, variance[:2].mean()), variance[2]])


def _step(
    seen: _Against, place: Floats, since: Floats, velocity: Floats, lasting: Floats, free: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Robust least squares for what is free of offset, lag and drift: step and sigmas."""
    normal = np.diag(_PRIOR**-2.0)
    right = -normal @ np.append(place[:3], [0.0, 0.0])
    as_found = np.nan_to_num(seen.position_sigma / lasting[:, None])
    for rows, weight in ((seen.velocity, 1.0 / velocity[:, None]), (seen.position, as_found)):
        error = rows.residual * weight
        weight = weight * np.sqrt(cauchy_weights((error**2).sum(axis=0) / seen.share, _C2))
        by_lag = rows.common[:, LAG]
        tall = np.concatenate([rows.common[:, LEVER], by_lag[:, None], (by_lag * since)[:, None]], axis=1)
        tall = (tall * weight[:, None]).transpose(0, 2, 1).reshape(-1, 5)
        normal += tall.T @ tall
        right -= tall.T @ (rows.residual * weight).ravel()
    covariance = np.linalg.inv(normal[np.ix_(free, free)])
    return covariance @ right[free], np.sqrt(np.diag(covariance))


def _shared(found: Estimate, seen: _Against, velocity: Floats) -> float:
    """Correlation of velocity errors with those of the first, by fixes of one moment: 0 to 1.

    The sum of both variances less that of the difference, which the motion does not touch, is twice what they share.
    """
    solved, fixes = found.solved, found.smoother.drive.fixes
    own = np.flatnonzero((solved.epochs.fix >= 0) & ~fixes.small_only[solved.epochs.fix])
    if len(own) < _FEWEST:
        return _SHARED_UNKNOWN
    own_s = solved.epochs.t_s[own]
    right = np.clip(np.searchsorted(own_s, seen.t_s), 1, len(own) - 1)
    nearest = right - (seen.t_s - own_s[right - 1] < own_s[right] - seen.t_s)
    at, fix = own[nearest], solved.epochs.fix[own[nearest]]
    first = solved.vel_residual[:2, at] / np.sqrt(fixes.share[fix])
    second = seen.velocity_error()[:2] / velocity[:2, None]
    together = (np.abs(own_s[nearest] - seen.t_s) <= _TOGETHER_S) & (fixes.speed_only[fix] == seen.speed_only)
    together &= np.abs(fixes.vel_rows[..., fix] - seen.axes)[:2].max(axis=(0, 1)) < _SAME_AXES
    use = together & np.isfinite(fixes.vel_sigma[:2, fix]) & (np.abs(first) < 3.0) & (np.abs(second) < 3.0)
    if use.sum() < _FEWEST:
        return _SHARED_UNKNOWN
    one = (fixes.vel_sigma[:, fix] * solved.noise.velocity[:, None])[:2][use]
    other = (seen.velocity_sigma * velocity[:, None])[:2][use]
    apart = first[use] * one - second[use] * other
    shared = float((one**2 + other**2 - apart**2).sum() / (2.0 * one * other).sum())
    return float(np.clip(shared, 0.0, _MOST_SHARED))


def joined(found: Estimate, receivers: Sequence[Receiver]) -> tuple[Fixes, NDArray[np.intp], NDArray[np.intp]]:
    """All fixes in one list, in the clock of the first.

    returns : the fixes, of m; (m,) which receiver, 0 for the first; (m,) which of its fixes
    """
    noise, first = found.solved.noise, found.smoother.drive.fixes
    alone = [replace(first, offset_s=np.zeros((3, len(first.t_s))))]
    for receiver in receivers:
        own = receiver.fixes
        pos_sigma, vel_sigma = own.pos_sigma / noise.position[:, None], own.vel_sigma / noise.velocity[:, None]
        alone.append(replace(own, pos_sigma=pos_sigma, vel_sigma=vel_sigma))
    shared = float(np.mean([receiver.shared for receiver in receivers]))
    parts = []
    for own in alone:
        company = sum(_near(own.t_s, other.t_s) for other in alone if other is not own)
        parts.append(replace(own, vel_sigma=own.vel_sigma * np.sqrt(1.0 + shared * company)))
    which = np.repeat(np.arange(len(parts)), [len(part.t_s) for part in parts])
    order = np.argsort(np.concatenate([part.t_s for part in parts]), kind="stable")
    row = np.concatenate([np.arange(len(part.t_s)) for part in parts])
    together = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)[..., order] for name in _OF_FIXES
    }
    return Fixes(**together), which[order], row[order]


_OF_FIXES: Final = tuple(Fixes.__dataclass_fields__)


def _near(t_s: Floats, other_s: Floats) -> Floats:
    """1 where another receiver has a fix of the same moment: (m,)."""
    return np.asarray(
        np.searchsorted(other_s, t_s + _TOGETHER_S) > np.searchsorted(other_s, t_s - _TOGETHER_S), dtype=np.float64
    )


def solved_with(found: Estimate, fixes: Fixes) -> Estimate:
    """The solution with other fixes of the same drive, in the clock of those before; the noise stays what it was.

    raises : numpy.linalg.LinAlgError where they do not determine one
    """
    before = found.smoother
    smoother = Smoother(replace(before.drive, fixes=fixes), before.model, moved_lag=found.solved.moved_lag)
    smoother.first_lag, smoother.datum = before.first_lag, before.datum
    again = smoother.solve(found.solved.state, found.solved.noise, "tls")
    return with_stops_in_silence(smoother, again)
