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

from dataclasses import replace
from typing import Final

import numpy as np

from recon.numerics.smoothing.arrival import Arrival
from recon.numerics.smoothing.band import Factor, Solution, factor, solve_bordered
from recon.numerics.smoothing.constraints import add_drift, add_road, add_standing, add_value, add_walks
from recon.numerics.smoothing.disturbances import Disturbances
from recon.numerics.smoothing.earth import GravityField, earth_rate_n
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
from recon.numerics.smoothing.model import Drive, Model, Noise
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.priors import Datum, add_priors, free_of
from recon.numerics.smoothing.robust import SHARPEST, Loss, Sharpness, kept_together, robust_weights
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.solved import Integrated, Linearised, Parts, Solved
from recon.numerics.smoothing.start import fix_motion
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    COMMON_SIZE,
    GYRO_BIAS,
    KNOT_SIZE,
    LAG,
    POSITION,
    ROTATION,
    SCALES,
    State,
)
from recon.numerics.smoothing.stops import (
    SLOW,
    Mask,
    block_means,
    find_stops,
    quiet_in_silence,
    still_noise,
    still_spans,
)

MOST_STEPS: Final = 30
_FEWEST_STEPS: Final = 4
"""From a start in closed form: outliers are told apart while it converges."""
_SETTLING: Final = 6
"""Steps after which an epoch that moves keeps the constraint of the wheels: one near walking pace may otherwise lose it
and win it back from step to step for ever.
"""
_SHARP: Final = 30.0
_SMALL_TURN: Final = 1e-3
_SMALL_MOVE: Final = {"cauchy": 1.0, "tls": 0.1}
"""rad and m; steps shrink thirty- to hundredfold, so the one after these is below 0.1 mm. Where weights still creep
along in an outage, noise is estimated all the same.
"""
_STALE: Final = (3e-3, 1.0, 0.02)
"""Change of gyro bias rad/s, accel bias m/s^2 and scale beyond which their first order no longer does: increments are
integrated anew. That of the accelerometer is linear but for the rotation."""
_STALE_LAG: Final = 0.02
"""s; a lag beyond this moves the stamps, for velocity times lag is only its first order."""
_FIRST_DAMPING: Final = 1e-6
"""Share by which the diagonal grows where the normal equations are not positive definite; tenfold each time."""
_STANDING_WHEELS: Final = 0.1
"""m/s; while GNSS says that it moves, such wheels only say that something carries the vehicle."""


class Smoother:
    """A drive made ready: stops found, epochs placed, memory taken. `solve` may be called with other noise.

    arrival : what is known of the first knot and of what is common, in place of the priors of the model
    moved_lag : s, what the stamps of the fixes are moved by, where it is known beforehand
    increments : of the samples, where they are summed up already
    """

    def __init__(
        self,
        drive: Drive,
        model: Model,
        arrival: Arrival | None = None,
        moved_lag: float | None = None,
        increments: Increments | None = None,
    ) -> None:
        self.drive, self.model, self.arrival = drive, model, arrival
        samples = drive.samples
        self.blocks = block_means(samples, max(1, round(0.1 * samples.per_interval / _typical(samples))))
        self.motion = motion = fix_motion(drive.fixes)
        self.moved_lag = self._first_lag() if moved_lag is None else moved_lag
        self.first_lag = self.moved_lag
        self.still, limits = find_stops(self.blocks, motion[0] + self.moved_lag, motion[1], in_silence=False)
        self.alone = limits is not None and limits.alone
        self.quiet = quiet_in_silence(self.blocks, motion[0] + self.moved_lag, motion[1], limits) & ~self.still
        self.still_noise = still_noise(self.blocks, self.still)
        knots = samples.knot_times
        self.length = np.diff(knots)
        self.disturbed = Disturbances.of(samples, drive.impacts)
        self.earth_rate_n = earth_rate_n(drive.anchor.lat)
        self.knot_rate = samples.gyro_s[:: samples.per_interval].T
        self.normal = Normal(samples.intervals + 1)
        self.aids = [aid.at(knots) for aid in drive.aids]
        self._increments = increments
        self.datum = Datum.of(drive.fixes, model.mounting)
        self.free = free_of(model) if arrival is None else arrival.free
        self._stand()
        self._place()

    def _first_lag(self) -> float:
        """What the stamps of the fixes are moved by before anything else is known: s."""
        if self.arrival is not None:
            return self.arrival.moved_lag
        late = find_lag(self.blocks, *self.motion) if self.model.lag > 0.0 else UNKNOWN
        return -late.seconds if abs(late.seconds) > max(_STALE_LAG, 3.0 * late.sigma) else 0.0

    def believe(self, standing: Mask) -> None:
        """From now on the vehicle stands in these of the `quiet` blocks: (B,)."""
        self.still, self.quiet = self.still | standing, self.quiet & ~standing
        self._stand()
        self._place()

    def _stand(self) -> None:
        """The knots and intervals that lie in standstills."""
        knots = self.drive.samples.knot_times
        self.still_knots = still_spans(self.blocks, self.still, knots - 0.1, knots + 0.1)
        self.still_intervals = still_spans(self.blocks, self.still, knots[:-1], knots[1:])

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
            slip=self.model.slip_growth,
            wheel_sigma=self.model.wheel_speed,
            on=self.epochs.live & ~quiet & ~samples.filled[step] & ~self._slipping(t_s),
            rolls=np.zeros(len(t_s), dtype=bool),
            wheel_speed=speed,
        )

    def solve(self, state: State, noise: Noise, loss: Loss, resumed: bool = False) -> Solved:
        """Gauss-Newton steps until they are small. Raises numpy.linalg.LinAlgError where there is no solution.

        resumed : the state is that of an earlier solution, whose residuals tell outliers from the first step on
        """
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        made = self._integrated(state, noise)
        sharpness: Sharpness | None = SHARPEST if resumed else None
        begun = _FEWEST_STEPS if resumed else 1
        damping, done = 0.0, False
        self.body = replace(self.body, rolls=np.zeros_like(self.body.rolls))
        for count in range(begun, MOST_STEPS + 1):
            state, made = self._kept_fresh(state, noise, made, landed=count != 2)
            here = self._linearise(state, noise, gravity, made, loss, sharpness, count)
            sharpness = here.sharpness
            try:
                system, solution = self._step(damping)
            except np.linalg.LinAlgError:
                if count == MOST_STEPS:
                    raise
                damping = max(_FIRST_DAMPING, 10.0 * damping)
                continue
            damping = 0.1 * damping if damping > _FIRST_DAMPING else 0.0
            state = state.moved(solution.step.T, solution.step_global)
            sharp = loss == "cauchy" or (sharpness is not None and min(sharpness) > _SHARP)
            settled = count >= _FEWEST_STEPS and sharp and damping == 0.0 and not _stale(state, made.increments)
            done = settled and _small(solution, loss)
            if done:
                break
        return self._solved(state, noise, gravity, made, here, system, solution, count - begun + 1, done)

    def about(self, state: State, noise: Noise) -> Solved:
        """One linear step about a state that is known so well that what it leaves far off is an outlier.

        For the marginal of a part of a drive, linearised where all of the drive puts it. Raises LinAlgError.
        """
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        made = self._integrated(state, noise)
        here = self._linearise(state, noise, gravity, made, "tls", SHARPEST, MOST_STEPS)
        system, solution = self._step(0.0)
        state = state.moved(solution.step.T, solution.step_global)
        return self._solved(state, noise, gravity, made, here, system, solution, 1, True)

    def _solved(
        self,
        state: State,
        noise: Noise,
        gravity: GravityField,
        made: Integrated,
        here: Linearised,
        system: Factor,
        solution: Solution,
        steps: int,
        converged: bool,
    ) -> Solved:
        return Solved(
            state=state,
            noise=noise,
            epochs=self.epochs,
            inside=made.inside,
            ends=misclosure(state, made.increments, gravity, self.earth_rate_n),
            increments=made.increments,
            system=system,
            solution=solution,
            pos_weight=here.weights[0],
            vel_weight=here.weights[1],
            pos_residual=here.position.residual,
            vel_residual=here.velocity.residual,
            steps=steps,
            converged=converged,
            moved_lag=self.moved_lag,
        )

    def _kept_fresh(self, state: State, noise: Noise, made: Integrated, landed: bool) -> tuple[State, Integrated]:
        """Integrated anew where biases went far, with stamps moved where the lag did.

        landed : false after the first step, which overshoots what the second takes back, biases and scale errors most
        """
        if landed and _stale(state, made.increments):
            made = self._integrated(state, noise)
        if abs(state.common[LAG]) > _STALE_LAG:
            self.moved_lag += float(state.common[LAG])
            state = state.with_common(LAG, 0.0)
            self._place()
            made = replace(made, inside=locate(self.epochs, self.drive.samples, made.increments))
        return state, made

    def _linearise(
        self,
        state: State,
        noise: Noise,
        gravity: GravityField,
        made: Integrated,
        loss: Loss,
        sharpness: Sharpness | None,
        count: int,
    ) -> Linearised:
        """Sum the normal equations at a state up in `normal`."""
        ends = misclosure(state, made.increments, gravity, self.earth_rate_n)
        if count > _SETTLING:
            self.body = self.body.kept_on(at_epochs(state, ends, self.epochs, made.inside))
        position, velocity, body = self._rows(state, ends, made.inside, noise, robust=count > 1)
        squared = (
            _squared(position, self.drive.fixes, self.epochs),
            _squared(velocity, self.drive.fixes, self.epochs),
        )
        weights, sharpness = robust_weights(squared, loss, sharpness, count)
        weights = kept_together(*weights, self.epochs.fix >= 0)
        self._assemble(state, gravity, count)
        add_walks(self.normal, state, self.disturbed.walk_s, noise.gyro_walk, noise.accel_walk)
        jacobian = inertial_jacobian(state, made.increments, gravity, self.earth_rate_n)
        add_inertial(self.normal, jacobian, made.white)
        add_drift(self.normal, state.drift_n, self.length, noise.drift, noise.drift_tau, begins=self.arrival is None)
        add_measured(
            self.normal,
            made.inside,
            self.epochs.slots,
            position.weighted(weights[0]),
            velocity.weighted(weights[1]),
            body if self.model.wheels else None,
            float(state.common[LAG]),
        )
        return Linearised(position, velocity, weights, sharpness)

    def increments(self, state: State) -> Increments:
        """The samples summed up at biases near those of the state, anew only where they have moved far."""
        if self._increments is None or _stale(state, self._increments):
            biases = state.gyro_bias[:, :-1], state.accel_bias[:, :-1]
            self._increments = preintegrate(self.drive.samples, *biases, state.common[SCALES])
        return self._increments

    def _integrated(self, state: State, noise: Noise) -> Integrated:
        increments = self.increments(state)
        inside = locate(self.epochs, self.drive.samples, increments)
        return Integrated(increments, inside, whitening(increments, *self.disturbed.densities(noise)))

    def _slipping(self, t_s: Floats) -> Mask:
        """Times at which wheels may slip: from an impact until the vehicle stands, or for as long as that may take."""
        slipping = np.zeros(len(t_s), dtype=bool)
        for impact in self.drive.impacts:
            stands = self.blocks.t_s[self.still & (self.blocks.t_s > impact.end_s)]
            until = min([impact.end_s + impact.slip_s, *stands[:1].tolist()])
            slipping |= (t_s >= impact.start_s) & (t_s <= until)
        return slipping

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
            body_rows(here, state, self.epochs, self.body, (noise.sideways, noise.upwards), robust),
        )

    def sideways(self, solved: Solved) -> tuple[Floats, Floats]:
        """Motion of the wheels across their track at the epochs at which it is looked at, to the left and up.

        returns : (2, n) in sigmas of the time that each stands for, robustly weighted, and (2, n) s: when, and how long
        """
        body = self._rows(solved.state, solved.ends, solved.inside, solved.noise, robust=True)[2]
        used = body.residual[2] != 0.0
        return body.residual[1:, used], np.stack([self.epochs.t_s, self.epochs.seconds])[:, used]

    def _assemble(self, state: State, gravity: GravityField, count: int) -> None:
        """The factors whose noise is given: stops, roads, aids, priors."""
        normal, model = self.normal, self.model
        normal.clear()
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
        for aid in self.aids:
            aid.add(normal, state, gravity)
        if self.arrival is not None:
            self.arrival.add(normal, state)
            return
        add_value(normal, 0, GYRO_BIAS, state.gyro_bias[:, 0], model.gyro_bias)
        add_value(normal, 0, ACCEL_BIAS, state.accel_bias[:, 0], model.accel_bias)
        add_priors(normal, state, model, self.datum, self.moved_lag - self.first_lag)

    def parts(self, solved: Solved) -> Parts:
        """The sums of factors at a solution, apart by whose noise they have."""
        state, inside, increments = solved.state, solved.inside, solved.increments
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        ends = misclosure(state, increments, gravity, self.earth_rate_n)
        position, velocity, body = self._rows(state, ends, inside, solved.noise, robust=True)
        tall = inertial_jacobian(state, increments, gravity, self.earth_rate_n)
        self._assemble(state, gravity, 4)
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


def _small(solution: Solution, loss: Loss) -> bool:
    """Did the last step hardly turn and move the knots?"""
    turn, move = (float(np.abs(solution.step.T[part]).max()) for part in (ROTATION, POSITION))
    return turn < _SMALL_TURN and move < _SMALL_MOVE[loss]


def _stale(state: State, increments: Increments) -> bool:
    gyro = np.abs(state.gyro_bias[:, :-1] - increments.gyro_bias).max() / _STALE[0]
    accel = np.abs(state.accel_bias[:, :-1] - increments.accel_bias).max() / _STALE[1]
    scale = np.abs(state.common[SCALES] - increments.scale).max() / _STALE[2]
    return bool(max(gyro, accel, scale) > 1.0)


def _squared(measured: Measured, fixes: Fixes, epochs: Epochs) -> Floats:
    """Squared normalised residuals of the fixes at the epochs: (E,)."""
    share = fixes.share[epochs.fix]
    return np.asarray((measured.residual**2).sum(axis=0) / share)
