"""Kalman filter and smoother of position and velocity, pushed by measured accelerations and held by positions.

On each axis, with x = (p, v), acceleration a(t) as the control and w white noise of density q on it,

    dp/dt = v,   dv/dt = a + w            x_k+1 = F x_k + (dp, dv),   F = [1 h; 0 1],   Q = q^2 [h^3/3 h^2/2; h^2/2 h]
    z_k = p_k + r_k                       e = z - p,   s = P_pp + R,   K = (P_pp, P_pv) / s

An error s of the positions that lasts for a time tau, as a Gauss-Markov process, is none of this model: estimates
follow it, so that it adds s^2 to the variance of p, and its change looks like velocity. That is white of density
2 s^2 / tau for all that changes sooner, and of it an even filter with T^2 = P_pp / P_vv passes s^2 / (sqrt(2) tau T),
being of second order with a damping of 1 / sqrt(2), an even smoother, of gain 1 / (1 + (w T)^4), three quarters as
much.

What the acceleration does between two times, dp and dv, follows from its integrals since the first sample, which are
worked out once for all samples: so the filter steps from position to position, whatever the rate of the accelerations,
and the estimate at every sample is the one closed step from the position before it. The axes have nothing in common.

A position that lies further than `gate` sigmas from what was predicted is given the variance with which it would lie
just there: an outlier pulls little, the less the further off it is. Where they all lie so far off for longer than
`patience`, it is the filter that went astray, and it believes them again.

References
    Kalman (1960), J. Basic Engineering 82(1), 35-45. Rauch, Tung, Striebel (1965), AIAA J. 3(8), 1445-1450: the
    smoother. Bierman (1973), Int. J. Control 18(1), 65-75: the same without inverses, after Bryson and Frazier.
    Schweppe (1965), IEEE Trans. Information Theory 11(1), 61-70: the likelihood of innovations.
    Bar-Shalom, Li, Kirubarajan (2001), "Estimation with applications to tracking and navigation", 6.2.2: Q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.constant_velocity_pushes import Pushes, pushes

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

MANY: Final = 1000
"""Positions that tell the density of the noise well enough."""
FIRST_SPEED: Final = 30.0
"""m/s, sigma of the velocity at the first position."""


@dataclass(frozen=True)
class Motion:
    """Estimates at n times on k axes: pos (n, k) m, vel (n, k) m/s, and their variances."""

    pos: Floats
    vel: Floats
    pos_var: Floats
    vel_var: Floats


def drift_variance(pos_var: Floats, vel_var: Floats, lasting: Floats, tau_s: float, *, smooth: bool) -> Floats:
    """What errors of positions that last for minutes add to the variance of a velocity: (n, k) m^2/s^2.

    pos_var, vel_var : (n, k) m^2, m^2/s^2, of the model; lasting : (n, k) m, their sigma; tau_s : s
    """
    passed = (0.75 if smooth else 1.0) / np.sqrt(2.0)
    return np.asarray(passed * lasting**2 / tau_s * np.sqrt(vel_var / pos_var))


@dataclass(frozen=True)
class Innovations:
    """What each position but the first said less what was predicted: (m-1, k) m, its variance, the weight it got."""

    value: Floats
    variance: Floats
    weight: Floats


class State(NamedTuple):
    """State and covariance at some times, each (n,)."""

    p: Floats
    v: Floats
    pp: Floats
    pv: Floats
    vv: Floats

    def moved(self, h: Floats, dp: Floats, dv: Floats, q2: Floats) -> State:
        """After h s, pushed by dp m and dv m/s."""
        pv = self.pv + h * self.vv
        return State(
            self.p + h * self.v + dp,
            self.v + dv,
            self.pp + h * (self.pv + pv) + q2 * h**3 / 3.0,
            pv + q2 * h**2 / 2.0,
            self.vv + q2 * h,
        )


class Updates(NamedTuple):
    """What positions did on one axis, each (m-1,): innovation, its variance as told and as believed, gains."""

    innovation: Floats
    told_var: Floats
    weight: Floats
    variance: Floats
    gain_p: Floats
    gain_v: Floats


@dataclass(frozen=True)
class Fusion:
    """Accelerations at n samples and positions at m times, made ready: what the one does between the others.

    t_s : (n,) s; fix_s : (m,) s; fix : (m, k) m; fix_var : (m, k) m^2, white
    here, there : integrals of the acceleration at the samples and at the positions
    held_q2 : (m,) m^2/s^3, what steps without acceleration add to Q, from each position to the next
    trust : gate in sigmas, patience in s
    """

    t_s: Floats
    fix_s: Floats
    fix: Floats
    fix_var: Floats
    here: Pushes
    there: Pushes
    held_q2: Floats
    trust: tuple[float, float]

    @classmethod
    def of(
        cls,
        t_s: Floats,
        acc: Floats,
        held: NDArray[np.bool_],
        fix_s: Floats,
        fix: Floats,
        fix_var: Floats,
        *,
        held_density: float,
        gate: float,
        patience: float,
    ) -> Fusion:
        """Make ready.

        t_s : (n,) s, strictly increasing, n > 1; acc : (n, k) m/s^2; held : (n-1,) steps of which it tells nothing
        fix_s : (m,) s, strictly increasing, inside of t_s, m > 0; fix : (m, k) m; fix_var : (m, k) m^2, above 0
        held_density : m/s^1.5, of the noise in steps that are held
        """
        silent = np.append(0.0, np.cumsum(np.where(held, np.diff(t_s), 0.0)))
        edges = np.append(fix_s, t_s[-1])
        step = np.diff(edges)
        share = np.diff(np.interp(edges, t_s, silent)) / np.where(step > 0.0, step, 1.0)
        here, there = pushes(t_s, acc, held, fix_s)
        return cls(t_s, fix_s, fix, fix_var, here, there, share * held_density**2, (gate, patience))

    def estimate(self, density: Floats, *, smooth: bool) -> tuple[Motion, Innovations]:
        """Position and velocity at the samples from the first position on, and the innovations.

        density : (k,) m/s^1.5, of the white noise on the acceleration
        smooth : each estimate from all positions, not only from those before
        returns : Motion at the samples not before fix_s[0], and Innovations
        """
        rows = np.arange(np.searchsorted(self.t_s, self.fix_s[0]), len(self.t_s))
        last = np.searchsorted(self.fix_s, self.t_s[rows], side="right") - 1
        until_s = self.t_s[rows] - self.fix_s[last]
        start, stop = (Pushes(*(part[at] for part in side)) for side, at in ((self.there, last), (self.here, rows)))
        moved_p, moved_v = start.between(stop, until_s)
        found: list[Floats] = [np.empty(moved_p.shape) for _ in range(4)]
        told: list[Floats] = [np.empty((len(self.fix) - 1, self.fix.shape[1])) for _ in range(3)]
        for axis, own in enumerate(density.tolist()):
            filtered, updates = self.filtered(axis, own)
            state = State(*(part[last] for part in filtered))
            q2 = own**2 + self.held_q2[last]
            state = state.moved(until_s, moved_p[:, axis], moved_v[:, axis], q2)
            if smooth:
                state = smoothed(state, updates, np.diff(self.fix_s), self.fix_s, self.t_s[rows], last)
            for column, values in zip(found, (state.p, state.v, state.pp, state.vv), strict=True):
                column[:, axis] = values
            for column, values in zip(told, (updates.innovation, updates.told_var, updates.weight), strict=True):
                column[:, axis] = values
        return Motion(*found), Innovations(*told)

    def likeliest(self, axes: Sequence[int], densities: Sequence[float]) -> float:
        """The density, m/s^1.5, under which the innovations on some axes are the most likely.

        It is sought among `densities`, falling by one factor: the first that the next one does not better, for where a
        density is far too small, all innovations lie beyond the gate and count as much as one there, which would look
        likely again. A parabola through it and its neighbours tells the top. Of long records the middle suffices.
        """
        middle = max(0, (len(self.fix) - MANY) // 2)
        part = self._only(slice(middle, middle + MANY))
        costs: list[float] = []
        for density in densities:
            costs.append(sum(part._cost(axis, density) for axis in axes))
            if len(costs) > 1 and costs[-1] > costs[-2]:
                break
        best = int(np.argmin(costs))
        if not 0 < best < len(costs) - 1:
            return densities[best]
        before, least, after = costs[best - 1 : best + 2]
        shift = 0.5 * (before - after) / (before - 2.0 * least + after)
        return float(densities[best] * (densities[best + 1] / densities[best]) ** shift)

    def _only(self, rows: slice) -> Fusion:
        there = Pushes(*(side[rows] for side in self.there))
        parts = {name: getattr(self, name)[rows] for name in ("fix_s", "fix", "fix_var", "held_q2")}
        return replace(self, there=there, **parts)

    def _cost(self, axis: int, density: float) -> float:
        """Twice the negative logarithm of the likelihood, but for a constant. Schweppe 1965."""
        _, updates = self.filtered(axis, density)
        squares = updates.innovation**2 / updates.told_var
        return float((np.log(updates.told_var) + np.minimum(squares, self.trust[0] ** 2)).sum())

    def filtered(self, axis: int, density: float) -> tuple[State, Updates]:
        """On one axis: the state after each position (m,), and what all but the first did (m-1,)."""
        step = np.diff(self.fix_s)
        start, stop = (Pushes(*(part[at] for part in self.there)) for at in (slice(-1), slice(1, None)))
        dp, dv = start.between(stop, step)
        fixes = self.fix[:, axis], self.fix_var[:, axis]
        return _forward(step, dp[:, axis], dv[:, axis], *fixes, density**2 + self.held_q2, self.trust)


def _forward(
    step: Floats, dp: Floats, dv: Floats, fix: Floats, fix_var: Floats, q2: Floats, trust: tuple[float, float]
) -> tuple[State, Updates]:
    """One axis: the state after each position (m,), and what all but the first did (m-1,). trust : gate and patience.

    Plain numbers: arrays of one or two take ten times as long.
    """
    (gate, patience), doubted_s = trust, 0.0
    p, v, pp, pv, vv = float(fix[0]), 0.0, float(fix_var[0]), 0.0, FIRST_SPEED**2
    after, updates = [(p, v, pp, pv, vv)], []
    noise = (q2[:-1] * step**3 / 3.0, q2[:-1] * step**2 / 2.0, q2[:-1] * step)
    columns: Any = (part.tolist() for part in (step, dp, dv, *noise, fix[1:], fix_var[1:]))
    for h, push_p, push_v, q_pp, q_pv, q_vv, z, r in zip(*columns, strict=True):
        p, v = p + h * v + push_p, v + push_v
        moved = pv + h * vv
        pp, pv, vv = pp + h * (pv + moved) + q_pp, moved + q_pv, vv + q_vv
        error = z - p
        far = (error / gate) ** 2 - pp
        doubted_s = doubted_s + h if far > r else 0.0
        believed = far if 0.0 < doubted_s <= patience else r
        variance = pp + believed
        gain_p, gain_v = pp / variance, pv / variance
        updates.append((error, pp + r, r / believed, variance, gain_p, gain_v))
        p, v = p + gain_p * error, v + gain_v * error
        pp, pv, vv = (1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv
        after.append((p, v, pp, pv, vv))
    return State(*np.array(after).T), Updates(*np.array(updates).reshape(-1, len(Updates._fields)).T)


def smoothed(state: State, updates: Updates, step: Floats, fix_s: Floats, t_s: Floats, last: Rows) -> State:
    """The estimates at the samples t_s (n,), corrected by what the positions after `last` (n,), before each, say.

    x + P F^T y,    P - P F^T Y F P,    F to the next position, of which y and Y tell and all that follow it
    """
    inside = slice(0, int(np.searchsorted(last, len(step))))
    y_p, y_v, y_pp, y_pv, y_vv = (part[last[inside]] for part in _backward(updates, step))
    p, v, pp, pv, vv = (part[inside] for part in state)
    h = fix_s[last[inside] + 1] - t_s[inside]
    ahead_p, ahead_v = pp + h * pv, pv + h * vv
    corrected = State(
        p + ahead_p * y_p + pv * y_v,
        v + ahead_v * y_p + vv * y_v,
        pp - ahead_p * (ahead_p * y_pp + 2.0 * pv * y_pv) - pv * pv * y_vv,
        pv - ahead_p * (ahead_v * y_pp + vv * y_pv) - pv * (ahead_v * y_pv + vv * y_vv),
        vv - ahead_v * (ahead_v * y_pp + 2.0 * vv * y_pv) - vv * vv * y_vv,
    )
    return State(*(np.append(part, rest[inside.stop :]) for part, rest in zip(corrected, state, strict=True)))


def _backward(updates: Updates, step: Floats) -> Floats:
    """What each position but the first and all later ones tell of the state just before it: y and Y, (5, m-1).

    With A = I - K H and F to the position after it, from the last one on: y = A^T F^T y_next + H^T e / s,
    Y = A^T F^T Y_next F A + H^T H / s. Bierman 1973; nothing is inverted.
    """
    y_p, y_v, y_pp, y_pv, y_vv = 0.0, 0.0, 0.0, 0.0, 0.0
    columns: Any = (
        part[::-1].tolist()
        for part in (updates.innovation, updates.variance, updates.gain_p, updates.gain_v, np.append(step, 0.0)[1:])
    )
    out = []
    for error, variance, gain_p, gain_v, h in zip(*columns, strict=True):
        y_v += h * y_p
        y_vv += h * (2.0 * y_pv + h * y_pp)
        y_pv += h * y_pp
        kept = 1.0 - gain_p
        y_p = kept * y_p - gain_v * y_v + error / variance
        y_pp = kept * (kept * y_pp - 2.0 * gain_v * y_pv) + gain_v * gain_v * y_vv + 1.0 / variance
        y_pv = kept * y_pv - gain_v * y_vv
        out.append((y_p, y_v, y_pp, y_pv, y_vv))
    return np.array(out).reshape(-1, 5).T[:, ::-1]
