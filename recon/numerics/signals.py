"""Sampled signals with irregular times: derivatives, interpolation, means over intervals, runs.

Times are either float seconds or int64 nanoseconds. Integer times are only ever subtracted as integers, because a
double holds no more than 53 bits: at 1.5e9 s it resolves 0.24 us.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.numerics.integration import cumulative

Floats = NDArray[np.float64]
Times = NDArray[Any]
"""float64 s or int64 ns."""

_BLOCK: Final = 16_384
"""New times interpolated at once: what is found on the way stays in the cache of one core."""


def wrap_angle(angle: ArrayLike) -> Floats:
    """The same angle in (-pi, pi]. Every step is exact, so an angle already inside comes back bit for bit.

    angle : (...) rad
    returns : (...) rad
    """
    turn = 2.0 * np.pi
    rest = np.fmod(np.asarray(angle, dtype=np.float64), turn)
    return np.asarray(np.where(rest > np.pi, rest - turn, np.where(rest <= -np.pi, rest + turn, rest)))


def differentiate(t_s: ArrayLike, y: ArrayLike) -> Floats:
    """Derivative at the samples by the parabola through three neighbours: second order at irregular times and ends.

    Two samples give their slope, one gives NaN.

    t_s : (n,) s, strictly increasing
    y : (n,) or (n, k)
    returns : shape of y, unit of y per second
    """
    t_s, y = np.asarray(t_s, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(y) < 2:
        return np.full_like(y, np.nan)
    return np.asarray(np.gradient(y, t_s, axis=0, edge_order=2 if len(y) > 2 else 1))


def bracket(t_new: ArrayLike, t: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Where each new time falls between the samples.

    t_new : (m,) s or int64 ns
    t : (n,) in the same unit and type, increasing, at least one
    returns : left, right (m,) sample numbers; fraction (m,) of the way from left to right, NaN outside the span of t
    raises : TypeError if the times are of two types, ValueError if t is empty
    """
    t_new, t = _same_clock(t_new, t)
    if len(t) == 0:
        raise ValueError("no samples to interpolate between")
    left = np.clip(np.searchsorted(t, t_new, side="right") - 1, 0, max(len(t) - 2, 0))
    right = np.minimum(left + 1, len(t) - 1)
    step = np.asarray(t[right] - t[left])
    fraction = np.asarray((t_new - t[left]) / np.where(step > 0, step, 1), dtype=np.float64)
    fraction[(t_new < t[0]) | (t_new > t[-1])] = np.nan
    return left, right, fraction


def interpolate(t_new: ArrayLike, t: ArrayLike, y: ArrayLike, max_gap: float | None = None) -> Floats:
    """Linear interpolation that does not invent: NaN outside the span of t and inside gaps longer than max_gap.

    NaN samples are skipped, column by column; the gap is then that between the numbers around them. At the time of a
    sample its value is returned, even beside a gap.

    t_new : (m,) s or int64 ns
    t : (n,) in the same unit and type, strictly increasing
    y : (n,) or (n, k)
    max_gap : in the unit of t
    returns : (m,) or (m, k)
    raises : TypeError if the times are of two types
    """
    t_new, t = _same_clock(t_new, t)
    y = np.asarray(y, dtype=np.float64)
    known = ~np.isnan(y)
    if len(y) and known.all():
        return _interpolate_known(t_new, t, y, max_gap)
    result = np.full((len(t_new), *y.shape[1:]), np.nan)
    for column, numbers, target in zip(_columns(y), _columns(known), _columns(result), strict=True):
        if numbers.any():
            target[:] = _interpolate_known(t_new, t[numbers], column[numbers], max_gap)
    return result


def interval_mean(t_new: ArrayLike, t_ns: ArrayLike, y: ArrayLike, width_s: float, max_gap_s: float) -> Floats:
    """Mean, over an interval about each new time, of the line through the samples: what a lower rate shall hold.

    Means a width apart conserve the integral, and what is too fast for the new rate is damped before it is aliased.
    At the ends, and beside gaps longer than max_gap_s, the interval shrinks symmetrically, so a straight line passes
    unchanged. NaN samples are skipped, column by column.

    t_new : (m,) int64 ns, increasing; t_ns : (n,) int64 ns, strictly increasing
    y : (n,) or (n, k)
    returns : (m,) or (m, k), NaN outside the span of t_ns and inside gaps
    """
    t_new, t_ns = np.asarray(t_new), np.asarray(t_ns)
    y = np.asarray(y, dtype=np.float64)
    result = np.full((len(t_new), *y.shape[1:]), np.nan)
    for column, target in zip(_columns(y), _columns(result), strict=True):
        known = np.flatnonzero(~np.isnan(column))
        for rows in np.split(known, np.flatnonzero(np.diff(t_ns[known]) > max_gap_s * 1e9) + 1):
            if len(rows):
                t = t_ns[rows]
                inside = slice(*np.searchsorted(t_new, [t[0], t[-1] + 1]))
                target[inside] = _piece_mean((t_new[inside] - t[0]) * 1e-9, (t - t[0]) * 1e-9, column[rows], width_s)
    return result


def _piece_mean(t_new_s: Floats, t_s: Floats, y: Floats, width_s: float) -> Floats:
    """As `interval_mean` of one column without a gap, for times inside its span."""
    half_s = np.minimum(width_s / 2.0, np.minimum(t_new_s - t_s[0], t_s[-1] - t_new_s))
    mean = np.interp(t_new_s, t_s, y)
    wide = half_s > 0.0
    middle, half = t_new_s[wide], half_s[wide]
    mean[wide] = (_area_until(middle + half, t_s, y) - _area_until(middle - half, t_s, y)) / (2.0 * half)
    return mean


def _area_until(t_new_s: Floats, t_s: Floats, y: Floats) -> Floats:
    """Area under the line through at least two samples from the first one to each new time."""
    area = cumulative(t_s, y, "trapezoid")
    k = np.clip(np.searchsorted(t_s, t_new_s, side="right") - 1, 0, len(t_s) - 2)
    into = t_new_s - t_s[k]
    return np.asarray(area[k] + into * (y[k] + into * (np.diff(y) / np.diff(t_s))[k] / 2.0))


def interpolate_angle(t_new: ArrayLike, t: ArrayLike, angle: ArrayLike, max_gap: float | None = None) -> Floats:
    """As `interpolate`, along the shorter way around the circle.

    angle : (n,) or (n, k) rad
    returns : (m,) or (m, k) rad in (-pi, pi]
    """
    unwrapped = np.array(angle, dtype=np.float64)
    for column in _columns(unwrapped):
        known = ~np.isnan(column)
        column[known] = np.unwrap(column[known])
    return wrap_angle(interpolate(t_new, t, unwrapped, max_gap))


def _interpolate_known(t_new: Times, t: Times, y: Floats, max_gap: float | None) -> Floats:
    """As `interpolate` where y holds numbers only; each column of the result is contiguous."""
    result = np.empty((*y.shape[1:], len(t_new))).T
    for start in range(0, len(t_new), _BLOCK):
        some = slice(start, start + _BLOCK)
        left, right, fraction = bracket(t_new[some], t)
        if max_gap is not None:
            between = (fraction > 0.0) & (fraction < 1.0)
            fraction[between & (np.asarray(t[right] - t[left]) > max_gap)] = np.nan
        rest = 1.0 - fraction
        for column, target in zip(_columns(y), _columns(result[some]), strict=True):
            np.multiply(rest, column[left], out=target)
            target += fraction * column[right]
    return result


def _columns(y: NDArray[Any]) -> NDArray[Any]:
    """The columns of an (n,) or (n, k) array as the rows of a view (k, n)."""
    return y.T if y.ndim == 2 else y[None, :]


def _same_clock(t_new: ArrayLike, t: ArrayLike) -> tuple[Times, Times]:
    """Both times as int64 or both as float64."""
    pair = np.asarray(t_new), np.asarray(t)
    for kind, dtype in (("i", np.int64), ("f", np.float64)):
        if all(times.dtype.kind == kind for times in pair):
            return pair[0].astype(dtype, copy=False), pair[1].astype(dtype, copy=False)
    raise TypeError(
        f"times must be both float seconds or both integer nanoseconds, not {pair[0].dtype} and {pair[1].dtype}"
    )


def runs(mask: ArrayLike) -> NDArray[np.intp]:
    """Where a mask is True without break.

    mask : (n,) bool
    returns : (m, 2) start and stop, half-open: mask[start:stop] is all True and cannot be made longer
    """
    padded = np.concatenate(([False], np.asarray(mask, dtype=bool), [False]))
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)


def changes(y: ArrayLike) -> NDArray[np.bool_]:
    """Rows that bring news: a column holds a number other than the last number seen in that column.

    The first number of a column is news, a NaN never is, and a value that returns after NaNs is news only if it
    differs from the one before them. So a value that a logger holds and repeats is reported once.

    y : (n,) or (n, k)
    returns : (n,) bool
    """
    y = np.asarray(y)
    news = np.zeros(len(y), dtype=bool)
    for column in _columns(y):
        known = np.flatnonzero(column == column)  # only NaN differs from itself, whatever the type
        numbers = column[known]
        news[known[:1]] = True
        news[known[1:]] |= numbers[1:] != numbers[:-1]
    return news


def median_rate(t_ns: ArrayLike) -> float:
    """Sampling rate in Hz, 1 / median step; NaN for fewer than two samples.

    t_ns : (n,) int64 ns, strictly increasing
    """
    steps = np.diff(np.asarray(t_ns))
    return float(1e9 / np.median(steps)) if len(steps) else float("nan")
