"""A point that runs round a circle while it climbs and swings up and down: a coil spring, in closed form.

    p_n = (r sin(w t), r (1 - cos(w t)), c t + A sin(W t))

It starts at the origin towards the east. The spring is the classic test of an integrator; the flat circle with a body
that turns along, as a car in a roundabout does, that of an integrator with attitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.numerics.motion.truth import MotionTruth
from recon.numerics.rotation import Floats, from_euler


@dataclass(frozen=True)
class Spring:
    """Circle, climb and vertical oscillation.

    radius : m
    rate : rad/s round the circle, positive to the left (counter-clockwise seen from above)
    climb : m/s, steady
    amplitude, oscillation : m and rad/s of the vertical swing
    turning : True: the yaw of the body follows the course; False: the body keeps facing east. It stays level.
    """

    radius: float
    rate: float
    climb: float = 0.0
    amplitude: float = 0.0
    oscillation: float = 0.0
    turning: bool = True

    def at(self, t_s: Floats) -> MotionTruth:
        """Truth at the times (n,) s, in any order."""
        r, w, amplitude, swing = self.radius, self.rate, self.amplitude, self.oscillation
        sin, cos, zero = np.sin(w * t_s), np.cos(w * t_s), np.zeros_like(t_s)
        up, up_cos = amplitude * np.sin(swing * t_s), amplitude * np.cos(swing * t_s)
        turn_rate = w if self.turning else 0.0
        return MotionTruth(
            t_s=t_s,
            pos_n=np.column_stack((r * sin, 2.0 * r * np.sin(w * t_s / 2.0) ** 2, self.climb * t_s + up)),
            vel_n=np.column_stack((r * w * cos, r * w * sin, self.climb + swing * up_cos)),
            acc_n=np.column_stack((-r * w**2 * sin, r * w**2 * cos, -(swing**2) * up)),
            q_nv=from_euler(turn_rate * t_s, zero, zero),
            gyro_v=np.column_stack((zero, zero, np.full_like(t_s, turn_rate))),
        )


def circle(radius: float, speed: float, *, turning: bool = True) -> Spring:
    """Flat circle to the left at constant speed. radius : m; speed : m/s."""
    return Spring(radius=radius, rate=speed / radius, turning=turning)
