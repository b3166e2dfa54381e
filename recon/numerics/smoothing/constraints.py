"""The factors of single knots and of what is common: walks, stops, the road, priors.

    biases            x_k+1 = x_k + n,               n ~ walk^2 T
    GNSS drift        c_k+1 = exp(-T / tau) c_k + n,  stationary, first-order Gauss-Markov
    standing          v = 0, and no rotation from knot to knot: the heading holds better than the tilt, which wind
                      and load change. A relation between knots, not "gyro = bias", which would use the gyro twice.
    road              roads are level across on average: vehicle roll - k a_y = 0 for each stretch travelled. The faster
                      a road is, the longer its bends and their banks: 3 m for each km/h of the design speed at least.
                      What has two wheels leans until nothing is felt across: k = -1 / g, at any angle

References
    AASHTO (2018), "A policy on geometric design of highways and streets", 7th ed., section 3.3 (lengths of bends).
    Brown and Hwang (2012), 4th ed., section 4.2 (Gauss-Markov process).
    Cossalter (2006), "Motorcycle dynamics", 2nd ed., section 4.1 (steady turning: the roll angle of equilibrium).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.soa import Floats, cross, mmt, mtv, rotation_log, skew
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    DRIFT,
    GYRO_BIAS,
    MOUNT,
    ROLL,
    ROTATION,
    VELOCITY,
    State,
)

LEANING: Final = -1.0 / 9.80665
"""s^2/m; roll per lateral acceleration in the vehicle's axes of what has two wheels."""
_SURE = 3.0
"""Sigmas."""
_C2 = 9.0
_MOVING = 0.5
"""m/s above which a road is travelled."""


def add_walks(normal: Normal, state: State, length: Floats, gyro_walk: float, accel_walk: float) -> None:
    """Add the random walks of the biases. length : (K,) s; walks in rad/s/sqrt(s) and m/s^2/sqrt(s)."""
    normal.add_walk(GYRO_BIAS, np.diff(state.gyro_bias), gyro_walk**2 * length)
    normal.add_walk(ACCEL_BIAS, np.diff(state.accel_bias), accel_walk**2 * length)


def add_drift(normal: Normal, drift_n: Floats, length: Floats, sigma: Floats, tau: float, begins: bool = True) -> None:
    """Add the Gauss-Markov process of the GNSS position, which begins at the first knot, or before it.

    sigma : (3,) m; tau : s
    """
    kept = np.exp(-length / tau)
    variance = (1.0 - kept**2) * sigma[:, None] ** 2
    normal.add_walk(DRIFT, drift_n[:, 1:] - kept * drift_n[:, :-1], variance, kept)
    if begins:
        normal.add_values([0], DRIFT, drift_n[:, :1].T, 1.0 / sigma[None] ** 2)


def add_standing(
    normal: Normal,
    state: State,
    still_knots: NDArray[np.bool_],
    still_intervals: NDArray[np.bool_],
    length: Floats,
    sigma: float,
    heading_walk: float,
    tilt_walk: float,
    robust: bool,
) -> None:
    """Add zero velocity at still knots and a constant attitude over still intervals.

    still_knots : (N,); still_intervals : (K,); length : (K,) s
    sigma : m/s at one second; heading_walk, tilt_walk : rad/sqrt(s)
    """
    at = np.flatnonzero(still_knots)
    if len(at):
        vel = state.vel_n[:, at].T
        weight = np.full((len(at), 1), 1.0 / sigma**2)
        if robust:
            weight = weight * cauchy_weights((vel**2).sum(axis=1) / sigma**2, _C2)[:, None] ** 2
        normal.add_values(at, VELOCITY, vel, np.broadcast_to(weight, vel.shape))
    k = np.flatnonzero(still_intervals)
    if len(k):
        turn = relative_turn(state, k)
        weight = 1.0 / (np.array([tilt_walk, tilt_walk, heading_walk])[:, None] ** 2 * length[k])
        if robust:
            weight = weight * cauchy_weights((turn**2 * weight).sum(axis=0), _C2)
        tall = np.zeros((len(k), 3, 7))
        root = np.sqrt(weight).T
        i = np.arange(3)
        tall[:, i, i], tall[:, i, i + 3], tall[:, :, 6] = -root, root, -turn.T * root
        normal.add_pairs(ROTATION, slice(0, 0), tall, k)


def relative_turn(state: State, k: NDArray[np.intp]) -> Floats:
    """Rotation from knots k to k + 1, axes n: (3, n) rad."""
    return rotation_log(mmt(state.rot_ns[..., k + 1], state.rot_ns[..., k]))


@dataclass(frozen=True)
class Road:
    """How the vehicle leans at the n knots at which it moves, which is how the road does.

    k : (n,) knots; stretches : (n,) of road that each stands for; lateral : (n,) m/s^2
    up, leaning : (3, n) local up, axes n and vehicle; bank : (n,) rad, of the road
    """

    k: NDArray[np.intp]
    stretches: Floats
    lateral: Floats
    up: Floats
    leaning: Floats
    bank: Floats


def road(
    state: State,
    gravity: GravityField,
    rate_s: Floats,
    still_knots: NDArray[np.bool_],
    length: Floats,
    stretch: tuple[float, float],
) -> Road:
    """The road as a state has it.

    rate_s : (3, N) rad/s at the knots, as logged; stretch : m and s, a stretch is the one plus speed times the other
    """
    speed = np.sqrt((state.vel_n**2).sum(axis=0)) * ~still_knots
    k = np.flatnonzero(speed > _MOVING)
    each = np.zeros(state.knots)
    each[:-1] += 0.5 * length
    each[1:] += 0.5 * length
    pull = gravity.value_n[:, k]
    up = -pull / np.sqrt((pull**2).sum(axis=0))
    leaning = np.einsum("ij,jn->in", state.rot_vs, mtv(state.rot_ns[..., k], up))
    turn_rate = np.einsum("ij,jn->in", state.rot_vs, rate_s[:, k] - state.gyro_bias[:, k])
    lateral = speed[k] * turn_rate[2]
    return Road(
        k=k,
        stretches=speed[k] * each[k] / (stretch[0] + stretch[1] * speed[k]),
        lateral=lateral,
        up=up,
        leaning=leaning,
        bank=leaning[1] - state.common[ROLL] * lateral,
    )


def leans(seen: Road, sigma: float) -> bool:
    """Does the body lean into bends rather than out of them, by what sets two wheels apart from four?

    sigma : rad, of the bank of a stretch
    """
    squares = float((seen.stretches * seen.lateral**2).sum())
    into = float((seen.stretches * seen.lateral * seen.leaning[1]).sum())
    return bool(into - 0.5 * LEANING * squares < -_SURE * sigma * np.sqrt(squares))


def add_road(normal: Normal, state: State, seen: Road, sigma: float) -> None:
    """Add that the road is level across, once per stretch of road. sigma : rad"""
    if not len(seen.k):
        return
    root = np.sqrt(seen.stretches * cauchy_weights((seen.bank / sigma) ** 2, _C2)) / sigma
    to_vehicle = np.einsum("ij,kjn->ikn", state.rot_vs, state.rot_ns[..., seen.k])
    tall = np.zeros((len(seen.k), 1, 8))
    tall[:, 0, :3] = (cross(seen.up, to_vehicle[1]) * -root).T
    tall[:, 0, 3] = -seen.lateral * root
    tall[:, 0, 4:7] = (-skew(seen.leaning)[1] * root).T
    tall[:, 0, 7] = -seen.bank * root
    normal.add_knots(ROTATION, slice(ROLL, MOUNT.stop), tall, seen.k)


def add_value(normal: Normal, knot: int, columns: slice, error: Floats, sigma: Floats | float) -> None:
    """Add a prior of three components of one knot: error (3,), sigma (3,) or one for all."""
    weight = np.broadcast_to(1.0 / np.asarray(sigma) ** 2, (1, 3))
    normal.add_values([knot], columns, error[None], weight)
