"""The errors of a drive's IMU and receiver, as parameters give them and presets where they do not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from recon.numerics.rotation import conjugate, from_euler
from recon_simulators.drive_params import DriveParams
from recon_simulators.gnss_model import GnssModel, MultipathModel, random_outages
from recon_simulators.presets import PLACED_OUTAGES, preset_value
from recon_simulators.sensor_model import ImuModel, TriadModel


def chosen(params: DriveParams, name: str) -> Any:
    """A value as given, else that of the preset."""
    own = getattr(params, name)
    return preset_value(params.sensors, name) if own is None else own


def imu_model_of(params: DriveParams, values: Mapping[str, Any], rng: np.random.Generator) -> ImuModel:
    """The IMU. values : of `chosen`, by name; rng : draws its constant errors. Raises ValueError, see ImuModel."""
    q_vs = from_euler(values["mount_yaw"], values["mount_pitch"], values["mount_roll"])
    return ImuModel(
        rate_hz=values["imu_rate"],
        jitter_s=params.imu_jitter,
        q_sv=tuple(conjugate(q_vs).tolist()),
        accel=_triad("accel", params, values, rng),
        gyro=_triad("gyro", params, values, rng),
    )


def _triad(sensor: str, params: DriveParams, values: Mapping[str, Any], rng: np.random.Generator) -> TriadModel:
    """Three sensors, their constant biases and scale errors drawn from rng."""
    bias, scale = (rng.normal(0.0, values[f"{sensor}_{error}"], 3).tolist() for error in ("bias", "scale"))
    return TriadModel(
        bias=tuple(bias),
        bias_walk=values[f"{sensor}_bias_walk"],
        instability=values[f"{sensor}_instability"],
        correlation_s=params.instability_time,
        noise_density=values[f"{sensor}_noise"],
        vibration=values[f"{sensor}_vibration"],
        band_hz=params.vibration_band,
        scale=tuple(scale),
        quantisation=values[f"{sensor}_quantisation"],
        full_scale=values[f"{sensor}_full_scale"],
    )


def gnss_model_of(
    params: DriveParams, values: Mapping[str, Any], duration_s: float, rng: np.random.Generator
) -> GnssModel:
    """The receiver, with its outages. values : of `chosen`, by name; rng : places random outages."""
    outages = params.outages
    if outages is None:
        placed = PLACED_OUTAGES.get(params.sensors, ())
        outages = tuple((share * duration_s, share * duration_s + length) for share, length in placed)
    rate_hz = values["outage_rate"] if params.outages is None else params.outage_rate or 0.0
    return GnssModel(
        rate_hz=values["gnss_rate"],
        slow_sigmas=(values["gnss_horizontal"], values["gnss_vertical"]),
        correlation_s=values["gnss_correlation"],
        white_sigmas=(values["gnss_white_horizontal"], values["gnss_white_vertical"]),
        velocity_sigmas=(values["gnss_velocity"], values["gnss_velocity_vertical"]),
        lever_arm_v=values["lever_arm"],
        lag_s=params.gnss_lag,
        velocity_lag_s=params.gnss_lag if params.gnss_velocity_lag is None else params.gnss_velocity_lag,
        speed_step=params.gnss_speed_step,
        course_step=params.gnss_course_step,
        course_hold=params.gnss_course_hold,
        multipath=MultipathModel(
            share=values["multipath"],
            size=values["multipath_size"],
            length_s=values["multipath_length"],
            single=values["multipath_single"],
            velocity_sigmas=values["multipath_velocity"],
        ),
        outages=(*outages, *random_outages(rate_hz, params.outage_length, duration_s, rng)),
    )
