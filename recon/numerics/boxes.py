"""How a second IMU on one rigid body stands to the first: rotation, clock, lever arm, from what both measure.

With R from box 2 to box 1, r from box 1 to box 2 in the axes of box 1, and t + tau(t) what the clock of box 2 shows at
the time t of box 1, a rigid body demands

    w_1(t)                          = R w_2(t + tau) + b_w
    f_1(t) + w. x r + w x (w x r)   = R f_2(t + tau) + b_f,        tau(t) = lag + drift (t - middle)

Both sides are averaged alike, which leaves vibration out. Clocks begin as `box_clocks` finds them, the rotation as the
quaternion of Davenport. From there all is found at once by least squares with Huber's weights: rotation, lag, drift,
lever arm, and the scale errors of all twelve sensors, held near zero by what sensors are.

The lever arm is seen through the turn rates of box 1, whose noise, squared, would draw it towards zero. So the slopes
along it count by those that box 2 tells, whose noise is another one (instrumental variables). Scale errors, seen
through what box 2 measures, count by the mean of both, whose noise has no part in their difference where boxes are
alike. That is done once clocks fit: before, what one box tells is another time than that of the other.

The biases b may wander: within half a minute both sides count relative to their means, so nothing is learnt from
gravity through biases that nobody knows, and all from its change. Sigmas come from what each such window adds to the
gradient (sandwich estimate), for errors are correlated, each seen by a fit without it (jackknife), for a fit of many
numbers to few windows is drawn to each of them. Windows in which the boxes stand otherwise than in most, for
one came loose, are left out.

References
    Davenport (1968), "A vector approach to the algebra of rotations with applications", NASA TN D-4696 (q-method).
    Huber (1981), "Robust Statistics", ch. 7.
    Liang, Zeger (1986), "Longitudinal data analysis using generalized linear models", Biometrika 73(1) (sandwich).
    Reiersol (1941), "Confluence analysis by means of lag moments and other methods of confluence analysis",
    Econometrica 9(1), 1-24 (instrumental variables).
    Bell, McCaffrey (2002), "Bias reduction in standard errors for linear regression with multi-stage samples", Survey
    Methodology 28(2), section 3 (jackknife).
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sec. 2.5.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.box_clocks import Inertial, Smooth, clock
from recon.numerics.moving_window import rolling_std
from recon.numerics.rotation import Floats, cross_matrix, from_rotvec, multiply, normalize, to_matrix
from recon.numerics.signals import median_rate

_WINDOW_S: Final = 30.0
"""In which both sides count relative to their means: biases stay through it, turns and brakings do not."""
_EACH: Final = 2
"""Steps of the averages from row to row; their width is five."""
_SWIFT_S: Final = 0.04
"""Width of the averages of which angular accelerations are taken, where a lever arm is gone along."""
_LEVER_PRIOR: Final = 3.0
"""m, on each axis: both boxes are in one vehicle."""
_SCALE_PRIOR: Final = 0.005
"""Of each axis: what is left of its error after a factory's calibration."""
_HUBER: Final = 1.345
"""Sigmas from which a misfit counts less than its square."""
_LARGE, _LENGTH = 0.7, 1.9144
"""Share of rows, those of standing among them, whose misfit is below; length of three normal values that it is."""
_EVEN, _ROUNDS = 6, 24
"""Rounds of plain least squares, until the clocks fit, and again without loose windows; rounds at most."""
_ALIKE, _TOLD = 0.02, 0.01
"""rad; rotations of two windows that are one, and the sigma up to which a window tells its own."""
_SETTLED: Final = 0.02
"""Of the sigmas; smaller steps end the search."""
_FINEST: Final = 1e-3
"""Of the time between samples: averages over several of them tell no lag finer."""
_QUIET: Final = 0.02
"""Share of a drive that stands at least."""
_TURN, _CLOCK, _LEVER = slice(0, 3), slice(3, 5), slice(5, 8)
_GYRO_SCALE_1, _GYRO_SCALE_2 = slice(8, 11), slice(11, 14)
_FORCE_SCALE_1, _FORCE_SCALE_2 = slice(14, 17), slice(17, 20)
_PRECISION: Final = np.concatenate((np.zeros(5), np.full(3, _LEVER_PRIOR**-2), np.full(12, _SCALE_PRIOR**-2)))
"""Of what is known of the state beforehand."""


@dataclass(frozen=True)
class Placement:
    """How box 2 stands to box 1.

    q_12 : (4,) takes box 2 to box 1;  q_sigma : (3,) rad, about the axes of box 1
    lag : s, what the clock of box 2 shows more at middle_ns of box 1;  drift : s/s, what it gains
    lever : (3,) m, from box 1 to box 2, axes of box 1

    Sigmas are NaN where less than a minute of driving together tells them.
    """

    q_12: Floats
    q_sigma: Floats
    lag: float
    lag_sigma: float
    drift: float
    drift_sigma: float
    middle_ns: int
    lever: Floats
    lever_sigma: Floats

    def in_clock_of_first(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of box 2 in the clock of box 1: (n,) int64 ns."""
        since = t_ns - (self.middle_ns + round(self.lag * 1e9))
        gained = np.rint(since * (self.drift / (1.0 + self.drift))).astype(np.int64)
        return np.asarray(t_ns - round(self.lag * 1e9) - gained)


class _Sides(NamedTuple):
    """Both boxes on the grid of the first: t_s (n,) from the middle; averages and their derivatives (n, 6)."""

    t_s: Floats
    one: Floats
    one_rate: Floats
    two: Floats
    two_rate: Floats


def place(first: Inertial, second: Inertial, largest_s: float = 10.0) -> Placement:
    """Find rotation, clock and lever arm.

    largest_s : s, lags are sought up to this, early and late
    raises : ValueError where the boxes share too little, or what they measured has nothing in common
    """
    one, two = Smooth.of(first), Smooth.of(second)
    lag, drift, middle_ns = clock(one, two, largest_s)
    bias = quiet_rate(first)
    state = np.zeros(len(_PRECISION))
    state[_CLOCK] = lag, drift
    sides = _sides(one, two, middle_ns, state[_CLOCK])
    q_12 = _davenport(sides)
    loose = np.zeros(0)
    for number in range(_ROUNDS):
        if number == _EVEN:
            loose = _loose_windows(sides, to_matrix(q_12), state, bias)
        sides = _without(sides, loose)
        robust = number >= 2 * _EVEN
        step, covariance = _step(sides, to_matrix(q_12), state, bias, robust=robust)
        q_12 = normalize(multiply(from_rotvec(step[_TURN]), q_12))
        state = np.concatenate((np.zeros(3), (state + step)[3:]))
        sides = _sides(one, two, middle_ns, state[_CLOCK])
        if robust and np.all(step**2 <= _SETTLED**2 * np.diag(covariance)):
            break
    sigma = np.sqrt(np.diag(covariance))
    (lag, drift), (lag_sigma, drift_sigma) = state[_CLOCK].tolist(), sigma[_CLOCK].tolist()
    arm = state[_LEVER]
    arm_sigma = np.hypot(sigma[_LEVER], _SCALE_PRIOR * np.linalg.norm(arm))  # its accelerations are the gyroscope's
    lag_sigma = float(np.hypot(lag_sigma, _FINEST / median_rate(first.t_ns)))
    return Placement(q_12, sigma[_TURN], lag, lag_sigma, drift, drift_sigma, middle_ns, arm, arm_sigma)


def quiet_rate(box: Inertial) -> Floats:
    """Bias of the gyroscope: the median of its quietest seconds, which are those of standing: (3,) rad/s."""
    window = 2 * round(median_rate(box.t_ns) / 2.0) + 1
    spreads = [rolling_std(np.nan_to_num(values), window).sum(axis=1) for values in (box.gyro, box.accel)]
    restless = sum(spread / max(float(np.median(spread)), 1e-12) for spread in spreads)
    return np.asarray(np.nanmedian(box.gyro[restless <= np.quantile(restless, _QUIET)], axis=0))


def lever_acceleration(box: Inertial, lever: Floats) -> Floats:
    """w. x r + w x (w x r) at the rows of a box, w. from what is slower than vibration.

    box : its gyroscope free of bias;  lever : (3,) m, its axes
    returns : (n, 3) m/s^2
    """
    smooth = Smooth.of(box, _SWIFT_S)
    since_s = np.asarray((box.t_ns - smooth.start_ns) * 1e-9, dtype=np.float64)
    turn = np.nan_to_num(smooth.at(since_s, 1)[:, :3])
    return np.asarray(np.cross(turn, lever) + np.cross(box.gyro, np.cross(box.gyro, lever)))


def _sides(one: Smooth, two: Smooth, middle_ns: int, tau: Floats) -> _Sides:
    """Both boxes where both are known, with this lag and drift."""
    t_s = np.asarray(one.spline.x[::_EACH], dtype=np.float64)
    since_s = t_s - (middle_ns - one.start_ns) * 1e-9
    there_s = t_s + (one.start_ns - two.start_ns) * 1e-9 + tau[0] + tau[1] * since_s
    columns = one.at(t_s), one.at(t_s, 1), two.at(there_s), two.at(there_s, 1)
    known = np.isfinite(columns[0]).all(axis=1) & np.isfinite(columns[2]).all(axis=1)
    return _Sides(since_s[known], *(values[known] for values in columns))


def _starts(t_s: Floats, length_s: float) -> NDArray[np.intp]:
    """Rows at which a window of that length begins."""
    return np.flatnonzero(np.diff(np.floor(t_s / length_s), prepend=-np.inf))


def _centred(values: Floats, weights: Floats, starts: NDArray[np.intp]) -> Floats:
    """Values (n, ...) relative to their weighted means in windows."""
    shape = (-1, *(1,) * (values.ndim - 1))
    heavy = weights.reshape(shape)
    total = np.add.reduceat(weights, starts).reshape(shape)
    means = np.add.reduceat(heavy * values, starts, axis=0) / np.maximum(total, 1e-300)
    lengths = np.diff(np.append(starts, len(values)))
    return np.asarray(values - np.repeat(means, lengths, axis=0))


def _davenport(sides: _Sides) -> Floats:
    """Rotation of box 2 to box 1 that fits turn rates and specific forces best, each by its size: (4,)."""
    ones = np.ones(len(sides.t_s))
    starts = _starts(sides.t_s, _WINDOW_S)
    profile = np.zeros((3, 3))
    for group in (slice(0, 3), slice(3, 6)):
        here, there = (_centred(values[:, group], ones, starts) for values in (sides.one, sides.two))
        profile += here.T @ there / max(float(np.sqrt((here**2).sum() * (there**2).sum())), 1e-300)
    trace, skew = np.trace(profile), profile - profile.T
    away = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    table = np.block([[trace, away], [away[:, None], profile + profile.T - trace * np.eye(3)]])
    return np.asarray(np.linalg.eigh(table)[1][:, -1])


def _step(sides: _Sides, rot_12: Floats, state: Floats, bias: Floats, *, robust: bool) -> tuple[Floats, Floats]:
    """A step of Gauss and Newton, and the covariance of the state: (20,), (20, 20).

    Of a single window the covariance is NaN: what a fit without it would find, nobody knows.
    """
    windows = _starts(sides.t_s, _WINDOW_S)
    gradient = -_PRECISION * state
    told = np.zeros((len(windows), len(state), len(state)))
    parts = np.zeros(told.shape[:2])
    for misfit, slopes, told_by in _misfits(sides, rot_12, state, bias):
        even = np.ones(len(misfit))
        size = np.linalg.norm(_centred(misfit, even, windows), axis=1)
        sigma = max(float(np.quantile(size, _LARGE)) / _LENGTH, 1e-12)
        kept = _HUBER * np.sqrt(3.0) * sigma / np.maximum(size, 1e-300) if robust else even
        weights = np.minimum(1.0, kept) / sigma**2
        error, partial = (_centred(values, weights, windows) for values in (misfit, slopes))
        heavy = weights[:, None, None] * (_centred(told_by, weights, windows) if robust else partial)
        parts += np.add.reduceat(np.einsum("nij,ni->nj", heavy, error), windows, axis=0)
        told += np.stack(
            [
                ours.reshape(-1, len(state)).T @ theirs.reshape(-1, len(state))
                for ours, theirs in zip(_split(heavy, windows), _split(partial, windows), strict=True)
            ]
        )
    gradient = gradient + parts.sum(axis=0)
    inverse = np.linalg.pinv(told.sum(axis=0) + np.diag(_PRECISION))
    if len(windows) < 2:
        return inverse @ gradient, np.full_like(inverse, np.nan)
    left = np.eye(len(state)) - told @ inverse
    alone = np.linalg.solve(left, parts[..., None])[..., 0]
    return inverse @ gradient, inverse @ (alone.T @ alone + np.diag(_PRECISION)) @ inverse.T


def _split(rows: Floats, starts: NDArray[np.intp]) -> list[Floats]:
    return np.split(rows, starts[1:])


def _loose_windows(sides: _Sides, rot_12: Floats, state: Floats, bias: Floats) -> Floats:
    """Numbers of the windows in which the boxes stand otherwise than in most: (m,).

    Each window tells its own turn from the common rotation; that which most others share is believed. A window that
    tells nothing goes with the nearest that does.
    """
    windows = _starts(sides.t_s, _WINDOW_S)
    even, normal, gradient = np.ones(len(sides.t_s)), np.zeros((len(windows), 3, 3)), np.zeros((len(windows), 3))
    for misfit, slopes, _ in _misfits(sides, rot_12, state, bias):
        error, turned = (_centred(values, even, windows) for values in (misfit, slopes[:, :, _TURN]))
        sigma = max(float(np.quantile(np.linalg.norm(error, axis=1), _LARGE)) / _LENGTH, 1e-12)
        normal += np.add.reduceat(np.einsum("nij,nik->njk", turned, turned), windows, axis=0) / sigma**2
        gradient += np.add.reduceat(np.einsum("nij,ni->nj", turned, error), windows, axis=0) / sigma**2
    inverse = np.linalg.pinv(normal, hermitian=True)
    turns = np.einsum("nij,nj->ni", inverse, gradient)
    weakest = np.linalg.eigvalsh(normal)[:, 0]
    telling = np.flatnonzero(weakest > _TOLD**-2)
    if not len(telling):
        return np.zeros(0)
    alike = np.linalg.norm(turns[telling, None] - turns[telling], axis=2) < _ALIKE
    shared = alike[np.argmax(alike.sum(axis=1))]
    nearest = np.argmin(np.abs(np.arange(len(windows))[:, None] - telling), axis=1)
    return np.asarray(np.floor(sides.t_s[windows] / _WINDOW_S)[~shared[nearest]])


def _without(sides: _Sides, loose: Floats) -> _Sides:
    """The rows outside of the windows of these numbers."""
    kept = ~np.isin(np.floor(sides.t_s / _WINDOW_S), loose)
    return _Sides(*(values[kept] for values in sides))


def _misfits(sides: _Sides, rot_12: Floats, state: Floats, bias: Floats) -> list[tuple[Floats, Floats, Floats]]:
    """What the first box measures beyond the second, rates then forces, its slopes, and these as the second tells them.

    returns : (n, 3), (n, 3, 20), (n, 3, 20) of rates and of forces
    """
    gyro_1 = sides.one[:, :3] - bias
    gyro_2, turn_2 = (values[:, :3] @ rot_12.T for values in (sides.two, sides.two_rate))
    swing = _swing(gyro_1, sides.one_rate[:, :3])
    swing_2 = _swing(gyro_2 - (gyro_2 - gyro_1).mean(axis=0), turn_2)
    found = []
    scales = (_GYRO_SCALE_1, _GYRO_SCALE_2), (_FORCE_SCALE_1, _FORCE_SCALE_2)
    for group, (scale_1, scale_2) in zip((slice(0, 3), slice(3, 6)), scales, strict=True):
        turned, rate = sides.two[:, group] @ rot_12.T, sides.two_rate[:, group] @ rot_12.T
        slopes = np.zeros((len(turned), 3, len(state)))
        slopes[:, :, _TURN] = -cross_matrix(turned)
        slopes[:, :, _CLOCK] = np.stack((rate, rate * sides.t_s[:, None]), axis=-1)
        slopes[:, :, scale_1] = turned[:, :, None] * np.eye(3)
        slopes[:, :, scale_2] = -rot_12 * sides.two[:, None, group]
        told_by, both = slopes.copy(), 0.5 * (sides.one[:, group] + turned)
        told_by[:, :, scale_1] = both[:, :, None] * np.eye(3)
        told_by[:, :, scale_2] = -rot_12 * (both @ rot_12)[:, None]
        if scale_1 == _FORCE_SCALE_1:
            slopes[:, :, _LEVER], told_by[:, :, _LEVER] = -swing, -swing_2
        linear = [_LEVER, scale_1, scale_2]
        modelled = turned + sum(slopes[:, :, part] @ state[part] for part in linear)
        found.append((sides.one[:, group] - modelled, slopes, told_by))
    return found


def _swing(gyro: Floats, turn: Floats) -> Floats:
    """What takes a lever arm to the acceleration along it, w. x + w x (w x): (n, 3, 3)."""
    across = cross_matrix(gyro)
    return cross_matrix(turn) + across @ across
