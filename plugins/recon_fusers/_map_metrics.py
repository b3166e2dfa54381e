"""Every number that fuser.map found beside the trajectory, with its sigma."""

from __future__ import annotations

from typing import Final

import numpy as np

from recon import Array, Metric
from recon.driving import mounting_metrics
from recon.fixes import Observed
from recon.numerics.smoothing import Estimate
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    BARO,
    CAMERA,
    CAMERA_LEVER,
    CLOCK,
    GYRO_BIAS,
    GYRO_SCALE,
    LAG,
    LEVER,
    PITCH,
    REAR,
    ROLL,
    SLIP,
    VELOCITY_LAG,
    WHEEL,
)

_HOW: Final = "maximum a posteriori"
_LEANS: Final = "it leans into bends, as what has two wheels does"
_OF_SENSOR: Final = (
    ("gyro_scale", GYRO_SCALE, "1", 1.0), ("accel_scale", ACCEL_SCALE, "1", 1.0),
    ("camera_turned", CAMERA, "deg", np.degrees(1.0)), ("camera_lever", CAMERA_LEVER, "m", 1.0),
)  # fmt: skip
_OF_VEHICLE: Final = (
    ("gnss_delay", LAG, "s", -1.0), ("gnss_velocity_delay", VELOCITY_LAG, "s", -1.0),
    ("gnss_clock_drift", CLOCK, "ppm", -1e6),
    ("side_slip_per_acceleration", SLIP, "s^2/m", 1.0), ("pitch_per_acceleration", PITCH, "s^2/m", 1.0),
    ("roll_per_acceleration", ROLL, "s^2/m", 1.0), ("wheel_speed_scale", WHEEL, "1", 1.0),
)  # fmt: skip
"""Name, unknown, unit of the metric, and that by which the unknown is multiplied."""


def estimates(found: Estimate, observed: Observed) -> list[Metric]:
    """What does not change in a drive, biases, and sizes of noise; what is not estimated is left out."""
    deviation = np.sqrt(np.maximum(np.diag(found.covariance_common), 0.0))
    return [
        *mounting_metrics(found),
        *_lever(found, "lever_arm", LEVER),
        *_lever(found, "rear_axle", REAR),
        *_vehicle(found, deviation),
        *_biases(found),
        *_sensor(found, deviation),
        *_noise(found, observed),
    ]


def _lever(found: Estimate, name: str, part: slice) -> list[Metric]:
    rot_vs = found.solved.state.rot_vs
    variance = np.diag(rot_vs @ found.covariance_common[part, part] @ rot_vs.T)
    if not variance.any():
        return []
    note = "vehicle, from the IMU"
    return [
        Metric(f"{name}_{axis}", float(value), "m", float(np.sqrt(max(v, 0.0))), method=_HOW, note=note)
        for axis, value, v in zip("xyz", rot_vs @ found.solved.state.common[part], variance, strict=True)
    ]


def _vehicle(found: Estimate, deviation: Array) -> list[Metric]:
    """Delays, and how the body leans, slips and rolls."""
    solved, rows = found.solved, []
    common = solved.state.common
    for name, index, unit, factor in _OF_VEHICLE:
        if deviation[index] > 0.0 and (index != WHEEL or len(found.smoother.drive.wheel_t_s)):
            value = common[index] + (solved.moved_lag if index == LAG else 0.0)
            note = _LEANS if index == ROLL and found.smoother.model.lean else ""
            sigma = abs(factor) * float(deviation[index])
            rows.append(Metric(name, factor * float(value), unit, sigma, method=_HOW, note=note))
    if deviation[BARO] > 0.0:
        scale, note = 1.0 + float(common[BARO]), "of the standard atmosphere's climbs"
        rows.append(Metric("baro_scale", scale, "1", float(deviation[BARO]), method=_HOW, note=note))
    return rows


def _sensor(found: Estimate, deviation: Array) -> list[Metric]:
    """Scale errors, and where the camera is."""
    common = found.solved.state.common
    return [
        Metric(f"{name}_{axis}", float(v) * factor, unit, float(s) * factor, method=_HOW, note="sensor frame")
        for name, part, unit, factor in _OF_SENSOR
        for axis, v, s in zip("xyz", common[part], deviation[part], strict=True)
        if s > 0.0
    ]


def _biases(found: Estimate) -> list[Metric]:
    state = found.solved.state
    rows = []
    for name, values, part, unit, factor in (
        ("gyro_bias", state.gyro_bias, GYRO_BIAS, "deg/s", np.degrees(1.0)),
        ("accel_bias", state.accel_bias, ACCEL_BIAS, "m/s^2", 1.0),
    ):
        deviation = np.sqrt(np.maximum(np.diagonal(found.covariance[:, part, part], axis1=1, axis2=2).min(axis=0), 0.0))
        rows += [
            Metric(
                f"{name}_{axis}", float(v.mean()) * factor, unit, float(s) * factor, float(v.min()) * factor,
                float(v.max()) * factor, "mean over the drive", "sensor frame; low and high are those of the drive"
            )
            for axis, v, s in zip("xyz", values, deviation, strict=True)
        ]  # fmt: skip
    return rows


def _noise(found: Estimate, observed: Observed) -> list[Metric]:
    noise, solved = found.solved.noise, found.solved
    fixes = observed.fixes
    rows = [
        Metric("gyro_noise", float(np.degrees(noise.gyro)), "deg/s/sqrt(Hz)", note="in the moving vehicle"),
        Metric("accel_noise", noise.accel, "m/s^2/sqrt(Hz)", note="in the moving vehicle"),
        Metric("gyro_bias_walk", float(np.degrees(noise.gyro_walk)), "deg/s/sqrt(s)"),
        Metric("accel_bias_walk", noise.accel_walk, "m/s^2/sqrt(s)"),
        Metric("motion_sideways", noise.sideways, "m/s", note="of the wheels, mean of a second"),
        Metric("motion_upwards", noise.upwards, "m/s", note="of the wheels, mean of a second"),
        Metric("road_bank", float(np.degrees(noise.bank)), "deg", note="sigma, mean of a stretch of road"),
    ]
    if np.isfinite(fixes.pos_sigma).any():
        rows += [
            Metric("gnss_slow_error_horizontal", float(noise.drift[0]), "m", note="sigma of each axis"),
            Metric("gnss_slow_error_vertical", float(noise.drift[2]), "m"),
            Metric("gnss_slow_error_time", noise.drift_tau, "s", note="correlation time"),
            Metric("gnss_position_noise_factor", float(noise.position[0]), "1", note="on the white sigma"),
        ]
    if np.isfinite(fixes.vel_sigma).any():
        rows.append(Metric("gnss_velocity_noise_factor", float(noise.velocity[0]), "1", note="on the sigma"))
    used = solved.epochs.fix >= 0
    for name, sigma, weight in (
        ("positions", fixes.pos_sigma, solved.pos_weight),
        ("velocities", fixes.vel_sigma, solved.vel_weight),
    ):
        seen = used & np.isfinite(sigma[:, solved.epochs.fix]).any(axis=0)
        if seen.any():
            rows.append(Metric(f"gnss_{name}", float(seen.sum())))
            rows.append(Metric(f"gnss_{name}_rejected", float((seen & (weight < 0.5)).sum())))
    rows.append(Metric("steps", float(solved.steps), note="of Gauss and Newton, from the start on"))
    return rows
