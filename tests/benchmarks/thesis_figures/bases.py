"""Chapter 9.1: the parabola through three samples in several bases, their condition and the error of the area."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from recon.numerics.integration import increments
from recon.tables import Array
from thesis_figures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILLION, Number, legend_above_all, panels

STEP_S = 1.0 / 1024.0
"""Multiples of it are exact beside any of the times here, so that only the bases differ."""
OFFSETS_S = 2.0 ** np.arange(0.0, 31.0, 2.0)
"""From the first second of a log to seconds since 1970."""
TRIPLES = 40
SINGULAR = 1e18
"""A condition beyond which a system of doubles has no solution."""


class Basis(NamedTuple):
    """Coordinate x of three times (3,) s, the polynomials in x lowest power first (3, 3), and s for one x."""

    x: Array
    polynomials: Array
    scale_s: float


def _monomial(t_s: Array) -> Basis:
    return Basis(t_s, np.eye(3), 1.0)


def _centred(t_s: Array) -> Basis:
    return Basis(t_s - t_s[1], np.eye(3), 1.0)


def _legendre(t_s: Array) -> Basis:
    half = 0.5 * (t_s[2] - t_s[0])
    x = ((t_s - t_s[0]) - half) / half
    return Basis(x, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.5, 0.0, 1.5]]), half)


def _newton(t_s: Array) -> Basis:
    step = float(t_s[1] - t_s[0])
    x = (t_s - t_s[1]) / step
    return Basis(x, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]]), step)


def _lagrange(t_s: Array) -> Basis:
    half = 0.5 * (t_s[2] - t_s[0])
    x = ((t_s - t_s[0]) - half) / half
    return Basis(x, np.linalg.inv(np.vander(x, 3, increasing=True)).T, half)


BASES: Mapping[str, Callable[[Array], Basis]] = {
    "monomials (thesis)": _monomial,
    "centred monomials": _centred,
    "Legendre": _legendre,
    "Lagrange": _lagrange,
    "centred Newton": _newton,
}
LOOKS = dict(
    zip(
        (*BASES, "divided differences"),
        ((ORANGE, "--"), (PURPLE, "-"), (BLUE, "-"), (GREEN, "-"), (VERMILLION, "-."), (BLACK, ":")),
        strict=True,
    )
)


def bases() -> tuple[Figure, list[Number]]:
    """Condition of the 3 x 3 system of each basis, and relative error of the area, over the time since the origin."""
    figure, (above, below) = panels(2, 1, height=3.8, sharex=True)
    draws = [_triple(seed) for seed in range(TRIPLES)]
    numbers = []
    for name, (color, line) in LOOKS.items():
        condition, error = np.array(
            [np.max([_judged(name, offset + t_s, y) for t_s, y in draws], axis=0) for offset in OFFSETS_S]
        ).T
        if name in BASES:
            above.loglog(OFFSETS_S, condition, line, color=color, lw=1.0, label=name)
            numbers.append(Number(f"condition, {name}, at 2^30 s", float(condition[-1])))
        below.loglog(OFFSETS_S, np.maximum(error, 1e-17), line, color=color, lw=1.0, label=name)
        numbers.append(Number(f"error of the area, {name}, at 2^30 s", float(error[-1])))
    above.set_ylabel("condition")
    below.set(ylabel="error of the area", xlabel="time since the origin / s", ylim=(1e-17, None))
    legend_above_all(figure, below, 2)
    return figure, numbers


def _triple(seed: int) -> tuple[Array, Array]:
    """Three times about 10 ms apart and three values: (3,) s and (3,)."""
    rng = np.random.default_rng(seed)
    return np.concatenate(([0.0], np.cumsum(rng.integers(6, 15, 2)))) * STEP_S, rng.normal(1.0, 0.5, 3)


def _judged(name: str, t_s: Array, y: Array) -> tuple[float, float]:
    """Condition of the basis at these times, and error of the area under the first interval, relative to its size."""
    size = float(np.abs(y).max() * (t_s[1] - t_s[0]))
    if name not in BASES:
        return 1.0, abs(float(increments(t_s, y, "parabola")[0]) - _exact(t_s, y)) / size
    basis = BASES[name](t_s)
    system = np.vander(basis.x, 3, increasing=True) @ basis.polynomials.T
    condition = float(np.linalg.cond(system))
    if condition > SINGULAR:
        return np.inf, np.nan
    coefficients = np.linalg.solve(system, y)
    powers = np.arange(1.0, 4.0)
    primitive = (basis.x[1] ** powers - basis.x[0] ** powers) / powers
    area = basis.scale_s * float(primitive @ (basis.polynomials.T @ coefficients))
    return condition, abs(area - _exact(t_s, y)) / size


def _exact(t_s: Array, y: Array) -> float:
    """The area in whole fractions, rounded once."""
    (a, b, c), (p, q, r) = (list(map(Fraction, values.tolist())) for values in (t_s, y))
    bend = ((r - q) / (c - b) - (q - p) / (b - a)) / (c - a)
    return float((b - a) * (p + q) / 2 - (b - a) ** 3 * bend / 6)
