"""What fuser.kalman_cv found at its knots, with the covariances of changes between any two times: the stream `knots`.

The smoother's chain of position and velocity on each axis (recon.numerics.constant_velocity_chain) errs independently
of what receivers err by for minutes, s, a Gauss-Markov process of first order that is added to the position:

    z = (p + s, v, s),    cov(z_k, z_k+1) = [G P + S, S; S, S],    S = exp(-T / tau) sigma_k sigma_k+1

and of what its change adds to the velocity, which lasts as long as the smoother looks about, sqrt(P_pp / P_vv), in the
form that recon.knots asks for. The attitude is taken as it is given: how well it is known is not.

Reference: Brown, Hwang (2012), "Introduction to random signals and applied Kalman filtering", 4th ed., 3.6.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import KNOTS, Array, build, meta, with_meta
from recon.knots import SIZE, Knots
from recon.numerics.constant_velocity import drift_variance
from recon.numerics.constant_velocity_chain import Chain
from recon.numerics.smoothing.soa import mm

_FACTS: Final = ("anchor", "earth", "time_scale", "clock", "body")
_AXES: Final = 3
_STATES: Final = SIZE + _AXES


def knots(
    found: Chain, t_ns: NDArray[np.int64], q: Array, slow: Array, tau_s: float, noise: Array, trajectory: pa.Table
) -> pa.Table:
    """One row for each knot; position and velocity as in the trajectory, whose facts it shares.

    t_ns : (N,) ns; q : (N, 4); slow : (N, 3) m, sigma of what lasts, tau_s : s, for how long
    noise : (N,) m/s^1.5, on the acceleration from each knot to the next
    """
    root, chained = _covariances(found, t_ns, slow, tau_s)
    identity = np.eye(_STATES)
    chain = np.linalg.solve(root[:-1], np.linalg.solve(root[1:], chained.swapaxes(1, 2)).swapaxes(1, 2)) - identity
    own = root[:, :SIZE, :SIZE].copy()
    own[:, range(6, SIZE), range(6, SIZE)] = np.nan
    told = Knots(t_ns, own, np.asarray(chain), np.zeros((len(t_ns), SIZE, 1)), np.zeros(len(t_ns)), noise)
    table = build(KNOTS, time=t_ns, pos=found.pos, vel=found.vel, q=q, **told.columns())
    facts = meta(trajectory)
    return with_meta(table, **{name: facts[name] for name in _FACTS if name in facts})


def _covariances(found: Chain, t_ns: NDArray[np.int64], slow: Array, tau_s: float) -> tuple[Array, Array]:
    """Roots (N, 12, 12) of the covariances at the knots, and those of each knot and the next (N-1, 12, 12)."""
    step_s = np.diff(t_ns)[:, None] * 1e-9
    kept = np.exp(-step_s / tau_s)
    slow = np.maximum(slow, 1e-6)  # m: without anything that lasts there were no root
    pos_var, vel_var = found.covariance[0, 0], found.covariance[1, 1]
    drift = np.sqrt(drift_variance(pos_var, vel_var, slow, tau_s, smooth=True))
    moving, moved = found.covariance.copy(), mm(found.gains, found.covariance[:, :, 1:])
    moving[1, 1] += drift**2
    moved[1, 1] += np.exp(-step_s * np.sqrt(vel_var / pos_var)[1:]) * drift[:-1] * drift[1:]
    own = _placed(moving, slow**2)
    after = _placed(moved, kept * slow[:-1] * slow[1:])
    return np.asarray(np.linalg.cholesky(own), np.float64), after


def _placed(moving: Array, lasting: Array) -> Array:
    """Covariances (2, 2, n, 3) of the smoother and (n, 3) of what lasts as (n, 12, 12)."""
    whole = np.zeros((len(lasting), _STATES, _STATES))
    whole[:, range(6, SIZE), range(6, SIZE)] = 1.0
    axes = np.arange(_AXES)
    position, velocity, slow = axes, axes + _AXES, axes + SIZE
    for row, one in enumerate((position, velocity)):
        for column, other in enumerate((position, velocity)):
            whole[:, one, other] = moving[row, column]
    whole[:, position, position] += lasting
    for one, other in ((position, slow), (slow, position), (slow, slow)):
        whole[:, one, other] = lasting
    return whole
