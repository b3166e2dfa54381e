"""What a peer is given, what it gives back, and the truth.

Frames: `_n` East-North-Up at the anchor, fixed to the Earth and to a plane (it does not follow the curvature); `_s` the
sensor, that is the IMU; `_v` the vehicle (ISO 8855).

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., section 2.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from recon.numerics.geodesy import earth_rate_n, normal_gravity
from recon.numerics.rotation import Floats

EARTH_RADIUS = 6_378_000.0
"""m, for the direction of gravity away from the anchor: to first order, any mean radius will do."""


@dataclass(frozen=True)
class World:
    """Gravity and rotation about the anchor.

    gravity : m/s^2 at the anchor, centrifugal force included
    earth_rate_n : (3,) rad/s
    radius : m, of the Earth; infinite where a simulation drives on a plane
    """

    gravity: float
    earth_rate_n: Floats
    radius: float

    @classmethod
    def at(cls, lat_deg: float, height: float = 0.0) -> World:
        """The Earth below an anchor at lat_deg and height in m."""
        return cls(float(normal_gravity(lat_deg, height)), earth_rate_n(lat_deg), EARTH_RADIUS)

    @classmethod
    def plane(cls, gravity: float) -> World:
        """A plane that does not turn; gravity in m/s^2."""
        return cls(gravity, np.zeros(3), np.inf)

    def gravity_at(self, pos_n: Floats) -> Floats:
        """Gravity to first order in the distance: (..., 3) m/s^2 at pos_n (..., 3) m."""
        east, north, up = np.moveaxis(pos_n / self.radius, -1, 0)
        return -self.gravity * np.stack([east, north, 1.0 - 2.0 * up], axis=-1)


@dataclass(frozen=True)
class Noise:
    """The class of the sensors: one sigma of each error, as a data sheet and a look at the log tell.

    gyro, accel : rad/s/sqrt(Hz), m/s^2/sqrt(Hz), density of white noise
    gyro_walk, accel_walk : rad/s/sqrt(s), m/s^2/sqrt(s), random walk of the biases
    gyro_bias, accel_bias : rad/s, m/s^2, at the start
    gyro_scale : 1
    drift_n, drift_s : (3,) m and s, Gauss-Markov error of the GNSS position and its correlation time
    white_n : (3,) m, white error of the GNSS position
    velocity_n : (3,) m/s, white error of the GNSS velocity
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
    gyro_bias: float
    accel_bias: float
    gyro_scale: float
    drift_n: Floats
    drift_s: float
    white_n: Floats
    velocity_n: Floats


@dataclass(frozen=True)
class Drive:
    """A log, and what a peer is told besides.

    t_s : (n,) s, rising; gyro_s, accel_s : (n, 3) rad/s and m/s^2 (specific force), sensor
    fix_t_s : (m,) s, rising, inside t_s; fix_pos_n, fix_vel_n : (m, 3) m and m/s, of the antenna
    noise, world : see there
    start_q_ns : (4,) attitude at t_s[0]
    lever_s, rear_s : (3,) m, from the IMU to the antenna and to the middle of the rear axle
    mount_q_vs : (4,) sensor to vehicle
    """

    t_s: Floats
    gyro_s: Floats
    accel_s: Floats
    fix_t_s: Floats
    fix_pos_n: Floats
    fix_vel_n: Floats
    noise: Noise
    world: World
    start_q_ns: Floats
    lever_s: Floats
    rear_s: Floats
    mount_q_vs: Floats


@dataclass(frozen=True)
class Estimate:
    """A trajectory of the IMU, at times of the peer's own choice; the truth has the same form.

    t_s : (k,) s, rising; pos_n, vel_n : (k, 3) m and m/s; q_ns : (k, 4)
    pos_std_n : (k, 3) m, what it tells of its positions; None where it tells nothing
    """

    t_s: Floats
    pos_n: Floats
    vel_n: Floats
    q_ns: Floats
    pos_std_n: Floats | None = None


Solve: TypeAlias = Callable[[Drive], Estimate]
