"""What is true of a moving body, and what an ideal accelerometer on it feels.

    f_v = R_vn (a_n - g_n),  g_n = (0, 0, -g)

so a body at rest and level feels +g along z. The local frame n (East-North-Up) is taken as inertial here; what the
ellipsoid and its rotation add is in `earth`.

References: Titterton and Weston, Strapdown Inertial Navigation Technology (2004), sec. 3.5; ISO 8855:2011 for the
vehicle frame (x forward, y left, z up).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import Floats, conjugate, rotate


@dataclass(frozen=True)
class MotionTruth:
    """State of a body at n times.

    t_s : (n,) s
    pos_n, vel_n, acc_n : (n, 3) m, m/s, m/s^2, local East-North-Up; acc_n is the acceleration, without gravity
    q_nv : (n, 4) scalar first, takes vehicle to local; continuous in time, so it may have a negative scalar part
    gyro_v : (n, 3) rad/s, angular rate of the vehicle relative to the local frame, in the vehicle frame
    """

    t_s: Floats
    pos_n: Floats
    vel_n: Floats
    acc_n: Floats
    q_nv: Floats
    gyro_v: Floats


@dataclass(frozen=True)
class RoadTruth(MotionTruth):
    """State of a body whose other points are wanted as well, as a lever arm needs it.

    gyro_rate_v : (n, 3) rad/s^2, derivative of gyro_v
    """

    gyro_rate_v: Floats


class Motion(Protocol):
    """Anything that knows its truth at any time, also before its start and after its end."""

    def at(self, t_s: Floats) -> MotionTruth:
        """Truth at the times (n,) s, in any order."""
        ...


def specific_force(truth: MotionTruth, gravity: float = STANDARD_GRAVITY) -> Floats:
    """What an ideal accelerometer at the origin of the vehicle frame reads.

    gravity : m/s^2, magnitude, downwards
    returns : (n, 3) m/s^2, vehicle
    """
    return rotate(conjugate(truth.q_nv), truth.acc_n + np.array([0.0, 0.0, gravity]))
