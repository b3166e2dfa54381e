"""A box that turns in its mount: when, by how much, and its samples as if it had not.

Where a vehicle drives straight ahead, its axes follow in those of the box from where it goes and where up is. They stay
but for steps, where somebody touched the box. n such attitudes fall into stretches of one mean each, by the least

    sum over stretches of ( sum |R - mean|^2 + penalty ),    |R_1 - R_2|^2 = 8 sin^2(angle / 2)

which dynamic programming finds. When about the end of a stretch the box turned, its gyroscope tells: where what it read
beside the turns of the vehicle rises for good by that angle.

References
    Jackson et al. (2005), "An algorithm for optimal partitioning of data on an interval", IEEE Signal Processing
    Letters 12(2).
    Moakher (2002), "Means and averaging in the group of rotations", SIAM J. Matrix Anal. Appl. 24(1), section 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.rotation import conjugate, from_matrix, from_rotvec, multiply, to_rotvec
from recon.numerics.rotation_series import compose

Floats = NDArray[np.float64]

_FAST: Final = 5.0
"""m/s; whoever drives faster goes ahead."""
_STRAIGHT: Final = 1.0
"""m/s^2 across, below which a body hardly leans."""
_FEWEST, _FEWEST_AT_ENDS = 4, 2
"""Attitudes in a stretch, and in the first and the last, which may go on where none are told."""
_BESIDE: Final = 8
"""Attitudes before and after a turn, at most, by which it is judged."""
_PENALTY: Final = 0.04
"""Of a further stretch: what two times fifteen attitudes gain that are 3 degrees apart."""
_LEAST: Final = np.radians(2.5)
"""rad; less is what a body does by itself."""
_SURE: Final = 4.0
"""Sigmas of an attitude."""
_SPREADS: Final = 1.5
"""Of the attitudes beside it by which a turn is larger, lest a few that go astray make one."""
_TENTH: Final = 0.1
"""Share of a turn from which it has begun, and which is left when it is over."""
_UNREAD: Final = 0.4
"""Share of a turn that the gyroscope reads at least, or else the course does not make all of it."""
_READ: Final = 0.3
"""Share of a turn by which what is read beside it may miss it, for attitudes while it turns blur it."""
_TILTED: Final = 0.3
"""Share of a turn that is no heading, from which on it is looked at alone, for a vehicle hardly turns so."""
_AROUND_S: Final = 5.0
"""s before and after two attitudes in which a box may turn: a slow turn has attitudes inside."""
_MARGIN, _LEAST_S = 0.25, 0.1
"""Of the time from the first tenth of a turn to the last, and s, before it and after it, for the rest."""


@dataclass(frozen=True)
class Turn:
    """The box turned between two times, s. first_from_new : (3, 3), its axes since then to those of the beginning."""

    start_s: float
    end_s: float
    first_from_new: Floats


@dataclass(frozen=True)
class Attitudes:
    """Of a vehicle that drives straight ahead in its box: at (k,) s, axes (k, 3, 3) of it from those of the box.

    sigma : (k,) rad
    """

    t_s: Floats
    axes: Floats
    sigma: Floats


def attitudes(t_s: Floats, rot_ns: Floats, vel_n: Floats, rate_s: Floats, sigma: Floats) -> Attitudes:
    """Where the drive tells them.

    t_s : (N,) s; rot_ns : (3, 3, N) from box to n, z up; vel_n : (3, N) m/s; rate_s : (3, N) rad/s, box, without bias
    sigma : (N,) rad, of the heading
    """
    speed, up_s = np.sqrt((vel_n**2).sum(axis=0)), rot_ns[2]
    k = np.flatnonzero((speed > _FAST) & (np.abs((rate_s * up_s).sum(axis=0)) * speed < _STRAIGHT))
    ahead_s = np.einsum("ijk,ik->jk", rot_ns[..., k], vel_n[:, k] / speed[k])
    left_s = np.cross(up_s[:, k], ahead_s, axis=0)
    left_s /= np.sqrt((left_s**2).sum(axis=0))
    axes = np.stack([ahead_s, left_s, np.cross(ahead_s, left_s, axis=0)]).transpose(2, 0, 1)
    return Attitudes(t_s[k], axes, sigma[k])


def turns_of(seen: Attitudes) -> list[Turn]:
    """The turns, each between the last attitude before it and the first one after it."""
    if len(seen.t_s) < 2 * _FEWEST:
        return []
    bounds = _merged(seen, _stretches(seen.axes))
    first, *others = [_mean(seen.axes[i:j]) for i, j in pairwise(bounds)]
    return [
        Turn(float(seen.t_s[at - 1]), float(seen.t_s[at]), first.T @ mean)
        for at, mean in zip(bounds[1:-1], others, strict=True)
    ]


def refined(turns: list[Turn], seen: Attitudes) -> list[Turn]:
    """The turns corrected by what is left of them in the attitudes of a box that was turned back by them.

    Those that come out as hardly any are none.
    """
    starts = np.array([-np.inf, *(turn.end_s for turn in turns)])
    ends = np.array([*(turn.start_s for turn in turns), np.inf])
    inside = [(seen.t_s >= start) & (seen.t_s <= end) for start, end in zip(starts, ends, strict=True)]
    if not all(some.any() for some in inside):
        return turns
    first, *others = [_mean(seen.axes[some]) for some in inside]
    return _counting(
        [
            replace(turn, first_from_new=first.T @ mean @ turn.first_from_new)
            for turn, mean in zip(turns, others, strict=True)
        ]
    )


def _counting(turns: list[Turn]) -> list[Turn]:
    """Those that are large enough, each against the one before that is."""
    found: list[Turn] = []
    for turn in turns:
        if sizes([*found, turn])[-1] > _LEAST:
            found.append(turn)
    return found


def sizes(turns: list[Turn]) -> list[float]:
    """By how much the box turned each time: rad."""
    axes = [np.eye(3), *(turn.first_from_new for turn in turns)]
    return [_angle(one.T @ other) for one, other in pairwise(axes)]


def when_read(turns: list[Turn], t_s: Floats, gyro_s: Floats, course: Floats, up_s: Floats) -> list[Turn]:
    """The turns in the times in which the gyroscope reads them, what the vehicle turns itself taken off.

    Where it reads nothing while the course changes by as much, it is the course that is wrong, as in multipath.

    t_s : (n,) s; gyro_s : (n, 3) rad/s, box, without bias
    course : (n,) rad, of the vehicle, anticlockwise, no jumps; up_s : (n, 3), box
    """
    axes = [np.eye(3), *(turn.first_from_new for turn in turns)]
    found = []
    for turn, before in zip(turns, axes, strict=False):
        rows = slice(*np.searchsorted(t_s, [turn.start_s - _AROUND_S, turn.end_s + _AROUND_S]))
        if rows.stop - rows.start < 2:  # in a silence of the IMU, where the attitudes are hardly known
            continue
        up, driven = up_s[rows.start], course[rows] - course[rows.start]
        whole = _rotvec(before.T @ turn.first_from_new)
        turned = _beside(t_s[rows], gyro_s[rows], driven[:, None] * up)
        level = whole - (whole @ up) * up
        if np.linalg.norm(level) > _TILTED * np.linalg.norm(whole):
            whole, turned = level, turned - (turned @ up)[:, None] * up
        when = _when(turn, whole, t_s[rows], turned)
        inside = np.searchsorted(t_s[rows], [when.start_s, when.end_s]).clip(max=len(driven) - 1)
        size = float(np.linalg.norm(whole))
        along = whole / max(size, np.finfo(float).tiny)
        bend = float(np.diff(driven[inside])[0] * (up @ along))
        read = float(np.diff(turned[inside], axis=0)[0] @ along) + bend
        if max(abs(read), abs(bend + size)) > _UNREAD * size:
            found.append(when)
    return _counting(found)


def _beside(t_s: Floats, gyro_s: Floats, vehicle: Floats) -> Floats:
    """What a box turned beside its vehicle: rotation vectors (n, 3) rad, in its axes of the beginning.

    t_s : (n,) s; gyro_s : (n, 3) rad/s; vehicle : (n, 3) rad, rotation vectors, in the axes of the beginning
    """
    steps = 0.5 * (gyro_s[1:] + gyro_s[:-1]) * np.diff(t_s)[:, None]
    box = compose(from_rotvec(steps), (1.0, 0.0, 0.0, 0.0))
    return to_rotvec(multiply(conjugate(from_rotvec(vehicle)), box))


def _when(turn: Turn, whole: Floats, t_s: Floats, turned: Floats) -> Turn:
    """About the best step from nothing to the whole, from its first tenth to its last. whole : (3,); turned : (n, 3)"""
    size = np.linalg.norm(whole)
    if np.linalg.norm(turned[-1] - whole) < _READ * size:
        whole = turned[-1]
    before, behind = (np.sqrt(((turned - one) ** 2).sum(axis=1)) for one in (np.zeros(3), whole))
    step = int(np.argmin(np.cumsum(before) - np.cumsum(behind)))
    still, done = np.flatnonzero(before[: step + 1] < _TENTH * size), behind[step:] < _TENTH * size
    if not len(still) or not done.any():
        return turn
    start, end = float(t_s[still[-1]]), float(t_s[step + int(np.argmax(done))])
    margin = _MARGIN * (end - start) + _LEAST_S
    return replace(turn, start_s=start - margin, end_s=end + margin)


def turned_back(turns: list[Turn], t_s: Floats, vectors_s: Floats, bias_s: Floats) -> Floats:
    """What a box measured, (n, 3), in its axes of the beginning; the bias (3,) stays as if these were the box's."""
    out = vectors_s.copy()
    for turn in turns:
        since = t_s >= turn.end_s
        out[since] = (vectors_s[since] - bias_s) @ turn.first_from_new.T + bias_s
    return out


def _stretches(axes: Floats) -> list[int]:
    """Where stretches of (n, 3, 3) begin, and the end: [0, ..., n]."""
    n = len(axes)
    total = np.concatenate([np.zeros((1, 9)), np.cumsum(axes.reshape(n, 9), axis=0)])
    cost, origin = np.full(n + 1, np.inf), np.zeros(n + 1, dtype=int)
    cost[0] = 0.0
    for stop in range(_FEWEST_AT_ENDS, n + 1):
        first = np.arange(max(stop - (_FEWEST_AT_ENDS if stop == n else _FEWEST) + 1, 1))
        length = stop - first
        spread = 3.0 * length - ((total[stop] - total[first]) ** 2).sum(axis=1) / length
        every = cost[first] + spread + _PENALTY
        origin[stop] = int(np.argmin(every))
        cost[stop] = every[origin[stop]]
    bounds = [n]
    while bounds[-1] > 0:
        bounds.append(int(origin[bounds[-1]]))
    return bounds[::-1]


def _merged(seen: Attitudes, bounds: list[int]) -> list[int]:
    """The same without those between stretches that are hardly apart, as a whole or where they meet, nearest first."""
    while len(bounds) > 2:
        means = [_mean(seen.axes[i:j]) for i, j in pairwise(bounds)]
        whole = [_angle(one.T @ other) for one, other in pairwise(means)]
        sure = [
            min(angle / _LEAST, _sure(seen, *three))
            for angle, three in zip(whole, zip(bounds, bounds[1:], bounds[2:], strict=False), strict=True)
        ]
        least = int(np.argmin(sure))
        if sure[least] > 1.0:
            break
        bounds = bounds[: least + 1] + bounds[least + 2 :]
    return bounds


def _sure(seen: Attitudes, start: int, at: int, stop: int) -> float:
    """The turn from the attitudes since start to those at `at` and behind until stop, in the least that counts."""
    beside = seen.axes[max(start, at - _BESIDE) : at], seen.axes[at : min(stop, at + _BESIDE)]
    one, other = (_mean(axes) for axes in beside)
    spread = max(np.sqrt(0.5 * ((axes - _mean(axes)) ** 2).sum(axis=(1, 2)).mean()) for axes in beside)
    least = max(_LEAST, _SURE * seen.sigma[at - 1], _SURE * seen.sigma[at], _SPREADS * spread)
    return float(_angle(one.T @ other) / least)


def _mean(axes: Floats) -> Floats:
    """The rotation nearest to the arithmetic mean of (n, 3, 3)."""
    u, _, vt = np.linalg.svd(axes.mean(axis=0))
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _angle(rot: Floats) -> float:
    """By which a matrix turns: rad, 0 to pi."""
    return float(2.0 * np.arcsin(min(np.sqrt(((rot - np.eye(3)) ** 2).sum() / 8.0), 1.0)))


def _rotvec(rot: Floats) -> Floats:
    """Of a matrix: (3,) rad."""
    return to_rotvec(from_matrix(rot))
