"""Times between the knots at which something is measured, and the state there.

Every GNSS fix has its own time; where fixes are rare a grid of seconds carries the constraints of the vehicle. Inside
an interval the state follows the strap-down increments from the knot before, plus the misclosure at the knot behind,
spread so that both ends fit: the rotation linearly, the position by the cubic of Hermite that matches its error and
that of the velocity. With u = (t - t_k) / T,

    R(u) = exp(u theta) R_k dR(u),    p(u) = p_k + v_k u T + a (u T)^2 / 2 + R_k dP(u) + (e_p - b) u^2 + b u^3,

theta, e_v, e_p the misclosures, b = e_v T - 2 e_p, a gravity less Coriolis. Whatever a change of bias or tilt does
inside the interval is absorbed by the ends, so the state at u depends on both knots through eight scalars only.

References
    Forster, Carlone, Dellaert, Scaramuzza (2017), "On-manifold preintegration for real-time visual-inertial odometry",
    IEEE T-RO 33(1), eqs. 32 to 38 (increments).
    Groves (2013), 2nd ed., section 5.4 (gravity and Coriolis in Earth-fixed axes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.samples import LONG_GAP_S, Samples
from recon.numerics.smoothing.soa import (
    Floats,
    cross,
    mm,
    mtm,
    mv,
    quat_exp,
    quat_multiply,
    quat_to_matrix,
    rotation_exp,
    rotation_log,
)
from recon.numerics.smoothing.state import State
from recon.numerics.smoothing.stops import Blocks

EPOCH_S: Final = 1.0
"""s between epochs where no fix is."""
_NEAR: Final = (0.15, 0.22, 0.26, 0.22, 0.15)
"""Weights of the 0.1 s means around an epoch: a bell of about 0.1 s, for levers and what lags multiply."""


@dataclass(frozen=True)
class Epochs:
    """Slots for S epochs in each of K intervals, E = K S in all; those not `live` are padding.

    t_s : (E,) s; interval : (E,) knot before; fix : (E,) index of the fix, -1 for none
    seconds : (E,) s of the drive that an epoch stands for, 1 at most
    gyro_s, accel_s : (3, E) as logged, mean of about 0.1 s around
    calm : as logged, against the second around
    slots : S; middle_s : s, of the drive
    """

    t_s: Floats
    interval: NDArray[np.intp]
    fix: NDArray[np.intp]
    live: NDArray[np.bool_]
    seconds: Floats
    gyro_s: Floats
    accel_s: Floats
    calm: Calm
    slots: int
    middle_s: float = 0.0

    @property
    def since_s(self) -> Floats:
        """Times since the middle of the drive: (E,) s."""
        return self.t_s - self.middle_s


@dataclass(frozen=True)
class Calm:
    """What moves about its mean within a second, as a body does on its springs: (3, E), sensor.

    rate rad/s, force m/s^2 : means of the second; turned rad, pushed m/s : integrals of both less their means
    """

    rate: Floats
    force: Floats
    turned: Floats
    pushed: Floats

    @classmethod
    def around(cls, blocks: Blocks, t_s: Floats) -> Calm:
        """Of the second around each time; nothing moves where the record begins or ends within it."""
        edges = np.concatenate([blocks.t_s[:1], 0.5 * (blocks.t_s[1:] + blocks.t_s[:-1]), blocks.t_s[-1:]])
        whole = (t_s - 0.5 * EPOCH_S >= edges[0]) & (t_s + 0.5 * EPOCH_S <= edges[-1])
        ends = t_s + np.where(whole, 0.5 * EPOCH_S, 0.0) * np.array([[-1.0], [1.0]])

        def means(rows: Floats) -> Floats:
            """Of what has such integrals up to the edges."""
            return np.stack([np.diff(np.interp(ends, edges, row), axis=0)[0] for row in rows]) / EPOCH_S

        def of(logged: Floats) -> tuple[Floats, Floats]:
            once = _summed(logged, edges)
            twice = _summed(0.5 * (once[:, 1:] + once[:, :-1]), edges)
            here = np.stack([np.interp(t_s, edges, row) for row in once])
            mean = np.where(whole, means(once), _near(blocks, logged, t_s))
            return mean, np.where(whole, here - means(twice), 0.0)

        (rate, turned), (force, pushed) = of(blocks.gyro), of(blocks.accel)
        return cls(rate, force, turned, pushed)


def _summed(rows: Floats, edges: Floats) -> Floats:
    """Integrals up to the edges of what is constant between them: (3, n + 1) of (3, n)."""
    return np.concatenate([np.zeros((3, 1)), np.cumsum(rows * np.diff(edges), axis=1)], axis=1)


def place_epochs(samples: Samples, blocks: Blocks, fix_t_s: Floats) -> Epochs:
    """An epoch at each fix between the first knot and the last, and each second where there is none.

    In gaps of more than 10 s there is none, for the state between their knots is not known.

    fix_t_s : (m,) s, rising
    """
    knots = samples.knot_times
    silent_interval = samples.filled.reshape(-1, samples.per_interval).all(axis=1)
    silence = np.asarray(silent_interval & (np.diff(knots) > LONG_GAP_S))
    inside = np.flatnonzero((fix_t_s > knots[0]) & (fix_t_s < knots[-1]))
    ends = np.concatenate([knots[:1], fix_t_s[inside], knots[-1:]])
    silent = np.flatnonzero(np.diff(ends) > 1.5 * EPOCH_S)
    filler = [np.arange(ends[i] + EPOCH_S, ends[i + 1] - 0.5 * EPOCH_S, EPOCH_S) for i in silent]
    t_s = np.concatenate([fix_t_s[inside], *filler])
    fix = np.concatenate([inside, np.full(len(t_s) - len(inside), -1)])
    order = np.argsort(t_s, kind="stable")
    t_s, fix = t_s[order], fix[order]
    interval = np.clip(np.searchsorted(knots, t_s, side="right") - 1, 0, samples.intervals - 1)
    heard = ~silence[interval]
    t_s, fix, interval = t_s[heard], fix[heard], interval[heard]
    slot = np.arange(len(t_s)) - np.searchsorted(interval, interval)
    slots = int(slot.max()) + 1
    place = interval * slots + slot
    size = samples.intervals * slots
    of = np.repeat(np.arange(samples.intervals), slots)
    live, times, fixes, seconds = np.zeros(size, bool), knots[of], np.full(size, -1), np.zeros(size)
    live[place], times[place], fixes[place] = True, t_s, fix
    seconds[place] = np.clip(np.gradient(t_s) if len(t_s) > 1 else 1.0, 0.0, 1.0)
    return Epochs(
        t_s=times,
        interval=of,
        fix=fixes,
        live=live,
        seconds=seconds,
        gyro_s=_near(blocks, blocks.gyro, times),
        accel_s=_near(blocks, blocks.accel, times),
        calm=Calm.around(blocks, times),
        slots=slots,
        middle_s=0.5 * float(knots[0] + knots[-1]),
    )


def _near(blocks: Blocks, means: Floats, t_s: Floats) -> Floats:
    last = means.shape[1] - 1
    middle = np.arange(last + 1)
    smooth = sum(w * means[:, np.clip(middle + i - 2, 0, last)] for i, w in enumerate(_NEAR))
    return np.stack([np.interp(t_s, blocks.t_s, axis) for axis in np.asarray(smooth)])


@dataclass(frozen=True)
class Inside:
    """Where the epochs lie in their intervals, and the strap-down increments from the knot before.

    u : (E,) share of the interval; dt : (E,) s since the knot
    rot (3, 3, E), vel, pos (3, E) : increments
    value, slope : (4, E) weights of the errors of (position, velocity) at the knot before, then behind, on the
        position and on the velocity at the epoch
    """

    u: Floats
    dt: Floats
    rot: Floats
    vel: Floats
    pos: Floats
    value: Floats
    slope: Floats


def locate(epochs: Epochs, samples: Samples, increments: Increments) -> Inside:
    """The stored increments at the sample before each epoch, and one fractional step."""
    k, m = epochs.interval, samples.per_interval
    i = np.clip(np.searchsorted(samples.t_s, epochs.t_s, side="right") - 1, k * m, k * m + m - 1)
    h = epochs.t_s - samples.t_s[i]
    rate = samples.gyro_s[i].T - increments.gyro_bias[:, k]
    force = samples.accel_s[i].T - increments.accel_bias[:, k]
    q, vel, pos = increments.q[:, i], increments.dv[:, i], increments.dp[:, i]
    force_k = mv(quat_to_matrix(q), force)
    dt, length = epochs.t_s - samples.knot_times[k], increments.duration[k]
    u = dt / length
    rise, steep = 3 * u**2 - 2 * u**3, 6 * (u - u**2) / length
    return Inside(
        u=u,
        dt=dt,
        rot=quat_to_matrix(quat_multiply(q, quat_exp(rate * h))),
        vel=vel + force_k * h,
        pos=pos + vel * h + 0.5 * force_k * h * h,
        value=np.stack([1 - rise, length * (u - 2 * u**2 + u**3), rise, length * (u**3 - u**2)]),
        slope=np.stack([-steep, 1 - 4 * u + 3 * u**2, steep, 3 * u**2 - 2 * u]),
    )


@dataclass(frozen=True)
class Misclosure:
    """How far the strap-down motion from each knot misses the next, and what the motion between is made of.

    duration : (K,) s; gravity_n : (3, K) gravity less Coriolis, m/s^2
    turn_n : (3, K) rad, rotation to spread, that of the Earth included
    square, cube : (3, K) m, coefficients of u^2 and u^3 of the position to spread
    rotation_n, velocity_n, position_n : (3, K) the misclosures themselves
    """

    duration: Floats
    gravity_n: Floats
    turn_n: Floats
    square: Floats
    cube: Floats
    rotation_n: Floats
    velocity_n: Floats
    position_n: Floats


def misclosure(state: State, increments: Increments, gravity: GravityField, earth_rate_n: Floats) -> Misclosure:
    """Of all intervals. earth_rate_n : (3,) rad/s."""
    length = increments.duration
    rot, vel, pos = state.rot_ns[..., :-1], state.vel_n[:, :-1], state.pos_n[:, :-1]
    omega = earth_rate_n[:, None]
    pull = gravity_and_coriolis(state, gravity, omega)
    rot_end = mm(rotation_exp(-omega * length), mm(rot, increments.rotation))
    turn = mv(rot, mv(increments.rotation, rotation_log(mtm(rot_end, state.rot_ns[..., 1:]))))
    e_vel = state.vel_n[:, 1:] - (vel + pull * length + mv(rot, increments.velocity))
    e_pos = state.pos_n[:, 1:] - (pos + vel * length + 0.5 * pull * length**2 + mv(rot, increments.position))
    cube = e_vel * length - 2.0 * e_pos
    return Misclosure(length, pull, turn - omega * length, e_pos - cube, cube, turn, e_vel, e_pos)


def gravity_and_coriolis(state: State, gravity: GravityField, omega: Floats) -> Floats:
    """Gravity at the first knot of each interval less the Coriolis acceleration of its mean velocity: (3, K) m/s^2."""
    mean = 0.5 * (state.vel_n[:, :-1] + state.vel_n[:, 1:])
    return np.asarray(gravity.at(state.pos_n)[:, :-1] - 2.0 * cross(omega, mean))


def state_at(state: State, ends: Misclosure, epochs: Epochs, inside: Inside) -> tuple[Floats, Floats, Floats]:
    """rot_ns (3, 3, E), vel_n (3, E) m/s and pos_n (3, E) m at the epochs."""
    k, u, dt = epochs.interval, inside.u, inside.dt
    rot_k, pull = state.rot_ns[..., k], ends.gravity_n[:, k]
    square, cube = ends.square[:, k], ends.cube[:, k]
    rot = mm(mm(rotation_exp(ends.turn_n[:, k] * u), rot_k), inside.rot)
    spread = (2.0 * square * u + 3.0 * cube * u**2) / ends.duration[k]
    vel = state.vel_n[:, k] + pull * dt + mv(rot_k, inside.vel) + spread
    pos = state.pos_n[:, k] + state.vel_n[:, k] * dt + 0.5 * pull * dt**2 + mv(rot_k, inside.pos)
    return rot, vel, pos + square * u**2 + cube * u**3
