"""The best trajectory of a whole drive: all unknowns at once, by robust nonlinear least squares (MAP).

Knots every two seconds carry the state; the IMU between them is summed up beforehand (preintegration); GNSS fixes and
the constraints of wheels hang between the knots; what all knots share - mounting, levers, lags, scale errors,
compliance - borders the band of the normal equations. Gauss-Newton converges in four to nine steps from a closed-form
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
from recon.numerics.smoothing.band import Factor, Solution, factor, marginals, selected_inverse, solve_bordered
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.epochs import locate, misclosure
from recon.numerics.smoothing.equations import Equations
from recon.numerics.smoothing.inertial import whitening
from recon.numerics.smoothing.model import Drive, Model, Noise
from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.prepared import STALE_LAG
from recon.numerics.smoothing.robust import SHARPEST, Loss, Sharpness
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.solved import Integrated, Linearised, Solved
from recon.numerics.smoothing.state import COMMON_SIZE, KNOT_SIZE, LAG, POSITION, ROTATION, SCALES, State

MOST_STEPS: Final = 30
_FEWEST_STEPS: Final = 4
"""From a start in closed form: outliers are told apart while it converges."""
_SHARP: Final = 10.0
"""From here on weights are 0 or 1 but where the square of a residual is within a tenth of the limit."""
_SMALL_TURN: Final = 1e-3
_SMALL_MOVE: Final = {"cauchy": 1.0, "tls": 0.1}
"""rad and m; what is left are millimetres, for weights creep along. Noise is estimated before they are done."""
_STALE: Final = (3e-3, 1.0, 0.02)
"""Change of gyro bias rad/s, accel bias m/s^2 and scale beyond which their first order no longer does: increments are
integrated anew. That of the accelerometer is linear but for the rotation."""
_SPUN: Final = (5e-3, 0.05)
"""rad and m/s by which a spin makes scale errors of the gyroscope and biases of the accelerometer miss between knots,
where their share of an interval is that of its time: increments are integrated anew, too."""
_FINE: Final = (2e-5, 0.02, 1e-3)
"""The same three, beyond which the motion between knots misses more than it is known to."""
_FIRST_DAMPING: Final = 1e-6
"""Share by which the diagonal grows where the normal equations are not positive definite; tenfold each time."""
_SWINGING: Final = (6, 0.5)
"""Steps, and rad: a heading with a larger sigma that still turns is one that hardly anything tells, and would swing for
ever."""
_SWINGING_LAG: Final = 0.1
"""s; a lag that takes a fix across the edge of an impact may swing, too, and moves stamps only beyond this."""
_BACK: Final = 0.5
"""Share of the last step; one that turns more of it back shows that it went too far, as the next would: the slope of a
road in seconds of IMU far from fixes may swing so for ever."""


class Smoother(Equations):
    """The equations of a drive and their solution. `solve` may be called with other noise.

    increments : of the samples, where they are summed up already; the rest as of Prepared
    steps : taken so far, of all solutions
    """

    def __init__(
        self,
        drive: Drive,
        model: Model,
        arrival: Arrival | None = None,
        moved_lag: float | None = None,
        increments: Increments | None = None,
    ) -> None:
        super().__init__(drive, model, arrival, moved_lag)
        self._increments = increments
        self.steps = 0
        self._held = np.zeros(self.normal.knots)

    def solve(
        self, state: State, noise: Noise, loss: Loss, resumed: Sharpness | None = None, rough: bool = False
    ) -> Solved:
        """Gauss-Newton steps until they are small. Raises numpy.linalg.LinAlgError where there is no solution.

        resumed : how sharply outliers were told so far, where the state is that of an earlier solution
        rough : outliers told apart are enough
        """
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        made = self._integrated(state, noise)
        damping, done, sharpness = 0.0, False, resumed
        share, last = 1.0, np.zeros((self.normal.knots, 3))
        self.body = replace(self.body, rolls=np.zeros_like(self.body.rolls))
        for count in range(_FEWEST_STEPS if resumed else 1, MOST_STEPS + 1):
            state, made = self._kept_fresh(state, noise, made, count)
            here = self.linearise(state, noise, gravity, made, loss, sharpness, count)
            sharpness = here.sharpness
            try:
                system, solution = self._step(damping, self._held)
            except np.linalg.LinAlgError:
                if count == MOST_STEPS:
                    raise
                damping = max(_FIRST_DAMPING, 10.0 * damping)
                continue
            damping = 0.1 * damping if damping > _FIRST_DAMPING else 0.0
            turn = solution.step[:, ROTATION]
            back = count > _SWINGING[0] and (turn * last).sum() < -_BACK * (last**2).sum()
            share, last = 0.5 * share if back else min(1.0, 2.0 * share), turn
            state = state.moved(share * solution.step.T, share * solution.step_global)
            self.steps += 1
            sharp = loss == "cauchy" or (sharpness is not None and min(sharpness) > _SHARP)
            settled = count >= _FEWEST_STEPS and sharp and damping == 0.0 and not _stale(state, made.increments)
            done = settled and _small(solution, loss)
            if done or (settled and rough):
                break
            if count > _SWINGING[0]:
                self._hold(system, solution)
        if self._held.any():  # what holds a heading in place tells nothing of it
            here = self.linearise(state, noise, gravity, made, loss, sharpness, count)
            system, solution = self._step()
        return self._solved(state, noise, gravity, made, here, system, solution, done)

    def about(self, state: State, noise: Noise) -> Solved:
        """One linear step about a state that is known so well that what it leaves far off is an outlier.

        For the marginal of a part of a drive, linearised where all of the drive puts it. Raises LinAlgError.
        """
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        made = self._integrated(state, noise)
        here = self.linearise(state, noise, gravity, made, "tls", SHARPEST, MOST_STEPS)
        system, solution = self._step()
        state = state.moved(solution.step.T, solution.step_global)
        self.steps += 1
        return self._solved(state, noise, gravity, made, here, system, solution, True)

    def anew(self, solved: Solved) -> Solved:
        """The solution with the motion between its knots integrated with the biases and scale errors that it found.

        To first order their share of an interval is that of its time; where a vehicle brakes or turns in a part of one
        it is not. Left as it is where they were known well enough before.
        """
        state = solved.state
        if not _far(state, solved.increments, _FINE):
            return solved
        self._increments = None
        increments = self.increments(state)
        gravity = GravityField.around(state.pos_n, self.drive.anchor)
        return replace(
            solved,
            increments=increments,
            inside=locate(solved.epochs, self.drive.samples, increments),
            ends=misclosure(state, increments, gravity, self.earth_rate_n),
        )

    def _solved(
        self,
        state: State,
        noise: Noise,
        gravity: GravityField,
        made: Integrated,
        here: Linearised,
        system: Factor,
        solution: Solution,
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
            steps=self.steps,
            converged=converged,
            moved_lag=self.moved_lag,
        )

    def _kept_fresh(self, state: State, noise: Noise, made: Integrated, count: int) -> tuple[State, Integrated]:
        """Integrated anew where biases went far, with stamps moved where the lag did.

        Not after the first step, which overshoots what the second takes back, biases and scale errors most.
        """
        if count != 2 and _stale(state, made.increments):
            made = self._integrated(state, noise)
        if abs(state.common[LAG]) > (STALE_LAG if count <= _SWINGING[0] else _SWINGING_LAG):
            self.move_stamps(float(state.common[LAG]))
            state = state.with_common(LAG, 0.0)
            made = replace(made, inside=locate(self.epochs, self.drive.samples, made.increments))
        return state, made

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

    def _hold(self, system: Factor, solution: Solution) -> None:
        """Keep knots from turning, more than the last step would have needed, that turn and might as well not."""
        turn = np.abs(solution.step[:, ROTATION]).max(axis=1)
        turns = np.flatnonzero(turn > _SMALL_TURN)
        if len(turns):
            variance = marginals(selected_inverse(system, solution), turns)[:, ROTATION, ROTATION]
            unknown = np.einsum("kii->ki", variance).max(axis=1) > _SWINGING[1] ** 2
            swings = turns[unknown | (self._held[turns] > 0.0)]
            self._held[swings] = np.maximum(4.0 * self._held[swings], turn[swings] ** -2)

    def _step(self, damping: float = 0.0, held: Floats | float = 0.0) -> tuple[Factor, Solution]:
        """Solve for what is free; fixed unknowns do not move. The sums are written over.

        damping : share by which the diagonal grows; held : (N,) 1/rad^2 by which a knot is kept from turning
        """
        free = np.append(self.free, True)
        knots = self.normal.knots
        border = self.normal.border if free.all() else self.normal.border[free]
        corner = self.normal.corner[np.ix_(free, free)]
        i = np.arange(KNOT_SIZE)
        self.normal.blocks[:, i, i] *= 1.0 + damping
        self.normal.blocks[:, i[ROTATION], i[ROTATION]] += np.asarray(held)[..., None]
        system = factor(self.normal.buffer, knots, KNOT_SIZE)
        found = solve_bordered(system, border.reshape(len(border), -1).T, corner)
        whole = np.zeros(COMMON_SIZE)
        whole[self.free] = found.step_global
        return system, replace(found, step_global=whole)


def _small(solution: Solution, loss: Loss) -> bool:
    """Did the last step hardly turn and move the knots?"""
    turn, move = (float(np.abs(solution.step.T[part]).max()) for part in (ROTATION, POSITION))
    return turn < _SMALL_TURN and move < _SMALL_MOVE[loss]


def _stale(state: State, increments: Increments) -> bool:
    return _far(state, increments, _STALE) or max(_spun(state, increments)) > 1.0


def _far(state: State, increments: Increments, limits: tuple[float, float, float]) -> bool:
    """Is a bias or scale error further from where it was integrated with than the limits?"""
    gyro = np.abs(state.gyro_bias[:, :-1] - increments.gyro_bias).max() / limits[0]
    accel = np.abs(state.accel_bias[:, :-1] - increments.accel_bias).max() / limits[1]
    scale = np.abs(state.common[SCALES] - increments.scale).max() / limits[2]
    return bool(max(gyro, accel, scale) > 1.0)


def _spun(state: State, increments: Increments) -> tuple[float, float]:
    """What first-order corrections miss most in an interval that turns, by what they may.

    k int w,    b T angle / 8:    the arc of b, turned as the vehicle turns, above its chord
    """
    scale = state.common[SCALES][:3] - increments.scale[:3]
    bias = np.abs(state.accel_bias[:, :-1] - increments.accel_bias).max(axis=0)
    turned = np.arccos(np.clip(0.5 * (np.trace(increments.rotation) - 1.0), -1.0, 1.0))
    rotation = np.abs(np.einsum("ijk,j->ik", increments.rotation_gyro_scale, scale)).max()
    velocity = (bias * increments.duration * turned / 8.0).max()
    return float(rotation) / _SPUN[0], float(velocity) / _SPUN[1]
