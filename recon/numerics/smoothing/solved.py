"""What the smoother works with from step to step, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from recon.numerics.smoothing.band import Factor, Inverse, Solution, selected_inverse
from recon.numerics.smoothing.epochs import Epochs, Inside, Misclosure
from recon.numerics.smoothing.measurements import Measured
from recon.numerics.smoothing.model import Noise
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.robust import Sharpness
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.state import State


@dataclass(frozen=True)
class Solved:
    """The solution, and the linear system at it.

    epochs, inside, ends, increments : of the last linearisation; ends anew, for the solution
    system, solution : factor of the knots, and the last step; both stay good until the smoother solves again
    pos_weight, vel_weight : (E,) robust weights of the fixes at the epochs
    pos_residual, vel_residual : (3, E) in sigmas, before the robust weight
    steps, converged : how many steps the smoother has taken, those of earlier solutions included, and whether the last
        was small
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

    @cached_property
    def inverse(self) -> Inverse:
        """What the covariances follow from, first asked for before the smoother solves again."""
        return selected_inverse(self.system, self.solution)

    @property
    def rejected(self) -> float:
        """Share of the fixes whose position or velocity is put aside."""
        fixes = self.epochs.fix >= 0
        aside = np.minimum(self.pos_weight, self.vel_weight)[fixes] < 0.5
        return float(aside.mean()) if fixes.any() else 0.0


@dataclass(frozen=True)
class Integrated:
    """The IMU between the knots: increments, where the epochs lie in them, and what whitens their errors."""

    increments: Increments
    inside: Inside
    white: Floats


@dataclass(frozen=True)
class Linearised:
    """What the fixes said at a state: their rows, the robust weights (E,) of positions and velocities, the loss."""

    position: Measured
    velocity: Measured
    weights: tuple[Floats, Floats]
    sharpness: Sharpness | None


@dataclass(frozen=True)
class Parts:
    """The normal equations at a solution in parts.

    fixed : factors whose noise is given; fixes : position across and up, velocity across and up
    inertial : (K, 9, 31), as from `inertial_jacobian`; the drift and the walks of the biases are left out
    """

    fixed: Normal
    fixes: tuple[Normal, Normal, Normal, Normal]
    inertial: Floats
