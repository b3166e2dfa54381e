"""The trajectory at the rate of the IMU: nothing is integrated again.

The increments stored when they were summed up are set on the smoothed knots and the misclosure is spread as in
`epochs`. Rotation, velocity and position are polynomials in u of the interval times the stored increments; what a
change of bias would add inside an interval is a correction of its ends, which the spread already makes. Attitude and
velocity come out in the local level frame of the place, which turns by 0.01 degrees per kilometre.

    q(u) = exp(u theta) q_k dq(u) ~ (1 + u theta / 2 - u^2 |theta|^2 / 8) q_k dq(u)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing.earth import level_rotation
from recon.numerics.smoothing.epochs import Misclosure
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats, cross, matrix_to_quat, mm, mmt, mv, quat_multiply, rotation_log
from recon.numerics.smoothing.state import State

_CHUNK = 128
"""Intervals worked on at once, so that they stay in the cache."""


@dataclass(frozen=True)
class Motion:
    """At the n + 1 samples: q_lv (4, n+1) vehicle to local level, vel_l (3, n+1) m/s, pos_n (3, n+1) m, of the IMU.

    u : (n,) share of the interval, of all but the last sample
    """

    q_lv: Floats
    vel_l: Floats
    pos_n: Floats
    u: Floats


def full_rate(state: State, ends: Misclosure, increments: Increments, samples: Samples, anchor: Anchor) -> Motion:
    """At every sample: n + 1 = K m + 1, the last at the last knot."""
    m, count = samples.per_interval, samples.intervals
    knots, length = samples.knot_times, ends.duration
    rot_ln = level_rotation(state.pos_n, anchor)
    level = rot_ln[..., :-1]
    tilt = rotation_log(mmt(rot_ln[..., 1:], level))
    q = _turning(matrix_to_quat(mm(level, state.rot_ns[..., :-1])), mv(level, ends.turn_n) + tilt)
    vel = state.vel_n[:, :-1]
    pull = ends.gravity_n * length
    vel_l = [
        mv(level, vel),
        mv(level, pull + 2.0 * ends.square / length) + cross(tilt, mv(level, vel)),
        mv(level, 3.0 * ends.cube / length),
    ]
    pos_n = [state.pos_n[:, :-1], vel * length, 0.5 * pull * length + ends.square, ends.cube]
    to_level, to_n = mm(level, state.rot_ns[..., :-1]), state.rot_ns[..., :-1]
    q_sv = matrix_to_quat(state.rot_vs.T[..., None])
    n = count * m
    out = Motion(np.empty((4, n + 1)), np.empty((3, n + 1)), np.empty((3, n + 1)), np.empty(n))
    last = rot_ln[..., -1]
    out.q_lv[:, n] = matrix_to_quat((last @ state.rot_ns[..., -1] @ state.rot_vs.T)[..., None])[:, 0]
    out.vel_l[:, n], out.pos_n[:, n] = last @ state.vel_n[:, -1], state.pos_n[:, -1]
    for start in range(0, count, _CHUNK):
        k = slice(start, min(count, start + _CHUNK))
        i = slice(k.start * m, k.stop * m)
        shape = (k.stop - k.start, m)
        u = (samples.t_s[i].reshape(shape) - knots[k, None]) / length[k, None]
        out.u[i] = u.reshape(-1)
        q_ls = quat_multiply(_horner(q, k, u), increments.q[:, i].reshape(4, *shape)).reshape(4, -1)
        out.q_lv[:, i] = quat_multiply(q_ls, q_sv)
        vel_k = np.einsum("ijk,jkm->ikm", to_level[..., k], increments.dv[:, i].reshape(3, *shape))
        out.vel_l[:, i] = (_horner(vel_l, k, u) + vel_k).reshape(3, -1)
        pos_k = np.einsum("ijk,jkm->ikm", to_n[..., k], increments.dp[:, i].reshape(3, *shape))
        out.pos_n[:, i] = (_horner(pos_n, k, u) + pos_k).reshape(3, -1)
    return out


def _turning(q: Floats, turn: Floats) -> list[Floats]:
    """Coefficients of 1, u, u^2 of exp(u turn) q: (4, K) each."""
    half = np.concatenate([np.zeros_like(turn[:1]), 0.5 * turn])
    return [q, quat_multiply(half, q), -0.5 * (half**2).sum(axis=0) * q]


def _horner(coefficients: list[Floats], k: slice, u: Floats) -> Floats:
    """Polynomials in u (n, m) of the intervals k: (c, n, m)."""
    total = coefficients[-1][:, k, None] * u
    for coefficient in coefficients[-2:0:-1]:
        total += coefficient[:, k, None]
        total *= u
    total += coefficients[0][:, k, None]
    return np.asarray(total)


def between_knots(values: Floats, u: Floats, per_interval: int) -> Floats:
    """Values at the knots (c, K + 1), interpolated linearly at the samples: (c, K m + 1)."""
    intervals = values.shape[1] - 1
    out = np.empty((len(values), len(u) + 1))
    steps = out[:, :-1].reshape(len(values), intervals, per_interval)
    np.multiply(np.diff(values)[:, :, None], u.reshape(intervals, per_interval), out=steps)
    steps += values[:, :-1, None]
    out[:, -1] = values[:, -1]
    return out
