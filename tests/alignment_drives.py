"""Simulated drives for the closed-form start: boxes mounted in every way, velocities of GNSS at the knots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.numerics import rotation
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.motion import Drive, Segment, specific_force, stop_and_go
from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.soa import mmt, rotation_log

GRAVITY_N = np.array([0.0, 0.0, -STANDARD_GRAVITY])
GYRO_BIAS = np.radians(0.5)
VEL_SIGMA = 0.1


@dataclass(frozen=True)
class Run:
    """What was logged, and the truth at the knots."""

    samples: Samples
    still: np.ndarray
    bias: np.ndarray
    vel_n: np.ndarray
    known: np.ndarray
    speed: np.ndarray
    rot_ns: np.ndarray
    rot_vs: np.ndarray

    @property
    def whole(self) -> list[slice]:
        return [slice(0, self.known.size)]

    def increments(self, bias: np.ndarray) -> Increments:
        each = np.zeros((3, self.samples.intervals))
        return preintegrate(self.samples, each + bias[:, None], each, np.zeros(6))

    def bias_at_stops(self) -> np.ndarray:
        return np.median(self.samples.gyro_s[self.still], axis=0)


def simulate(
    drive: Drive, seconds: float, rot_vs: np.ndarray, seed: int, start_s: float = 0.0, bias_size: float = GYRO_BIAS
) -> Run:
    """A box of 0.01 deg/s/sqrt(Hz), 150 ug/sqrt(Hz) and 20 mg at 100 Hz, and GNSS velocities at the knots."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, seconds + 0.005, 0.01)
    truth = drive.at(t_s + start_s)
    bias = bias_size * unit(rng.normal(size=3))
    gyro = truth.gyro_v @ rot_vs + bias + rng.normal(0.0, np.radians(0.1), truth.gyro_v.shape)
    accel = specific_force(truth) @ rot_vs + 0.2 * unit(rng.normal(size=3))
    samples = regular_samples(t_s, gyro, accel + rng.normal(0.0, 0.015, gyro.shape))
    at_knots = drive.at(samples.knot_times + start_s)
    vel_n = at_knots.vel_n.T
    return Run(
        samples=samples,
        still=np.linalg.norm(drive.at(samples.t_s + start_s).vel_n, axis=1) == 0.0,
        bias=bias,
        vel_n=vel_n + rng.normal(0.0, VEL_SIGMA, vel_n.shape),
        known=np.ones(vel_n.shape[1], bool),
        speed=np.linalg.norm(vel_n, axis=0),
        rot_ns=np.moveaxis(rotation.to_matrix(at_knots.q_nv) @ rot_vs, 0, -1),
        rot_vs=rot_vs,
    )


def box(number: int) -> np.ndarray:
    """R_vs of one of 24 boxes: each of the 24 ways in which a cube can lie, askew by up to 15 degrees."""
    rng = np.random.default_rng(number)
    faces = rotation.from_rotvec(
        np.pi / 2 * np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0, 1, 0], [0, 3, 0]])
    )
    lies = rotation.multiply(faces[number % 6], rotation.from_rotvec([0.0, 0.0, np.pi / 2 * (number // 6)]))
    askew = rotation.from_rotvec(unit(rng.normal(size=3)) * np.radians(rng.uniform(0.0, 15.0)))
    return rotation.to_matrix(rotation.multiply(askew, lies))


def city(number: int, seconds: float = 300.0) -> Run:
    return simulate(stop_and_go(seconds, np.random.default_rng(number)), seconds, box(number), number)


def never_stopping(number: int, seconds: float = 300.0) -> Run:
    """Bends of 1 to 3 m/s^2, straights, slopes and changes of speed, cut out between start and end."""
    rng = np.random.default_rng(number)
    segments, speed = [Segment(10.0, 8.0)], 8.0
    for _ in range(int(seconds / 4.0) + 5):
        speed = rng.uniform(max(6.0, speed - 6.0), min(16.0, speed + 6.0))
        bend = rng.choice([0.0, 1.0, -1.0]) * rng.uniform(1.0, 3.0) / speed**2
        segments.append(Segment(rng.uniform(4.0, 10.0), speed, curvature=bend, slope=rng.uniform(-0.06, 0.06)))
    drive = Drive((*segments, Segment(10.0, 0.0)))
    return simulate(drive, seconds, box(number), number, start_s=12.0)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between rotations (3, 3, ...)."""
    return np.degrees(np.linalg.norm(rotation_log(mmt(a, b)), axis=0))
