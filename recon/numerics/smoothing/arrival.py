"""What everything before a time says of the state at that time: the prior of a smoother that goes on from there.

A window of a drive that grows is smoothed again and again; what leaves it behind is kept as the mean and the
information of the state at its first knot and of what all knots have in common. To first order nothing is lost
(marginalisation); later changes of what was linearised are.

    cost  += (x - x_0)^T I (x - x_0),   x = (knot, common),   differences of rotations as in `state`

References
    Sibley, Matthies, Sukhatme (2010), "Sliding window filter with application to planetary landing", J. Field Robotics
    27(5), section 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import Floats, mmt, rotation_log
from recon.numerics.smoothing.state import COMMON_SIZE, KNOT_SIZE, MOUNT, State

_LEAST: Final = 1e-9
"""Of the largest eigenvalue of a covariance in units of its sigmas: what is smaller is rounding."""


@dataclass(frozen=True)
class Arrival:
    """The state at the first knot of what follows, and how well it is known.

    state : of one knot; information : (47, 47), the knot's unknowns and then what is common
    free : (29,) which of the common unknowns are; moved_lag : s, as in solved.Solved
    """

    state: State
    information: Floats
    free: NDArray[np.bool_]
    moved_lag: float

    @classmethod
    def of(
        cls, state: State, covariance: Floats, cross: Floats, common: Floats, free: NDArray[np.bool_], moved_lag: float
    ) -> Arrival:
        """From the marginal covariances (18, 18), (18, 29), (29, 29) of a solution at its last knot."""
        joint = np.block([[covariance, cross], [cross.T, common]])
        used = np.concatenate([np.ones(KNOT_SIZE, bool), free])
        sigma = np.sqrt(np.diag(joint)[used])
        value, vector = np.linalg.eigh(joint[np.ix_(used, used)] / np.outer(sigma, sigma))
        root = vector / np.sqrt(np.maximum(value, _LEAST * value[-1])) / sigma[:, None]
        information = np.zeros_like(joint)
        information[np.ix_(used, used)] = root @ root.T
        return cls(state, information, free, moved_lag)

    def add(self, normal: Normal, state: State) -> None:
        """Add it as a prior of the first knot and of what is common."""
        mean = self.state
        knot = np.concatenate(
            [
                state.drift_n[:, 0] - mean.drift_n[:, 0],
                rotation_log(mmt(state.rot_ns[..., :1], mean.rot_ns))[:, 0],
                state.vel_n[:, 0] - mean.vel_n[:, 0],
                state.pos_n[:, 0] - mean.pos_n[:, 0],
                state.gyro_bias[:, 0] - mean.gyro_bias[:, 0],
                state.accel_bias[:, 0] - mean.accel_bias[:, 0],
            ]
        )
        common = state.common - mean.common
        common[MOUNT] = rotation_log((state.rot_vs @ mean.rot_vs.T)[..., None])[:, 0]
        error = np.concatenate([knot, common])
        pull = self.information @ error
        own, shared = slice(0, KNOT_SIZE), slice(KNOT_SIZE, KNOT_SIZE + COMMON_SIZE)
        normal.blocks[0, :, :KNOT_SIZE] += self.information[own, own]
        normal.border[:-1, 0] += self.information[shared, own]
        normal.border[-1, 0] -= pull[own]
        normal.corner[:-1, :-1] += self.information[shared, shared]
        normal.corner[:-1, -1] -= pull[shared]
        normal.corner[-1, :-1] -= pull[shared]
        normal.corner[-1, -1] += float(error @ pull)
