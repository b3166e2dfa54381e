"""Quadrature of irregularly sampled data.

With h the step of an interval and y'' the second divided difference of a parabola through three samples, the area
under that parabola between neighbours is the trapezoid less a correction,

    area = h (y_k + y_k+1) / 2 - h^3 y''[k, k+1, k+2] / 6,

the same whichever third sample the parabola passes. It needs differences only, so it keeps its precision at large
times, where the 3x3 system of the thesis (eq. of section 2.1) is singular to rounding.

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
    the mean of the two parabolas that cover the interval, of the only one at the ends. Two samples leave a trapezoid.

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


def cumulative(t_s: ArrayLike, y: ArrayLike, rule: Rule) -> Floats:
    """Integral of y from the first sample to each; arguments and errors as `increments`.

    returns : shape of y, unit of y times s, beginning with 0
    """
    area = increments(t_s, y, rule)
    result = np.zeros_like(np.asarray(y, dtype=np.float64))
    np.cumsum(area, axis=0, out=result[1:])
    return result


def _curvature(step: Floats, y: Floats, rule: Rule) -> Floats:
    """Second divided difference to use in each interval, shape of step and y's columns."""
    slope = np.diff(y, axis=0) / step
    inner = np.diff(slope, axis=0) / (step[:-1] + step[1:])
    ahead = np.concatenate((inner, inner[-1:]))
    if rule == "parabola":
        return ahead
    behind = np.concatenate((inner[:1], inner))
    return np.asarray((ahead + behind) / 2.0)
