"""Fewer points for the eye: of each of many equal spans of time the rows with the lowest and the highest value.

What a line of ordinary thickness covers stays the same as long as a span is not wider than the line, and no peak is
lost. A band keeps its lowest lower and its highest upper edge in each span.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.tables import Array

Rows = NDArray[np.intp]
SPANS: Final = 2000
"""Two for each pixel of a wide chart, or one for each of those of a print."""


def gaps(t_ns: NDArray[np.int64], longest_s: float) -> NDArray[np.bool_]:
    """Rows before which more than `longest_s` passed, and more than ten usual steps; (n,), the first is one."""
    steps = np.diff(t_ns)
    long = steps > longest_s * 1e9
    if long.any():
        long &= steps > 10.0 * np.median(steps)
    return np.concatenate((np.ones(min(len(t_ns), 1), dtype=bool), long))


def extremes(t_ns: NDArray[np.int64], values: Array, begins: NDArray[np.bool_], spans: int = SPANS) -> Rows:
    """Rows to draw, rising: all where there are few, else lowest and highest of each span and the ends of pieces.

    t_ns : (n,) rising; values : (n,) finite; begins : (n,) rows with which a piece begins
    """
    if len(t_ns) <= 2 * spans:
        return np.arange(len(t_ns))
    starts = _starts(t_ns, spans)
    counts = np.diff(np.append(starts, len(values)))
    kept = begins | np.append(begins[1:], True)
    for reduce in (np.minimum, np.maximum):
        hits = np.flatnonzero(values == np.repeat(reduce.reduceat(values, starts), counts))
        first = np.searchsorted(hits, starts)
        kept[hits[first]] = True
    return np.flatnonzero(kept)


def scattered(t_ns: NDArray[np.int64], values: Array, begins: NDArray[np.bool_], spans: int = SPANS) -> Rows:
    """As `extremes` for single points: one of every few rows more, so that a cloud does not become two lines."""
    every = np.arange(0, len(t_ns), len(t_ns) // (4 * spans) + 1)
    return np.union1d(extremes(t_ns, values, begins, spans), every)


def envelope(
    t_ns: NDArray[np.int64], low: Array, high: Array, begins: NDArray[np.bool_], spans: int = SPANS
) -> tuple[Rows, Array, Array]:
    """Rows at which a band is drawn, its lower and upper edges there: of each span lowest and highest.

    t_ns : (n,) rising; low, high : (n,) finite
    """
    if len(t_ns) <= 2 * spans:
        return np.arange(len(t_ns)), low, high
    edges = begins.copy()
    edges[_starts(t_ns, spans)] = True
    starts = np.flatnonzero(edges)
    return starts, np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)


def band(
    t_ns: NDArray[np.int64], values: Array, sigma: Array, longest_s: float
) -> tuple[NDArray[np.int64], Array, Array, list[slice]]:
    """Two standard deviations to either side where they are known: times, lower and upper edges, `pieces`.

    t_ns : (n,) rising; values : (n,) finite; sigma : (n,), NaN where not known; longest_s : as in `gaps`
    """
    known = np.isfinite(sigma)
    t_ns, values, around = t_ns[known], values[known], 2.0 * sigma[known]
    begins = gaps(t_ns, longest_s)
    rows, low, high = envelope(t_ns, values - around, values + around, begins)
    return t_ns[rows], low, high, pieces(rows, begins)


def _starts(t_ns: NDArray[np.int64], spans: int) -> Rows:
    """First row of each span that holds one."""
    number = (t_ns - t_ns[0]) // (int(t_ns[-1] - t_ns[0]) // spans + 1)
    return np.flatnonzero(np.concatenate(([True], number[1:] != number[:-1])))


def pieces(rows: Rows, begins: NDArray[np.bool_]) -> list[slice]:
    """Runs of the rows chosen that a line joins: slices into `rows`."""
    piece = np.cumsum(begins)[rows]
    cuts = (np.flatnonzero(np.diff(piece)) + 1).tolist()
    return [slice(*ends) for ends in pairwise([0, *cuts, len(rows)])]
