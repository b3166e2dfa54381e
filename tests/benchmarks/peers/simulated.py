"""Drives of simulator.drive as the peers take them, with their truth.

The simulator tells velocity and attitude relative to East, North and Up of the place where the vehicle is; here they
are turned to the axes of the anchor. The noise that a peer is told is what the simulator draws from, so no peer is
tuned worse than it could be; the vibration of the moving car is not told, nor is any outlier. Sensors "perfect" have
sigmas of zero, which no filter takes: tell the peer others.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import Anchor, geodetic_to_enu, local_axes_e
from recon.numerics.rotation import Floats, conjugate, from_euler, from_matrix, multiply, rotate
from recon.tables import matrix, time_ns, vector
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams
from recon_simulators.presets import NAMES, preset_value

from .drives import Drive, Estimate, Noise, World

_LEAST: Final = 0.01
"""m, s or m/s: smaller sigmas and times would only make covariances singular."""
_LEAST_SCALE: Final = 1e-4
"""As _LEAST, for the scale of the gyro."""


def simulated(params: DriveParams) -> tuple[Drive, Estimate]:
    """What the peers are given of a simulated drive, and the truth. Raises DataError as simulator.drive."""
    streams = simulate_drive(params)
    values = {name: preset_value(params.sensors, name) if own is None else own for name, own in _own(params)}
    anchor = Anchor(float(np.degrees(params.lat)), float(np.degrees(params.lon)), params.height)
    q_vs = from_euler(values["mount_yaw"], values["mount_pitch"], values["mount_roll"])
    imu, gnss = streams["imu"], streams["gnss"]
    start_ns = int(time_ns(imu)[0])
    truth = _truth(streams["reference"], anchor, q_vs, start_ns)
    lever_s, rear_s = (rotate(conjugate(q_vs), np.array(values[name])) for name in ("lever_arm", "rear_axle"))
    fix_t_s = _since(gnss, start_ns)
    used = (fix_t_s >= truth.t_s[0]) & (fix_t_s <= truth.t_s[-1])
    lat, lon, height = (vector(gnss, name) for name in ("lat", "lon", "height"))
    drive = Drive(
        t_s=truth.t_s,
        gyro_s=matrix(imu, "gyro"),
        accel_s=matrix(imu, "accel"),
        fix_t_s=fix_t_s[used],
        fix_pos_n=geodetic_to_enu(lat, lon, height, anchor)[used],
        fix_vel_n=rotate(_turn_to(anchor, lat, lon), matrix(gnss, "vel"))[used],
        noise=_noise(values, params.instability_time),
        world=World.at(anchor.lat, anchor.height),
        start_q_ns=truth.q_ns[0],
        lever_s=lever_s,
        rear_s=rear_s,
        mount_q_vs=q_vs,
    )
    return drive, truth


def _own(params: DriveParams) -> list[tuple[str, Any]]:
    return [(name, getattr(params, name)) for name in NAMES]


def _since(table: pa.Table, start_ns: int) -> Floats:
    return np.asarray((time_ns(table) - start_ns) * 1e-9)


def _truth(reference: pa.Table, anchor: Anchor, q_vs: Floats, start_ns: int) -> Estimate:
    turn = _turn_to(anchor, vector(reference, "lat"), vector(reference, "lon"))
    return Estimate(
        _since(reference, start_ns),
        matrix(reference, "pos"),
        rotate(turn, matrix(reference, "vel")),
        multiply(turn, multiply(matrix(reference, "q"), q_vs)),
    )


def _turn_to(anchor: Anchor, lat: Floats, lon: Floats) -> Floats:
    """Rotations (n, 4) from the axes of each place to those of the anchor."""
    axes_e = np.moveaxis(local_axes_e(lat, lon), -1, 0)
    return from_matrix(local_axes_e(anchor.lat, anchor.lon).T @ axes_e)


def _noise(values: dict[str, Any], instability_s: float) -> Noise:
    """A slow change of the biases counts as the random walk that it is over short times, sigma sqrt(2 / tau)."""
    share = np.sqrt(2.0 / instability_s)
    gyro_walk, accel_walk = (
        float(np.hypot(values[f"{sensor}_bias_walk"], share * values[f"{sensor}_instability"]))
        for sensor in ("gyro", "accel")
    )
    drift, white = (
        np.maximum([values[f"gnss_{kind}{axis}"] for axis in ("horizontal", "horizontal", "vertical")], _LEAST)
        for kind in ("", "white_")
    )
    velocity = [values[f"gnss_velocity{axis}"] for axis in ("", "", "_vertical")]
    return Noise(
        gyro=values["gyro_noise"],
        accel=values["accel_noise"],
        gyro_walk=gyro_walk,
        accel_walk=accel_walk,
        gyro_bias=values["gyro_bias"],
        accel_bias=values["accel_bias"],
        gyro_scale=max(values["gyro_scale"], _LEAST_SCALE),
        drift_n=drift,
        drift_s=max(values["gnss_correlation"], _LEAST),
        white_n=white,
        velocity_n=np.maximum(velocity, _LEAST),
    )
