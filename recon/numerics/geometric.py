"""Integrators that keep the geometry of a motion: Magnus for the attitude, Stoermer-Verlet for the position.

Attitude: q' = q (x) omega / 2 is solved over one step by the exponential of the first two terms of the Magnus series,

    phi = h / 2 (omega_1 + omega_2) + sqrt(3) / 12 h^2 omega_1 x omega_2

with the rates at the two Gauss points of the step. It stays a rotation whatever the step, and is of order 4 where the
rates are. Those come from the cubic through the four samples about the step.

Position, in kicks and drifts: v_k+1/2 = v_k + h/2 a_k,  p_k+1 = p_k + h v_k+1/2,  v_k+1 = v_k+1/2 + h/2 a_k+1. Order 2.
Where the force follows from the position it is symplectic, and the error of the energy stays bounded. An accelerometer
gives the force as a function of time instead: then it is a rule of quadrature like others.

References
    Iserles, Munthe-Kaas, Norsett, Zanna (2000), "Lie-group methods", Acta Numerica 9, 215-365.
    Hairer, Lubich, Wanner (2003), "Geometric numerical integration illustrated by the Stoermer-Verlet method",
    Acta Numerica 12, 399-450.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.integration import cumulative

Floats = NDArray[np.float64]

_GAUSS: Final = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)
_NODES: Final = 4
_AMPLIFIED: Final = 2.0
"""A cubic may make an error of its samples so many times larger; beside a gap it is replaced by a straight line."""


def magnus_turns(t_s: Floats, gyro_b: Floats) -> Floats:
    """Rotation vector of each step between samples: (n-1, 3) rad.

    t_s : (n,) s, strictly increasing; gyro_b : (n, 3) rad/s, body
    """
    if len(t_s) < 2:
        return np.zeros((0, 3))
    first, second = (_rate_at(t_s, gyro_b, share) for share in _GAUSS)
    step = np.diff(t_s)[:, None]
    return np.asarray(0.5 * step * (first + second) + np.sqrt(3.0) / 12.0 * step**2 * np.cross(first, second))


def verlet_velocity(t_s: Floats, acc_n: Floats, held: NDArray[np.bool_]) -> Floats:
    """Change of velocity since the first sample: (n, 3) m/s.

    acc_n : (n, 3) m/s^2, local; held : (n-1,) bool, steps without a kick
    """
    return cumulative(t_s, acc_n, "trapezoid", held=held)


def verlet_position(t_s: Floats, vel_n: Floats, acc_n: Floats, held: NDArray[np.bool_]) -> Floats:
    """Change of position since the first sample: (n, 3) m.

    vel_n : (n, 3) m/s, of `verlet_velocity` and any constant; acc_n, held : as there
    """
    position = np.zeros_like(vel_n)
    step = np.diff(t_s)[:, None]
    kick = np.where(held[:, None], 0.0, 0.5 * step * acc_n[:-1])
    np.cumsum(step * (vel_n[:-1] + kick), axis=0, out=position[1:])
    return position


def _rate_at(t_s: Floats, gyro_b: Floats, share: float) -> Floats:
    """Rate at a share of each step: (n-1, 3), by the cubic through the samples about it."""
    count = len(t_s)
    nodes = min(_NODES, count)
    rows = np.clip(np.arange(count - 1) - 1, 0, count - nodes)[:, None] + np.arange(nodes)
    wanted = t_s[:-1] + share * np.diff(t_s)
    weights = np.ones((count - 1, nodes))
    for own in range(nodes):
        for other in range(nodes):
            if other != own:
                near, far = t_s[rows[:, own]], t_s[rows[:, other]]
                weights[:, own] *= (wanted - far) / (near - far)
    cubic = np.einsum("kn,kni->ki", weights, gyro_b[rows])
    line = gyro_b[:-1] + share * np.diff(gyro_b, axis=0)
    return np.where(np.abs(weights).sum(axis=1, keepdims=True) <= _AMPLIFIED, cubic, line)
