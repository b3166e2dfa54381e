"""Samples that a sensor has clipped, and what may lie behind them.

A sensor that reaches the end of its range repeats that value exactly. So does the smooth top of a peak that is
quantised, but a parabola that stays L samples within one quantum falls by eight quanta in the next L. A plateau at the
extreme of an axis counts as clipped where it falls by three times as much. Two samples are the same by chance, too: two
at the top of a parabola that falls by D beside them differ by a quarter of that at most, so that of a hundred pairs one
is the same at D = 400 quanta. At the end of a range that accelerometers usually have (4, 8, 16, 32 g) one sample is
enough: a short pulse, seldom sampled, may leave no more.

What was cut off lies between the plateau and the two lines by which the flanks would go on, as long as the peak is
concave: the tangent of a concave curve lies above it.

Where something else knows the change of velocity dv, as fixes before and after an impact do, it tells how much was cut
off, and the plateau only when. The impulses x, an axis each, along d, of what was lost, l = dv less that recorded:

    (D^T S^-1 D + P^-1) (x - b / 2) = D^T S^-1 (l - D b / 2),    l ~ N(D x, S),    x ~ N(b / 2, P = diag(b^2))

with b the impulse of the most that the flanks allow.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.signals import runs

Floats = NDArray[np.float64]

_FEWEST: Final = 2
"""Equal samples that make a plateau."""
_USUAL: Final = STANDARD_GRAVITY * np.array([4.0, 8.0, 16.0, 32.0])
"""m/s^2, ends of ranges of accelerometers."""
_SAME: Final = 1e-6
"""Share of the extreme within which values are the same; arithmetic on equal numbers leaves them equal to rounding."""
_NEAR: Final = 1e-3
"""The same of a range that is given, as data sheets round."""
_STEEP, _STEEP_PAIR = 24.0, 400.0
"""Quanta by which the signal falls beside a clipped plateau, within its length, and beside one of two samples."""


def clipped(y: Floats, full_scale: float | None = None, least: float = 0.0) -> NDArray[np.bool_]:
    """Samples at the end of the sensor's range, by axis.

    y : (n, k), NaN where missing
    full_scale : end of the range, where it is known; None: found from plateaus at the extremes of each axis
    least : extremes of a smaller size are none of a sensor's
    returns : (n, k)
    """
    if full_scale is not None:
        return np.asarray(np.abs(y) >= (1.0 - _NEAR) * full_scale)
    found = np.zeros(y.shape, dtype=bool)
    for axis in range(y.shape[1]):
        for sign in (1.0, -1.0):
            found[:, axis] |= _plateaus(sign * y[:, axis], least)
    return found


def _plateaus(y: Floats, least: float) -> NDArray[np.bool_]:
    """Of one axis (n,), at its largest value."""
    mask = np.zeros(len(y), dtype=bool)
    top = float(np.nanmax(y)) if np.isfinite(y).any() else 0.0
    if top <= least:
        return mask
    fewest = 1 if (np.abs(top / _USUAL - 1.0) < _NEAR).any() else _FEWEST
    long = [run for run in runs(np.nan_to_num(y, nan=-np.inf) >= (1.0 - _SAME) * top) if run[1] - run[0] >= fewest]
    if not long:
        return mask
    step = np.abs(np.diff(y))
    quantum = float(step[step > _SAME * top].min(initial=top))
    for start, stop in long:
        ends = [y[max(2 * start - stop, 0)], y[min(2 * stop - start, len(y)) - 1]]
        steep = _STEEP_PAIR if stop - start == _FEWEST and fewest == _FEWEST else _STEEP
        mask[start:stop] = top - np.nanmin(ends) > steep * quantum
    return mask


def hidden(t_s: Floats, y: Floats, mask: NDArray[np.bool_]) -> Floats:
    """The most that may be missing in clipped samples of one axis, with the sign of what they show; 0 elsewhere.

    Each plateau is continued by the slopes of its flanks: the steeper one of the step into it and the step before.

    t_s : (n,) s; y : (n,); mask : (n,)
    """
    missing = np.zeros_like(y)
    for start, stop in runs(mask):
        inside = slice(start, stop)
        sign = np.sign(y[start]) or 1.0
        lines = []
        if start >= 2:
            rise = float((sign * np.diff(y[start - 2 : start + 1]) / np.diff(t_s[start - 2 : start + 1])).max())
            lines.append(max(rise, 0.0) * (t_s[inside] - t_s[start - 1]) + sign * (y[start - 1] - y[start]))
        if stop + 1 < len(y):
            fall = float((-sign * np.diff(y[stop - 1 : stop + 2]) / np.diff(t_s[stop - 1 : stop + 2])).max())
            lines.append(max(fall, 0.0) * (t_s[stop] - t_s[inside]) + sign * (y[stop] - y[start]))
        if lines:
            missing[inside] = sign * np.maximum(np.min(lines, axis=0), 0.0)
    return missing


def courses(t_s: Floats, most: Floats, mask: NDArray[np.bool_]) -> Floats:
    """Two courses that what was cut off one axis may have taken, each with an impulse of 1 m/s: flat, and as `most`.

    What is concave lies between them. Of several plateaus each has its share of the impulse of `most`.

    t_s : (n,) s; most : (n,), as `hidden` tells it; mask : (n,), with a clipped sample
    returns : (2, n) m/s^2, zero where nothing was clipped
    """
    step_s = np.gradient(t_s)
    size = np.abs(most) if np.abs(most)[mask].any() else mask.astype(float)
    flat, peaked = np.zeros_like(most), np.where(mask, size, 0.0)
    for start, stop in runs(mask):
        inside = slice(start, stop)
        flat[inside] = (peaked * step_s)[inside].sum() / step_s[inside].sum()
    return np.asarray(np.stack([flat, peaked]) / (peaked * step_s).sum())


def impulses(lost: Floats, covariance: Floats, directions: Floats, most: Floats) -> tuple[Floats, Floats]:
    """How much each axis lost by clipping: (k,) m/s, none less than nothing, and its covariance (k, k).

    lost : (3,) m/s, S = covariance : (3, 3), of the change of velocity that was not recorded; directions : (3, k), D
    most : (k,) m/s, b, above zero
    """
    normal = directions.T @ np.linalg.solve(covariance, directions) + np.diag(most**-2.0)
    found = most / 2.0 + np.linalg.solve(
        normal, directions.T @ np.linalg.solve(covariance, lost - directions @ most / 2.0)
    )
    return np.maximum(found, 0.0), np.linalg.inv(normal)
