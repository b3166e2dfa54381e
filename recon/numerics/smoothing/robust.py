"""Weights that make least squares blind to outliers.

A weight multiplies the squared residual of a whole measurement, r^2 = e^T R^-1 e, in the next solution.

Graduated non-convexity with truncated least squares begins with a cost that is nearly convex (small mu) and ends, mu
multiplied from one solution to the next, with min(r^2, c^2): every weight is then 0 or 1, so an inlier counts in full
and the covariances stay honest. Cauchy weights need no schedule but leave inliers weighted down.

References
    Yang, Antonante, Tzoumas, Carlone (2020), "Graduated Non-Convexity for Robust Spatial Perception: From Non-Minimal
    Solvers to Global Outlier Rejection", IEEE Robotics and Automation Letters 5(2), eqs. 12 to 14 and remark 5.
    Holland, Welsch (1977), "Robust regression using iteratively reweighted least-squares", Communications in
    Statistics A6(9): Cauchy weights.
"""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Loss = Literal["cauchy", "tls"]
Sharpness = tuple[float, float]
"""Of the truncation of positions and of velocities."""

_C2: Final = 16.0
"""Squared normalised residual of three components beyond which a fix is an outlier."""
_CAUCHY_C2: Final = 9.0
_VELOCITIES_IN_DOUBT: Final = 0.3
"""Share of them that is put aside; their unit may be wrong."""
_GROWTH: Final = 100.0
"""Factor by which the truncation sharpens from step to step."""


SHARPEST: Final[Sharpness] = (1e4, 1e4)
"""Every weight is 0 or 1."""
OPEN: Final[Sharpness] = (1e-2, 1e-2)
"""What comes next weights residuals from half the limit to twice of it, so that a good fix may come back."""


def tls_weights(squared: ArrayLike, c2: float, mu: float) -> Floats:
    """Weights of truncated least squares at one stage of graduated non-convexity.

    squared : (...) r^2; c2 : c^2, the r^2 of an outlier; mu : control parameter
    returns : (...) 1 up to c^2 mu / (mu + 1), 0 from c^2 (mu + 1) / mu on, c / r sqrt(mu (mu + 1)) - mu between
    """
    squared = np.asarray(squared, dtype=np.float64)
    lowest, highest = c2 * mu / (mu + 1.0), c2 * (mu + 1.0) / mu
    between = np.sqrt(c2 * mu * (mu + 1.0) / np.clip(squared, lowest, highest)) - mu
    return np.where(squared <= lowest, 1.0, np.where(squared >= highest, 0.0, between))


def tls_start(squared: ArrayLike, c2: float) -> float:
    """The first control parameter, c^2 / (2 max r^2 - c^2), at which the largest residual still counts.

    At most 1, which is reached where all r^2 are under c^2: only multiplying it makes all weights one.

    squared : (...) r^2 of all measurements, may be empty; c2 : as in `tls_weights`
    """
    largest = float(np.max(squared, initial=0.0))
    return c2 / max(2.0 * largest - c2, c2)


def cauchy_weights(squared: ArrayLike, c2: float) -> Floats:
    """Weights 1 / (1 + r^2 / c^2) of the cost c^2 log(1 + r^2 / c^2).

    squared : (...) r^2; c2 : c^2, the r^2 of half a weight
    returns : (...) in (0, 1]
    """
    return np.asarray(1.0 / (1.0 + np.asarray(squared, dtype=np.float64) / c2))


def kept_together(position: Floats, velocity: Floats, fixes: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """A position is trusted no more than the velocity of its fix, unless velocities themselves are in doubt.

    A reflection that stays for many fixes looks like a slow error of the position, but not of the velocity.
    """
    doubtful = bool(fixes.any()) and float((velocity[fixes] < 0.5).mean()) > _VELOCITIES_IN_DOUBT
    return (position if doubtful else np.minimum(position, velocity)), velocity


def robust_weights(
    squared: tuple[Floats, Floats], loss: Loss, sharpness: Sharpness | None, count: int
) -> tuple[tuple[Floats, Floats], Sharpness | None]:
    """Weights of positions and of velocities, each for itself; the first step takes all."""
    if count == 1:
        one = np.ones_like(squared[0])
        return (one, one), None
    if loss == "cauchy":
        return (cauchy_weights(squared[0], _CAUCHY_C2), cauchy_weights(squared[1], _CAUCHY_C2)), None
    sharper = (
        (tls_start(squared[0], _C2), tls_start(squared[1], _C2))
        if sharpness is None
        else (min(sharpness[0] * _GROWTH, SHARPEST[0]), min(sharpness[1] * _GROWTH, SHARPEST[1]))
    )
    return (tls_weights(squared[0], _C2, sharper[0]), tls_weights(squared[1], _C2, sharper[1])), sharper
