"""What fuser.map found at its knots, with the covariances of changes between any two times: the stream `knots`.

The chain of gains of the solution, see recon.numerics.smoothing.band, in the form that recon.knots asks for: its 18
unknowns turned to z = (position, velocity, attitude) in the local level frame of the place, then the rest, and counted
in sigmas by the Cholesky root of their covariance. The attitude is that of the vehicle: d - R_nv m, d the error of the
sensor's, m that of the mounting, which is one of the common unknowns.

    P = L L^T,    D_k = L_k^-1 G_k L_k+1 - I,    T_k = -(z-part of W_k y + R_lv m), y = S^-1/2 eta

C is the rows of S^1/2 that belong to scale errors.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from recon import KNOTS, Array, build, meta, time_ns, with_meta
from recon.driving import undetermined
from recon.knots import ATTITUDE, POSITION, SIZE, VELOCITY, Knots
from recon.numerics.smoothing import Estimate, level_rotation
from recon.numerics.smoothing import state as unknowns
from recon.numerics.smoothing.soa import matrix_to_quat, mm, mmt, mv

_FACTS = ("anchor", "earth", "time_scale", "clock")
_REST = slice(SIZE, unknowns.KNOT_SIZE)


def knots(found: Estimate, imu: pa.Table, trajectory: pa.Table) -> pa.Table:
    """One row for each knot; position, velocity and attitude as in the trajectory, whose anchor it shares."""
    state, drive = found.solved.state, found.smoother.drive
    rot_ln = level_rotation(state.pos_n, drive.anchor)
    rot_lv = mm(rot_ln, mmt(state.rot_ns, state.rot_vs[..., None]))
    t_ns = time_ns(imu)[0] + np.rint(drive.samples.knot_times * 1e9).astype(np.int64)
    known = _covariances(found, t_ns, np.moveaxis(rot_ln, -1, 0), np.moveaxis(rot_lv, -1, 0))
    table = build(
        KNOTS,
        time=t_ns,
        pos=state.pos_n.T,
        vel=mv(rot_ln, state.vel_n).T,
        q=matrix_to_quat(rot_lv).T,
        gyro_bias=state.gyro_bias.T,
        accel_bias=state.accel_bias.T,
        drift=state.drift_n.T,
        **known.columns(),
    )
    facts = meta(trajectory)
    return with_meta(table, **{name: facts.get(name) for name in _FACTS}, **known.facts())


def _covariances(found: Estimate, t_ns: np.ndarray, rot_ln: Array, rot_lv: Array) -> Knots:
    """rot_ln, rot_lv : (N, 3, 3). Raises DataError where they are none to working precision."""
    inverse, smoother = found.inverse, found.smoother
    turn = _turn(rot_ln)
    try:
        root = np.asarray(np.linalg.cholesky(turn @ inverse.conditional @ turn.swapaxes(1, 2)), np.float64)
    except np.linalg.LinAlgError as error:
        raise undetermined() from error
    chained = turn[:-1] @ inverse.gains @ turn[1:].swapaxes(1, 2) @ root[1:]
    shared = turn[:, :SIZE] @ inverse.sensitivity
    shared[:, ATTITUDE] += rot_lv @ np.eye(unknowns.COMMON_SIZE)[unknowns.MOUNT, smoother.free]
    common = np.linalg.cholesky(inverse.covariance_global)
    gyro, accel = (np.append(values, values[-1]) for values in smoother.disturbed.densities(found.solved.noise))
    return Knots(
        t_ns,
        root[:, :SIZE, :SIZE],
        np.asarray(np.linalg.solve(root[:-1], chained - root[:-1]), np.float64),
        -shared @ common,
        gyro,
        accel,
        np.eye(unknowns.COMMON_SIZE)[unknowns.SCALES, smoother.free] @ common,
    )


def _turn(rot_ln: Array) -> Array:
    """Takes a knot's errors to position, velocity, attitude, local level, then the rest: (N, 18, 18)."""
    turn = np.zeros((len(rot_ln), unknowns.KNOT_SIZE, unknowns.KNOT_SIZE))
    for rows, part in (
        (POSITION, unknowns.POSITION),
        (VELOCITY, unknowns.VELOCITY),
        (ATTITUDE, unknowns.ROTATION),
    ):
        turn[:, rows, part] = rot_ln
    others = [*range(unknowns.DRIFT.start, unknowns.DRIFT.stop)]
    others += [*range(unknowns.GYRO_BIAS.start, unknowns.ACCEL_BIAS.stop)]
    turn[:, _REST, others] = np.eye(len(others))
    return turn
