"""What the filter ekf_rts knows of the drive: its states, how they move, and what is measured of them.

Error states, true less estimated; the rotation is about axes n, rot_ns = exp(rotation) rot_ns_estimated:

| state                | unit           | model                                                                   |
|----------------------|----------------|-------------------------------------------------------------------------|
| ROTATION             | rad            | -R (bias + scale u u.rate) - earth x rotation                           |
| VELOCITY, POSITION   | m/s, m         | rotation x (R f) - R bias - 2 earth x velocity                          |
| GYRO_BIAS, ACCEL_BIAS | rad/s, m/s^2  | random walks                                                            |
| DRIFT                | m              | Gauss-Markov error of the GNSS position                                 |
| MOUNT                | rad            | pitch and yaw of the sensor in the vehicle, constant                    |
| SCALE                | 1              | error of the gyro's scale about the vehicle's z axis u, constant        |

References
    Groves (2013), 2nd ed., sections 14.2 and 14.3 (error models in Earth-fixed axes).
    Dissanayake, Sukkarieh, Nebot, Durrant-Whyte (2001), "The aiding of a low-cost strapdown inertial measurement unit
    using vehicle model constraints", IEEE T-RA 17(5).
    Savage (1998), "Strapdown inertial navigation integration algorithm design", J. Guidance 21(1) and 21(2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.rotation import Floats, from_rotvec, rotate, to_matrix

from .drives import Drive
from .start import ATTITUDE_SIGMA, Start
from .steps import steps_between

ROTATION: Final = slice(0, 3)
VELOCITY: Final = slice(3, 6)
POSITION: Final = slice(6, 9)
GYRO_BIAS: Final = slice(9, 12)
ACCEL_BIAS: Final = slice(12, 15)
DRIFT: Final = slice(15, 18)
MOUNT: Final = slice(18, 20)
SCALE: Final = 20
SIZE: Final = 21

_FIRST_POSITION, _FIRST_VELOCITY = 5.0, 0.5
"""m, m/s; sigma of the first position and velocity, medians of some fixes."""
_MOUNT_SIGMA: Final = float(np.radians(1.0))
_SIDEWAYS: Final = 0.1
"""m/s, sigma of the speed of the rear axle to the side and upwards, once a second."""
_STANDING: Final = 0.02
"""m/s, sigma of the speed of a car that stands, once a second."""


@dataclass
class State:
    """The estimate that the errors belong to.

    rot_ns : (3, 3); x : (21,) all other states by their slices, of which ROTATION stays zero
    """

    rot_ns: Floats
    x: Floats

    def moved(self, error: Floats) -> State:
        """The state with an error (21,) added."""
        x = self.x + error
        x[ROTATION] = 0.0
        return State(turn(error[ROTATION]) @ self.rot_ns, x)


@dataclass(frozen=True)
class Blocks:
    """The IMU between k + 1 edges, about the gyro bias of the start.

    edge_s : (k + 1,) s; dt_s : (k,) s
    angle_s : (k, 3) rad, rotation vector of each block; velocity_s : (k, 3) m/s, integral of the specific force in the
        axes of the block's beginning
    edge_rate_s : (k + 1, 3) rad/s, as measured
    """

    edge_s: Floats
    dt_s: Floats
    angle_s: Floats
    velocity_s: Floats
    edge_rate_s: Floats


def blocks_between(drive: Drive, edge_s: Floats, gyro_bias: Floats) -> Blocks:
    """Rotation vectors with coning, velocities with sculling, to second order in the angle of a block. Savage 1998."""
    steps = steps_between(drive, edge_s)
    first, count = steps.first[:-1], np.diff(steps.first)
    angle = (steps.rate_s - gyro_bias) * steps.dt_s[:, None]
    before = np.cumsum(angle, axis=0) - angle
    before -= np.repeat(before[first], count, axis=0)
    coning = 0.5 * np.add.reduceat(np.cross(before, angle), first, axis=0)
    velocity = rotate(from_rotvec(before + 0.5 * angle), steps.force_s * steps.dt_s[:, None])
    return Blocks(
        edge_s,
        np.diff(edge_s),
        np.add.reduceat(angle, first, axis=0) + coning,
        np.add.reduceat(velocity, first, axis=0),
        steps.edge_rate_s,
    )


def first_state(drive: Drive, begin: Start) -> tuple[State, Floats]:
    """The state at the first sample and its covariance (21, 21)."""
    noise, x = drive.noise, np.zeros(SIZE)
    x[VELOCITY], x[POSITION], x[GYRO_BIAS] = begin.vel_n, begin.pos_n, begin.gyro_bias
    sigma = np.empty(SIZE)
    sigma[ROTATION], sigma[VELOCITY], sigma[POSITION] = ATTITUDE_SIGMA, _FIRST_VELOCITY, _FIRST_POSITION
    sigma[GYRO_BIAS], sigma[ACCEL_BIAS], sigma[DRIFT] = noise.gyro_bias, noise.accel_bias, noise.drift_n
    sigma[MOUNT], sigma[SCALE] = _MOUNT_SIGMA, noise.gyro_scale
    return State(to_matrix(drive.start_q_ns), x), np.diag(sigma**2)


class Model:
    """How a state of one drive moves and what is measured of it; `rate_s` arguments are (3,) rad/s as measured.

    A measurement is residual (r,), its derivative by the error state (r, 21) and the sigma of its noise (r,).
    """

    def __init__(self, drive: Drive, gyro_bias: Floats):
        self.drive = drive
        self.gyro_bias = gyro_bias
        self.rot_vs = to_matrix(drive.mount_q_vs)
        self.up_s = self.rot_vs[2]
        self.earth = cross_matrix(drive.world.earth_rate_n)

    def moved(self, state: State, angle_s: Floats, velocity_s: Floats, dt_s: float) -> tuple[State, Floats, Floats]:
        """The state a block later, the transition of its error (21, 21) and the variances added to it (21,)."""
        noise, rot, x = self.drive.noise, state.rot_ns, state.x.copy()
        measured = angle_s + self.gyro_bias * dt_s
        angle = angle_s - (x[GYRO_BIAS] - self.gyro_bias) * dt_s - x[SCALE] * (self.up_s @ measured) * self.up_s
        middle = rot @ turn(0.5 * angle)
        gained_n = rot @ velocity_s - middle @ x[ACCEL_BIAS] * dt_s
        gained_n += (self.drive.world.gravity_at(x[POSITION]) - 2.0 * self.earth @ x[VELOCITY]) * dt_s
        fades = np.exp(-dt_s / noise.drift_s)
        transition = np.eye(SIZE)
        transition[ROTATION, ROTATION] -= self.earth * dt_s
        transition[ROTATION, GYRO_BIAS] = -middle * dt_s
        transition[ROTATION, SCALE] = -middle @ self.up_s * (self.up_s @ measured)
        transition[VELOCITY, ROTATION] = -cross_matrix(rot @ velocity_s)
        transition[VELOCITY, VELOCITY] -= 2.0 * self.earth * dt_s
        transition[VELOCITY, ACCEL_BIAS] = -middle * dt_s
        transition[POSITION, VELOCITY] = dt_s * np.eye(3)
        transition[POSITION, ROTATION] = 0.5 * dt_s * transition[VELOCITY, ROTATION]
        transition[POSITION, ACCEL_BIAS] = -0.5 * dt_s**2 * middle
        transition[DRIFT, DRIFT] *= fades
        x[POSITION] += (x[VELOCITY] + 0.5 * gained_n) * dt_s
        x[VELOCITY] += gained_n
        x[DRIFT] *= fades
        rot_next = turn(-self.drive.world.earth_rate_n * dt_s) @ rot @ turn(angle)
        return State(rot_next, x), transition, self._added(dt_s, fades)

    def _added(self, dt_s: float, fades: float) -> Floats:
        noise, added = self.drive.noise, np.zeros(SIZE)
        added[ROTATION], added[VELOCITY] = noise.gyro**2 * dt_s, noise.accel**2 * dt_s
        added[POSITION] = noise.accel**2 * dt_s**3 / 3.0
        added[GYRO_BIAS], added[ACCEL_BIAS] = noise.gyro_walk**2 * dt_s, noise.accel_walk**2 * dt_s
        added[DRIFT] = noise.drift_n**2 * (1.0 - fades**2)
        return added

    def _turning(self, state: State, rate_s: Floats) -> Floats:
        """Rate relative to the local frame: (3,) rad/s, sensor."""
        scaled = state.x[SCALE] * (self.up_s @ rate_s) * self.up_s
        return np.asarray(rate_s - state.x[GYRO_BIAS] - scaled - state.rot_ns.T @ self.drive.world.earth_rate_n)

    def position(self, state: State, fix_n: Floats) -> tuple[Floats, Floats, Floats]:
        """Of the antenna, with the drift of the receiver."""
        lever_n = state.rot_ns @ self.drive.lever_s
        by_error = np.zeros((3, SIZE))
        by_error[:, ROTATION] = -cross_matrix(lever_n)
        by_error[:, POSITION] = by_error[:, DRIFT] = np.eye(3)
        return fix_n - state.x[POSITION] - lever_n - state.x[DRIFT], by_error, self.drive.noise.white_n

    def velocity(self, state: State, rate_s: Floats, fix_n: Floats) -> tuple[Floats, Floats, Floats]:
        """Of the antenna, which turns with the car."""
        around_n = state.rot_ns @ np.cross(self._turning(state, rate_s), self.drive.lever_s)
        by_error = np.zeros((3, SIZE))
        by_error[:, ROTATION] = -cross_matrix(around_n)
        by_error[:, VELOCITY] = np.eye(3)
        by_error[:, GYRO_BIAS] = state.rot_ns @ cross_matrix(self.drive.lever_s)
        return fix_n - state.x[VELOCITY] - around_n, by_error, self.drive.noise.velocity_n

    def rear_axle(self, state: State, rate_s: Floats) -> tuple[Floats, Floats, Floats, float]:
        """It moves neither to the side nor upwards in the vehicle; besides, its speed forward in m/s."""
        pitch, yaw = state.x[MOUNT]
        rot_vs = turn(np.array([0.0, pitch, yaw])) @ self.rot_vs
        around_s = np.cross(self._turning(state, rate_s), self.drive.rear_s)
        vel_v = rot_vs @ (state.rot_ns.T @ state.x[VELOCITY] + around_s)
        rot_vn = rot_vs @ state.rot_ns.T
        by_error = np.zeros((3, SIZE))
        by_error[:, ROTATION] = rot_vn @ cross_matrix(state.x[VELOCITY])
        by_error[:, VELOCITY] = rot_vn
        by_error[:, GYRO_BIAS] = rot_vs @ cross_matrix(self.drive.rear_s)
        by_error[:, MOUNT] = -cross_matrix(vel_v)[:, 1:]
        return -vel_v[1:], by_error[1:], np.full(2, _SIDEWAYS), float(vel_v[0])

    def standing(self, state: State) -> tuple[Floats, Floats, Floats]:
        """No velocity."""
        by_error = np.zeros((3, SIZE))
        by_error[:, VELOCITY] = np.eye(3)
        return -state.x[VELOCITY], by_error, np.full(3, _STANDING)


def cross_matrix(v: Floats) -> Floats:
    """(3, 3) matrix of the cross product: cross_matrix(v) @ w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def turn(rotvec: Floats) -> Floats:
    """(3, 3) rotation matrix of a rotation vector (3,) rad; on single vectors faster than a quaternion's way."""
    angle2 = float(rotvec @ rotvec)
    cross = cross_matrix(rotvec)
    if angle2 < 1e-8:
        return np.eye(3) + cross + 0.5 * cross @ cross
    angle = np.sqrt(angle2)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle2 * cross @ cross)
