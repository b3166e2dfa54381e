"""What the motion over ground says of the axes of an IMU, for any mounting.

Between two fixes, with speed v over ground and turn rate w (anticlockwise), the means of an IMU that is fixed to the
vehicle are, to first order,

    mean(accel_s) = f dv/dt + l v w + g u,        mean(gyro_s) = k w + b

f, l and u are the vehicle's forward, left and up in the axes of the log if its unit is that of gravity and speed, k is
up once more, as the gyroscope tells it. Slopes and leaning of the body act as noise. Both are solved by least squares
with Cauchy weights; variances are those of ten-second clusters (jackknife), for errors are correlated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.doctor.finding import Floats
from recon.numerics.doctor.log import Gnss, Imu
from recon.numerics.signals import wrap_angle
from recon.numerics.smoothing.robust import cauchy_weights

FEWEST: Final = 15
"""Spans between fixes, under which nothing is said."""
LEAST_SPEED: Final = 2.5
"""m/s from which a course is believed."""
_SHORTEST_S, _LONGEST_S, _EVERY_S = 0.9, 3.1, 0.5
_MOST_ACCELERATION, _MOST_TURN = 9.0, 1.2
_LONGEST_GAP_S: Final = 0.5
_IMPACT: Final = 1.5
"""Times gravity by which what is felt may differ from it; no receiver follows an impact."""
_CLUSTER_S: Final = 10.0
_ROUNDS: Final = 4


@dataclass(frozen=True)
class Spans:
    """Spans between fixes, s of them.

    t_s : (s,) s, middle; speed : (s,) m/s; ahead : (s,) m/s^2, dv/dt; across : (s,) m/s^2, v w, NaN without course
    turn : (s,) rad/s, likewise; accel : (s, 3), gyro : (s, 3), means of the IMU
    """

    t_s: Floats
    speed: Floats
    ahead: Floats
    across: Floats
    turn: Floats
    accel: Floats
    gyro: Floats


@dataclass(frozen=True)
class Direction:
    """A vector in the axes of the log and how well it is known. vector : (3,); sigma : of its length and across it."""

    vector: Floats
    sigma: float

    @property
    def length(self) -> float:
        """Of the vector."""
        return float(np.linalg.norm(self.vector))

    @property
    def unit(self) -> Floats:
        """Of length one."""
        return np.asarray(self.vector / max(self.length, 1e-12))

    @property
    def told(self) -> bool:
        """Known to a sixth of its length, about ten degrees."""
        return bool(self.length > 6.0 * self.sigma)


@dataclass(frozen=True)
class Motion:
    """forward, left, up, turn (that of the gyroscope): where the data tell; spans : what they were told by."""

    forward: Direction | None
    left: Direction | None
    up: Direction | None
    turn: Direction | None
    spans: Spans


def spans_of(imu: Imu, gnss: Gnss, lag_s: float) -> Spans:
    """Changes of speed and course between fixes about a second apart, and the means of the IMU there.

    lag_s : a fix stamped t describes t - lag_s
    """
    rows = np.flatnonzero(np.isfinite(gnss.over_ground))
    t_s = gnss.t_s[rows] - lag_s
    tick = np.floor(t_s / _EVERY_S + 0.25)
    rows = rows[np.unique(tick, return_index=True)[1]]
    t_s = gnss.t_s[rows] - lag_s
    after = np.searchsorted(t_s, t_s + _SHORTEST_S)
    first = np.flatnonzero(after < len(rows))
    last = after[first]
    near = (t_s[last] - t_s[first] <= _LONGEST_S) & (t_s[first] >= imu.t_s[0]) & (t_s[last] <= imu.t_s[-1])
    near &= _covered(imu, t_s[first], t_s[last])
    first, last = first[near], last[near]
    begin, end = t_s[first], t_s[last]
    length = end - begin
    speed, course = gnss.over_ground[rows], gnss.direction[rows]
    turn = -wrap_angle(course[last] - course[first]) / length
    turn = np.where(np.minimum(speed[first], speed[last]) > LEAST_SPEED, turn, np.nan)
    mean = 0.5 * (speed[first] + speed[last])
    ahead, across = (speed[last] - speed[first]) / length, mean * turn
    accel, gyro = (_means(imu.t_s, y, begin, end) for y in (imu.accel, imu.gyro))
    use = (np.abs(ahead) < _MOST_ACCELERATION) & np.isfinite(accel).all(axis=1)
    use &= ~(np.abs(turn) > _MOST_TURN) & ~(np.abs(across) > _MOST_ACCELERATION)
    return Spans(*(y[use] for y in (0.5 * (begin + end), mean, ahead, across, turn, accel, gyro)))


def motion_of(imu: Imu, gnss: Gnss, lag_s: float) -> Motion:
    """What the drive tells of the axes; see the module."""
    spans = spans_of(imu, gnss, lag_s)
    forward = left = up = turn = None
    if len(spans.t_s) >= FEWEST and np.ptp(spans.ahead) > 0.0:
        turning = np.isfinite(spans.across)
        bends = turning.sum() >= FEWEST and np.ptp(spans.across[turning]) > 0.0
        lateral = np.where(turning, spans.across, 0.0) if bends else np.zeros_like(spans.ahead)
        causes = np.column_stack([spans.ahead, *([lateral] if bends else []), np.ones_like(spans.ahead)])
        usual = turning | (np.abs(spans.ahead) < _MOST_ACCELERATION) if bends else np.ones(len(lateral), bool)
        found = regress(causes[usual], spans.accel[usual], spans.t_s[usual])
        forward, up = found[0], found[-1]
        left = found[1] if bends else None
    known = np.isfinite(spans.turn) & np.isfinite(spans.gyro).all(axis=1)
    if known.sum() >= FEWEST and np.ptp(spans.turn[known]) > 0.0:
        rate = spans.turn[known]
        turn = regress(np.column_stack([rate, np.ones_like(rate)]), spans.gyro[known], spans.t_s[known])[0]
    return Motion(forward, left, up, turn, spans)


def _covered(imu: Imu, begin: Floats, end: Floats) -> NDArray[np.bool_]:
    """(s,) spans in which the IMU has no gap of more than half a second, and feels no impact."""
    size = np.sqrt((imu.accel**2).sum(axis=1))
    usual = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    unfit = np.abs(size - usual) > _IMPACT * usual
    unfit[1:] |= np.diff(imu.t_s) > _LONGEST_GAP_S
    count = np.concatenate(([0], np.cumsum(unfit)))
    first, last = (np.clip(np.searchsorted(imu.t_s, t), 0, len(imu.t_s) - 1) for t in (begin, end))
    return np.asarray(count[first] == count[last])


def _means(t_s: Floats, y: Floats, begin: Floats, end: Floats) -> Floats:
    """Means of y (n, 3) from begin to end (s,): (s, 3); NaN for a column without a number."""
    found = np.full((len(begin), y.shape[1]), np.nan)
    for axis, column in enumerate(y.T):
        known = np.isfinite(column)
        if known.sum() < 2:
            continue
        t, value = t_s[known], column[known]
        area = np.concatenate(([0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(t))))
        found[:, axis] = (np.interp(end, t, area) - np.interp(begin, t, area)) / (end - begin)
    return found


def regress(causes: Floats, y: Floats, t_s: Floats) -> list[Direction]:
    """Coefficients of y (s, 3) on the causes (s, c), a vector for each cause."""
    weight = np.ones(len(y))
    for _ in range(_ROUNDS):
        normal = (causes * weight[:, None]).T @ causes
        inverse = np.linalg.pinv(normal, hermitian=True)
        found = inverse @ (causes * weight[:, None]).T @ y
        residual = y - causes @ found
        squared = (residual**2).sum(axis=1)
        weight = cauchy_weights(squared / max(float(np.median(squared)), 1e-12), 6.0)
    cluster = np.unique(np.floor((t_s - t_s[0]) / _CLUSTER_S), return_inverse=True)[1]
    variance = np.zeros(causes.shape[1])
    for axis in range(y.shape[1]):
        score = causes * (weight * residual[:, axis])[:, None]
        sums = np.array([np.bincount(cluster, part) for part in score.T])
        variance += np.diag(inverse @ (sums @ sums.T) @ inverse)
    share = len(np.unique(cluster))
    variance *= share / max(share - 1.0, 0.5)
    return [Direction(vector, float(np.sqrt(v / 3.0))) for vector, v in zip(found, variance, strict=True)]
