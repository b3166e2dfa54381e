"""Which rows of a log have a time that fits those around them, and where a log pauses.

A box writes its rows in the order of time. Where times fall all the same, the fewest rows go that leave times which do
not fall: the others are the longest such selection (M. L. Fredman, On computing the length of longest increasing
subsequences, Discrete Mathematics 11, 1975). So one row that is years late goes alone, and not all that follow it.

A first or last row far from all others is in order and yet no part of the drive: written before the clock was set, or
with a damaged time. It goes as well; any other large step is a pause of the box and stays.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from recon.numerics.signals import runs
from recon.rows import Metric

Mask: TypeAlias = NDArray[np.bool_]
Times: TypeAlias = NDArray[np.int64]

EARLIEST_NS: Final = 946_684_800 * 1_000_000_000
"""2000-01-01: a clock that shows less was never set."""
PAUSE_NS: Final = 3_600 * 1_000_000_000
"""A step in time of more than an hour is a pause, except in logs that hold a row now and then: there it is one of"""
PAUSE_STEPS: Final = 100
"""median steps."""


def in_order(t_ns: Times, missing: Mask) -> Mask:
    """Rows whose time can be used: (n,) bool. Among them it never falls.

    t_ns : (n,) ns; missing : (n,) bool, rows without a time
    """
    usable = ~missing
    timed = t_ns if usable.all() else t_ns[usable]
    rising = _longest_rising(timed)
    if not rising.all():
        timed = timed[rising]
        usable[np.flatnonzero(usable)[~rising]] = False
    after = pauses(timed)
    if 0 in after:
        usable[np.argmax(usable)] = False
    if len(timed) - 2 in after:
        usable[len(usable) - 1 - np.argmax(usable[::-1])] = False
    return usable


def rising(t_ns: Times, name: str) -> tuple[NDArray[np.intp] | slice, list[Metric]]:
    """Rows in the order of time, each time once, and what became of the others.

    Messages come as they were received: they are sorted by time. One that repeats a time is left out, as is a first or
    last one whose time is far from all others.

    t_ns : (n,) ns; name : of the sensor in its file
    """
    if (t_ns[1:] > t_ns[:-1]).all() and in_order(t_ns, np.zeros(len(t_ns), dtype=bool)).all():
        return slice(None), []
    order = np.argsort(t_ns, kind="stable")
    ordered = t_ns[order]
    repeated = np.diff(ordered, prepend=ordered[:1] - 1) <= 0
    usable = in_order(ordered[~repeated], np.zeros(np.count_nonzero(~repeated), dtype=bool))
    learnt = []
    falls = np.count_nonzero(t_ns[1:] < t_ns[:-1])
    if falls:
        learnt.append(Metric("rows_sorted", float(falls), note=f"{name}: times that fell"))
    for what, count in (("of the time of an earlier one", repeated.sum()), ("far from all others", (~usable).sum())):
        if count:
            learnt.append(Metric("rows_left_out", float(count), note=f"{name}: {what}, of {len(t_ns)}"))
    return order[~repeated][usable], learnt


def median_ns(times_ns: Times) -> int:
    """The median of (n,) ns since an epoch to the ns, which doubles of them would round to 256 ns."""
    first = int(times_ns[0])
    return first + round(float(np.median(times_ns - first)))


def slots(t_ns: Times) -> tuple[Mask, NDArray[np.int32]]:
    """Rows with which a new time begins, (n,) bool, and to which of these times each row belongs, (n,) from 0.

    t_ns : (n,) that never falls, at least one
    """
    begins = np.diff(t_ns, prepend=t_ns[0] - 1) > 0
    return begins, np.cumsum(begins, dtype=np.int32) - 1


def never_falling(t_ns: Times, usable: Mask) -> Times:
    """The times with those that cannot be used replaced by one beside them: (n,) ns.

    t_ns : (n,) ns; usable : (n,) bool as `in_order` gives them
    """
    if usable.all():
        return t_ns
    rows = np.flatnonzero(usable)
    beside = np.maximum(np.cumsum(usable) - 1, 0)
    return np.asarray(t_ns[rows[beside]]) if len(rows) else np.zeros_like(t_ns)


def pauses(t_ns: Times) -> NDArray[np.intp]:
    """Rows behind which a log pauses: (m,) row numbers.

    t_ns : (n,) ns, never falling
    """
    steps = np.diff(t_ns)
    if not len(steps) or steps.max() <= PAUSE_NS:
        return np.zeros(0, np.intp)
    return np.flatnonzero(steps > max(PAUSE_NS, PAUSE_STEPS * np.median(steps)))


def repeating(t_ns: Times, fresh: Iterable[Mask]) -> Mask:
    """Rows of the time of an earlier row that the same sensor reported: (n,) bool.

    Rows of one time that update different sensors complement each other.

    t_ns : (n,) ns; fresh : by sensor (n,) bool, never falling in time
    """
    found = np.zeros(len(t_ns), dtype=bool)
    if (t_ns[1:] > t_ns[:-1]).all():
        return found
    for mask in fresh:
        rows = np.flatnonzero(mask)
        found[rows[1:][np.diff(t_ns[rows]) == 0]] = True
    return found


def _longest_rising(t_ns: Times) -> Mask:
    """The longest selection of rows in which time never falls: (n,) bool; of several, the one that keeps what is above.

    A row that no row above exceeds and that exceeds none below is part of it; only the stretches between such rows
    need a search.
    """
    if not len(t_ns):
        return np.zeros(0, dtype=bool)
    if (t_ns[1:] >= t_ns[:-1]).all():
        return np.ones(len(t_ns), dtype=bool)
    greatest = np.maximum.accumulate(t_ns)
    least = np.minimum.accumulate(t_ns[::-1])[::-1]
    chosen = (t_ns >= greatest) & (t_ns <= least)
    for start, stop in runs(~chosen):
        chosen[start + _search(t_ns[start:stop])] = True
    return chosen


def _search(t_ns: Times) -> NDArray[np.intp]:
    """Rows of the longest selection, by patience sorting from the last row to the first: (m,) row numbers."""
    negated = (-t_ns).tolist()
    heads: list[int] = []  # negated time of the first row of the best selection of each length
    rows: list[int] = []  # that row
    following = [-1] * len(negated)
    for row in range(len(negated) - 1, -1, -1):
        length = bisect_right(heads, negated[row])
        following[row] = rows[length - 1] if length else -1
        heads[length : length + 1] = [negated[row]]
        rows[length : length + 1] = [row]
    chosen, row = [], rows[-1]
    while row >= 0:
        chosen.append(row)
        row = following[row]
    return np.array(chosen, dtype=np.intp)
