"""How the errors of the smoother of recon.numerics.constant_velocity at two times belong together.

Smoothed errors are a chain: with the covariances P of all positions and the gains of the smoother,

    cov(x_k, x_k+1) = G_k P_k+1,    G_k = Pf_k F^T (F Pf_k F^T + Q)^-1,    Pf of the positions up to k alone,

and over several steps the gains multiply. The knots are positions at least a second apart, and the last sample.

Reference: Rauch, Tung, Striebel (1965), AIAA J. 3(8), 1445-1450, eq. 3.30.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.constant_velocity import Floats, Fusion, State, smoothed
from recon.numerics.smoothing.soa import mm

SPACING_S = 0.9
"""Positions that follow a knot sooner are no knots: one a second is enough, and clocks jitter."""


class Chain(NamedTuple):
    """The smoother at N knots, on k axes.

    t_s : (N,) s; fix : (N,) number of the last position up to there
    pos : (N, k) m, vel : (N, k) m/s
    covariance : (2, 2, N, k) of both; gains : (2, 2, N-1, k), G
    """

    t_s: Floats
    fix: NDArray[np.intp]
    pos: Floats
    vel: Floats
    covariance: Floats
    gains: Floats


def chain(fusion: Fusion, density: Floats) -> Chain:
    """The smoother as a chain from the first position to the last sample. density : (k,) m/s^1.5"""
    t_s, fix = fusion.fix_s, np.arange(len(fusion.fix_s))
    if fusion.t_s[-1] > t_s[-1]:
        t_s, fix = np.append(t_s, fusion.t_s[-1]), np.append(fix, len(fix) - 1)
    knots = _apart(t_s)
    axes = [_axis(fusion, axis, own, t_s, knots) for axis, own in enumerate(density.tolist())]
    states, gains = [one for one, _ in axes], np.stack([each for _, each in axes], axis=-1)
    p, v, pp, pv, vv = (np.stack(parts, axis=-1) for parts in zip(*states, strict=True))
    return Chain(t_s[knots], fix[knots], p, v, np.array([[pp, pv], [pv, vv]]), gains)


def _apart(t_s: Floats) -> NDArray[np.intp]:
    """Numbers of times, the first and the last among them, that are a second apart."""
    second = np.floor((t_s - t_s[0]) / SPACING_S)
    first = np.flatnonzero(np.diff(second, prepend=-1.0) > 0.0)
    return np.append(first[first < len(t_s) - 1], len(t_s) - 1)


def _axis(fusion: Fusion, axis: int, own: float, t_s: Floats, knots: NDArray[np.intp]) -> tuple[State, Floats]:
    """Smoothed states at the knots, and the gains (2, 2, N-1) between them, of one axis."""
    filtered, updates = fusion.filtered(axis, own)
    last = np.minimum(np.arange(len(t_s)), len(fusion.fix_s) - 1)
    q2, step = own**2 + fusion.held_q2[last], np.diff(t_s)
    state = State(*(part[last] for part in filtered))
    if len(t_s) > len(fusion.fix_s):
        end, (dp, dv) = slice(-1, None), _pushed_to_the_end(fusion, axis)
        moved = State(*(part[end] for part in state)).moved(step[end], dp, dv, q2[end])
        state = State(*(np.append(part[:-1], there) for part, there in zip(state, moved, strict=True)))
    gains = _gains(State(*(part[:-1] for part in state)), step, q2[:-1])
    total = np.repeat(np.eye(2)[:, :, None], len(knots) - 1, axis=2)
    for number in range(int(np.diff(knots).max(initial=0))):
        here = np.flatnonzero(knots[:-1] + number < knots[1:])
        total[..., here] = mm(total[..., here], gains[..., knots[here] + number])
    both = smoothed(state, updates, np.diff(fusion.fix_s), fusion.fix_s, t_s, last)
    return State(*(part[knots] for part in both)), total


def _pushed_to_the_end(fusion: Fusion, axis: int) -> tuple[Floats, Floats]:
    """What the acceleration does from the last position to the last sample: (1,) m and (1,) m/s."""
    start, stop = (type(side)(side.once[-1:], side.twice[-1:]) for side in (fusion.there, fusion.here))
    dp, dv = start.between(stop, fusion.t_s[-1:] - fusion.fix_s[-1:])
    return dp[:, axis], dv[:, axis]


def _gains(state: State, h: Floats, q2: Floats) -> Floats:
    """G from times (n,), whose filtered covariances are given, over h s each: (2, 2, n)."""
    none = np.zeros_like(h)
    ahead = state.moved(h, none, none, q2)
    crossed = np.array([[state.pp + h * state.pv, state.pv], [state.pv + h * state.vv, state.vv]])
    inverse = np.array([[ahead.vv, -ahead.pv], [-ahead.pv, ahead.pp]]) / (ahead.pp * ahead.vv - ahead.pv**2)
    return mm(crossed, inverse)
