"""How late GNSS is against the IMU, for any mounting and before anything else is known.

Between two fixes speed changes by the integral of one fixed combination of the accelerometer's axes, and course by one
of the gyroscope's, if the IMU is read at the times that the fixes describe. For every lag on a grid both changes are
regressed on the means of the three axes between the fixes,

    d(speed) / dt = mean(accel_s) . f + c,        d(course) / dt = mean(gyro_s) . u + c

with f and u free: no mounting is asked for. Where R^2 of the variance is explained, the log-likelihood of a lag is
-n / 2 log(1 - R^2); both are summed, and the largest sum tells the lag, each comparison refining it by a parabola.
Roads slope slowly: a mean over twenty seconds is taken off accelerations. Rows that do not fit get Cauchy's weights.

The variance of a lag is the sum of squares of the changes that leaving out any ten seconds would make (jackknife),
for errors are correlated. An antenna ahead of the rear axle sees a turn early, by lever / speed; the course counts
accordingly less.

References
    Knapp, Carter (1976), "The generalized correlation method for estimation of time delay", IEEE T-ASSP 24(4).
    Miller (1974), "The jackknife - a review", Biometrika 61(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.moving_window import moving_average
from recon.numerics.signals import wrap_angle
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.stops import Blocks

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]

LARGEST_S: Final = 2.0
"""s; lags are sought up to this, early and late."""
_STEP_S: Final = 0.1
"""s between lags, and of the grid of the IMU."""
_SPACING_S: Final = 0.5
"""s; fixes nearer to the one before add little."""
_SHORTEST_S, _LONGEST_S = 0.9, 2.6
"""s between the fixes of a row: shorter spans are noisy, longer ones blur."""
_MOST_ROWS: Final = 5_000
"""More do not make the sigma smaller than what is not modelled."""
_FEWEST_ROWS: Final = 30
_SLOW_S: Final = 20.0
"""s over which the mean acceleration is taken off, with what slopes do to it."""
_LEAST_SPEED: Final = 3.0
"""m/s from which a course is believed."""
_MOST_ACCELERATION, _MOST_TURN = 10.0, 1.0
"""m/s^2 and rad/s; fixes that change faster are wrong, and no receiver follows an impact."""
_AHEAD: Final = 1.5
"""m; sigma of where the antenna is ahead of the rear axle, and of the slip that acts alike."""
_ROUNDS: Final = 3
_CAUCHY_C2: Final = 6.0
_MAD: Final = 1.4826
"""Standard deviation of normal values by their median absolute deviation."""
_CLUSTER_S: Final = 10.0
_FLOOR_S: Final = 0.01
"""s; sigma of what is not modelled, such as the filter of the receiver."""
_LEAST_SHARE: Final = 0.2
"""Explained by the best lag; drives that have nothing to do with each other reach a tenth."""
_LEAST_GAIN, _LEAST_LEAD = 15.0, 5.0
"""Of the log-likelihood, over no relation and over the next peak."""
_NEAR_S: Final = 0.4
"""s within which the two comparisons tell of the same lag."""
_LARGEST_SIGMA: Final = 0.25
"""s; a peak that is wider tells nothing."""


@dataclass(frozen=True)
class Lag:
    """seconds : a fix stamped t describes t - seconds: positive where GNSS is late; sigma : s, inf where not found."""

    seconds: float
    sigma: float


UNKNOWN: Final = Lag(0.0, float("inf"))


@dataclass(frozen=True)
class _Grid:
    """The IMU at equal steps.

    start_s : s; accel, gyro : (3, G) integrals since; unknown : (G,) s of gaps and impacts since
    """

    start_s: float
    accel: Floats
    gyro: Floats
    unknown: Floats


@dataclass(frozen=True)
class _Changes:
    """What GNSS tells of the change between two fixes.

    begin_s, end_s : (m,) s, their stamps; rate : (m,) per second; trust : (m,) weight beforehand
    lead : (m,) s by which an antenna one sigma ahead makes GNSS look early
    """

    begin_s: Floats
    end_s: Floats
    rate: Floats
    trust: Floats
    lead: Floats

    def some(self, rows: Mask) -> _Changes:
        """Only some rows."""
        return _Changes(self.begin_s[rows], self.end_s[rows], self.rate[rows], self.trust[rows], self.lead[rows])


@dataclass(frozen=True)
class _Fit:
    """Weighted regressions on the sensor's means at all lags.

    explained : (J,) share of the variance; weight : (m,) as used
    residual : (m,) at the best lag; slope : (m,) change of the prediction there with the lag, less what its
        coefficients would take up, per s
    """

    explained: Floats
    weight: Floats
    residual: Floats
    slope: Floats


@dataclass(frozen=True)
class _Found:
    """What one comparison tells. gain : (J,) log-likelihood of the lags over no relation; lag : s; variance : s^2."""

    gain: Floats
    lag: float
    variance: float


def find_lag(blocks: Blocks, fix_t_s: Floats, speed: Floats, course: Floats, largest_s: float = LARGEST_S) -> Lag:
    """How late the stamps of GNSS velocities are: a fix stamped t describes the earlier time t - lag.

    blocks : means of about 0.1 s; fix_t_s : (m,) s, strictly increasing
    speed : (m,) m/s over ground, NaN where unknown; course : (m,) rad, either sense, NaN where unknown
    largest_s : s; lags are sought up to this, early and late
    returns : lag 0 with sigma inf where none stands out
    """
    if len(blocks.t_s) < 2 or blocks.t_s[-1] - blocks.t_s[0] < 2.0 * largest_s + _SLOW_S:
        return UNKNOWN
    grid = _on_grid(blocks)
    reach = max(1, round(largest_s / _STEP_S))
    found = []
    for told, integral in (
        (_of_speed(fix_t_s, speed), grid.accel),
        (_of_course(fix_t_s, speed, course), grid.gyro),
    ):
        changes = told.some(_measured(told, grid, reach))
        if len(changes.rate) >= _FEWEST_ROWS and np.ptp(changes.rate) > 0.0:
            found.append(_compare(changes, _means(changes, integral, grid.start_s, reach)))
    return _peak([one for one in found if one is not None])


def _on_grid(blocks: Blocks) -> _Grid:
    t_s = np.arange(blocks.t_s[0], blocks.t_s[-1], _STEP_S)
    accel, gyro = (np.array([np.interp(t_s, blocks.t_s, axis) for axis in y]) for y in (blocks.accel, blocks.gyro))
    accel -= moving_average(accel.T, 2 * round(0.5 * _SLOW_S / _STEP_S) + 1).T
    unknown = np.interp(t_s, blocks.t_s, ~blocks.measured) > 0.0
    unknown |= (accel**2).sum(axis=0) > _MOST_ACCELERATION**2
    start_s = float(t_s[0]) - 0.5 * _STEP_S
    return _Grid(start_s, _integral(accel), _integral(gyro), _integral(unknown.astype(np.float64)))


def _integral(y: Floats) -> Floats:
    """From the first step: (..., G + 1) of (..., G)."""
    return np.concatenate((np.zeros((*y.shape[:-1], 1)), np.cumsum(y, axis=-1) * _STEP_S), axis=-1)


def _pairs(t_s: Floats, known: Mask) -> tuple[Rows, Rows]:
    """Begin and end of spans of about a second, both ends known."""
    rows = np.flatnonzero(known)
    tick = np.floor(t_s[rows] / _SPACING_S + 0.25).astype(np.int64)
    rows = rows[np.unique(tick, return_index=True)[1]]
    after = np.searchsorted(t_s[rows], t_s[rows] + _SHORTEST_S)
    begin, end = rows[after < len(rows)], rows[after[after < len(rows)]]
    near = t_s[end] - t_s[begin] <= _LONGEST_S
    some = slice(None, None, max(1, -(-int(near.sum()) // _MOST_ROWS)))
    return begin[near][some], end[near][some]


def _of_speed(t_s: Floats, speed: Floats) -> _Changes:
    """Accelerations, less their mean over twenty seconds as on the side of the IMU."""
    known = np.isfinite(speed)
    begin, end = _pairs(t_s, known)
    rate = (speed[end] - speed[begin]) / (t_s[end] - t_s[begin])
    trust = (np.abs(rate) < _MOST_ACCELERATION).astype(np.float64)
    if len(begin):
        middle, t_known = 0.5 * (t_s[end] + t_s[begin]), t_s[known]
        half = np.minimum(0.5 * _SLOW_S, np.minimum(middle - t_known[0], t_known[-1] - middle))
        earlier, later = (np.interp(middle + side * half, t_known, speed[known]) for side in (-1.0, 1.0))
        rate = rate - (later - earlier) / (2.0 * half)
    return _Changes(t_s[begin], t_s[end], rate, trust, np.zeros_like(rate))


def _of_course(t_s: Floats, speed: Floats, course: Floats) -> _Changes:
    """Rates of turn of moving fixes, whose errors go with one over the speed."""
    begin, end = _pairs(t_s, np.isfinite(course) & (speed > _LEAST_SPEED))
    rate = wrap_angle(course[end] - course[begin]) / (t_s[end] - t_s[begin])
    slower = np.minimum(speed[begin], speed[end])
    trust = np.where(np.abs(rate) < _MOST_TURN, slower**2, 0.0)
    return _Changes(t_s[begin], t_s[end], rate, trust, _AHEAD / slower)


def _measured(changes: _Changes, grid: _Grid, reach: int) -> Mask:
    """Rows to use: the IMU is measured there at every lag, so that all lags are judged by the same rows."""
    first = np.floor((changes.begin_s - grid.start_s) / _STEP_S).astype(np.intp) - reach - 1
    last = np.floor((changes.end_s - grid.start_s) / _STEP_S).astype(np.intp) + reach + 2
    use = (first >= 0) & (last < len(grid.unknown)) & (changes.trust > 0.0)
    use[use] = grid.unknown[last[use]] == grid.unknown[first[use]]
    return np.asarray(use)


def _means(changes: _Changes, integral: Floats, start_s: float, reach: int) -> Floats:
    """Means of the sensor between the fixes for lags of -reach - 1 to reach + 1 steps: (J + 2, 3, m)."""
    back = np.arange(-reach - 2, reach + 2)[:, None]
    at = []
    for stamp in (changes.begin_s, changes.end_s):
        place = (stamp - start_s) / _STEP_S
        left = np.floor(place).astype(np.intp)
        value = integral[:, left - back]
        at.append(value[:, 1:] + (place - left) * (value[:, :-1] - value[:, 1:]))
    return np.asarray((at[1] - at[0]).swapaxes(0, 1) / (changes.end_s - changes.begin_s))


def _compare(changes: _Changes, means: Floats) -> _Found | None:
    """The lag at which the means explain the changes best, rows that do not fit weighted down; None if too little."""
    trust = changes.trust / changes.trust.mean()
    least = 1e-12 * float(np.var(changes.rate))
    weight = trust
    for _ in range(_ROUNDS):
        fit = _regress(changes.rate, means, weight)
        squared = trust * fit.residual**2
        weight = trust * cauchy_weights(squared / max(_MAD**2 * float(np.median(squared)), least), _CAUCHY_C2)
    if fit.explained.max() < _LEAST_SHARE:
        return None
    cluster = np.floor((changes.begin_s - changes.begin_s[0]) / _CLUSTER_S).astype(np.intp)
    score = np.bincount(cluster, fit.weight * fit.slope * fit.residual)
    bend = fit.weight * fit.slope**2
    information = bend.sum()
    without = np.maximum(information - np.bincount(cluster, bend), 1e-3 * information)
    variance = ((score / without) ** 2).sum() + (bend @ changes.lead / information) ** 2 + _FLOOR_S**2
    alone = information * (fit.weight @ fit.residual**2) / fit.weight.sum()
    independent = fit.weight.sum() * alone / max(alone, float(score @ score), np.finfo(float).tiny)
    gain = -0.5 * independent * np.log(np.maximum(1.0 - fit.explained, 1e-12))
    return _Found(gain, _vertex(fit.explained), float(variance))


def _regress(rate: Floats, means: Floats, weight: Floats) -> _Fit:
    """Of the rate (m,) on the means (J + 2, 3, m) and a constant."""
    total = weight.sum()
    y = rate - weight @ rate / total
    weighted = means * weight
    centre = means @ weight / total
    moment = weighted @ means.swapaxes(1, 2) - total * centre[:, :, None] * centre[:, None, :]
    inverse = np.linalg.pinv(moment, hermitian=True)
    with_y = weighted @ y
    coefficient = np.einsum("jab,jb->ja", inverse, with_y)
    explained = (coefficient * with_y).sum(axis=1)[1:-1] / (weight @ y**2)
    k = 1 + int(explained.argmax())
    x = means[k] - centre[k][:, None]
    slope = coefficient[k] @ (means[k + 1] - means[k - 1]) / (2.0 * _STEP_S)
    slope = slope - weight @ slope / total
    slope = slope - (inverse[k] @ (weighted[k] @ slope)) @ x
    return _Fit(explained, weight, y - coefficient[k] @ x, slope)


def _vertex(height: Floats) -> float:
    """Lag s of the vertex of the parabola through the largest height (J,) and its neighbours."""
    k = int(np.clip(height.argmax(), 1, len(height) - 2))
    before, at, after = height[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    part = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float((k - len(height) // 2 + np.clip(part, -0.5, 0.5)) * _STEP_S)


def _peak(found: list[_Found]) -> Lag:
    """The lag at which all comparisons together gain most, if no other comes near."""
    if not found:
        return UNKNOWN
    gain = np.sum([one.gain for one in found], axis=0)
    k = int(gain.argmax())
    peaks = 1 + np.flatnonzero((gain[1:-1] > gain[:-2]) & (gain[1:-1] >= gain[2:]))
    others = gain[np.concatenate((peaks[peaks != k], [0, len(gain) - 1]))]
    if k not in peaks or gain[k] < _LEAST_GAIN or gain[k] - others.max() < _LEAST_LEAD:
        return UNKNOWN
    agree = [one for one in found if abs(one.lag - _vertex(gain)) <= _NEAR_S]
    weight = np.array([1.0 / one.variance for one in agree])
    if weight.sum() < _LARGEST_SIGMA**-2:
        return UNKNOWN
    return Lag(float(weight @ [one.lag for one in agree] / weight.sum()), float(weight.sum() ** -0.5))
