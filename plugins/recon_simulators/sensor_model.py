"""What an IMU and a GNSS receiver report of a motion: the truth, moved to the sensor and spoiled by its errors.

    accel_s = clip(quantise((1 + s) R_sv f_v       + b + w(t) + n))
    gyro_s  = clip(quantise((1 + s) R_sv omega_v   + b + w(t) + n))
    pos_n   = p_n + R_nv l_v + m(t),    vel_n = v_n + R_nv (omega_v x l_v) + n

with scale error s, constant bias b, bias random walk w, white noise n and the lever arm l_v from IMU to antenna.
White noise of density N sampled at the rate f has sigma N sqrt(f); the walk of a bias takes steps K sqrt(dt). The
error m of a position is a first-order Gauss-Markov process, for that of a receiver changes slowly with the satellites
and the atmosphere: m_k+1 = c m_k + sqrt(1 - c^2) sigma n, c = exp(-dt / correlation time).

References: IEEE Std 952-1997, annex C (noise density and rate random walk); Groves, Principles of GNSS, Inertial, and
Multisensor Integrated Navigation Systems, 2nd ed. (2013), ch. 4 (errors of an IMU), sec. 14.3 (lever arm); Brown and
Hwang, Introduction to Random Signals and Applied Kalman Filtering, 4th ed. (2012), sec. 4.2 (Gauss-Markov process).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.motion import MotionTruth, specific_force
from recon.numerics.rotation import Floats, heading_from_yaw, rotate

Vector: TypeAlias = tuple[float, float, float]

_ON_GRID = 1e-9
"""Fraction of a sample period by which rounding may move the end of a time grid."""


@dataclass(frozen=True)
class TriadModel:
    """Errors of three orthogonal accelerometers or gyroscopes; U is m/s^2 or rad/s. The default has no error.

    | field           | unit        | meaning                                            |
    |-----------------|-------------|----------------------------------------------------|
    | bias            | U, sensor   | constant offset of each axis                       |
    | bias_walk       | U/sqrt(s)   | random walk of the bias, zero at the first sample  |
    | noise_density   | U/sqrt(Hz)  | white noise                                        |
    | scale           | 1           | scale error of each axis                           |
    | quantisation    | U           | step of the output; 0 for none                     |
    | full_scale      | U           | the output is clipped to +- this                   |
    """

    bias: Vector = (0.0, 0.0, 0.0)
    bias_walk: float = 0.0
    noise_density: float = 0.0
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
    | gravity  | m/s^2  | where the drive takes place                                                          |
    | accel    | m/s^2  | errors of the accelerometers                                                         |
    | gyro     | rad/s  | errors of the gyroscopes                                                             |

    Raises ValueError where the jitter could bring two samples out of order.
    """

    rate_hz: float = 100.0
    jitter_s: float = 0.0
    q_sv: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    gravity: float = STANDARD_GRAVITY
    accel: TriadModel = field(default_factory=TriadModel)
    gyro: TriadModel = field(default_factory=TriadModel)

    def __post_init__(self) -> None:
        """Refuse a jitter that would make time run backwards."""
        if not 0.0 <= self.jitter_s < 0.5 / self.rate_hz:
            raise ValueError(f"jitter_s is {self.jitter_s}; it must be below half a period, {0.5 / self.rate_hz} s")


@dataclass(frozen=True)
class GnssModel:
    """A GNSS receiver. Errors are independent per axis.

    | field            | unit       | meaning                                                              |
    |------------------|------------|----------------------------------------------------------------------|
    | rate_hz          | Hz         | rate of fixes                                                        |
    | horizontal_sigma | m          | position, east and north                                             |
    | vertical_sigma   | m          | position, up                                                         |
    | correlation_s    | s          | correlation time of the error of the position; 0 for white noise     |
    | velocity_sigma   | m/s        | velocity of each axis, white; speed and course are of that velocity  |
    | lever_arm_v      | m, vehicle | from the IMU to the antenna                                          |
    | lag_s            | s          | a fix stamped t describes the time t - lag_s                         |
    | outages          | s          | (start, stop) of time stamps without a fix; stop belongs to the next |
    """

    rate_hz: float = 1.0
    horizontal_sigma: float = 0.0
    vertical_sigma: float = 0.0
    correlation_s: float = 0.0
    velocity_sigma: float = 0.0
    lever_arm_v: Vector = (0.0, 0.0, 0.0)
    lag_s: float = 0.0
    outages: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class GnssFixes:
    """What the receiver reports at m times.

    t_s : (m,) s, time stamps
    pos_n, vel_n : (m, 3) m and m/s, local East-North-Up, of the antenna
    speed : (m,) m/s over ground
    course : (m,) rad over ground, clockwise from true north, in [0, 2 pi)
    """

    t_s: Floats
    pos_n: Floats
    vel_n: Floats
    speed: Floats
    course: Floats


def imu_times(start_s: float, stop_s: float, model: ImuModel, rng: np.random.Generator) -> Floats:
    """Sample times from start to before stop, irregular by the model's jitter: (n,) s, strictly increasing."""
    times = _grid(start_s, stop_s, model.rate_hz)
    return times + rng.uniform(-model.jitter_s, model.jitter_s, times.shape)


def imu_measurements(truth: MotionTruth, model: ImuModel, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Specific force and angular rate as the IMU reports them at the times of the truth.

    truth : at increasing times, as from `imu_times`
    returns : accel_s (n, 3) m/s^2 and gyro_s (n, 3) rad/s, sensor frame
    """
    q_sv = np.array(model.q_sv)
    force_s = rotate(q_sv, specific_force(truth, model.gravity))
    rate_s = rotate(q_sv, truth.gyro_v)
    accel_s = _spoil(force_s, truth.t_s, model.accel, model.rate_hz, rng)
    gyro_s = _spoil(rate_s, truth.t_s, model.gyro, model.rate_hz, rng)
    return accel_s, gyro_s


def gnss_times(start_s: float, stop_s: float, model: GnssModel) -> Floats:
    """Time stamps from start to before stop, those in an outage among them: (m,) s."""
    return _grid(start_s, stop_s, model.rate_hz)


def in_outage(t_s: Floats, model: GnssModel) -> NDArray[np.bool_]:
    """Which time stamps fall into an outage: (m,). Leaving out their fixes changes no other fix."""
    lost = np.zeros(t_s.shape, dtype=bool)
    for start, stop in model.outages:
        lost |= (start <= t_s) & (t_s < stop)
    return lost


def gnss_measurements(truth: MotionTruth, model: GnssModel, rng: np.random.Generator) -> GnssFixes:
    """Fixes of the antenna.

    truth : at the times that the fixes describe, that is motion.at(gnss_times(...) - model.lag_s)
    """
    lever_v = np.broadcast_to(np.array(model.lever_arm_v), truth.pos_n.shape)
    pos_n = truth.pos_n + rotate(truth.q_nv, lever_v)
    vel_n = truth.vel_n + rotate(truth.q_nv, np.cross(truth.gyro_v, lever_v))
    pos_sigma = np.array([model.horizontal_sigma, model.horizontal_sigma, model.vertical_sigma])
    pos_n = pos_n + pos_sigma * _gauss_markov(pos_n.shape, model, rng)
    vel_n = vel_n + model.velocity_sigma * rng.standard_normal(vel_n.shape)
    return GnssFixes(
        t_s=truth.t_s + model.lag_s,
        pos_n=pos_n,
        vel_n=vel_n,
        speed=np.hypot(vel_n[:, 0], vel_n[:, 1]),
        course=heading_from_yaw(np.arctan2(vel_n[:, 1], vel_n[:, 0])),
    )


def _gauss_markov(shape: tuple[int, ...], model: GnssModel, rng: np.random.Generator) -> Floats:
    """Stationary processes of sigma 1, one per column, at the rate of the receiver: (m, k)."""
    white = rng.standard_normal(shape)
    if not model.correlation_s:
        return white
    from scipy.signal import lfilter

    kept = np.exp(-1.0 / (model.rate_hz * model.correlation_s))
    white[1:] *= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], white, axis=0))


def _spoil(true_s: Floats, t_s: Floats, model: TriadModel, rate_hz: float, rng: np.random.Generator) -> Floats:
    """The output of three sensors whose input is known: (n, 3)."""
    noise = model.noise_density * np.sqrt(rate_hz) * rng.standard_normal(true_s.shape)
    steps = model.bias_walk * np.sqrt(np.diff(t_s, prepend=t_s[:1]))[:, None] * rng.standard_normal(true_s.shape)
    value = (1.0 + np.array(model.scale)) * true_s + np.array(model.bias) + np.cumsum(steps, axis=0) + noise
    if model.quantisation:
        value = np.round(value / model.quantisation) * model.quantisation
    return np.asarray(np.clip(value, -model.full_scale, model.full_scale))


def _grid(start_s: float, stop_s: float, rate_hz: float) -> Floats:
    """Regular times from start to before stop: (n,) s."""
    count = int(np.ceil((stop_s - start_s) * rate_hz - _ON_GRID))
    return start_s + np.arange(count) / rate_hz
