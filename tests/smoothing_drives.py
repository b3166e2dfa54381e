"""Simulated drives on the ellipsoid, logged by a box and a receiver whose every error is known.

The car is rigid and does what the smoother's model says, so that errors over sigmas should be about one. Noise is white
in the samples, biases wander, the error of GNSS positions is a Gauss-Markov process on top of white noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recon.numerics import rotation
from recon.numerics.geodesy import Anchor
from recon.numerics.motion.body import Springs, SprungBody
from recon.numerics.motion.earth import OnEarth
from recon.numerics.motion.traffic import traffic
from recon.numerics.smoothing import (
    Drive,
    Fixes,
    Model,
    Noise,
    Smoother,
    estimate,
    level_rotation,
    positions_n,
    regular_samples,
)
from recon.numerics.smoothing.aids import Aid
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.epochs import Inside, Misclosure, locate, misclosure
from recon.numerics.smoothing.likelihood import Likelihood
from recon.numerics.smoothing.measurements import AtEpochs, at_epochs
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.soa import Floats, mm, mv, rotation_exp
from recon.numerics.smoothing.start import start_state
from recon.numerics.smoothing.state import (
    ACCEL_SCALE,
    COMMON_SIZE,
    GYRO_SCALE,
    KNOT_SIZE,
    LAG,
    LEVER,
    PITCH,
    REAR,
    ROLL,
    SLIP,
    VELOCITY_LAG,
    WHEEL,
    State,
)

# Central differences of a step of 1e-5, relative to the size of a column.
DIFFERENCE = 1e-6
PLACE = Anchor(48.0, 11.0, 500.0)


@dataclass(frozen=True)
class Log:
    """How a drive is logged.

    seconds, kind, rest_s : of the route, see motion.traffic; seed : of route and noise
    imu_hz, gnss_hz; quiet : no noise and no bias at all
    box : (3, 3), R_vs; lever_v, rear_v : m, vehicle, from the IMU to the antenna and to the rear axle
    lag, velocity_lag : s, as in smoothing.state
    gyro, accel : densities; bias : deg/s, m/s^2, sigmas; walks as in Noise
    drift, tau, white, velocity : sigmas of GNSS, horizontal; 1.5 times that vertically
    outliers : share of the fixes that jump by 10 to 50 m; silent : s, spans without a record of the IMU
    turned : rad, how far the world is turned about the vertical
    """

    seconds: float = 180.0
    kind: str = "mixed"
    rest_s: float = 15.0
    seed: int = 1
    imu_hz: float = 50.0
    gnss_hz: float = 1.0
    quiet: bool = False
    box: np.ndarray = field(default_factory=lambda: box(12.0, 4.0, -3.0))
    lever_v: tuple[float, float, float] = (0.8, -0.3, 1.1)
    rear_v: tuple[float, float, float] = (-1.2, 0.2, -0.4)
    lag: float = 0.0
    velocity_lag: float = 0.0
    gyro: float = np.radians(0.01)
    accel: float = 1.5e-3
    gyro_bias: float = np.radians(0.5)
    accel_bias: float = 0.2
    gyro_walk: float = np.radians(2e-4)
    accel_walk: float = 2e-4
    drift: float = 1.0
    tau: float = 60.0
    white: float = 0.5
    velocity: float = 0.1
    outliers: float = 0.0
    silent: tuple[tuple[float, float], ...] = ()
    turned: float = 0.0
    place: Anchor = PLACE

    @property
    def noise(self) -> Noise:
        """What the smoother should believe."""
        axes = np.array([1.0, 1.0, 1.5])
        return Noise(
            self.gyro, self.accel, self.gyro_walk, self.accel_walk, self.drift * axes, self.tau, np.ones(3), np.ones(3)
        )


@dataclass(frozen=True)
class Truth:
    """At n times: rot_ns, rot_nv (3, 3, n), vel_n, pos_n (3, n) of the IMU, rate_s (3, n) relative to the Earth."""

    rot_ns: np.ndarray
    rot_nv: np.ndarray
    vel_n: np.ndarray
    pos_n: np.ndarray
    rate_v: np.ndarray


@dataclass(frozen=True)
class Simulated:
    """A drive and what is true of it. bias_t_s (n,), gyro_bias, accel_bias (3, n); outlier (m,) of the fixes."""

    log: Log
    drive: Drive
    motion: OnEarth
    bias_t_s: np.ndarray
    gyro_bias: np.ndarray
    accel_bias: np.ndarray
    outlier: np.ndarray

    def at(self, t_s: np.ndarray) -> Truth:
        """Truth at times (n,) s."""
        return _truth(self.motion, self.drive.anchor, self.log, t_s)

    def state(self, t_s: np.ndarray) -> State:
        """The true value of all unknowns, knots at t_s; the drift is left zero."""
        truth = self.at(t_s)
        common = np.zeros(COMMON_SIZE)
        common[LEVER] = self.log.box.T @ self.log.lever_v
        common[REAR] = self.log.box.T @ self.log.rear_v
        common[LAG], common[VELOCITY_LAG] = self.log.lag, self.log.velocity_lag
        gyro, accel = (
            np.array([np.interp(t_s, self.bias_t_s, axis) for axis in bias])
            for bias in (self.gyro_bias, self.accel_bias)
        )
        none = np.zeros_like(truth.pos_n)
        return State(truth.rot_ns, truth.vel_n, truth.pos_n, gyro, accel, none, self.log.box, common)


def box(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """R_vs of a box turned by Euler angles in degrees."""
    return rotation.to_matrix(rotation.from_euler(*np.radians([yaw, pitch, roll])))


def simulate(log: Log) -> Simulated:
    """Drive, and log it."""
    rng = np.random.default_rng(log.seed)
    route = replace(traffic(log.kind, log.seconds, rng, log.rest_s), yaw=log.turned)
    body = SprungBody(route, Springs(), log.rear_v, None, rng)
    motion = OnEarth(body, log.place, log.seconds + 1.0)
    loud = 0.0 if log.quiet else 1.0
    t_s = np.arange(round(log.seconds * log.imu_hz) + 1) / log.imu_hz
    ideal = motion.at(t_s)
    gyro_bias = _bias(log.gyro_bias * loud, log.gyro_walk * loud, t_s, rng)
    accel_bias = _bias(log.accel_bias * loud, log.accel_walk * loud, t_s, rng)
    white = loud * np.sqrt(log.imu_hz)
    gyro = ideal.rate_v @ log.box + gyro_bias.T + rng.normal(0.0, log.gyro, (len(t_s), 3)) * white
    accel = ideal.force_v @ log.box + accel_bias.T + rng.normal(0.0, log.accel, (len(t_s), 3)) * white
    heard = np.ones(len(t_s), bool)
    for start, stop in log.silent:
        heard &= (t_s <= start) | (t_s >= stop)
    fixes, outlier = _fixes(log, motion, rng, loud)
    none = np.zeros(0)
    drive = Drive(regular_samples(t_s[heard], gyro[heard], accel[heard]), fixes, log.place, none, none)
    return Simulated(log, drive, motion, t_s, gyro_bias, accel_bias, outlier)


def further_receiver(sim: Simulated, **changes: object) -> Fixes:
    """What another receiver in the vehicle reports of the drive, with errors of its own. changes : of its log."""
    log = replace(sim.log, **changes)
    return _fixes(log, sim.motion, np.random.default_rng((log.seed, 99)), 1.0)[0]


def _truth(motion: OnEarth, anchor: Anchor, log: Log, t_s: np.ndarray) -> Truth:
    truth = motion.at(t_s)
    pos_n = positions_n(truth.lat, truth.lon, truth.height, anchor)
    rot_nl = level_rotation(pos_n, anchor).swapaxes(0, 1)
    rot_nv = mm(rot_nl, np.moveaxis(rotation.to_matrix(truth.q_nv), 0, -1))
    return Truth(mm(rot_nv, log.box[..., None]), rot_nv, mv(rot_nl, truth.vel_n.T), pos_n, truth.gyro_v.T)


def _bias(sigma: float, walk: float, t_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    start = rng.normal(0.0, 1.0, (3, 1)) * sigma
    steps = rng.normal(0.0, 1.0, (3, len(t_s) - 1)) * walk * np.sqrt(np.diff(t_s))
    return start + np.concatenate([np.zeros((3, 1)), np.cumsum(steps, axis=1)], axis=1)


def _fixes(log: Log, motion: OnEarth, rng: np.random.Generator, loud: float) -> tuple[Fixes, np.ndarray]:
    t_s = np.arange(0.37 / log.gnss_hz, log.seconds, 1.0 / log.gnss_hz)
    count, axes = len(t_s), np.array([1.0, 1.0, 1.5])[:, None]
    placed = _truth(motion, log.place, log, t_s + log.lag)
    moved = _truth(motion, log.place, log, t_s + log.lag + log.velocity_lag)
    lever = np.broadcast_to(np.array(log.lever_v)[:, None], (3, count))
    swing = mv(moved.rot_nv, np.cross(moved.rate_v, lever, axis=0))
    drift, kept = rng.normal(0.0, 1.0, (3, count)), np.exp(-1.0 / (log.gnss_hz * log.tau))
    for i in range(1, count):
        drift[:, i] = kept * drift[:, i - 1] + np.sqrt(1.0 - kept**2) * drift[:, i]
    error = log.drift * drift + log.white * rng.normal(0.0, 1.0, (3, count))
    outlier = rng.random(count) < log.outliers
    way = rng.normal(0.0, 1.0, (3, count))
    jump = outlier * rng.uniform(10.0, 50.0, count) * way / np.sqrt((way**2).sum(axis=0))
    world = turned_about_up(log.turned)
    pos_n = placed.pos_n + mv(placed.rot_nv, lever) + world @ (loud * axes * error + jump)
    vel_error = loud * axes * log.velocity * rng.normal(0.0, 1.0, (3, count))
    vel_n = moved.vel_n + swing + world @ vel_error
    fixes = Fixes(
        t_s=t_s,
        pos_n=pos_n,
        pos_sigma=np.broadcast_to(axes * log.white, (3, count)).copy(),
        vel_rows=np.repeat(np.eye(3)[..., None], count, axis=2),
        vel=vel_n,
        vel_sigma=np.broadcast_to(axes * log.velocity, (3, count)).copy(),
        small_only=np.zeros(count, bool),
        speed_only=np.zeros(count, bool),
        share=np.ones(count),
    )
    return fixes, outlier


def turned_about_up(angle: float) -> np.ndarray:
    """(3, 3), turns vectors in axes n by an angle in rad from east towards north."""
    return rotation_exp(np.array([[0.0], [0.0], [angle]]))[..., 0]


def dense(normal: Normal) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right side of the normal equations, first the knots and then what is common."""
    knots, size = normal.knots, KNOT_SIZE
    rows = knots * size
    matrix = np.zeros((rows + COMMON_SIZE, rows + COMMON_SIZE))
    for k in range(knots):
        own = slice(k * size, (k + 1) * size)
        matrix[own, own] = normal.blocks[k, :, :size]
        if k + 1 < knots:
            behind = slice(own.stop, own.stop + size)
            matrix[own, behind] = normal.blocks[k, :, size:]
            matrix[behind, own] = normal.blocks[k, :, size:].T
    border = normal.border[:-1].reshape(COMMON_SIZE, rows)
    matrix[rows:, :rows], matrix[:rows, rows:] = border, border.T
    matrix[rows:, rows:] = normal.corner[:-1, :-1]
    return matrix, np.concatenate([normal.border[-1].ravel(), normal.corner[:-1, -1]])


def derivatives(values: Callable[[State], np.ndarray], state: State, step: float = 1e-5) -> np.ndarray:
    """Central differences of values (...) for every unknown: (..., 18 N + 21), knots first, then what is common."""
    rows = KNOT_SIZE * state.knots
    columns = []
    for index in range(rows + COMMON_SIZE):
        change = np.zeros(rows + COMMON_SIZE)
        change[index] = step
        there, back = (
            values(state.moved(sign * change[:rows].reshape(-1, KNOT_SIZE).T, sign * change[rows:]))
            for sign in (1.0, -1.0)
        )
        columns.append((there - back) / (2.0 * step))
    return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class Linearised:
    """A short lively drive at a state near the truth, with all that the factors are made of."""

    sim: Simulated
    smoother: Smoother
    state: State
    increments: Increments
    inside: Inside
    gravity: GravityField

    def ends(self, state: State) -> Misclosure:
        """What the motion from each knot misses the next by."""
        return misclosure(state, self.increments, self.gravity, self.smoother.earth_rate_n)

    def here(self, state: State) -> AtEpochs:
        """The state at the epochs."""
        return at_epochs(state, self.ends(state), self.smoother.epochs, self.inside)


def linearised(log: Log, off: float = 0.0) -> Linearised:
    """`log` at the truth, or `off` times some sigmas away from it: 0.5 deg, 0.1 m/s, 1 m, 1e-4 rad/s, 0.01 m/s^2."""
    sim = simulate(log)
    smoother = Smoother(sim.drive, Model())
    true = sim.state(sim.drive.samples.knot_times)
    rng = np.random.default_rng(5)
    sizes = np.repeat([1.0, 0.01, 0.1, 1.0, 1e-4, 0.01], 3)[:, None] * off
    common = np.zeros(COMMON_SIZE)
    common[[SLIP, PITCH, WHEEL, ROLL]] = np.array([0.003, 0.004, 0.02, 0.003]) * off
    common[GYRO_SCALE], common[ACCEL_SCALE] = 1e-4 * off, 1e-3 * off
    state = true.moved(sizes * rng.normal(size=(KNOT_SIZE, true.knots)), common)
    increments = smoother.increments(true)
    inside = locate(smoother.epochs, sim.drive.samples, increments)
    return Linearised(sim, smoother, state, increments, inside, GravityField.around(true.pos_n, log.place))


def check_rows(drive: Linearised, aid: Aid, rows: Callable[[Any, State], Floats]) -> None:
    """The factors are those of weighted rows, whose Jacobian is found by differences; weights are those of now."""
    factors = aid.at(drive.smoother.drive.samples.knot_times)
    normal = Normal(drive.state.knots)
    factors.add(normal, drive.state, drive.gravity)
    now = rows(factors, drive.state)
    weight = np.sqrt(cauchy_weights((now**2).sum(axis=0), 9.0))
    jacobian = derivatives(lambda state: rows(factors, state) * weight, drive.state)
    jacobian = jacobian.reshape(-1, KNOT_SIZE * drive.state.knots + COMMON_SIZE)
    matrix, right = dense(normal)
    size = np.maximum(np.sqrt((jacobian**2).sum(axis=0)), 1e-4 * np.abs(jacobian).max())
    assert_allclose((matrix - jacobian.T @ jacobian) / np.outer(size, size), 0.0, atol=DIFFERENCE)
    residual = (now * weight).ravel()
    assert_allclose((right + jacobian.T @ residual) / size, 0.0, atol=DIFFERENCE * np.linalg.norm(residual))
    assert normal.cost == pytest.approx(residual @ residual, rel=1e-9)


def height_error(sim: Simulated, aids: tuple[Aid, ...]) -> Floats:
    """Errors of the heights of the knots, (N,) m; GNSS says nothing of the vertical velocity."""
    fixes = sim.drive.fixes
    flat = replace(fixes, vel_sigma=np.where(np.arange(3)[:, None] == 2, np.inf, fixes.vel_sigma))
    found = estimate(replace(sim.drive, fixes=flat, aids=aids), Model(), sim.log.noise, learn_noise=False)
    return (found.solved.state.pos_n - sim.at(sim.drive.samples.knot_times).pos_n)[2]


def likelihood_of(sim: Simulated, noise: Noise) -> tuple[Smoother, Likelihood]:
    """The smoother of a drive, and its marginal likelihood about the solution with this noise."""
    smoother = Smoother(sim.drive, Model())
    return smoother, Likelihood(smoother, smoother.solve(start_state(smoother), noise, "cauchy"))
