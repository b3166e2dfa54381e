"""What a GNSS receiver reports of a motion: where its antenna was, spoiled by its errors.

    position = place + R_nv l_v + m(t) + n + multipath,   velocity = v_n + R_nv (omega_v x l_v) + n + multipath

with the lever arm l_v from IMU to antenna. The error m is a first-order Gauss-Markov process, for that of a receiver
changes slowly with the satellites and the atmosphere; n is white. Multipath comes in bursts: for some seconds the
position is off by a constant vector and the velocity by another. A fix tells where the antenna was a lag before its
stamp, and how fast it was another lag before.

References: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013), sec.
9.3 (errors, multipath), 14.3 (lever arm).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import earth_rate_n, ecef_to_geodetic, geodetic_to_ecef, local_axes_e
from recon.numerics.motion import EarthTruth
from recon.numerics.rotation import Floats, conjugate, heading_from_yaw, rotate
from recon_simulators.noise import gauss_markov
from recon_simulators.sensor_model import Vector

Span = tuple[float, float]

_FLAT = (1.0, 1.0, 0.7)
"""Relative size of east, north and up in the direction of an outlier."""
_CLEAR_START_S, _CLEAR_END_S, _APART_S = 60.0, 15.0, 10.0
"""Random outages keep away from the start and the end of the record, and from each other."""


@dataclass(frozen=True)
class MultipathModel:
    """Bursts of outliers.

    | field           | unit | meaning                                                                   |
    |-----------------|------|---------------------------------------------------------------------------|
    | share           | 1    | of all fixes that are affected                                            |
    | size            | m    | least and largest error of a position, uniform between                    |
    | length_s        | s    | shortest and longest burst, uniform between                               |
    | single          | 1    | share of the bursts that hit one fix alone                                |
    | velocity_sigmas | m/s  | each burst takes one of them for the error of its velocity, per axis      |
    """

    share: float = 0.0
    size: Span = (10.0, 50.0)
    length_s: Span = (3.0, 15.0)
    single: float = 0.0
    velocity_sigmas: tuple[float, ...] = (1.0,)


@dataclass(frozen=True)
class GnssModel:
    """A GNSS receiver. Errors are independent per axis.

    | field             | unit       | meaning                                                                   |
    |-------------------|------------|---------------------------------------------------------------------------|
    | rate_hz           | Hz         | rate of fixes                                                             |
    | slow_sigmas       | m          | of the slow error of the position: horizontal (each axis) and vertical    |
    | correlation_s     | s          | correlation time of the slow error; 0 for white noise                     |
    | white_sigmas      | m          | of the white error of the position, horizontal and vertical               |
    | velocity_sigmas   | m/s        | of the white error of the velocity, horizontal and vertical               |
    | lever_arm_v       | m, vehicle | from the IMU to the antenna                                               |
    | lag_s             | s          | a fix stamped t describes the place at t - lag_s                          |
    | velocity_lag_s    | s          | and the velocity at t - velocity_lag_s                                    |
    | speed_step        | m/s        | step of the speed over ground; 0 for none                                 |
    | course_step       | rad        | step of the course; 0 for none                                            |
    | course_hold       | m/s        | below this speed the course stays what it was                             |
    | multipath         |            | outliers                                                                  |
    | outages           | s          | (start, stop) of time stamps without a fix; stop belongs to the next      |
    """

    rate_hz: float = 1.0
    slow_sigmas: Span = (0.0, 0.0)
    correlation_s: float = 0.0
    white_sigmas: Span = (0.0, 0.0)
    velocity_sigmas: Span = (0.0, 0.0)
    lever_arm_v: Vector = (0.0, 0.0, 0.0)
    lag_s: float = 0.0
    velocity_lag_s: float = 0.0
    speed_step: float = 0.0
    course_step: float = 0.0
    course_hold: float = 0.0
    multipath: MultipathModel = field(default_factory=MultipathModel)
    outages: tuple[Span, ...] = ()


@dataclass(frozen=True)
class Burst:
    """Fixes from `first` to before `stop`, counted with those in outages, whose position is off by `size` m."""

    first: int
    stop: int
    size: float


@dataclass(frozen=True)
class GnssFixes:
    """What the receiver reports at m times, of the antenna.

    lat, lon : (m,) deg;  height : (m,) m above the ellipsoid;  vel_n : (m, 3) m/s, local level
    speed : (m,) m/s over ground;  course : (m,) rad over ground, clockwise from true north, in [0, 2 pi)
    bursts : which fixes are outliers
    """

    lat: Floats
    lon: Floats
    height: Floats
    vel_n: Floats
    speed: Floats
    course: Floats
    bursts: tuple[Burst, ...]


def in_outage(t_s: Floats, model: GnssModel) -> NDArray[np.bool_]:
    """Which time stamps fall into an outage: (m,). Leaving out their fixes changes no other fix."""
    lost = np.zeros(t_s.shape, dtype=bool)
    for start, stop in model.outages:
        lost |= (start <= t_s) & (t_s < stop)
    return lost


def random_outages(rate_hz: float, length_s: Span, duration_s: float, rng: np.random.Generator) -> tuple[Span, ...]:
    """Spans without fixes in s, apart from each other: as many as the rate asks for, rounded up, that find room."""
    lengths = rng.uniform(*length_s, int(np.ceil(rate_hz * duration_s - 1e-9)))
    room_s = duration_s - _CLEAR_START_S - _CLEAR_END_S
    lengths = lengths[np.cumsum(lengths + _APART_S) <= room_s]
    free_s = room_s - np.sum(lengths + _APART_S)
    before = np.concatenate(([0.0], np.cumsum(lengths + _APART_S)[:-1])) if len(lengths) else lengths
    starts = _CLEAR_START_S + np.sort(rng.uniform(0.0, max(free_s, 0.0), len(lengths))) + before
    return tuple(zip(starts.tolist(), (starts + lengths).tolist(), strict=True))


def gnss_measurements(place: EarthTruth, motion: EarthTruth, model: GnssModel, rng: np.random.Generator) -> GnssFixes:
    """Fixes of the antenna.

    place, motion : truth at the times whose position and whose velocity the m fixes describe, their lags before them
    """
    rows = len(place.t_s)
    lever_v = np.broadcast_to(np.array(model.lever_arm_v), (rows, 3))
    offset_n = rotate(place.q_nv, lever_v)
    rate_v = motion.rate_v - rotate(conjugate(motion.q_nv), earth_rate_n(motion.lat))
    vel_n = motion.vel_n + rotate(motion.q_nv, np.cross(rate_v, lever_v))
    offset_n = offset_n + _axes(model.slow_sigmas) * gauss_markov((rows, 3), model.rate_hz, model.correlation_s, rng)
    offset_n += _axes(model.white_sigmas) * rng.standard_normal((rows, 3))
    vel_n = vel_n + _axes(model.velocity_sigmas) * rng.standard_normal((rows, 3))
    bursts = _strike(offset_n, vel_n, model, rng)
    pos_e = geodetic_to_ecef(place.lat, place.lon, place.height)
    pos_e += np.einsum("ijn,nj->ni", local_axes_e(place.lat, place.lon), offset_n)
    lat, lon, height = ecef_to_geodetic(pos_e)
    speed, course = _over_ground(vel_n, model)
    return GnssFixes(lat, lon, height, vel_n, speed, course, bursts)


def _strike(pos_n: Floats, vel_n: Floats, model: GnssModel, rng: np.random.Generator) -> tuple[Burst, ...]:
    """Add bursts to positions and velocities, both (m, 3), until their share is reached; where they were added."""
    multipath, rows = model.multipath, len(pos_n)
    hit, bursts = np.zeros(rows, dtype=bool), []
    while hit.sum() < np.round(multipath.share * rows):
        alone = rng.random() < multipath.single
        length = 1 if alone else max(1, int(np.round(rng.uniform(*multipath.length_s) * model.rate_hz)))
        first = int(rng.integers(0, rows))
        stop = min(rows, first + length)
        direction, size = rng.standard_normal(3) * _FLAT, rng.uniform(*multipath.size)
        sigma = rng.choice(multipath.velocity_sigmas)
        pos_n[first:stop] += size * direction / np.linalg.norm(direction)
        vel_n[first:stop] += sigma * rng.standard_normal(3)
        hit[first:stop] = True
        bursts.append(Burst(first, stop, float(size)))
    return tuple(sorted(bursts, key=lambda burst: burst.first))


def _over_ground(vel_n: Floats, model: GnssModel) -> tuple[Floats, Floats]:
    """Speed and course of a velocity (m, 3), as coarse as the receiver tells them; a course never had is north."""
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    course = heading_from_yaw(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
    if model.course_hold:
        last = np.maximum.accumulate(np.where(speed >= model.course_hold, np.arange(len(speed)), -1))
        course = np.where(last >= 0, course[last], 0.0)
    if model.speed_step:
        speed = np.round(speed / model.speed_step) * model.speed_step
    if model.course_step:
        course = np.mod(np.round(course / model.course_step) * model.course_step, 2.0 * np.pi)
    return speed, course


def _axes(sigmas: Span) -> Floats:
    """Horizontal and vertical as east, north, up: (3,)."""
    horizontal, vertical = sigmas
    return np.array([horizontal, horizontal, vertical])
