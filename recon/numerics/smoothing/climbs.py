"""What a barometer adds to IMU and GNSS: how far the height of one knot is from that of the next.

    up (p_k+1 - p_k) = (1 + b) (h_k+1 - h_k) + (r_k+1 - r_k),    h_k = its height + w_k

with b the error of its scale, r the reference, which walks with the weather, and w white. What is white stays where it
is, while errors of changes, taken each for itself, would add up. So the reference, barometer less state, is smoothed at
every state (local level model), and what it walks are the residuals; with the derivatives of the whole changes this
descends to the least cost of state and reference together.

References
    Groves (2013), 2nd ed., section 6.2.1 (barometric height).
    Durbin, Koopman (2012), "Time series analysis by state space methods", 2nd ed., chapter 2 (local level model).
    Holland, Welsch (1977), Communications in Statistics A6(9) (Cauchy's weights).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from recon.numerics.smoothing.aids import around
from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.state import BARO, POSITION, State

_C2: Final = 9.0
_LEVELS: Final = 4
"""Solutions for the reference, from which doors and tunnels stand out."""


@dataclass(frozen=True)
class Climb:
    """Changes of height, from a barometer.

    t_s : (m,) s, rising; height : (m,) m above whatever
    white : m, sigma of the mean over two seconds; walk : m/sqrt(s), of the pressure of the air
    """

    t_s: Floats
    height: Floats
    white: float
    walk: float

    def at(self, knot_t_s: Floats) -> ClimbFactors:
        """The means around the knots."""
        count, (height,) = around(knot_t_s, self.t_s, self.height[None])
        k = np.flatnonzero((count[1:] > 0) & (count[:-1] > 0))
        return ClimbFactors(k, height, self.white**2, self.walk**2 * np.diff(knot_t_s)[k])


@dataclass(frozen=True)
class ClimbFactors:
    """k : (n,) the knots before; height : (N,) m; white : m^2, of each mean; walk : (n,) m^2, between two knots."""

    k: NDArray[np.intp]
    height: Floats
    white: float
    walk: Floats

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state."""
        k = self.k
        up = _up(gravity, k)
        rise = np.diff(self.height)[k]
        moved = (1.0 + state.common[BARO]) * rise - (up * (state.pos_n[:, k + 1] - state.pos_n[:, k])).sum(axis=0)
        error, weight = walked(k, len(self.height), moved, self.white, self.walk)
        root = np.sqrt(weight / self.walk)
        tall = np.stack([*(-up * root), *(up * root), -rise * root, error * root], axis=-1)[:, None]
        normal.add_pairs(POSITION, slice(BARO, BARO + 1), tall, k)


def walked(k: NDArray[np.intp], knots: int, moved: Floats, white: float, walk: Floats) -> tuple[Floats, Floats]:
    """How far a level walks that is seen with white noise, by least squares with Cauchy's weights for its jumps.

    (I / white + D' W D) level = seen / white, D seen = moved: the local level model, smoothed.

    k : (n,) knots before each change, of so many; moved : (n,) m, as seen; white, walk : m^2, variances of what is
        seen and of each change
    returns : (n,) m, (n,) weights
    """
    change = np.zeros(knots)
    change[k + 1] = moved
    seen = np.cumsum(change)
    level, weight = moved, cauchy_weights(moved**2 / (2.0 * white + walk), _C2)
    for _ in range(_LEVELS):
        stiff = np.zeros(knots - 1)
        stiff[k] = weight * white / walk
        diagonal = 1.0 + np.append(stiff, 0.0) + np.append(0.0, stiff)
        level = np.diff(solveh_banded(np.array([np.append(0.0, -stiff), diagonal]), seen))[k]
        weight = cauchy_weights(level**2 / walk, _C2)
    return level, weight


def _up(gravity: GravityField, k: NDArray[np.intp]) -> Floats:
    """Local up at knots: (3, n), axes n."""
    pull = gravity.value_n[:, k]
    return np.asarray(-pull / np.sqrt((pull**2).sum(axis=0)))
