"""Impacts from aside: what a collision adds to a motion that wheels alone could not make.

    v_n += R_z(yaw) dv (S((t - t0) / T) - S((t - t0 - T) / D)),    yaw += spin S((t - t0) / W)

with S the cycloidal law of `drive`: the vehicle is pushed by dv within T, as a haversine pulse, its tyres skid until
the push is used up, D later, and it spins meanwhile. All derivatives are closed formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recon.numerics.motion.truth import Motion, MotionTruth
from recon.numerics.rotation import Floats, conjugate, from_rotvec, multiply, rotate, to_euler

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Impact:
    """One push.

    start_s, length_s : s, of the pulse;  delta_v : (2,) m/s, forward and left of the vehicle when it begins
    skid_s : s, in which the tyres take it off again;  spin : rad, by which the vehicle turns;  spin_s : s
    """

    start_s: float
    length_s: float
    delta_v: tuple[float, float]
    skid_s: float
    spin: float = 0.0
    spin_s: float = 1.0


@dataclass(frozen=True)
class Struck:
    """A motion with impacts on top."""

    motion: Motion
    impacts: Sequence[Impact]

    def at(self, t_s: Floats) -> MotionTruth:
        """Truth at the times (n,) s, in any order."""
        plain = self.motion.at(t_s)
        pos_n, vel_n, acc_n = plain.pos_n.copy(), plain.vel_n.copy(), plain.acc_n.copy()
        yaw, yaw_rate = np.zeros_like(t_s), np.zeros_like(t_s)
        for impact in self.impacts:
            push_n = self._push(impact)
            for start_s, length_s, sign in (
                (impact.start_s, impact.length_s, 1.0),
                (impact.start_s + impact.length_s, impact.skid_s, -1.0),
            ):
                way, speed, accel = _eased(t_s, start_s, length_s)
                pos_n += sign * way[:, None] * push_n
                vel_n += sign * speed[:, None] * push_n
                acc_n += sign * accel[:, None] * push_n
            _, turned, rate = _eased(t_s, impact.start_s, impact.spin_s)
            yaw += impact.spin * turned
            yaw_rate += impact.spin * rate
        q_nv = multiply(from_rotvec(yaw[:, None] * _UP), plain.q_nv)
        gyro_v = plain.gyro_v + rotate(conjugate(q_nv), yaw_rate[:, None] * _UP)
        return MotionTruth(t_s, pos_n, vel_n, acc_n, q_nv, gyro_v)

    def _push(self, impact: Impact) -> Floats:
        """The change of velocity, local: (3,) m/s."""
        heading = float(to_euler(self.motion.at(np.array([impact.start_s])).q_nv)[0][0])
        ahead, left = impact.delta_v
        cos, sin = np.cos(heading), np.sin(heading)
        return np.array([ahead * cos - left * sin, ahead * sin + left * cos, 0.0])


def _eased(t_s: Floats, start_s: float, length_s: float) -> tuple[Floats, Floats, Floats]:
    """Integral, value and rate of the cycloidal law from 0 to 1: (n,) s, 1, 1/s."""
    u = (t_s - start_s) / length_s
    x = np.clip(u, 0.0, 1.0)
    turn = 2.0 * np.pi * x
    value = x - np.sin(turn) / (2.0 * np.pi)
    integral = x**2 / 2.0 - np.sin(np.pi * x) ** 2 / (2.0 * np.pi**2) + np.maximum(u - 1.0, 0.0)
    return length_s * integral, value, 2.0 * np.sin(np.pi * x) ** 2 / length_s
