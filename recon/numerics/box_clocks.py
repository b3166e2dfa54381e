"""Two clocks by what two gyroscopes of one rigid body measure: averages alike, lag and drift.

The magnitude of the turn rate does not ask how a box is mounted. Where two records of it correlate best, a parabola
through the top of the correlation, is the lag; a line through the lags of windows of a minute, by medians, the drift.

References
    Knapp, Carter (1976), "The generalized correlation method for estimation of time delay", IEEE T-ASSP 24(4).
    Theil (1950), "A rank-invariant method of linear and polynomial regression analysis", Indag. Math. 12.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.moving_window import moving_average
from recon.numerics.rotation import Floats
from recon.numerics.signals import interval_mean, median_rate

_WIDTH_S: Final = 0.1
"""Of the mean that is taken twice; vibration of an engine or a road is faster."""
_PARTS: Final = 5
"""Steps of the grid in one width."""
_GAP_S: Final = 0.5
_WINDOW_S: Final = 60.0
_SHORTEST_S: Final = 30.0
_NEARBY_S: Final = 2.0
"""The lag of a window is sought so near to that of the whole record."""
_FEWEST_WINDOWS: Final = 3
_LEAST_LIKENESS, _CLEAR_LIKENESS = 0.4, 0.7
"""Correlations below which two boxes are no neighbours, and from which a window tells a lag."""


class Inertial(NamedTuple):
    """What a box measured: t_ns (n,) int64, strictly increasing; gyro (n, 3) rad/s; accel (n, 3) m/s^2."""

    t_ns: NDArray[np.int64]
    gyro: Floats
    accel: Floats


class Smooth(NamedTuple):
    """The averages of a box, gyro and accel side by side, by a cubic spline over s since start_ns."""

    start_ns: int
    step_s: float
    spline: Any
    known: Floats

    @classmethod
    def of(cls, box: Inertial, width_s: float = _WIDTH_S) -> Smooth:
        """Those of a box; raises ValueError where it has hardly any rows."""
        from scipy.interpolate import CubicSpline  # slow import: only when used

        if len(box.t_ns) < 2:
            raise ValueError("a box has fewer than two rows")
        step_s = max(width_s, 2.0 / median_rate(box.t_ns)) / _PARTS
        grid = np.arange(box.t_ns[0], box.t_ns[-1] + 1, round(step_s * 1e9))
        if len(grid) < _PARTS:
            raise ValueError(f"a box has only {(box.t_ns[-1] - box.t_ns[0]) * 1e-9:.2g} s")
        means = interval_mean(grid, box.t_ns, np.hstack((box.gyro, box.accel)), _PARTS * step_s, _GAP_S)
        values = np.asarray(moving_average(means, _PARTS))
        known = np.asarray(np.isfinite(values).all(axis=1), dtype=np.float64)
        return cls(int(grid[0]), step_s, CubicSpline((grid - grid[0]) * 1e-9, np.nan_to_num(values)), known)

    def at(self, t_s: Floats, order: int = 0) -> Floats:
        """Averages or their derivatives at times (n,) s since start_ns: (n, 6), NaN outside and beside gaps."""
        known = np.interp(t_s, self.spline.x, self.known, left=0.0, right=0.0) == 1.0
        return np.asarray(np.where(known[:, None], self.spline(t_s, order), np.nan))

    def turn_rate(self, t_s: Floats) -> Floats:
        """Magnitude of the angular rate, zero where it is not known: (n,) rad/s."""
        return np.asarray(np.nan_to_num(np.linalg.norm(self.at(t_s)[:, :3], axis=1)))


def clock(one: Smooth, two: Smooth, largest_s: float) -> tuple[float, float, int]:
    """How the clock of the second box goes against that of the first.

    largest_s : s, lags are sought up to this, early and late
    returns : lag in s at the middle of what both cover, drift in s/s, and that middle in ns of the first clock
    raises : ValueError where they share too little, or their turn rates have nothing in common
    """
    step_s = max(one.step_s, two.step_s)
    reach = round(largest_s / step_s)
    offset_s = (one.start_ns - two.start_ns) * 1e-9
    t_s = np.arange(0.0, one.spline.x[-1], step_s)
    around_s = np.asarray(step_s * np.arange(-reach, len(t_s) + reach) + offset_s)
    lags, strengths = _likeness(one.turn_rate(t_s), two.turn_rate(around_s), step_s, reach)
    whole = float(lags[0])
    begin_s, end_s = max(0.0, -offset_s - whole), min(one.spline.x[-1], two.spline.x[-1] - offset_s - whole)
    if end_s - begin_s < _SHORTEST_S:
        raise ValueError(f"the boxes share {max(end_s - begin_s, 0.0):.0f} s; {_SHORTEST_S:.0f} s are needed")
    if strengths[0] < _LEAST_LIKENESS:
        raise ValueError(f"their turn rates have little in common: the correlation is {strengths[0]:.2f} at best")
    middle_s = (begin_s + end_s) / 2.0
    lag, drift = _line(one, two, np.array([begin_s, end_s]), whole, offset_s)
    return lag, drift, one.start_ns + round(middle_s * 1e9)


def _line(one: Smooth, two: Smooth, span_s: Floats, whole: float, offset_s: float) -> tuple[float, float]:
    """Lag at the middle of the span and drift, by the line of medians through the lags of its windows."""
    from scipy.stats import theilslopes  # slow import: only when used

    step_s, reach = one.step_s, round(_NEARBY_S / one.step_s)
    count = max(1, round((span_s[1] - span_s[0]) / _WINDOW_S))
    edges = np.linspace(span_s[0], span_s[1], count + 1).tolist()
    middles, lags = [], []
    for begin_s, end_s in pairwise(edges):
        t_s = np.arange(begin_s, end_s, step_s)
        around_s = np.asarray(begin_s + step_s * np.arange(-reach, len(t_s) + reach) + offset_s + whole)
        lag, strength = _likeness(one.turn_rate(t_s), two.turn_rate(around_s), step_s, reach)
        if strength[0] > _CLEAR_LIKENESS:
            middles.append((begin_s + end_s) / 2.0 - span_s.mean())
            lags.append(whole + float(lag[0]))
    if len(lags) < _FEWEST_WINDOWS:
        return (float(np.median(lags)) if lags else whole), 0.0
    slope, intercept, *_ = theilslopes(lags, middles)
    return float(intercept), float(slope)


def _likeness(fixed: Floats, moving: Floats, step_s: float, reach: int) -> tuple[Floats, Floats]:
    """Lag of the best correlation, refined by a parabola, and its coefficient: (1,) s and (1,).

    fixed : (n,);  moving : (n + 2 reach,), from `reach` steps before the first of fixed
    """
    from scipy.signal import correlate  # slow import: only when used

    size = len(fixed)
    centred = fixed - fixed.mean()
    sums = np.cumsum(np.vstack((np.zeros(2), np.column_stack((moving, moving**2)))), axis=0)
    mean, square = ((sums[size:] - sums[:-size]) / size).T
    spread = np.sqrt(np.maximum(square - mean**2, 0.0)) * centred.std() * size
    likeness = correlate(moving, centred, mode="valid", method="fft") / np.maximum(spread, 1e-12)
    top = int(np.argmax(likeness))
    shift = 0.0
    if 0 < top < len(likeness) - 1:
        before, here, after = likeness[top - 1 : top + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * here + after)
    return np.array([(top - reach + shift) * step_s]), likeness[top : top + 1]
