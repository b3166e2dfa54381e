"""A car's body on its springs: what lies between the road that it follows and the box that is bolted to it.

The drive says where the middle of the rear axle runs and how the road lies there. Relative to that, the body turns by

    yaw   = k_slip a_y                          the rear tyres slip outwards in a bend
    pitch = -k_pitch a_x + bounce               the nose rises under power (positive pitch: nose down)
    roll  =  k_roll a_y  + bounce               the body leans out of the bend

and heaves, where a_x, a_y are the accelerations of the rear axle in the vehicle, smoothed by the springs, and bounce
is smooth noise that grows with the speed. A car on a ferry feels the swell instead. All four are uniform cubic
B-splines of time, so that their derivatives are exact, and with them velocity and acceleration of a point at a lever
arm, p = p_axle + heave - R l:

    v = v_axle + heave. - R (omega x l),   a = a_axle + heave.. - R (omega. x l + omega x (omega x l))

References: Gillespie, Fundamentals of Vehicle Dynamics (1992), ch. 4 (ride), 6 (slip angle, roll gradient); de Boor,
A Practical Guide to Splines (1978), ch. IX (B-splines).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from recon.numerics.motion.drive import Drive
from recon.numerics.motion.euler import angular_acceleration, angular_rate, carried_rates
from recon.numerics.motion.truth import MotionTruth
from recon.numerics.rotation import Floats, conjugate, from_euler, multiply, rotate

Span: TypeAlias = tuple[float, float]

_STEP_S = 0.04
_SPRING_S = 0.25
"""Standard deviation of the bell by which springs and dampers smooth what the tyres feel: 0.6 Hz."""
_TURN_HZ, _HEAVE_HZ, _SWELL_HZ = 2.0, 3.0, 0.1
_BOUNCE_SPEED, _MOST_BOUNCE = 15.0, 1.5
"""m/s at which the bounce has its sigma; it grows with the speed to so many times that."""
_SWELL = (np.radians(0.5), np.radians(0.7), np.radians(1.5), 0.3)
"""Sigma of yaw, pitch, roll in rad and of heave in m on a ferry."""
_BOARDING_S = 20.0


@dataclass(frozen=True)
class Springs:
    """How soft a car is; the default is rigid.

    slip, pitch, roll : rad per m/s^2
    bounce : rad, sigma of roll and pitch at 15 m/s;  heave : m, sigma at 15 m/s
    """

    slip: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    bounce: float = 0.0
    heave: float = 0.0


@dataclass(frozen=True)
class SprungBody:
    """The motion of a point of the body.

    drive : of the middle of the rear axle
    lever_v : m, vehicle, from the point to the rear axle
    carried : s, when the road itself moves, as the deck of a ferry does
    rng : of bounce and swell
    """

    drive: Drive
    springs: Springs
    lever_v: tuple[float, float, float]
    carried: Span | None
    rng: np.random.Generator
    _sway: _Spline = field(init=False)

    def __post_init__(self) -> None:
        """Feel the road once."""
        object.__setattr__(self, "_sway", _sway(self.drive, self.springs, self.carried, self.rng))

    def at(self, t_s: Floats) -> MotionTruth:
        """Truth of the point at the times (n,) s, in any order."""
        axle = self.drive.at(t_s)
        value, rate, accel = self._sway.at(t_s)
        (yaw, pitch, roll), heave_n = value[:, :3].T, np.array([0.0, 0.0, 1.0])
        q_rv = from_euler(yaw, pitch, roll)
        gyro_v, gyro_rate_v = carried_rates(
            q_rv,
            axle.gyro_v,
            axle.gyro_rate_v,
            angular_rate(pitch, roll, rate[:, :3]),
            angular_acceleration(pitch, roll, rate[:, :3], accel[:, :3]),
        )
        q_nv = multiply(axle.q_nv, q_rv)
        lever_v = np.broadcast_to(np.array(self.lever_v), gyro_v.shape)
        swing_v = np.cross(gyro_v, lever_v)
        return MotionTruth(
            t_s=t_s,
            pos_n=axle.pos_n + value[:, 3:] * heave_n - rotate(q_nv, lever_v),
            vel_n=axle.vel_n + rate[:, 3:] * heave_n - rotate(q_nv, swing_v),
            acc_n=axle.acc_n
            + accel[:, 3:] * heave_n
            - rotate(q_nv, np.cross(gyro_rate_v, lever_v) + np.cross(gyro_v, swing_v)),
            q_nv=q_nv,
            gyro_v=gyro_v,
        )


@dataclass(frozen=True)
class _Spline:
    """Uniform cubic B-spline of k quantities over the times 0, step, 2 step, ...; control : (m, k)."""

    control: Floats

    def at(self, t_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Value, first and second derivative by time: (n, k) each, constant outside."""
        place = np.clip(t_s / _STEP_S, 0.0, len(self.control) - 4.0 - 1e-9)
        first = place.astype(np.intp)
        u = (place - first)[:, None]
        weights = (
            (
                (1.0 - u) ** 3 / 6.0,
                (3.0 * u**3 - 6.0 * u**2 + 4.0) / 6.0,
                (1.0 + 3.0 * (u + u**2 - u**3)) / 6.0,
                u**3 / 6.0,
            ),
            (-((1.0 - u) ** 2) / 2.0, 1.5 * u**2 - 2.0 * u, (1.0 + 2.0 * u - 3.0 * u**2) / 2.0, u**2 / 2.0),
            (1.0 - u, 3.0 * u - 2.0, 1.0 - 3.0 * u, u),
        )
        points = [self.control[first + k] for k in range(4)]
        value, rate, accel = (sum(w * p for w, p in zip(row, points, strict=True)) for row in weights)
        return np.asarray(value), np.asarray(rate) / _STEP_S, np.asarray(accel) / _STEP_S**2


def _sway(drive: Drive, springs: Springs, carried: Span | None, rng: np.random.Generator) -> _Spline:
    """Yaw, pitch, roll and heave of the body relative to the road; none before the drive and after its end."""
    t_s = np.arange(-_STEP_S, drive.duration_s + 4.0 * _STEP_S, _STEP_S)
    road = drive.at(t_s)
    felt_v = _smooth(rotate(conjugate(road.q_nv), road.acc_n), _SPRING_S)
    speed = _smooth(np.linalg.norm(road.vel_n, axis=1)[:, None], _SPRING_S)
    sailing = np.zeros_like(speed) if carried is None else _during(t_s, carried)[:, None]
    lean = np.stack((springs.slip * felt_v[:, 1], -springs.pitch * felt_v[:, 0], springs.roll * felt_v[:, 1]), axis=-1)
    bounce = (
        np.minimum(speed / _BOUNCE_SPEED, _MOST_BOUNCE)
        * (1.0 - sailing)
        * _noise(
            (0.0, springs.bounce, springs.bounce, springs.heave),
            (_TURN_HZ, _TURN_HZ, _TURN_HZ, _HEAVE_HZ),
            len(t_s),
            rng,
        )
    )
    swell = sailing * _noise(_SWELL, (_SWELL_HZ,) * 4, len(t_s), rng) if sailing.any() else 0.0
    control = bounce + swell
    control[:, :3] += lean
    return _Spline(control)


def _noise(sigmas: tuple[float, ...], limits_hz: tuple[float, ...], rows: int, rng: np.random.Generator) -> Floats:
    """Smooth noise: (rows, k) of these sigmas, with a bell-shaped spectrum of this standard deviation."""
    columns = []
    for sigma, limit_hz in zip(sigmas, limits_hz, strict=True):
        bell_s = 1.0 / (2.0 * np.pi * limit_hz)
        # White noise smoothed by a bell keeps the part step / (2 sqrt(pi) bell) of its variance.
        size = sigma * np.sqrt(2.0 * np.sqrt(np.pi) * bell_s / _STEP_S)
        columns.append(size * _smooth(rng.standard_normal((rows, 1)), bell_s))
    return np.hstack(columns)


def _smooth(values: Floats, bell_s: float) -> Floats:
    """Columns (m, k) convolved with a bell of this standard deviation in s, the ends continued."""
    from scipy.ndimage import gaussian_filter1d

    return np.asarray(gaussian_filter1d(values, bell_s / _STEP_S, axis=0, mode="nearest"))


def _during(t_s: Floats, span: Span) -> Floats:
    """1 within a span, 0 outside, with smooth flanks inside it: (n,)."""
    x = np.clip(np.minimum(t_s - span[0], span[1] - t_s) / _BOARDING_S, 0.0, 1.0)
    return x**2 * (3.0 - 2.0 * x)
