"""Peer: error-state Kalman filter of 21 states, then Rauch-Tung-Striebel smoother.

The filter runs at 10 Hz and at every fix. Once a second the car either stands, by the IMU's own scatter, or its rear
axle moves along x. Everything measured is tested against its predicted covariance and left out where it does not fit.
Where fixes do not fit for so long that the filter must be wrong, as after a start amid multipath, all is as uncertain
as at first, and besides by what the fix is off.
The states and measurements are those of ekf_model.

References
    Rauch, Tung, Striebel (1965), "Maximum likelihood estimates of linear dynamic systems", AIAA J. 3(8), eqs. 3.28 ff.
    Sola (2017), "Quaternion kinematics for the error-state Kalman filter", arXiv:1711.02508, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.rotation import Floats, from_matrix, to_rotvec

from .drives import Drive, Estimate
from .ekf_model import POSITION, ROTATION, SIZE, VELOCITY, Blocks, Model, State, blocks_between, first_state
from .start import Flags, find_start
from .steps import with_none_longer

STEP_S: Final = 0.1
_GATE: Final = 16.0
"""Squared Mahalanobis distance: one good measurement of three components in 900 is beyond, of two in 3000."""
_LOST: Final = 20
"""Fixes in a row beyond the gate; a burst of multipath lasts up to 18."""
_LOST_TURN: Final = float(np.radians(10.0))
_MOVING: Final = 1.0
"""m/s, above which the wheels tell the direction."""


@dataclass(frozen=True)
class _Track:
    """The filter at k + 1 edges, before and after what is measured there.

    predicted_rot, rot : (k + 1, 3, 3); predicted_x, x : (k + 1, 21)
    predicted_cov, cov : (k + 1, 21, 21); transition : (k, 21, 21)
    """

    predicted_rot: Floats
    predicted_x: Floats
    predicted_cov: Floats
    rot: Floats
    x: Floats
    cov: Floats
    transition: Floats

    @classmethod
    def of(cls, edges: int) -> _Track:
        square = (edges, SIZE, SIZE)
        rot, x = (edges, 3, 3), (edges, SIZE)
        return cls(*map(np.empty, (rot, x, square, rot, x, square, (edges - 1, SIZE, SIZE))))


def solve(drive: Drive) -> Estimate:
    """Smoothed trajectory at 10 Hz and at the fixes."""
    begin = find_start(drive)
    ends = np.union1d([drive.t_s[0], drive.t_s[-1]], drive.fix_t_s)
    edge_s = with_none_longer(ends, STEP_S)
    blocks = blocks_between(drive, edge_s, begin.gyro_bias)
    model = Model(drive, begin.gyro_bias)
    still = begin.still[np.searchsorted(drive.t_s, edge_s)]
    state, cov = first_state(drive, begin)
    track = _filtered(model, blocks, state, cov, still)
    return _smoothed(edge_s, track)


def _filtered(model: Model, blocks: Blocks, state: State, first_cov: Floats, still: Flags) -> _Track:
    cov = first_cov
    edges = len(blocks.edge_s)
    track = _Track.of(edges)
    fixes = dict(zip(np.searchsorted(blocks.edge_s, model.drive.fix_t_s).tolist(), range(edges), strict=False))
    constrain = np.diff(np.floor(blocks.edge_s), prepend=-np.inf) > 0.0
    refused = 0
    for i in range(edges):
        if i > 0:
            state, transition, added = model.moved(
                state, blocks.angle_s[i - 1], blocks.velocity_s[i - 1], float(blocks.dt_s[i - 1])
            )
            cov = transition @ cov @ transition.T + np.diag(added)
            track.transition[i - 1] = transition
        if refused >= _LOST and i in fixes:
            cov = cov + first_cov + _misfit(model, state, fixes[i], blocks.edge_rate_s[i])
        track.predicted_rot[i], track.predicted_x[i], track.predicted_cov[i] = state.rot_ns, state.x, cov
        if i in fixes:
            before = state
            state, cov = _with_fix(model, state, cov, fixes[i], blocks.edge_rate_s[i])
            refused = refused + 1 if state is before else 0
        if constrain[i]:
            state, cov = _with_constraint(model, state, cov, bool(still[i]), blocks.edge_rate_s[i])
        track.rot[i], track.x[i], track.cov[i] = state.rot_ns, state.x, cov
    return track


def _misfit(model: Model, state: State, fix: int, rate_s: Floats) -> Floats:
    """What a filter that is lost may be off by, (21, 21): the way to this fix, and a turn that nobody knows."""
    sigma = np.zeros(SIZE)
    sigma[ROTATION] = _LOST_TURN
    sigma[VELOCITY] = model.velocity(state, rate_s, model.drive.fix_vel_n[fix])[0]
    sigma[POSITION] = model.position(state, model.drive.fix_pos_n[fix])[0]
    return np.diag(sigma**2)


def _with_fix(model: Model, state: State, cov: Floats, fix: int, rate_s: Floats) -> tuple[State, Floats]:
    state, cov = _updated(state, cov, *model.velocity(state, rate_s, model.drive.fix_vel_n[fix]))
    return _updated(state, cov, *model.position(state, model.drive.fix_pos_n[fix]))


def _with_constraint(model: Model, state: State, cov: Floats, still: bool, rate_s: Floats) -> tuple[State, Floats]:
    if still:
        return _updated(state, cov, *model.standing(state))
    *measured, speed = model.rear_axle(state, rate_s)
    return _updated(state, cov, *measured) if abs(speed) > _MOVING else (state, cov)


def _updated(state: State, cov: Floats, residual: Floats, by_error: Floats, sigma: Floats) -> tuple[State, Floats]:
    """After a measurement; as before where it lies beyond the gate. Joseph's form keeps the covariance positive."""
    crossed = cov @ by_error.T
    innovation = by_error @ crossed + np.diag(sigma**2)
    inverse = np.linalg.inv(innovation)
    if residual @ inverse @ residual > _GATE:
        return state, cov
    gain = crossed @ inverse
    kept = np.eye(SIZE) - gain @ by_error
    return state.moved(gain @ residual), kept @ cov @ kept.T + (gain * sigma**2) @ gain.T


def _smoothed(edge_s: Floats, track: _Track) -> Estimate:
    """Backwards: what the later estimate adds to the prediction, led back by cov transition^T predicted_cov^-1."""
    led = np.linalg.solve(track.predicted_cov[1:], track.transition @ track.cov[:-1]).transpose(0, 2, 1)
    rot, x, cov = track.rot.copy(), track.x.copy(), track.cov.copy()
    for i in range(len(edge_s) - 2, -1, -1):
        later = x[i + 1] - track.predicted_x[i + 1]
        later[ROTATION] = to_rotvec(from_matrix(rot[i + 1] @ track.predicted_rot[i + 1].T))
        smooth = State(rot[i], x[i]).moved(led[i] @ later)
        rot[i], x[i] = smooth.rot_ns, smooth.x
        cov[i] += led[i] @ (cov[i + 1] - track.predicted_cov[i + 1]) @ led[i].T
    std = np.sqrt(np.diagonal(cov, axis1=1, axis2=2)[:, POSITION])
    return Estimate(edge_s, x[:, POSITION], x[:, VELOCITY], from_matrix(rot), std)
