"""The factors at the epochs: GNSS position and velocity, and what wheels allow.

    position   p + R l + c + v d                              - z_p        d = LAG, l = LEVER, c = DRIFT
    velocity   T (v + R (w x l) + (R f + g) (d + d_v))        - z_v        T axes of what the receiver reports
                                                                           d grows by CLOCK times the time
    body       u = M (R^T v + w x r):  u_y - k_s a_y u_x,  u_z - k_p a_x u_x,  u_x - (1 + s) wheel speed

The body's rows say that a rear axle (at r) moves along its wheels' track: sideways and upwards nothing but slip, which
grows with the lateral acceleration, and the pitch of the springs. u_y and u_z are means of a second: a body that
bounces turns about its track, and a constraint that takes this for errors of the IMU finds scale errors where there are
none. About the mean it moves by u~ = f~ - w~ x u, with ~ for integrals over time less their means. Robust weights by
`robust`: the fixes' are kept by the smoother, the body's are Cauchy's.

References
    Groves (2013), 2nd ed., section 14.3 (lever arm).
    Dissanayake, Sukkarieh, Nebot, Durrant-Whyte (2001), "The aiding of a low-cost strapdown inertial measurement unit
    using vehicle model constraints for land vehicle applications", IEEE T-RA 17(5), eqs. 8 to 11.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.epochs import Epochs, Inside, Misclosure, state_at
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import Floats, cross, mm, mtv, mv, skew
from recon.numerics.smoothing.state import CLOCK, LAG, LEVER, MOUNT, PITCH, REAR, SLIP, VELOCITY_LAG, WHEEL, State

SEEN: Final = slice(0, 12)
"""Drift, rotation, velocity and position of both knots."""
COMMON: Final = slice(1, 16)
"""Mounting to wheel scale."""
_ROWS: Final = 9
_COLUMNS: Final = 40
_BODY_C2: Final = 9.0
_MOVING: Final = 1.0
"""m/s above which wheels tell the direction of motion."""


@dataclass(frozen=True)
class Fixes:
    """What GNSS reports, at m times. A component that is not measured has sigma inf and any finite value.

    t_s : (m,) s, rising, stamps less what is known of the lag
    pos_n : (3, m) m, axes n, of the antenna; pos_sigma : (3, m) m, white part
    vel_rows : (3, 3, m), rows take a velocity in n to the components measured; vel : (3, m) m/s; vel_sigma : (3, m)
    small_only : (m,) the velocity only says that it is small; its sigma is its speed, and tells nothing of the noise
    speed_only : (m,) the first component is the speed over ground, in a direction that only the solution knows
    share : (m,) part of a fix's information that is its own, below 1 where fixes follow each other fast
    offset_s : (3, m) m, sensor, from the antenna that LEVER leads to, to that of the fix; None where all have one
    """

    t_s: Floats
    pos_n: Floats
    pos_sigma: Floats
    vel_rows: Floats
    vel: Floats
    vel_sigma: Floats
    small_only: NDArray[np.bool_]
    speed_only: NDArray[np.bool_]
    share: Floats
    offset_s: Floats | None = None


@dataclass(frozen=True)
class BodyModel:
    """How well the constraint of the wheels holds: growth of its sigma with slip, wheel speed's sigma m/s.

    on : (E,) epochs at which it is used; rolls : (E,) those at which it is used however slow they are
    wheel_speed : (E,) m/s at the epochs, NaN where there is none; of its sign, which not all wheels tell, nothing is
        made
    """

    slip: float
    wheel_sigma: float
    on: NDArray[np.bool_]
    rolls: NDArray[np.bool_]
    wheel_speed: Floats

    def kept_on(self, here: AtEpochs) -> BodyModel:
        """The same, with the epochs that move in a state moving in all that come after it."""
        return replace(self, rolls=self.rolls | _moving(here))


@dataclass(frozen=True)
class Measured:
    """Rows of one kind at the epochs: weighted residuals and the parts of their Jacobians.

    residual : (3, E); turn : (3, 3, E) to the rotation at the epoch; along : (3, 3, E) to the position or the velocity
    there; common : (3, 16, E)
    """

    residual: Floats
    turn: Floats
    along: Floats
    common: Floats

    def weighted(self, weight: Floats) -> Measured:
        """Each epoch's rows multiplied by the square root of its weight: (E,) or (3, E)."""
        root = np.broadcast_to(np.sqrt(weight), self.residual.shape)
        w = root[:, None]
        return Measured(self.residual * root, self.turn * w, self.along * w, self.common * w)


@dataclass(frozen=True)
class AtEpochs:
    """The state at the epochs and what hangs on it: rot (3, 3, E), the rest (3, E).

    rate : rad/s, sensor, bias removed; force_n : specific force plus gravity, m/s^2, axes n
    """

    rot: Floats
    vel: Floats
    pos: Floats
    drift: Floats
    rate: Floats
    force_n: Floats


def at_epochs(state: State, ends: Misclosure, epochs: Epochs, inside: Inside) -> AtEpochs:
    """The state at the epochs; gravity is that at the knot before."""
    rot, vel, pos = state_at(state, ends, epochs, inside)
    k, u = epochs.interval, inside.u
    force = epochs.accel_s - state.accel_bias[:, k]
    return AtEpochs(
        rot=rot,
        vel=vel,
        pos=pos,
        drift=(1.0 - u) * state.drift_n[:, k] + u * state.drift_n[:, k + 1],
        rate=epochs.gyro_s - state.gyro_bias[:, k],
        force_n=mv(rot, force) + ends.gravity_n[:, k],
    )


def lag_at(state: State, epochs: Epochs) -> Floats:
    """What a fix at each epoch is later than its stamp: (E,) s."""
    return np.asarray(state.common[LAG] + state.common[CLOCK] * epochs.since_s)


def position_rows(here: AtEpochs, state: State, fixes: Fixes, epochs: Epochs, bridge: Floats) -> Measured:
    """Of the fixes' positions, weighted by their sigma. bridge : (3, E) m^2, variance of the drift between knots."""
    lever = _lever(state, fixes, epochs)
    arm = mv(here.rot, lever)
    weight = _own(1.0 / np.sqrt(fixes.pos_sigma[:, epochs.fix] ** 2 + bridge), fixes, epochs)
    error = here.pos + arm + here.drift + here.vel * lag_at(state, epochs) - fixes.pos_n[:, epochs.fix]
    common = np.zeros((3, COMMON.stop, len(epochs.t_s)))
    common[:, LEVER] = here.rot * weight[:, None]
    common[:, LAG] = here.vel * weight
    common[:, CLOCK] = common[:, LAG] * epochs.since_s
    along = np.zeros_like(here.rot)
    along[range(3), range(3)] = weight
    return Measured(error * weight, -skew(arm) * weight[:, None], along, common)


def velocity_rows(here: AtEpochs, state: State, fixes: Fixes, epochs: Epochs) -> Measured:
    """Of the fixes' velocities, weighted by their sigma."""
    lever = _lever(state, fixes, epochs)
    swing = mv(here.rot, cross(here.rate, lever))
    weight = _own(1.0 / fixes.vel_sigma[:, epochs.fix], fixes, epochs)
    rows = fixes.vel_rows[:, :, epochs.fix]
    unknown = fixes.speed_only[epochs.fix]
    if unknown.any():
        rows[:, :, unknown] = _along(here.vel[:, unknown])
    rows = rows * weight[:, None]
    total = here.vel + swing + here.force_n * (lag_at(state, epochs) + state.common[VELOCITY_LAG])
    common = np.zeros((3, COMMON.stop, len(epochs.t_s)))
    common[:, LEVER] = mm(rows, mm(here.rot, skew(here.rate)))
    common[:, LAG] = common[:, VELOCITY_LAG] = mv(rows, here.force_n)
    common[:, CLOCK] = common[:, LAG] * epochs.since_s
    error = mv(rows, total) - fixes.vel[:, epochs.fix] * weight
    return Measured(error, -mm(rows, skew(swing)), rows, common)


def _lever(state: State, fixes: Fixes, epochs: Epochs) -> Floats:
    """From the IMU to the antenna of each epoch's fix: (3, E) m, sensor."""
    lever = np.broadcast_to(state.common[LEVER, None], (3, len(epochs.t_s)))
    return lever if fixes.offset_s is None else np.asarray(lever + fixes.offset_s[:, epochs.fix])


def _along(vel_n: Floats) -> Floats:
    """Rows along and across a horizontal velocity, and up: (3, 3, n)."""
    speed = np.maximum(np.hypot(vel_n[0], vel_n[1]), 1e-3)
    east, north = vel_n[0] / speed, vel_n[1] / speed
    none, one = np.zeros_like(east), np.ones_like(east)
    return np.array([[east, north, none], [-north, east, none], [none, none, one]])


def _own(weight: Floats, fixes: Fixes, epochs: Epochs) -> Floats:
    """Weights (3, E), zero at epochs that are no fix."""
    share = np.where(epochs.fix >= 0, fixes.share[epochs.fix], 0.0)
    return np.asarray(weight * np.sqrt(share))


def body_rows(
    here: AtEpochs, state: State, epochs: Epochs, model: BodyModel, sigma: tuple[float, float], robust: bool
) -> Measured:
    """Of the wheels, vehicle axes x (wheel speed), y and z (no motion across), weighted.

    sigma : m/s, of y and z, at one second
    """
    rot_vs, calm = state.rot_vs, epochs.calm
    to_vehicle = np.einsum("ij,kjn->ikn", rot_vs, here.rot)
    turn_rate = np.einsum("ij,jn->in", rot_vs, here.rate)
    rear = np.broadcast_to(state.common[REAR, None], here.vel.shape)
    along_s, rate = mtv(here.rot, here.vel), here.rate + calm.rate - epochs.gyro_s
    u = np.einsum("ij,jn->in", rot_vs, along_s + cross(here.rate, rear))
    mean = np.einsum("ij,jn->in", rot_vs, along_s + cross(calm.turned, along_s) - calm.pushed + cross(rate, rear))
    push = mv(to_vehicle, here.force_n) + np.einsum("ij,jn->in", rot_vs, calm.force - epochs.accel_s)
    slip, pitch = -u[0] * push[1], -u[0] * push[0]
    wheel = np.abs(np.nan_to_num(model.wheel_speed)) * np.sign(u[0])
    error = np.stack(
        [
            u[0] - (1.0 + state.common[WHEEL]) * wheel,
            mean[1] + state.common[SLIP] * slip,
            mean[2] + state.common[PITCH] * pitch,
        ]
    )
    weight = _body_weights(u, turn_rate, here, epochs, model, sigma)
    if robust:
        squared = (error * weight) ** 2
        weight[0] /= np.sqrt(1.0 + squared[0] / _BODY_C2)
        weight[1:] /= np.sqrt(1.0 + squared[1:].sum(axis=0) / _BODY_C2)
    common = np.zeros((3, COMMON.stop, u.shape[1]))
    common[:1, MOUNT], common[1:, MOUNT] = -skew(u)[:1], -skew(mean)[1:]
    common[:1, REAR] = np.einsum("ij,jkn->ikn", rot_vs[:1], skew(here.rate))
    common[1:, REAR] = np.einsum("ij,jkn->ikn", rot_vs[1:], skew(rate))
    common[0, WHEEL], common[1, SLIP], common[2, PITCH] = -wheel, slip, pitch
    to_vehicle[1:] += np.einsum("ij,jkn,lkn->iln", rot_vs[1:], skew(calm.turned), here.rot, optimize=True)
    turn = mm(to_vehicle, skew(here.vel))
    w = weight[:, None]
    return Measured(error * weight, turn * w, to_vehicle * w, common * w)


def _body_weights(
    u: Floats, turn_rate: Floats, here: AtEpochs, epochs: Epochs, model: BodyModel, sigma: tuple[float, float]
) -> Floats:
    """(3, E) 1 / (m/s): nothing below walking pace, where the body sways more than the wheels tell."""
    moves = model.on & (model.rolls | _moving(here))
    side = np.hypot(sigma[0], model.slip * np.abs(turn_rate[2]) * u[0] ** 2 / 3.0)
    rolls = np.isfinite(model.wheel_speed) & epochs.live
    return np.asarray(
        np.stack(
            [
                np.where(rolls, 1.0 / model.wheel_sigma, 0.0),
                np.where(moves, 1.0 / side, 0.0),
                np.where(moves, 1.0 / sigma[1], 0.0),
            ]
        )
        * np.sqrt(epochs.seconds)
    )


def _moving(here: AtEpochs) -> NDArray[np.bool_]:
    """Which epochs move so fast that wheels tell the direction: (E,)."""
    return np.asarray(np.sqrt((here.vel**2).sum(axis=0)) > _MOVING)


def add_measured(
    normal: Normal,
    inside: Inside,
    slots: int,
    position: Measured | None,
    velocity: Measured | None,
    body: Measured | None,
    lag: Floats,
) -> None:
    """Add the rows of all epochs, those of an interval together. A kind that is None is left out. lag : (E,) s"""
    kinds = [
        (rows, measured, drift, inside.value + lag * inside.slope if drift else inside.slope)
        for rows, measured, drift in (
            (slice(0, 3), position, True),
            (slice(3, 6), velocity, False),
            (slice(6, 9), body, False),
        )
        if measured is not None
    ]

    def jacobian(intervals: slice) -> Floats:
        part = slice(intervals.start * slots, intervals.stop * slots)
        tall = np.zeros((part.stop - part.start, _ROWS, _COLUMNS))
        for rows, measured, drift, hermite in kinds:
            _fill(tall[:, rows], measured, drift, inside.u[part], hermite[:, part], part)
        return tall.reshape(-1, slots * _ROWS, _COLUMNS)

    normal.add_intervals(jacobian, slots * _ROWS, SEEN, SEEN, COMMON)


def _fill(rows: Floats, measured: Measured, drift: bool, u: Floats, hermite: Floats, part: slice) -> None:
    """Write the rows of one kind: chain rule from the state at the epoch to both knots."""
    turn, along = measured.turn[..., part], measured.along[..., part]
    for first, share, pos, vel in ((0, 1.0 - u, hermite[0], hermite[1]), (12, u, hermite[2], hermite[3])):
        if drift:
            rows[:, :, first : first + 3] = (along * share).transpose(2, 0, 1)
        rows[:, :, first + 3 : first + 6] = (turn * share).transpose(2, 0, 1)
        rows[:, :, first + 6 : first + 9] = (along * vel).transpose(2, 0, 1)
        rows[:, :, first + 9 : first + 12] = (along * pos).transpose(2, 0, 1)
    rows[:, :, 24:39] = measured.common[:, COMMON, part].transpose(2, 0, 1)
    rows[:, :, 39] = -measured.residual[:, part].T
