"""A car on a level circle at constant speed, as a box in its middle feels it.

    yaw = v t / r,  pos = r (sin yaw, 1 - cos yaw, 0),  specific force = (0, v^2 / r, g),  rate = (0, 0, v / r)

The accelerometers are noisy, the gyroscopes perfect.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np

from recon import IMU, REFERENCE, Params, Simulator, Streams, build, hookimpl, quantity, setting
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import from_euler

START_NS: Final = 1_714_550_400_000_000_000


class CircleParams(Params):
    """Parameters of simulator.$name."""

    speed: float = quantity(36.0, "km/h", gt=0, doc="Speed along the circle.")
    radius: float = quantity(25.0, "m", gt=0, doc="Radius of the circle.")
    duration: float = quantity(20.0, "s", gt=0, doc="Length of the record.")
    rate: float = quantity(100.0, "Hz", gt=0, doc="Samples per second.")
    noise: float = quantity(0.02, "m/s^2", ge=0, doc="Sigma of the noise of each accelerometer.")
    seed: int = setting(0, ge=0, doc="Seed of the noise.")


def circle(*, params: CircleParams) -> Streams:
    """The streams `imu` (axes of the vehicle) and `reference`, the truth."""
    t_s = np.arange(0.0, params.duration, 1.0 / params.rate)
    rate = params.speed / params.radius
    yaw = rate * t_s
    zero, one = np.zeros_like(t_s), np.ones_like(t_s)
    pos_n = params.radius * np.column_stack([np.sin(yaw), 1.0 - np.cos(yaw), zero])
    vel_n = params.speed * np.column_stack([np.cos(yaw), np.sin(yaw), zero])
    acc_v = np.column_stack([zero, params.speed * rate * one, zero])
    gyro_v = np.column_stack([zero, zero, rate * one])
    force_v = acc_v + np.array([0.0, 0.0, STANDARD_GRAVITY])
    noise = params.noise * np.random.default_rng(params.seed).standard_normal(acc_v.shape)
    time = START_NS + np.round(t_s * 1e9).astype(np.int64)
    q_nv = from_euler(yaw, 0.0, 0.0)
    return {
        "imu": build(IMU, time=time, accel=force_v + noise, gyro=gyro_v),
        "reference": build(REFERENCE, time=time, pos=pos_n, vel=vel_n, q=q_nv, accel=acc_v, gyro=gyro_v),
    }


@hookimpl
def declare_simulators() -> Iterable[Simulator]:
    """simulator.$name."""
    yield Simulator(
        name="$name",
        summary="A car on a circle.",
        params=CircleParams,
        run=circle,
        writes={"imu": IMU, "reference": REFERENCE},
        ideal={"noise": 0.0},
    )
