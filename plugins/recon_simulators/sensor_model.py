"""What an IMU reports of a motion: the truth, turned into the box and spoiled by its errors.

    accel_s = clip(quantise((1 + s) R_sv f_v       + b(t) + vibration + n))
    gyro_s  = clip(quantise((1 + s) R_sv omega_v   + b(t) + vibration + n))
    b(t)    = constant + random walk + Gauss-Markov process

with scale error s and white noise n. White noise of density N sampled at the rate f has sigma N sqrt(f); the walk of a
bias takes steps K sqrt(dt); its instability is a first-order Gauss-Markov process. Vibration is noise in a band of
frequencies whose sigma grows with the speed; it shakes the box and moves it nowhere.

References: IEEE Std 952-1997, annex C (noise density, rate random walk, bias instability); Groves, Principles of GNSS,
Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013), ch. 4 (errors of an IMU).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from recon.numerics.motion import EarthTruth
from recon.numerics.rotation import Floats, rotate
from recon_simulators.noise import gauss_markov, in_band

Vector: TypeAlias = tuple[float, float, float]

_ON_GRID = 1e-9
"""Fraction of a sample period by which rounding may move the end of a time grid."""
_SHAKEN_SPEED, _MOST_SHAKEN = 15.0, 1.5
"""m/s at which the vibration has its sigma; it grows with the speed to so many times that."""


@dataclass(frozen=True)
class TriadModel:
    """Errors of three orthogonal accelerometers or gyroscopes; U is m/s^2 or rad/s. The default has no error.

    | field           | unit        | meaning                                                     |
    |-----------------|-------------|-------------------------------------------------------------|
    | bias            | U, sensor   | constant offset of each axis                                |
    | bias_walk       | U/sqrt(s)   | random walk of the bias, zero at the first sample           |
    | instability     | U           | sigma of the Gauss-Markov part of the bias                  |
    | correlation_s   | s           | correlation time of that part                               |
    | noise_density   | U/sqrt(Hz)  | white noise                                                 |
    | vibration       | U           | sigma of the vibration at 15 m/s                            |
    | band_hz         | Hz          | lowest and highest frequency of the vibration               |
    | scale           | 1           | scale error of each axis                                    |
    | quantisation    | U           | step of the output; 0 for none                              |
    | full_scale      | U           | the output is clipped to +- this                            |
    """

    bias: Vector = (0.0, 0.0, 0.0)
    bias_walk: float = 0.0
    instability: float = 0.0
    correlation_s: float = 300.0
    noise_density: float = 0.0
    vibration: float = 0.0
    band_hz: tuple[float, float] = (8.0, 45.0)
    scale: Vector = (0.0, 0.0, 0.0)
    quantisation: float = 0.0
    full_scale: float = np.inf


@dataclass(frozen=True)
class ImuModel:
    """An IMU at the origin of the vehicle frame.

    | field    | unit   | meaning                                                                              |
    |----------|--------|--------------------------------------------------------------------------------------|
    | rate_hz  | Hz     | nominal sampling rate                                                                |
    | jitter_s | s      | samples are taken up to this early or late, uniformly; their time stamps are right    |
    | q_sv     | 1      | mounting, scalar first: takes vehicle to sensor                                      |
    | accel    | m/s^2  | errors of the accelerometers                                                         |
    | gyro     | rad/s  | errors of the gyroscopes                                                             |

    Raises ValueError where the jitter could bring two samples out of order.
    """

    rate_hz: float = 100.0
    jitter_s: float = 0.0
    q_sv: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    accel: TriadModel = field(default_factory=TriadModel)
    gyro: TriadModel = field(default_factory=TriadModel)

    def __post_init__(self) -> None:
        """Refuse a jitter that would make time run backwards."""
        if not 0.0 <= self.jitter_s < 0.5 / self.rate_hz:
            raise ValueError(f"jitter_s is {self.jitter_s}; it must be below half a period, {0.5 / self.rate_hz} s")


@dataclass(frozen=True)
class TriadSamples:
    """What three sensors report, and the bias that is in it: (n, 3) each, m/s^2 or rad/s, sensor frame."""

    output_s: Floats
    bias_s: Floats


def imu_times(start_s: float, stop_s: float, model: ImuModel, rng: np.random.Generator) -> Floats:
    """Sample times from start to before stop, irregular by the model's jitter: (n,) s, strictly increasing."""
    times = regular_times(start_s, stop_s, model.rate_hz)
    return times + rng.uniform(-model.jitter_s, model.jitter_s, times.shape)


def regular_times(start_s: float, stop_s: float, rate_hz: float) -> Floats:
    """Regular times from start to before stop: (n,) s."""
    count = int(np.ceil((stop_s - start_s) * rate_hz - _ON_GRID))
    return start_s + np.arange(count) / rate_hz


def imu_measurements(truth: EarthTruth, model: ImuModel, rng: np.random.Generator) -> tuple[TriadSamples, TriadSamples]:
    """Specific force and angular rate as the IMU reports them at the times of the truth.

    truth : at increasing times, as from `imu_times`
    returns : of the accelerometers, in m/s^2, and of the gyroscopes, in rad/s
    """
    q_sv = np.array(model.q_sv)
    speed = np.linalg.norm(truth.vel_n, axis=1)
    accel, gyro = (
        _spoil(rotate(q_sv, true_v), truth.t_s, speed, triad, model.rate_hz, rng)
        for true_v, triad in ((truth.force_v, model.accel), (truth.rate_v, model.gyro))
    )
    return accel, gyro


def _spoil(
    true_s: Floats, t_s: Floats, speed: Floats, model: TriadModel, rate_hz: float, rng: np.random.Generator
) -> TriadSamples:
    """The output of three sensors whose input is known."""
    rows, axes = true_s.shape
    noise = model.noise_density * np.sqrt(rate_hz) * rng.standard_normal(true_s.shape)
    steps = model.bias_walk * np.sqrt(np.diff(t_s, prepend=t_s[:1]))[:, None] * rng.standard_normal(true_s.shape)
    bias = np.array(model.bias) + np.cumsum(steps, axis=0)
    if model.instability:
        bias += model.instability * gauss_markov((rows, axes), rate_hz, model.correlation_s, rng)
    value = (1.0 + np.array(model.scale)) * true_s + bias + noise
    if model.vibration:
        shaken = np.minimum(speed / _SHAKEN_SPEED, _MOST_SHAKEN)[:, None]
        value += model.vibration * shaken * in_band((rows, axes), rate_hz, model.band_hz, rng)
    if model.quantisation:
        value = np.round(value / model.quantisation) * model.quantisation
    return TriadSamples(np.clip(value, -model.full_scale, model.full_scale), bias)
