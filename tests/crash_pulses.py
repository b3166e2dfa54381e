"""Specific forces of a car in which something happens: crashes, and what must not be taken for one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import STANDARD_GRAVITY as G
from recon.schema import IMU
from recon.tables import Array, build

RATE_HZ = 400.0
LENGTH_S = 20.0
ZERO_S = 10.0


def times(rate_hz: float = RATE_HZ, length_s: float = LENGTH_S) -> Array:
    return np.arange(round(rate_hz * length_s)) / rate_hz


def at_rest(t_s: Array) -> Array:
    """(n, 3) m/s^2 of a still, level box."""
    return np.tile([0.0, 0.0, G], (len(t_s), 1))


def pulse(t_s: Array, start_s: float, length_s: float, shape: str = "haversine") -> Array:
    """A pulse of unit area, 1/s: (n,)."""
    x = (t_s - start_s) / length_s
    inside = (x >= 0.0) & (x <= 1.0)
    y = {
        "haversine": 2.0 * np.sin(np.pi * x) ** 2,
        "half_sine": 0.5 * np.pi * np.sin(np.pi * x),
        "triangle": 4.0 * np.minimum(x, 1.0 - x),
        "trapezoid": np.minimum(np.minimum(x, 1.0 - x) / 0.2, 1.0) / 0.8,
    }[shape]
    return np.where(inside, y, 0.0) / length_s


def imu_of(t_s: Array, accel: Array, gyro: Array | None = None, schema: Any = IMU) -> pa.Table:
    """The imu stream of a box."""
    turn = np.zeros_like(accel) if gyro is None else gyro
    return build(schema, time=np.rint(t_s * 1e9).astype(np.int64), accel=accel, gyro=turn)


def noisy(accel: Array, sigma: float = 0.1, seed: int = 0) -> Array:
    return accel + np.random.default_rng(seed).normal(0.0, sigma, accel.shape)


def crash(t_s: Array, delta_v: tuple[float, float], length_s: float = 0.12, shape: str = "haversine") -> Array:
    """delta_v : m/s, forward and left."""
    accel = at_rest(t_s)
    accel[:, :2] += pulse(t_s, ZERO_S, length_s, shape)[:, None] * np.array(delta_v)
    return accel


def hard_braking(t_s: Array) -> Array:
    """1 g for a second and a half, with the shudder of an anti-lock brake (15 Hz, 0.2 g)."""
    accel = at_rest(t_s)
    x = t_s - ZERO_S
    on = np.clip(np.minimum(x / 0.2, (1.5 - x) / 0.1), 0.0, 1.0)
    accel[:, 0] -= on * G * (1.0 + 0.2 * np.sin(2.0 * np.pi * 15.0 * x))
    return accel


def pothole(t_s: Array) -> Array:
    """At 60 km/h: down and up again by 4 g, and 2.5 g backwards for 25 ms at each axle."""
    accel = at_rest(t_s)
    for after_s in (0.0, 0.16):
        start_s = ZERO_S + after_s
        accel[:, 2] += pulse(t_s, start_s, 0.03) * -0.6 + pulse(t_s, start_s + 0.025, 0.04) * 0.8
        accel[:, 0] -= pulse(t_s, start_s + 0.02, 0.025) * 0.3
    return accel


def kerb(t_s: Array) -> Array:
    """A kerb at 15 km/h with one wheel, then the other: 3 g up, 1.6 m/s lost in 60 ms in all, 0.5 m/s sideways."""
    accel = at_rest(t_s)
    for after_s in (0.0, 0.25):
        shove = pulse(t_s, ZERO_S + after_s, 0.06)
        accel += shove[:, None] * np.array([-0.8, 0.25, 0.9])
    return accel


def door_slam(t_s: Array) -> Array:
    """The body rings at 35 Hz with 3 g aside and 1 g up, gone after 150 ms."""
    accel = at_rest(t_s)
    x = np.clip(t_s - ZERO_S, 0.0, None)
    ring = np.exp(-x / 0.05) * np.sin(2.0 * np.pi * 35.0 * x)
    return accel + ring[:, None] * np.array([0.5, 3.0, 1.0]) * G


def speed_bump(t_s: Array) -> Array:
    """At 30 km/h: thrown up by 1.5 g and down by 1 g at each axle, 0.5 g backwards while it climbs."""
    accel = at_rest(t_s)
    for after_s in (0.0, 0.32):
        up, down = pulse(t_s, ZERO_S + after_s, 0.12), pulse(t_s, ZERO_S + after_s + 0.12, 0.12)
        accel += up[:, None] * np.array([-0.3, 0.0, 0.9]) - down[:, None] * np.array([-0.1, 0.0, 0.6])
    return accel


def railway_crossing(t_s: Array) -> Array:
    """Eight blows of the wheels on rails within a second, each 2 g up and 0.8 g to one side and back in 15 ms."""
    accel = at_rest(t_s)
    for blow in range(8):
        start_s = ZERO_S + 0.13 * blow
        jolt = pulse(t_s, start_s, 0.015) - 0.8 * pulse(t_s, start_s + 0.02, 0.02)
        accel += jolt[:, None] * np.array([-0.06, 0.06 * (-1.0) ** blow, 0.15])
    return accel


def gravel(t_s: Array) -> Array:
    """Three seconds of a rumble of the wheels' hop (9 to 14 Hz), 0.5 g aside and along, 1 g up."""
    accel = at_rest(t_s)
    x = t_s - ZERO_S
    on = np.clip(np.minimum(x, 3.0 - x) / 0.3, 0.0, 1.0)
    for axis, (size, tone_hz) in enumerate(((0.5, 9.0), (0.5, 11.0), (1.0, 14.0))):
        accel[:, axis] += on * G * size * np.sin(2.0 * np.pi * tone_hz * x) * np.cos(2.0 * np.pi * 0.7 * x)
    return accel


def phone_drop(t_s: Array) -> Array:
    """From 0.8 m, tumbling: 0.4 s weightless, then 60 g for 12 ms across the axis that had pointed up, and a bounce."""
    accel = at_rest(t_s)
    fall = (t_s > ZERO_S - 0.4) & (t_s < ZERO_S)
    accel[fall] = [0.1, -0.2, 0.3]
    hit = pulse(t_s, ZERO_S, 0.012)[:, None] * np.array([4.5, 1.5, 1.0])
    bounce = (t_s > ZERO_S + 0.012) & (t_s < ZERO_S + 0.11)
    accel[bounce] = [0.0, 0.2, -0.1]
    return accel + hit + pulse(t_s, ZERO_S + 0.11, 0.02)[:, None] * np.array([-0.5, 1.0, 0.8])
