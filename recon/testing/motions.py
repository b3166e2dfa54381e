"""The motions of the suite's drives: a road with all that stages look for, a stand, and a circle on which nothing is
constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from recon.numerics.motion import Drive, MotionTruth, Segment, circle
from recon.numerics.rotation import Floats, from_euler

ROAD: Final = Drive(
    (
        Segment(10.0, 0.0),
        Segment(6.0, 12.0),
        Segment(5.0, 12.0),
        Segment(2.0, 9.0),
        Segment(2.0, 9.0, curvature=0.05),
        Segment(2.5, 9.0, curvature=0.05),
        Segment(2.0, 9.0),
        Segment(4.0, 13.0),
        Segment(6.0, 0.0),
        Segment(5.0, 0.0),
        Segment(5.0, 10.0),
        Segment(2.0, 8.0, curvature=-0.04),
        Segment(3.0, 8.0),
        Segment(5.0, 0.0),
        Segment(6.0, 0.0),
    ),
    yaw=0.7,
)
"""A car rests, pulls away, turns left, stops, pulls away, turns right and stops."""
STAND: Final = Drive((Segment(20.0, 0.0),), yaw=0.7)
"""Nothing moves."""


@dataclass(frozen=True)
class RollingCircle:
    """A flat circle whose body sways as a boat does, so that its axis of rotation turns as well; in closed form.

        yaw = w t + a sin(W t),  pitch = a sin(1.3 W t),  roll = a cos(0.7 W t)

    The rates in the body follow from those of the ISO 8855 angles (Titterton and Weston 2004, eq. 3.52).

    radius : m; speed : m/s, constant; sway : rad, a; rate : rad/s, W
    """

    radius: float = 20.0
    speed: float = 10.0
    sway: float = 0.2
    rate: float = 2.0
    duration_s: float = 10.0

    def at(self, t_s: Floats) -> MotionTruth:
        """Truth at the times (n,) s, in any order."""
        turn, a, w = self.speed / self.radius, self.sway, self.rate * np.array([1.0, 1.3, 0.7])
        yaw = turn * t_s + a * np.sin(w[0] * t_s)
        pitch, roll = a * np.sin(w[1] * t_s), a * np.cos(w[2] * t_s)
        yaw_rate = turn + a * w[0] * np.cos(w[0] * t_s)
        pitch_rate, roll_rate = a * w[1] * np.cos(w[1] * t_s), -a * w[2] * np.sin(w[2] * t_s)
        gyro_v = np.column_stack(
            (
                roll_rate - yaw_rate * np.sin(pitch),
                pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
                yaw_rate * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
            )
        )
        around = circle(self.radius, self.speed).at(t_s)
        return replace(around, q_nv=from_euler(yaw, pitch, roll), gyro_v=gyro_v)


CIRCLE: Final = RollingCircle()
"""A smooth motion without a stop, for the order of integrators."""
