"""What the smoother is told: what was logged, how a car moves, how large random errors are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing.aids import Aid
from recon.numerics.smoothing.measurements import Fixes
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats


@dataclass(frozen=True)
class Noise:
    """Sizes of the random errors.

    gyro, accel : densities rad/s/sqrt(Hz), m/s^2/sqrt(Hz); gyro_walk, accel_walk : rad/s/sqrt(s), m/s^2/sqrt(s)
    drift : (3,) m, drift_tau : s, of the slow error of GNSS positions
    position, velocity : (3,) factors on the sigmas of the fixes
    sideways, upwards : m/s, motion of the wheels across their track, mean of a second
    bank : rad, of the road, mean of a stretch
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
    drift: Floats
    drift_tau: float
    position: Floats
    velocity: Floats
    sideways: float = 0.05
    upwards: float = 0.05
    bank: float = np.radians(1.5)


@dataclass(frozen=True)
class Model:
    """How a car moves, and what is known beforehand. Of scales, lags, slip, pitch, roll, wheel and mounting a
    sigma of zero fixes the value at its mean.

    gyro_bias rad/s, accel_bias m/s^2, gyro_scale, accel_scale 1 : sigmas
    mounting : (3, 3) vehicle from sensor, None for the closed form's; mounting_sigma : (3,) rad
    lever, rear : (3,) m, vehicle, mean; lever_sigma, rear_sigma : (3,) m
    camera : rad, sigma of the axes of a camera, 0 where there is none; camera_lever : (3,) m, sensor, mean;
        camera_lever_sigma : m
    baro : 1, sigma of the scale of a barometer's climbs, 0 where there is none
    lag, velocity_lag s; clock 1; slip, pitch, roll s^2/m; wheel 1 : sigmas
    lean : s^2/m, roll per lateral acceleration about which the sigma `roll` holds it
    wheels : does it roll on wheels, so that it moves forward only
    slip_growth : growth of the sigma of motion across with slip
    stop m/s, stop_heading, stop_tilt rad/sqrt(s) : how still a standing vehicle is
    road_stretch : m and s, a bank of the road holds for the one plus the speed times the other
    first_attitude : (3, 3) n from sensor at the first knot, None where not known; first_attitude_sigma : (3,) rad,
        about axes n
    """

    gyro_bias: float = np.radians(1.0)
    accel_bias: float = 0.5
    gyro_scale: float = 0.005
    accel_scale: float = 0.003
    mounting: Floats | None = None
    mounting_sigma: tuple[float, float, float] = (np.radians(10.0),) * 3
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lever_sigma: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rear: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rear_sigma: tuple[float, float, float] = (1.5, 1.5, 1.5)
    camera: float = 0.0
    camera_lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    camera_lever_sigma: float = 0.0
    baro: float = 0.0
    lag: float = 0.1
    velocity_lag: float = 0.1
    clock: float = 5e-5
    slip: float = 0.01
    pitch: float = 0.01
    roll: float = 0.01
    lean: float = 0.0
    wheel: float = 0.02
    wheel_speed: float = 0.1
    wheels: bool = True
    slip_growth: float = 0.004
    stop: float = 0.02
    stop_heading: float = 3e-5
    stop_tilt: float = 1e-4
    road_stretch: tuple[float, float] = (20.0, 10.0)
    first_attitude: Floats | None = None
    first_attitude_sigma: tuple[float, float, float] = (np.radians(1.0),) * 3


@dataclass(frozen=True)
class Impact:
    """A time in which the vehicle is pushed, or turns faster than the gyroscope tells, and what that does to the model.

    start_s, end_s : s; knots stand there, and biases do not change in between
    velocity, turn : m/s and rad, sigmas of what the IMU misses of the changes of velocity and attitude
    slip_s : s after the end in which wheels may slip, unless it stands before
    """

    start_s: float
    end_s: float
    velocity: float
    slip_s: float
    turn: float = 0.0


@dataclass(frozen=True)
class Drive:
    """What was logged. wheel_t_s : (w,) s, wheel_speed : (w,) m/s, without rows where there are no wheels' speeds;
    aids : what other sensors add; impacts : in the order of time
    """

    samples: Samples
    fixes: Fixes
    anchor: Anchor
    wheel_t_s: Floats
    wheel_speed: Floats
    aids: tuple[Aid, ...] = ()
    impacts: tuple[Impact, ...] = ()
