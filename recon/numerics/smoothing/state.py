"""What the smoother estimates: a state at every knot, and what all knots have in common.

| knot state         | unit    | meaning                                                                    |
|--------------------|---------|----------------------------------------------------------------------------|
| DRIFT              | m       | slow error of the GNSS position, axes n                                    |
| ROTATION           | rad     | rot_ns, sensor to n; its error is a rotation about axes n, exp(d) rot_ns   |
| VELOCITY, POSITION | m/s, m  | of the IMU, axes n                                                         |
| GYRO_BIAS          | rad/s   | sensor                                                                     |
| ACCEL_BIAS         | m/s^2   | sensor                                                                     |

| common             | unit    | meaning                                                                    |
|--------------------|---------|----------------------------------------------------------------------------|
| ROLL               | s^2/m   | roll of the body per lateral acceleration                                  |
| MOUNT              | rad     | error of rot_vs, sensor to vehicle: exp(d) rot_vs                          |
| LEVER, REAR        | m       | from the IMU to the antenna, to the rear axle; sensor                      |
| LAG                | s       | a position stamped t is that of the time t + LAG                           |
| VELOCITY_LAG       | s       | a velocity stamped t is that of the time t + LAG + VELOCITY_LAG            |
| CLOCK              | 1       | both grow by so much a second: LAG is that of the middle of the drive      |
| SLIP, PITCH        | s^2/m   | side-slip per lateral, pitch per longitudinal acceleration (compliance)    |
| WHEEL              | 1       | the wheels report (1 + WHEEL) times less than the truth                    |
| GYRO_SCALE, ACCEL_SCALE | 1  | scale errors of each axis                                                  |
| CAMERA             | rad     | error of the axes of a camera: it saw d where exp(CAMERA) d is true, sensor |
| CAMERA_LEVER       | m       | from the IMU to the camera; sensor                                         |
| BARO               | 1       | a climb is (1 + BARO) times that of a barometer in the standard atmosphere |

Axes n are East, North, Up at the anchor, fixed to the Earth; v is the vehicle (ISO 8855), s the box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from recon.numerics.smoothing.soa import Floats, mm, rotation_exp

DRIFT: Final = slice(0, 3)
ROTATION: Final = slice(3, 6)
VELOCITY: Final = slice(6, 9)
POSITION: Final = slice(9, 12)
GYRO_BIAS: Final = slice(12, 15)
ACCEL_BIAS: Final = slice(15, 18)
KNOT_SIZE: Final = 18

ROLL: Final = 0
MOUNT: Final = slice(1, 4)
LEVER: Final = slice(4, 7)
REAR: Final = slice(7, 10)
LAG: Final = 10
VELOCITY_LAG: Final = 11
CLOCK: Final = 12
SLIP: Final = 13
PITCH: Final = 14
WHEEL: Final = 15
GYRO_SCALE: Final = slice(16, 19)
ACCEL_SCALE: Final = slice(19, 22)
CAMERA: Final = slice(22, 25)
CAMERA_LEVER: Final = slice(25, 28)
BARO: Final = 28
COMMON_SIZE: Final = 29
SCALES: Final = slice(16, 22)

LARGEST_TURN: Final = 0.7
"""rad; a step of the solver that turns any knot by more is shortened, for the model is linear only nearby."""


@dataclass(frozen=True)
class State:
    """One value of all unknowns; arrays as in the module's tables, knots last: (3, N), rot_ns (3, 3, N).

    common : (29,); its MOUNT part stays zero, for rot_vs (3, 3) carries the mounting
    """

    rot_ns: Floats
    vel_n: Floats
    pos_n: Floats
    gyro_bias: Floats
    accel_bias: Floats
    drift_n: Floats
    rot_vs: Floats
    common: Floats

    @property
    def knots(self) -> int:
        """How many there are."""
        return int(self.pos_n.shape[1])

    def moved(self, step: Floats, step_common: Floats) -> State:
        """The state after a step of the solver: (18, N) and (29,). A turn beyond LARGEST_TURN shortens all of it."""
        turn = max(float(np.abs(step[ROTATION]).max()), float(np.abs(step_common[MOUNT]).max()))
        share = min(1.0, LARGEST_TURN / turn) if turn > 0.0 else 1.0
        step, step_common = step * share, step_common * share
        common = self.common + step_common
        common[MOUNT] = 0.0
        return State(
            rot_ns=mm(rotation_exp(step[ROTATION]), self.rot_ns),
            vel_n=self.vel_n + step[VELOCITY],
            pos_n=self.pos_n + step[POSITION],
            gyro_bias=self.gyro_bias + step[GYRO_BIAS],
            accel_bias=self.accel_bias + step[ACCEL_BIAS],
            drift_n=self.drift_n + step[DRIFT],
            rot_vs=rotation_exp(step_common[MOUNT]) @ self.rot_vs,
            common=common,
        )

    def with_common(self, where: slice | int, value: Floats | float) -> State:
        """The same with another value of what is common."""
        common = self.common.copy()
        common[where] = value
        return replace(self, common=common)
