"""The normal equations of a drive, summed up from all that is known of it at a state.

Each factor stands in a module of its own; here is which of them a drive has, and with what noise and what weights.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from recon.numerics.smoothing.arrival import Arrival
from recon.numerics.smoothing.constraints import (
    Road,
    add_drift,
    add_road,
    add_standing,
    add_value,
    add_walks,
    road,
)
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.epochs import Epochs, Inside, Misclosure, misclosure
from recon.numerics.smoothing.inertial import add_inertial, inertial_jacobian
from recon.numerics.smoothing.measurements import (
    Fixes,
    Measured,
    add_measured,
    at_epochs,
    body_rows,
    lag_at,
    position_rows,
    velocity_rows,
)
from recon.numerics.smoothing.model import Drive, Model, Noise
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.prepared import Prepared
from recon.numerics.smoothing.priors import Datum, add_priors, free_of
from recon.numerics.smoothing.robust import Loss, Sharpness, kept_together, robust_weights
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.solved import Integrated, Linearised, Parts, Solved
from recon.numerics.smoothing.state import ACCEL_BIAS, GYRO_BIAS, State

_SETTLING: Final = 6
"""Steps after which an epoch that moves keeps the constraint of the wheels: one near walking pace may otherwise lose it
and win it back from step to step for ever.
"""


class Equations(Prepared):
    """A drive with its factors, and memory for their sum: `normal`, which `linearise` fills.

    free : (29,) which of the common unknowns are estimated; datum : what the mounting and the levers are held by
    """

    def __init__(self, drive: Drive, model: Model, arrival: Arrival | None = None, moved_lag: float | None = None):
        super().__init__(drive, model, arrival, moved_lag)
        self.normal = Normal(drive.samples.intervals + 1)
        self.datum = Datum.of(drive.fixes, model.mounting)
        self.free = free_of(model) if arrival is None else arrival.free

    def linearise(
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
        self._assemble(state, noise, gravity, count)
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
            lag_at(state, self.epochs),
        )
        return Linearised(position, velocity, weights, sharpness)

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

    def road(self, state: State, gravity: GravityField) -> Road:
        """The road as a state has it."""
        return road(state, gravity, self.knot_rate, self.still_knots, self.length, self.model.road_stretch)

    def _assemble(self, state: State, noise: Noise, gravity: GravityField, count: int) -> None:
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
            add_road(normal, state, self.road(state, gravity), noise.bank)
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
        self._assemble(state, solved.noise, gravity, 4)
        lag = lag_at(state, self.epochs)
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


def _squared(measured: Measured, fixes: Fixes, epochs: Epochs) -> Floats:
    """Squared normalised residuals of the fixes at the epochs: (E,)."""
    share = fixes.share[epochs.fix]
    return np.asarray((measured.residual**2).sum(axis=0) / share)
