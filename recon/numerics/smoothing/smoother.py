"""The best trajectory of a whole drive: all unknowns at once, by robust nonlinear least squares (MAP).

Knots every two seconds carry the state; the IMU between them is summed up beforehand (preintegration); GNSS fixes and
the constraints of wheels hang between the knots; what all knots share - mounting, levers, lags, scale errors,
compliance - borders the band of the normal equations. Gauss-Newton converges in about six steps from a closed-form
start. Outliers are told apart on smoothed residuals: by Cauchy's loss first, truncated least squares last.

References
    Forster et al. (2017), IEEE T-RO 33(1) (preintegration).
    Yang, Antonante, Tzoumas, Carlone (2020), "Graduated non-convexity for robust spatial perception", IEEE RA-L 5(2).
    Bar-Shalom, Li, Kirubarajan (2001), "Estimation with applications to tracking and navigation", section 1.4 (MAP).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing import alignment
from recon.numerics.smoothing.band import Factor, Solution, factor, solve_bordered
from recon.numerics.smoothing.constraints import add_drift, add_road, add_standing, add_value, add_walks
from recon.numerics.smoothing.earth import GravityField, earth_rate_n, gravity_n
from recon.numerics.smoothing.epochs import Epochs, Inside, Misclosure, locate, misclosure, place_epochs
from recon.numerics.smoothing.inertial import add_inertial, inertial_jacobian, whitening
from recon.numerics.smoothing.lag import UNKNOWN, find_lag
from recon.numerics.smoothing.measurements import (
    BodyModel,
    Fixes,
    Measured,
    add_measured,
    at_epochs,
    body_rows,
    position_rows,
    velocity_rows,
)
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.robust import cauchy_weights, tls_start, tls_weights
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats, mmt, rotation_log
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    ACCEL_SCALE,
    COMMON_SIZE,
    GYRO_BIAS,
    GYRO_SCALE,
    KNOT_SIZE,
    LAG,
    LEVER,
    MOUNT,
    PITCH,
    POSITION,
    REAR,
    ROLL,
    ROTATION,
    SCALES,
    SLIP,
    VELOCITY_LAG,
    WHEEL,
    State,
)
from recon.numerics.smoothing.stops import MOVING, SLOW, block_means, still_blocks, still_noise, still_spans

Loss = Literal["cauchy", "tls"]

MOST_STEPS: Final = 30
_C2: Final = 16.0
"""Squared normalised residual of three components beyond which a fix is an outlier."""
_CAUCHY_C2: Final = 9.0
_GROWTH: Final = 100.0
"""Factor by which the truncation sharpens from step to step."""
_SHARP: Final = 30.0
_SMALL_TURN: Final = 1e-3
_SMALL_MOVE: Final = {"cauchy": 1.0, "tls": 0.1}
"""rad and m; steps shrink thirty- to hundredfold, so the one after these is below 0.1 mm. Where weights still creep along
in an outage, noise is estimated all the same.
"""
_STALE: Final = (3e-3, 1.0, 0.02)
"""Change of gyro bias rad/s, accel bias m/s^2 and scale beyond which their first order no longer does: increments are
integrated anew. That of the accelerometer is linear but for the rotation."""
_STALE_LAG: Final = 0.02
"""s; a lag beyond this moves the stamps, for velocity times lag is only its first order."""
_FIRST_DAMPING: Final = 1e-6
"""Share by which the diagonal grows where the normal equations are not positive definite; tenfold each time."""
_CONVENTION: Final = 1e-4
"""m and rad; sigma of a first position and heading that nothing measures, and which are set to be what they are."""
_GAP_S: Final = 3.0
"""s without a fix, beyond which the velocity between is not known beforehand."""
_DIFFERENCE_S: Final = 3.9
"""s between positions whose difference is a velocity: noise of metres then is one of decimetres per second."""
_STANDING_WHEELS: Final = 0.1
"""m/s; while GNSS says that it moves, such wheels only say that something carries the vehicle."""
_NO_HEADING: Final = 0.2
"""rad; doubt of the first heading that noise alone exceeds, and no drive."""
_MOVES_MUCH: Final = 0.2
_GAP_RATE: Final = 0.3
_GAP_FORCE: Final = 2.0
_GAP_FAR_S: Final = 2.0
"""rad/s and m/s^2, what may have happened where the IMU is silent for so long, s; less in a shorter gap, whose ends tell."""


@dataclass(frozen=True)
class Noise:
    """Sizes of the random errors.

    gyro, accel : densities rad/s/sqrt(Hz), m/s^2/sqrt(Hz); gyro_walk, accel_walk : rad/s/sqrt(s), m/s^2/sqrt(s)
    drift : (3,) m, drift_tau : s, of the slow error of GNSS positions
    position, velocity : (3,) factors on the sigmas of the fixes
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
    drift: Floats
    drift_tau: float
    position: Floats
    velocity: Floats


@dataclass(frozen=True)
class Model:
    """How a car moves, and what is known beforehand. Sigmas of priors: zero fixes the value at its mean.

    gyro_bias rad/s, accel_bias m/s^2, gyro_scale, accel_scale 1 : sigmas
    mounting : (3, 3) vehicle from sensor, None for the closed form's; mounting_sigma : (3,) rad
    lever, rear : (3,) m, vehicle, mean; lever_sigma, rear_sigma : (3,) m
    lag, velocity_lag s; slip, pitch, roll s^2/m; wheel 1 : sigmas
    wheels : does it roll on wheels, so that it moves forward only
    across m/s, slip_growth : sigma of motion across at one second, and its growth with slip
    stop m/s, stop_heading, stop_tilt rad/sqrt(s) : how still a standing vehicle is
    road rad, road_stretch m : bank of roads, and the length over which it changes
    first_attitude : (3, 3) n from sensor at the first knot, None where not known; first_attitude_sigma : (3,) rad,
        about axes n
    """

    gyro_bias: float = np.radians(1.0)
    accel_bias: float = 0.5
    gyro_scale: float = 0.005
    accel_scale: float = 0.003
    mounting: Floats | None = None
    mounting_sigma: tuple[float, float, float] = (np.radians(10.0),) * 3
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lever_sigma: tuple[float, float, float] = (1.0, 1.0, 1.0)
    rear: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rear_sigma: tuple[float, float, float] = (1.5, 1.5, 1.5)
    lag: float = 0.1
    velocity_lag: float = 0.1
    slip: float = 0.01
    pitch: float = 0.01
    roll: float = 0.01
    wheel: float = 0.02
    wheel_speed: float = 0.1
    wheels: bool = True
    across: float = 0.1
    slip_growth: float = 0.004
    stop: float = 0.02
    stop_heading: float = 3e-5
    stop_tilt: float = 1e-4
    road: float = np.radians(1.5)
    road_stretch: float = 100.0
    first_attitude: Floats | None = None
    first_attitude_sigma: tuple[float, float, float] = (np.radians(1.0),) * 3


@dataclass(frozen=True)
class Drive:
    """What was logged. wheel_t_s : (w,) s, wheel_speed : (w,) m/s, without rows where there are no wheels' speeds."""

    samples: Samples
    fixes: Fixes
    anchor: Anchor
    wheel_t_s: Floats
    wheel_speed: Floats


@dataclass(frozen=True)
class Solved:
    """The solution, and the linear system at it.

    epochs, inside, ends, increments : of the last linearisation; ends anew, for the solution
    system, solution : factor of the knots, and the last step; the factor stays good until the smoother solves again
    pos_weight, vel_weight : (E,) robust weights of the fixes at the epochs
    pos_residual, vel_residual : (3, E) in sigmas, before the robust weight; pos_sigma, vel_sigma : (3, E) m, m/s
    steps, converged : how many steps it took, and whether the last was small
    moved_lag : s added to the stamps of the fixes; the whole lag is that and LAG
    """

    state: State
    noise: Noise
    epochs: Epochs
    inside: Inside
    ends: Misclosure
    increments: Increments
    system: Factor
    solution: Solution
    pos_weight: Floats
    vel_weight: Floats
    pos_residual: Floats
    vel_residual: Floats
    steps: int
    converged: bool
    moved_lag: float

    @property
    def rejected(self) -> float:
        """Share of the fixes whose position or velocity is put aside."""
        fixes = self.epochs.fix >= 0
        aside = np.minimum(self.pos_weight, self.vel_weight)[fixes] < 0.5
        return float(aside.mean()) if fixes.any() else 0.0


@dataclass(frozen=True)
class Parts:
    """The normal equations at a solution in parts.

    fixed : factors whose noise is given; fixes : position across and up, velocity across and up
    inertial : (K, 9, 31), as from `inertial_jacobian`; the drift is left out
    """

    fixed: Normal
    fixes: tuple[Normal, Normal, Normal, Normal]
    inertial: Floats


class Smoother:
    """A drive made ready: stops found, epochs placed, memory taken. `solve` may be called with other noise."""

    def __init__(self, drive: Drive, model: Model) -> None:
        self.drive, self.model = drive, model
        samples = drive.samples
        self.blocks = block_means(samples, max(1, round(0.1 * samples.per_interval / _typical(samples))))
        self.motion = motion = fix_motion(drive.fixes)
        late = find_lag(self.blocks, *motion) if model.lag > 0.0 else UNKNOWN
        self.moved_lag = -late.seconds if abs(late.seconds) > max(_STALE_LAG, 3.0 * late.sigma) else 0.0
        self.first_lag = self.moved_lag
        self.still = still_blocks(self.blocks, motion[0] + self.moved_lag, motion[1])
        self.still_noise = still_noise(self.blocks, self.still)
        knots = samples.knot_times
        self.still_knots = still_spans(self.blocks, self.still, knots - 0.1, knots + 0.1)
        self.still_intervals = still_spans(self.blocks, self.still, knots[:-1], knots[1:])
        self.length = np.diff(knots)
        gap_s = (np.diff(samples.t_s) * samples.filled).reshape(samples.intervals, -1).sum(axis=1)
        self.gap_s = gap_s
        self.gap = (gap_s * np.minimum(gap_s / _GAP_FAR_S, 1.0)) ** 2 / self.length
        self.earth_rate_n = earth_rate_n(drive.anchor.lat)
        self.knot_rate = samples.gyro_s[:: samples.per_interval].T
        self.normal = Normal(samples.intervals + 1)
        self._increments: Increments | None = None
        self.first_rot_ns, self.origin_n = np.eye(3)[..., None], np.zeros(3)
        located = np.asarray(np.isfinite(drive.fixes.pos_sigma).any(axis=1))
        self.origin_sigma = np.where(located, np.inf, _CONVENTION)
        directed = located[:2].all() or bool((np.isfinite(drive.fixes.vel_sigma[1]) & ~drive.fixes.speed_only).any())
        self.heading_sigma = np.array([np.inf, np.inf, np.inf if directed else _CONVENTION])
        self.mounting = np.eye(3) if model.mounting is None else model.mounting
        self.free = np.ones(COMMON_SIZE, dtype=bool)
        self._place()

    def _place(self) -> None:
        """Place the epochs, at fixes stamped as now believed."""
        drive, samples = self.drive, self.drive.samples
        self.epochs = place_epochs(samples, self.blocks, drive.fixes.t_s + self.moved_lag)
        t_s = self.epochs.t_s
        step = np.clip(np.searchsorted(samples.t_s, t_s, side="right") - 1, 0, len(samples.filled) - 1)
        quiet = still_spans(self.blocks, self.still, t_s - 0.1, t_s + 0.1)
        speed = np.full(len(t_s), np.nan)
        if len(drive.wheel_t_s):
            speed = np.interp(t_s, drive.wheel_t_s, drive.wheel_speed)
            carried = (np.abs(speed) < _STANDING_WHEELS) & (np.interp(t_s, *self.motion[:2]) > SLOW)
            speed[carried] = np.nan
        self.body = BodyModel(
            sigma=self.model.across,
            slip=self.model.slip_growth,
            wheel_sigma=self.model.wheel_speed,
            on=self.epochs.live & ~quiet & ~samples.filled[step],
            wheel_speed=speed,
        )

    def solve(self, state: State, noise: Noise, loss: Loss) -> Solved:
        """Gauss-Newton steps until they are small. Raises numpy.linalg.LinAlgError where there is no solution."""
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        increments, inside, white = self._integrated(state, noise)
        sharpness: tuple[float, float] | None = None
        damping, done = 0.0, False
        for count in range(1, MOST_STEPS + 1):
            if _stale(state, increments):
                increments, inside, white = self._integrated(state, noise)
            if abs(state.common[LAG]) > _STALE_LAG:
                self.moved_lag += float(state.common[LAG])
                state = state.with_common(LAG, 0.0)
                self._place()
                inside = locate(self.epochs, self.drive.samples, increments)
            ends = misclosure(state, increments, gravity, self.earth_rate_n)
            position, velocity, body = self._rows(state, ends, inside, noise, robust=count > 1)
            squared = (
                _squared(position, self.drive.fixes, self.epochs),
                _squared(velocity, self.drive.fixes, self.epochs),
            )
            weights, sharpness = _robust(squared, loss, sharpness, count)
            self._assemble(state, noise, gravity, count)
            add_inertial(self.normal, inertial_jacobian(state, increments, gravity, self.earth_rate_n), white)
            add_drift(self.normal, state.drift_n, self.length, noise.drift, noise.drift_tau)
            add_measured(
                self.normal,
                inside,
                self.epochs.slots,
                position.weighted(weights[0]),
                velocity.weighted(weights[1]),
                body if self.model.wheels else None,
                float(state.common[LAG]),
            )
            try:
                system, solution = self._step(damping)
            except np.linalg.LinAlgError:
                if count == MOST_STEPS:
                    raise
                damping = max(_FIRST_DAMPING, 10.0 * damping)
                continue
            damping = 0.1 * damping if damping > _FIRST_DAMPING else 0.0
            turn, move = float(np.abs(solution.step.T[ROTATION]).max()), float(np.abs(solution.step.T[POSITION]).max())
            state = state.moved(solution.step.T, solution.step_global)
            sharp = loss == "cauchy" or (sharpness is not None and min(sharpness) > _SHARP)
            done = (
                count >= 4
                and sharp
                and damping == 0.0
                and turn < _SMALL_TURN
                and move < _SMALL_MOVE[loss]
                and not _stale(state, increments)
            )
            if done:
                break
        ends = misclosure(state, increments, gravity, self.earth_rate_n)
        return Solved(
            state=state,
            noise=noise,
            epochs=self.epochs,
            inside=inside,
            ends=ends,
            increments=increments,
            system=system,
            solution=solution,
            pos_weight=weights[0],
            vel_weight=weights[1],
            pos_residual=position.residual,
            vel_residual=velocity.residual,
            steps=count,
            converged=done,
            moved_lag=self.moved_lag,
        )

    def increments(self, state: State) -> Increments:
        """The samples summed up at biases near those of the state, anew only where they have moved far."""
        if self._increments is None or _stale(state, self._increments):
            biases = state.gyro_bias[:, :-1], state.accel_bias[:, :-1]
            self._increments = preintegrate(self.drive.samples, *biases, state.common[SCALES])
        return self._increments

    def _integrated(self, state: State, noise: Noise) -> tuple[Increments, Inside, Floats]:
        increments = self.increments(state)
        inside = locate(self.epochs, self.drive.samples, increments)
        return increments, inside, whitening(increments, *self.densities(noise))

    def densities(self, noise: Noise) -> tuple[Floats, Floats]:
        """Noise of gyro and accelerometer in each interval, more where the IMU was silent: (K,), (K,)."""
        gyro = np.sqrt(noise.gyro**2 + _GAP_RATE**2 * self.gap)
        return gyro, np.sqrt(noise.accel**2 + _GAP_FORCE**2 * self.gap)

    def _rows(
        self, state: State, ends: Misclosure, inside: Inside, noise: Noise, robust: bool
    ) -> tuple[Measured, Measured, Measured]:
        here = at_epochs(state, ends, self.epochs, inside)
        scaled = replace(
            self.drive.fixes,
            pos_sigma=self.drive.fixes.pos_sigma * noise.position[:, None],
            vel_sigma=self.drive.fixes.vel_sigma * noise.velocity[:, None],
        )
        u, length = inside.u, ends.duration[self.epochs.interval]
        bridge = (2.0 * noise.drift**2 / noise.drift_tau)[:, None] * (length * u * (1.0 - u))
        return (
            position_rows(here, state, scaled, self.epochs, bridge),
            velocity_rows(here, state, scaled, self.epochs),
            body_rows(here, state, self.epochs, self.body, robust),
        )

    def _assemble(self, state: State, noise: Noise, gravity: GravityField, count: int) -> None:
        """The factors whose noise is given: walks of the biases, stops, roads, priors."""
        normal, model = self.normal, self.model
        normal.clear()
        add_walks(normal, state, self.length, noise.gyro_walk, noise.accel_walk)
        add_standing(
            normal,
            state,
            self.still_knots,
            self.still_intervals,
            self.length,
            model.stop,
            model.stop_heading,
            model.stop_tilt,
            robust=count > 3,
        )
        if model.wheels:
            add_road(
                normal, state, gravity, self.knot_rate, self.still_knots, self.length, model.road, model.road_stretch
            )
        add_value(normal, 0, GYRO_BIAS, state.gyro_bias[:, 0], model.gyro_bias)
        add_value(normal, 0, ACCEL_BIAS, state.accel_bias[:, 0], model.accel_bias)
        self._add_priors(state)

    def parts(self, solved: Solved) -> Parts:
        """The sums of factors at a solution, apart by whose noise they have."""
        state, inside, increments = solved.state, solved.inside, solved.increments
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        ends = misclosure(state, increments, gravity, self.earth_rate_n)
        position, velocity, body = self._rows(state, ends, inside, solved.noise, robust=True)
        tall = inertial_jacobian(state, increments, gravity, self.earth_rate_n)
        self._assemble(state, solved.noise, gravity, 4)
        lag = float(state.common[LAG])
        guessed = self.drive.fixes.small_only[self.epochs.fix] * solved.vel_weight
        add_measured(
            self.normal,
            inside,
            self.epochs.slots,
            None,
            velocity.weighted(guessed),
            body if self.model.wheels else None,
            lag,
        )
        across, up = np.array([1.0, 1.0, 0.0])[:, None], np.array([0.0, 0.0, 1.0])[:, None]
        fixes = []
        told = solved.vel_weight * (guessed == 0.0)
        for kind, weight in ((position, solved.pos_weight), (velocity, told)):
            for axes in (across, up):
                part = Normal(self.normal.knots)
                rows = kind.weighted(axes * (weight > 0.5))
                placed, moved = (rows, None) if kind is position else (None, rows)
                add_measured(part, inside, self.epochs.slots, placed, moved, None, lag)
                fixes.append(part)
        return Parts(self.normal, (fixes[0], fixes[1], fixes[2], fixes[3]), tall)

    def _add_priors(self, state: State) -> None:
        model, common = self.model, state.common
        errors = common.copy()
        errors[MOUNT] = rotation_log((state.rot_vs @ self.mounting.T)[..., None])[:, 0]
        errors[LAG] += self.moved_lag - self.first_lag
        sigma = np.ones(COMMON_SIZE)
        sigma[MOUNT] = model.mounting_sigma
        sigma[LAG], sigma[VELOCITY_LAG], sigma[WHEEL] = model.lag, model.velocity_lag, model.wheel
        sigma[SLIP], sigma[PITCH], sigma[ROLL] = model.slip, model.pitch, model.roll
        sigma[GYRO_SCALE], sigma[ACCEL_SCALE] = model.gyro_scale, model.accel_scale
        self.free = sigma > 0.0
        weight = np.diag(1.0 / np.where(self.free, sigma, 1.0) ** 2)
        for where, mean, sizes in ((LEVER, model.lever, model.lever_sigma), (REAR, model.rear, model.rear_sigma)):
            errors[where] -= state.rot_vs.T @ np.asarray(mean)
            weight[where, where] = state.rot_vs.T @ np.diag(1.0 / np.asarray(sizes) ** 2) @ state.rot_vs
        self.normal.add_common(slice(0, COMMON_SIZE), errors, weight)
        if model.first_attitude is not None:
            turn = rotation_log(mmt(state.rot_ns[..., :1], model.first_attitude[..., None]))[:, 0]
            add_value(self.normal, 0, ROTATION, turn, np.asarray(model.first_attitude_sigma))
        for where, value, origin, sigma in (
            (POSITION, state.pos_n[:, 0], self.origin_n, self.origin_sigma),
            (ROTATION, self._turned(state), np.zeros(3), self.heading_sigma),
        ):
            add_value(self.normal, 0, where, value - origin, sigma)

    def _turned(self, state: State) -> Floats:
        """Rotation of the first knot since the start: (3,) rad, axes n."""
        return np.asarray(rotation_log(mmt(state.rot_ns[..., :1], self.first_rot_ns))[:, 0])

    def _step(self, damping: float) -> tuple[Factor, Solution]:
        """Solve for what is free; fixed unknowns do not move."""
        free = np.append(self.free, True)
        knots = self.normal.knots
        border = self.normal.border[free].reshape(int(free.sum()), -1).T
        corner = self.normal.corner[np.ix_(free, free)]
        i = np.arange(KNOT_SIZE)
        self.normal.blocks[:, i, i] *= 1.0 + damping
        system = factor(self.normal.buffer, knots, KNOT_SIZE)
        found = solve_bordered(system, border, corner)
        whole = np.zeros(COMMON_SIZE)
        whole[self.free] = found.step_global
        return system, replace(found, step_global=whole)


def _typical(samples: Samples) -> float:
    """Length of an interval of the log, s."""
    return float(np.median(np.diff(samples.knot_times)))


def _stale(state: State, increments: Increments) -> bool:
    gyro = np.abs(state.gyro_bias[:, :-1] - increments.gyro_bias).max() / _STALE[0]
    accel = np.abs(state.accel_bias[:, :-1] - increments.accel_bias).max() / _STALE[1]
    scale = np.abs(state.common[SCALES] - increments.scale).max() / _STALE[2]
    return bool(max(gyro, accel, scale) > 1.0)


def _squared(measured: Measured, fixes: Fixes, epochs: Epochs) -> Floats:
    """Squared normalised residuals of the fixes at the epochs: (E,)."""
    share = fixes.share[epochs.fix]
    return np.asarray((measured.residual**2).sum(axis=0) / share)


def _robust(
    squared: tuple[Floats, Floats], loss: Loss, sharpness: tuple[float, float] | None, count: int
) -> tuple[tuple[Floats, Floats], tuple[float, float] | None]:
    """Weights of positions and of velocities, each for itself; the first step takes all."""
    if count == 1:
        one = np.ones_like(squared[0])
        return (one, one), None
    if loss == "cauchy":
        return (cauchy_weights(squared[0], _CAUCHY_C2), cauchy_weights(squared[1], _CAUCHY_C2)), None
    sharper = (
        (tls_start(squared[0], _C2), tls_start(squared[1], _C2))
        if sharpness is None
        else (min(sharpness[0] * _GROWTH, 1e4), min(sharpness[1] * _GROWTH, 1e4))
    )
    return (tls_weights(squared[0], _C2, sharper[0]), tls_weights(squared[1], _C2, sharper[1])), sharper


def fix_motion(fixes: Fixes) -> tuple[Floats, Floats, Floats]:
    """Times s, horizontal speeds m/s and courses rad of the fixes that tell a speed: (k,) each, NaN for no course.

    Where none does, those of differences of positions. Of one that only says that it is small, the sigma is its speed.
    """
    seen = np.isfinite(fixes.vel_sigma[:2]).any(axis=0)
    if not seen.any():
        t_s, vel_n = _differences(fixes.t_s, fixes.pos_n)
        return t_s, np.hypot(vel_n[0], vel_n[1]), np.arctan2(vel_n[0], vel_n[1])
    vel_n = np.einsum("jim,jm->im", fixes.vel_rows[..., seen], fixes.vel[:, seen])
    small = fixes.small_only[seen]
    speed = np.where(small, fixes.vel_sigma[0, seen], np.hypot(vel_n[0], vel_n[1]))
    course = np.where(fixes.speed_only[seen] | small, np.nan, np.arctan2(vel_n[0], vel_n[1]))
    return fixes.t_s[seen], speed, course


def start_state(smoother: Smoother) -> State:
    """Closed form: gyro bias at stops, attitude from GNSS accelerations against specific force, then the mounting.

    Where only speed is known, the course is that of the turns since the start, which faces north by convention.
    Raises ValueError where nothing moves, so that no direction is forward and no heading is told.
    """
    drive, knots = smoother.drive, smoother.drive.samples.knot_times
    stands = int(smoother.still.sum()) > 5
    bias = np.median(smoother.blocks.gyro[:, smoother.still], axis=1) if stands else np.zeros(3)
    state = _resting(len(knots), bias)
    increments = smoother.increments(state)
    segments = segments_of(smoother.gap_s)
    vel_n, known = knot_velocities(drive, knots, increments, segments)
    pull_n = gravity_n(np.zeros((3, 1)), drive.anchor)[:, 0]
    if not stands:
        state = _resting(len(knots), alignment.gyro_bias_from_drift(increments, vel_n, known, pull_n, segments))
        increments = smoother.increments(state)
    rot_ns = alignment.align(increments, vel_n, known, pull_n, segments)
    if smoother.model.first_attitude is None and not _moves_much(smoother):
        unsure = alignment.heading_sigma(increments, rot_ns, vel_n, known, pull_n, segments)
        if unsure.min(initial=np.pi) > _NO_HEADING:
            raise ValueError("speed and course do not change by more than the noise of GNSS")
    rot_vs = alignment.mounting(rot_ns, vel_n, known) if smoother.model.mounting is None else smoother.model.mounting
    pos_n = knot_positions(drive, knots, vel_n)
    smoother.mounting, smoother.first_rot_ns, smoother.origin_n = rot_vs, rot_ns[..., :1], pos_n[:, 0]
    return replace(state, rot_ns=rot_ns, vel_n=vel_n, pos_n=pos_n, rot_vs=rot_vs)


def _moves_much(smoother: Smoother) -> bool:
    """Is it fast for a fair part of the time, so that its course is its heading even where that never changes?"""
    return bool((smoother.motion[1] > MOVING).mean() > _MOVES_MUCH) if len(smoother.motion[1]) else False


def _resting(knots: int, gyro_bias: Floats) -> State:
    """Nothing known but the bias of the gyro (3,) rad/s."""
    same = np.repeat(np.eye(3)[..., None], knots, axis=2)
    bias, none = np.repeat(gyro_bias[:, None], knots, axis=1), np.zeros((3, knots))
    return State(same, none, none, bias, none, none, np.eye(3), np.zeros(COMMON_SIZE))


def segments_of(gap_s: Floats, longest: float = 10.0) -> list[slice]:
    """Slices of knots between intervals that are mostly gap."""
    cut = np.flatnonzero(gap_s > longest * 0.1) + 1
    edges = [0, *cut.tolist(), len(gap_s) + 1]
    return [slice(a, b) for a, b in pairwise(edges) if b - a > 1]


def knot_velocities(
    drive: Drive, knots: Floats, increments: Increments, segments: list[slice]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Velocity at the knots, (3, N) m/s, and where it is known: of fixes, else of their positions, else of speed."""
    fixes = drive.fixes
    vector = np.isfinite(fixes.vel_sigma[:2]).all(axis=0) & ~fixes.speed_only
    speed = np.isfinite(fixes.vel_sigma[0]) & fixes.speed_only
    placed = np.isfinite(fixes.pos_sigma[:2]).all(axis=0)
    if vector.sum() > 1:
        t_s, vel_n = fixes.t_s[vector], np.einsum("jim,jm->im", fixes.vel_rows[..., vector], fixes.vel[:, vector])
    elif placed.sum() > 2:
        t_s, vel_n = _differences(fixes.t_s[placed], fixes.pos_n[:, placed])
    else:
        t_s = fixes.t_s[speed]
        known = _near(knots, t_s)
        along = np.interp(knots, t_s, fixes.vel[0, speed])
        return alignment.pseudo_velocity(increments, along, segments), known
    return np.stack([np.interp(knots, t_s, axis) for axis in vel_n]), _near(knots, t_s)


def _differences(t_s: Floats, pos_n: Floats) -> tuple[Floats, Floats]:
    """Velocities of positions at least DIFFERENCE_S apart: times (k,) s, (3, k) m/s."""
    ahead = np.searchsorted(t_s, t_s + _DIFFERENCE_S)
    first = np.flatnonzero(ahead < len(t_s))
    last = ahead[first]
    return 0.5 * (t_s[first] + t_s[last]), (pos_n[:, last] - pos_n[:, first]) / (t_s[last] - t_s[first])


def _near(knots: Floats, t_s: Floats) -> NDArray[np.bool_]:
    """Knots with a fix not much further away than usual."""
    if len(t_s) < 2:
        return np.zeros(len(knots), dtype=bool)
    usual = float(np.median(np.diff(t_s)))
    gap = np.append(np.diff(t_s), 0.0)[np.clip(np.searchsorted(t_s, knots) - 1, 0, len(t_s) - 1)]
    inside = (knots >= t_s[0] - usual) & (knots <= t_s[-1] + usual)
    return np.asarray((gap <= max(_GAP_S, 2.5 * usual)) & inside)


def knot_positions(drive: Drive, knots: Floats, vel_n: Floats) -> Floats:
    """Positions at the knots, (3, N) m: of the fixes, else the path of the velocities from zero."""
    out = np.zeros_like(vel_n)
    out[:, 1:] = np.cumsum(0.5 * (vel_n[:, 1:] + vel_n[:, :-1]) * np.diff(knots), axis=1)
    for axis in range(3):
        seen = np.isfinite(drive.fixes.pos_sigma[axis])
        if seen.any():
            out[axis] = np.interp(knots, drive.fixes.t_s[seen], drive.fixes.pos_n[axis, seen])
    return out
