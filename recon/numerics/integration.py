"""Quadrature of irregularly sampled data.

With h the step of an interval and y'' the second divided difference of a parabola through three samples, the area
under that parabola between neighbours is the trapezoid less a correction,

    area = h (y_k + y_k+1) / 2 - h^3 y''[k, k+1, k+2] / 6,

the same whichever third sample the parabola passes. It needs differences only, so it keeps its precision at large
times, where the 3x3 system of the thesis (eq. of section 2.1) is singular to rounding.

An interval much longer than the one beside it, r = h / g, is a gap, into which that parabola extrapolates a curvature
seen over g alone. The weights of its three samples are h (1/2 - r / (6 (1 + r))), h (1/2 + r / 6) and
-h r^2 / (6 (1 + r)), in size h (1 + r^2 / (3 (1 + r))) together: an error of the samples is amplified without bound.
So the correction is made only while they stay under 2 h, r < 3.8, and a longer gap is bridged by the trapezoid.

References
    Thesis, section 2.1 and chapter 6 (PaIS, parabola integrator for irregularly spaced data).
    Reed (2014), "Numerically integrating irregularly-spaced (x, y) data", The Mathematics Enthusiast 11(3), 643-648.
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Rule: TypeAlias = Literal["rectangle", "trapezoid", "parabola", "mean_parabola"]
RULES: tuple[Rule, ...] = get_args(Rule)


def increments(t_s: ArrayLike, y: ArrayLike, rule: Rule) -> Floats:
    """Area under y in each interval between samples.

    Rules: "rectangle" holds the left value (order 1); "trapezoid" (order 2); "parabola" is PaIS, interval k by the
    parabola through samples k, k+1, k+2 and the last by that through the last three (order 3); "mean_parabola" takes
    the mean of the two parabolas that cover the interval, of the only one at the ends. Two samples leave a trapezoid,
    and so does a parabola over a gap, an interval 3.8 times as long as the one beside it.

    t_s : (n,) s, strictly increasing
    y : (n,) or (n, k)
    returns : (n-1,) or (n-1, k), unit of y times s; empty for fewer than two samples
    raises : ValueError if rule is not in RULES, if t_s does not strictly increase or does not match y
    """
    t_s, y = np.asarray(t_s, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if rule not in RULES:
        raise ValueError(f"no integration rule {rule!r}; there are {', '.join(RULES)}")
    if t_s.shape != y.shape[:1]:
        raise ValueError(f"times of shape {t_s.shape} do not match values of shape {y.shape}")
    step = np.diff(t_s).reshape((-1,) + (1,) * (y.ndim - 1))
    if not np.all(step > 0.0):
        raise ValueError("times must strictly increase")
    if rule == "rectangle":
        return np.asarray(step * y[:-1])
    area = np.asarray(step * (y[:-1] + y[1:]) / 2.0)
    if rule == "trapezoid" or len(t_s) < 3:
        return area
    return np.asarray(area - step**3 * _curvature(step, y, rule) / 6.0)


def cumulative(t_s: ArrayLike, y: ArrayLike, rule: Rule, held: NDArray[np.bool_] | None = None) -> Floats:
    """Integral of y from the first sample to each; arguments and errors as `increments`.

    held : (n-1,) intervals of which y tells nothing: the integral does not change in them
    returns : shape of y, unit of y times s, beginning with 0
    """
    area = increments(t_s, y, rule)
    if held is not None:
        area[held] = 0.0
    result = np.zeros_like(np.asarray(y, dtype=np.float64))
    np.cumsum(area, axis=0, out=result[1:])
    return result


def _curvature(step: Floats, y: Floats, rule: Rule) -> Floats:
    """Second divided difference to use in each interval, zero in gaps; shape of step and y's columns."""
    slope = np.diff(y, axis=0) / step
    inner = np.diff(slope, axis=0) / (step[:-1] + step[1:])
    ahead = np.concatenate((inner, inner[-1:]))
    near_ahead = _near(step, np.concatenate((step[1:], step[-2:-1])))
    if rule == "parabola":
        return np.asarray(near_ahead * ahead)
    behind = np.concatenate((inner[:1], inner))
    near_behind = _near(step, np.concatenate((step[1:2], step[:-1])))
    parabolas = np.maximum(near_ahead.astype(np.float64) + near_behind, 1.0)
    return np.asarray((near_ahead * ahead + near_behind * behind) / parabolas)


def _near(step: Floats, beside: Floats) -> NDArray[np.bool_]:
    """Intervals short enough beside their neighbour: the parabola at most doubles an error of its samples."""
    return np.asarray(step**2 <= 3.0 * beside * (beside + step))
