"""Which positions of a receiver can be believed: newly reported ones that a vehicle could have driven through.

A logger that writes position and speed in different rows repeats the last position with each new speed. Such a row
lies within half a period of a row whose position is new; the repeats of a receiver that stands lie at whole periods.

Of the new positions the longest sequence is kept in which no neighbours are further apart than the largest speed and
what fixes scatter by allow,

    |p_j - p_i| <= v (t_j - t_i) + d.

So an excursion is left out, and of a record that jumps for good the longer part is kept, whichever it is. Without d
noise alone would refute most fixes of a fast receiver: at 20 Hz 400 km/h are 5.6 m from one to the next. The error of a
difference does not shrink with its step, so d is a length, of as many sigmas as a long drive needs for none of its good
fixes to be lost; sigma is what the fixes tell, from how far each lies beside the line between its neighbours.

The receiver's own speed s tells more: it comes from the Doppler shift, which reflections and the filter of a phone move
far less than the position. So neighbours are no further apart than the larger of the two speeds allows, half as much
again, and d. A speed of exactly 0 is what many receivers write where they know none, and across
outages no speed is known: there the largest speed holds alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recon.numerics.signals import changes
from recon.tables import Array

Mask = NDArray[np.bool_]
Rows = NDArray[np.intp]
_FASTER = 1.5
"""Times the reported speed: it is late by a second or two when a vehicle speeds up."""
_SCATTER_SIGMAS = 5.0
"""Of the difference of two fixes: 1 of 70 000 is farther, in three dimensions that err alike."""
_SCATTER_M = (15.0, 100.0)
"""Least and largest scatter: reflections move a fix for a while by more than fixes beside each other tell, and what
scatters wider is no receiver of positions.
"""
_NORMAL_MAD = 1.4826
"""Standard deviation of normal numbers over their median absolute deviation."""
_FEWEST = 10
"""Fixes between neighbours from which a scatter is told."""
RECENT = 500
"""Stretches that the sequence may leave to enter one whole; more would take minutes where all positions are noise."""


def reported(t_ns: NDArray[np.int64], place: Array, gap_ns: int) -> Mask:
    """Rows in which the receiver reported a position, not the logger repeated one: (n,) bool.

    t_ns : (n,) ns, strictly increasing; place : (n, k) any unit; gap_ns : longer steps are outages
    """
    new = changes(place)
    news_ns = t_ns[new]
    steps = np.diff(t_ns)
    if len(news_ns) < 2 or not (steps <= gap_ns).any():
        return np.ones(len(t_ns), dtype=bool)
    # A standing receiver brings news seldom, so the rows tell too: there are two at most for each report.
    period = min(float(np.median(np.diff(news_ns))), 2.0 * float(steps[steps <= gap_ns].mean()))
    after = np.searchsorted(news_ns, t_ns)
    later = news_ns[np.minimum(after, len(news_ns) - 1)] - t_ns
    earlier = t_ns - news_ns[np.maximum(after - 1, 0)]
    near = (np.abs(later) < 0.5 * period) | (np.abs(earlier) < 0.5 * period)
    return np.asarray(new | ~near)


def reach(t_s: Array, speed: Array, max_speed: float, max_gap: float) -> Array:
    """How far a vehicle can have come since the first of some positions, by the speed that is told beside them: (n,) m.

    t_s : (n,) s, strictly increasing; speed : (n,) m/s, NaN or 0 where it is not known
    max_speed : m/s, where no speed is known; max_gap : s, steps longer than that are outages
    """
    step, known = np.diff(t_s), speed > 0.0
    told = (step <= max_gap) & known[1:] & known[:-1]
    fastest = np.where(told, np.minimum(_FASTER * np.maximum(speed[1:], speed[:-1]), max_speed), max_speed)
    return np.append(0.0, np.cumsum(fastest * step))


def scatter(t_s: Array, pos: Array, max_gap: float) -> float:
    """How far noise alone may move two fixes apart, m, from their median distance to the line between their neighbours.

    The middle of three fixes lies beside that line by w_1 e_1 + w_3 e_3 - e_2, where w are the weights of the linear
    interpolation, so by sqrt(1 + w_1^2 + w_3^2) sigma of one; accelerations add a (dt / 2)^2, 1 m at a fix a second.

    t_s : (n,) s, strictly increasing; pos : (n, k) m, local; max_gap : s, steps longer than that are outages
    """
    step = np.diff(t_s)
    near = (step[1:] <= max_gap) & (step[:-1] <= max_gap)
    if near.sum() < _FEWEST:
        return _SCATTER_M[0]
    weight = (step[1:] / (step[1:] + step[:-1]))[near, None]
    beside = weight * pos[:-2][near] + (1.0 - weight) * pos[2:][near] - pos[1:-1][near]
    unit = np.abs(beside) / np.sqrt(1.0 + weight**2 + (1.0 - weight) ** 2)
    sigma = _NORMAL_MAD * float(np.median(unit, axis=0).max())
    return float(np.clip(_SCATTER_SIGMAS * np.sqrt(2.0) * sigma, *_SCATTER_M))


def drivable(t_s: Array, pos: Array, max_speed: float, scatter_m: float, reach_m: Array | None = None) -> Mask:
    """The longest sequence of positions that can be driven through: (n,) bool.

    Positions are taken in stretches without an impossible step, so the sequence enters a stretch where it can but
    leaves it at its end only: a few positions may be lost beside a jump, none that cannot be reached is kept.

    t_s : (n,) s, strictly increasing; pos : (n, k) m, local; max_speed : m/s; scatter_m : m, from `scatter`
    reach_m : (n,) m, from `reach`, where the receiver's own speed is to be heard as well
    """

    def reached(rows: Rows, origins: Rows) -> Mask:
        distance = np.linalg.norm(pos[rows] - pos[origins], axis=1)
        allowed = max_speed * (t_s[rows] - t_s[origins])
        if reach_m is not None:
            allowed = np.minimum(allowed, reach_m[rows] - reach_m[origins])
        return np.asarray(distance <= allowed + scatter_m)

    every = np.arange(len(t_s))
    cuts = np.flatnonzero(~reached(every[1:], every[:-1])) + 1
    first, stop = np.append(0, cuts), np.append(cuts, len(t_s))
    last, enter, length, before = stop - 1, first.copy(), stop - first, np.full(len(first), -1)
    for k in range(1, len(first)):
        choices = [(length[k], -1, first[k])]
        recent = slice(max(0, k - RECENT), k)
        whole = np.where(reached(first[k : k + 1], last[recent]), length[recent], 0)
        if whole.any():
            choices.append((length[k] + whole.max(), recent.start + int(whole.argmax()), first[k]))
        longest = length[:k].argmax()
        late = reached(every[first[k] : stop[k]], last[longest : longest + 1])
        if late.any():
            choices.append((late.sum() + length[longest], int(longest), first[k] + late.argmax()))
        length[k], before[k], enter[k] = max(choices)
    return _chain(len(t_s), int(length.argmax()), before, enter, stop)


def _chain(n: int, k: int, before: Rows, enter: Rows, stop: Rows) -> Mask:
    """Rows of the sequence that ends with stretch k."""
    kept = np.zeros(n, dtype=bool)
    while k >= 0:
        kept[enter[k] : stop[k]] = True
        k = int(before[k])
    return kept
