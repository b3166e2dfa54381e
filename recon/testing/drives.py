"""Drives with truth, as the laws need them: every canonical stream, the box as it is mounted.

The sensors are those of a modest box. `trajectory` is the truth with an error that grows as that of a box alone does;
`reference` is the truth. Everything follows from a seed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor, earth_rate_n, enu_to_geodetic, normal_gravity
from recon.numerics.motion import Drive, MotionTruth, specific_force
from recon.numerics.rotation import (
    Floats,
    conjugate,
    from_euler,
    from_rotvec,
    heading_from_yaw,
    multiply,
    rotate,
    to_rotvec,
)
from recon.numerics.signals import runs
from recon.recording import Recording
from recon.rows import Event, Metric, events, metrics
from recon.schema import (
    APPENDED,
    ATTITUDE,
    BARO,
    FRAMES,
    GNSS,
    GROUND,
    IMU,
    MAG,
    RESIDUALS,
    TRAJECTORY,
    VISUAL,
    WHEEL,
    by_step,
)
from recon.tables import build, with_meta
from recon.testing.motions import ROAD, RollingCircle

START_NS: Final = 1_700_000_000_000_000_000
ANCHOR: Final = Anchor(44.4949, 11.3426, 54.0)
GRAVITY: Final = float(normal_gravity(ANCHOR.lat, ANCHOR.height))
"""m/s^2, everywhere."""
MOUNT_YAW: Final = 0.3
MOUNTING: Final = from_euler(MOUNT_YAW, -0.05, 0.04)
"""Sensor to vehicle, scalar first: the box is turned by 17 deg and not level."""
FIELD_N: Final = np.array([0.0, 22e-6, -42e-6])
"""Magnetic flux density in T, local East-North-Up: pointing north and down."""

_CLOCK: Final = {"time_scale": "UTC", "clock": "absolute"}
_PLACED: Final = {
    **_CLOCK,
    "anchor": {"lat": ANCHOR.lat, "lon": ANCHOR.lon, "height": ANCHOR.height},
    "earth": "wgs84",
    "height_datum": "ellipsoid",
    "heading_kind": "course_true",
}
ACCEL_BIAS_S: Final = (0.03, -0.02, 0.04)
"""m/s^2, sensor."""
DRIFT: Final = 0.02
"""m/s^2, sigma on each axis of the acceleration by which `trajectory` errs."""


@dataclass(frozen=True)
class Conditions:
    """What drives, and how it is seen.

    noise : factor on the noise and bias of all sensors and on the drift of trajectory, 0 for ideal ones
    yaw : rad, turn of the drive and of its errors about the vertical; shift_n : (3,) m, move of the whole drive
    late_ns : shift of all times
    earth : does the Earth rotate under the drive, as it does under real sensors?
    slow : m, sigma on each axis of an error of the fixes that stays for minutes
    motion, step_s : what is driven; s between two samples of the imu
    """

    seed: int = 1
    noise: float = 1.0
    yaw: float = 0.0
    shift_n: tuple[float, float, float] = (0.0, 0.0, 0.0)
    late_ns: int = 0
    earth: bool = False
    slow: float = 0.0
    motion: Drive | RollingCircle = ROAD
    step_s: float = 0.01

    @property
    def turn(self) -> Floats:
        """The rotation by `yaw`: (4,)."""
        return from_euler(self.yaw, 0.0, 0.0)

    def truth(self, step_s: float) -> MotionTruth:
        """The motion, turned and moved, every `step_s`."""
        seen = self.motion.at(np.arange(0.0, self.motion.duration_s, step_s))
        pos_n, vel_n, acc_n = (rotate(self.turn, vector) for vector in (seen.pos_n, seen.vel_n, seen.acc_n))
        pos_n = pos_n + np.asarray(self.shift_n)
        return MotionTruth(seen.t_s, pos_n, vel_n, acc_n, multiply(self.turn, seen.q_nv), seen.gyro_v)


USUAL: Final = Conditions()


@lru_cache(maxsize=16)
def drive(conditions: Conditions = USUAL) -> Recording:
    """The drive with all canonical streams, imu and mag in the sensor frame; `reference` is the truth."""
    rng = np.random.default_rng(conditions.seed)
    streams = {
        **_inertial(conditions, rng),
        **_satellite(conditions, rng),
        **_around(conditions, rng),
        **_others(conditions, rng),
        "events": _events(conditions),
        "metrics": metrics([Metric("earlier", 1.0, "m", note="of a step above")]),
    }
    kept = {name: _with_step(name, table) if name in APPENDED else table for name, table in streams.items()}
    return Recording(kept, {"sources": ["simulated"]})


def _inertial(conditions: Conditions, rng: np.random.Generator) -> dict[str, pa.Table]:
    """imu in the sensor frame; attitude and reference, both the truth; trajectory, which drifts from it."""
    truth = conditions.truth(conditions.step_s)
    rows, noise = len(truth.t_s), conditions.noise
    to_sensor, to_vehicle = conjugate(MOUNTING), conjugate(truth.q_nv)
    earth_n = earth_rate_n(ANCHOR.lat) if conditions.earth else np.zeros(3)
    coriolis_n = 2.0 * np.cross(earth_n, truth.vel_n)
    accel_s = rotate(to_sensor, specific_force(truth, GRAVITY) + rotate(to_vehicle, coriolis_n))
    gyro_s = rotate(to_sensor, truth.gyro_v + rotate(to_vehicle, earth_n))
    accel_s += noise * (np.array(ACCEL_BIAS_S) + 0.02 * rng.standard_normal((rows, 3)))
    gyro_s += noise * (np.array([0.002, -0.001, 0.0015]) + 0.001 * rng.standard_normal((rows, 3)))
    drift_n = noise * DRIFT * rotate(conditions.turn, rng.standard_normal(3))
    time = _times(truth.t_s, conditions)
    return {
        "imu": with_meta(build(IMU, time=time, accel=accel_s, gyro=gyro_s), **_CLOCK),
        "attitude": with_meta(build(ATTITUDE, time=time, q=truth.q_nv), **_CLOCK),
        "trajectory": _trajectory(time, truth, drift_n),
        "reference": _trajectory(time, truth, np.zeros(3)),
    }


def _trajectory(time: NDArray[np.int64], truth: MotionTruth, drift_n: Floats) -> pa.Table:
    """The truth, its position and velocity in error by a constant acceleration: (3,) m/s^2, local."""
    t_s = truth.t_s[:, None]
    pos_n = truth.pos_n + t_s**2 / 2.0 * drift_n
    lat, lon, height = enu_to_geodetic(pos_n, ANCHOR)
    table = build(
        TRAJECTORY,
        time=time,
        pos=pos_n,
        vel=truth.vel_n + t_s * drift_n,
        q=truth.q_nv,
        lat=lat,
        lon=lon,
        height=height,
        accel=rotate(conjugate(truth.q_nv), truth.acc_n),
        gyro=truth.gyro_v,
    )
    return with_meta(table, **_PLACED)


def _satellite(conditions: Conditions, rng: np.random.Generator) -> dict[str, pa.Table]:
    """gnss at 5 Hz with positions both in degrees and in local metres, and residuals made of its noise."""
    truth = conditions.truth(0.2)
    rows, noise = len(truth.t_s), conditions.noise
    error_n = noise * rotate(conditions.turn, rng.standard_normal((rows, 3)))
    slow_n = conditions.slow * _slow(truth.t_s, np.random.default_rng((conditions.seed, 1)))
    pos_n = truth.pos_n + error_n + rotate(conditions.turn, slow_n)
    vel_n = truth.vel_n + 0.05 * noise * rotate(conditions.turn, rng.standard_normal((rows, 3)))
    lat, lon, height = enu_to_geodetic(pos_n, ANCHOR)
    time = _times(truth.t_s, conditions)
    gnss = build(
        GNSS,
        time=time,
        lat=lat,
        lon=lon,
        height=height,
        speed=np.hypot(vel_n[:, 0], vel_n[:, 1]),
        course=heading_from_yaw(np.arctan2(vel_n[:, 1], vel_n[:, 0])),
        vel=vel_n,
        pos_std=np.full((rows, 3), max(noise, 0.01)),
        vel_std=np.full((rows, 3), max(0.05 * noise, 0.001)),
        fix=np.full(rows, 3, dtype=np.int32),
        satellites=np.full(rows, 12, dtype=np.int32),
        pos=pos_n,
        acc=truth.acc_n,
    )
    residuals = build(
        RESIDUALS,
        time=time,
        sensor=pa.array(["gnss"] * rows),
        component=pa.array(["pos_e"] * rows),
        value=error_n[:, 0],
        sigma=np.full(rows, 1.0),
        weight=np.full(rows, 1.0),
        accepted=pa.array([True] * rows),
    )
    return {"gnss": with_meta(gnss, **_PLACED), "residuals": with_meta(residuals, **_CLOCK)}


def _slow(t_s: Floats, rng: np.random.Generator) -> Floats:
    """A Gauss-Markov process of first order with sigma 1 and 300 s (Gelb 1974, ch. 3.6): (n, 3)."""
    kept = np.exp(-np.diff(t_s, prepend=t_s[0]) / 300.0)[:, None]
    steps = np.sqrt(1.0 - kept**2) * rng.standard_normal((len(t_s), 3))
    left = np.cumprod(kept, axis=0)
    return np.asarray(left * (rng.standard_normal(3) + np.cumsum(steps / left, axis=0)))


def _around(conditions: Conditions, rng: np.random.Generator) -> dict[str, pa.Table]:
    """ground and visual at 10 Hz: what a map and a camera tell."""
    truth = conditions.truth(0.1)
    rows, noise = len(truth.t_s), conditions.noise
    time = _times(truth.t_s, conditions)
    lat, lon, ground = enu_to_geodetic(truth.pos_n * (1.0, 1.0, 0.0), ANCHOR)
    q_ns = multiply(truth.q_nv, MOUNTING)
    vel_s = rotate(conjugate(q_ns), truth.vel_n)
    speed = np.linalg.norm(vel_s, axis=1)
    turn = multiply(conjugate(q_ns), np.vstack((q_ns[1:], q_ns[-1:])))
    half = from_rotvec(0.5 * to_rotvec(turn))  # from image to image it goes along the chord
    streams = {
        "ground": build(
            GROUND,
            time=time,
            lat=lat,
            lon=lon,
            height=ground,
            slope_e=np.zeros(rows),
            slope_n=np.zeros(rows),
            height_std=np.full(rows, 1.0),
        ),
        "visual": build(
            VISUAL,
            time=time,
            end_time=time + 100_000_000,
            q=multiply(turn, from_rotvec(0.002 * noise * rng.standard_normal((rows, 3)))),
            direction=rotate(half, vel_s / np.maximum(speed, 1e-9)[:, None]),
            rotation_std=np.full(rows, 0.002),
            direction_std=np.where(speed > 1.0, 0.02, np.nan),
        ),
    }
    return {name: with_meta(table, **_CLOCK) for name, table in streams.items()}


def _others(conditions: Conditions, rng: np.random.Generator) -> dict[str, pa.Table]:
    """mag, baro, wheel and frames at 10 Hz."""
    truth = conditions.truth(0.1)
    rows, noise = len(truth.t_s), conditions.noise
    time = _times(truth.t_s, conditions)
    field_s = rotate(conjugate(multiply(truth.q_nv, MOUNTING)), FIELD_N)
    height = ANCHOR.height + truth.pos_n[:, 2]
    pressure = 101_325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588
    streams = {
        "mag": build(MAG, time=time, mag=field_s + 3e-7 * noise * rng.standard_normal((rows, 3))),
        "baro": build(BARO, time=time, pressure=pressure + 3.0 * noise * rng.standard_normal(rows)),
        "wheel": build(WHEEL, time=time, speed=np.linalg.norm(truth.vel_n, axis=1)),
        "frames": build(
            FRAMES,
            time=time,
            index=np.arange(rows),
            file=pa.array([f"{index:06d}.jpg" for index in range(rows)]),
        ),
    }
    return {name: with_meta(table, **_CLOCK) for name, table in streams.items()}


def _events(conditions: Conditions) -> pa.Table:
    """The standstills, by the truth."""
    truth = conditions.truth(0.01)
    still = runs(np.linalg.norm(truth.vel_n, axis=1) == 0.0)
    times = _times(truth.t_s, conditions)
    return events([Event(int(times[a]), int(times[b - 1]), "standstill") for a, b in still if b - a > 100])


def _times(t_s: Floats, conditions: Conditions) -> NDArray[np.int64]:
    return START_NS + conditions.late_ns + np.round(t_s * 1e9).astype(np.int64)


def _with_step(stream: str, table: pa.Table) -> pa.Table:
    columns = {name: table[name] for name in table.column_names}
    return build(by_step(stream), step=pa.array(["above"] * table.num_rows), **columns)
