"""What is known before the first measurement: priors of what all knots share, and of the first knot.

References
    Koch (1999), "Parameter estimation and hypothesis testing in linear models", section 3.2.4 (prior information).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from recon.numerics.smoothing.constraints import add_value
from recon.numerics.smoothing.measurements import Fixes
from recon.numerics.smoothing.model import Model
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import Floats, mmt, rotation_log
from recon.numerics.smoothing.state import (
    ACCEL_SCALE,
    BARO,
    CAMERA,
    CAMERA_LEVER,
    CLOCK,
    COMMON_SIZE,
    GYRO_SCALE,
    LAG,
    LEVER,
    MOUNT,
    PITCH,
    POSITION,
    REAR,
    ROLL,
    ROTATION,
    SLIP,
    VELOCITY_LAG,
    WHEEL,
    State,
)
from recon.numerics.smoothing.stops import Mask

_CONVENTION: Final = 1e-4
"""m and rad; sigma of a first position and heading that nothing measures, and which are set to be what they are."""


@dataclass(frozen=True)
class Datum:
    """Values that priors stand about, and the sigmas of a first position and heading that are a convention.

    rot_vs : (3, 3) mounting, vehicle from sensor; rot_ns : (3, 3, 1) and pos_n : (3,) m, of the first knot
    pos_sigma : (3,) m and turn_sigma : (3,) rad, axes n; infinite where fixes tell
    """

    rot_vs: Floats
    rot_ns: Floats
    pos_n: Floats
    pos_sigma: Floats
    turn_sigma: Floats

    @classmethod
    def of(cls, fixes: Fixes, mounting: Floats | None) -> Datum:
        """A drive begins at the origin and points where it likes, unless its fixes say otherwise."""
        located = np.asarray(np.isfinite(fixes.pos_sigma).any(axis=1))
        directed = located[:2].all() or bool((np.isfinite(fixes.vel_sigma[1]) & ~fixes.speed_only).any())
        return cls(
            rot_vs=np.eye(3) if mounting is None else mounting,
            rot_ns=np.eye(3)[..., None],
            pos_n=np.zeros(3),
            pos_sigma=np.where(located, np.inf, _CONVENTION),
            turn_sigma=np.array([np.inf, np.inf, np.inf if directed else _CONVENTION]),
        )

    def moved(self, rot_vs: Floats, rot_ns: Floats, pos_n: Floats) -> Datum:
        """About other values."""
        return replace(self, rot_vs=rot_vs, rot_ns=rot_ns, pos_n=pos_n)

    def mounted(self, rot_vs: Floats) -> Datum:
        """About another mounting."""
        return replace(self, rot_vs=rot_vs)


def free_of(model: Model) -> Mask:
    """Which of the common unknowns are estimated, not fixed: (29,)."""
    return _sigmas(model) > 0.0


def add_priors(normal: Normal, state: State, model: Model, datum: Datum, moved_lag: float) -> None:
    """Add those of what all knots share, and of the first knot. moved_lag : s, of the stamps since the start."""
    errors, sigma = state.common.copy(), _sigmas(model)
    errors[MOUNT] = rotation_log((state.rot_vs @ datum.rot_vs.T)[..., None])[:, 0]
    errors[LAG] += moved_lag
    errors[ROLL] -= model.lean
    errors[CAMERA_LEVER] -= model.camera_lever
    weight = np.diag(1.0 / np.where(sigma > 0.0, sigma, 1.0) ** 2)
    for where, mean, sizes in ((LEVER, model.lever, model.lever_sigma), (REAR, model.rear, model.rear_sigma)):
        errors[where] -= state.rot_vs.T @ np.asarray(mean)
        weight[where, where] = state.rot_vs.T @ np.diag(1.0 / np.asarray(sizes) ** 2) @ state.rot_vs
    normal.add_common(slice(0, COMMON_SIZE), errors, weight)
    if model.first_attitude is not None:
        turn = _turn(state, model.first_attitude[..., None])
        add_value(normal, 0, ROTATION, turn, np.asarray(model.first_attitude_sigma))
    add_value(normal, 0, POSITION, state.pos_n[:, 0] - datum.pos_n, datum.pos_sigma)
    add_value(normal, 0, ROTATION, _turn(state, datum.rot_ns), datum.turn_sigma)


def _sigmas(model: Model) -> Floats:
    """Of the common unknowns, zero where they are fixed; those of the levers stand apart: (29,)."""
    sigma = np.ones(COMMON_SIZE)
    sigma[MOUNT] = model.mounting_sigma
    sigma[LAG], sigma[VELOCITY_LAG], sigma[CLOCK] = model.lag, model.velocity_lag, model.clock
    sigma[WHEEL] = model.wheel
    sigma[SLIP], sigma[PITCH], sigma[ROLL] = model.slip, model.pitch, model.roll
    sigma[BARO] = model.baro
    sigma[CAMERA], sigma[CAMERA_LEVER] = model.camera, model.camera_lever_sigma
    sigma[GYRO_SCALE], sigma[ACCEL_SCALE] = model.gyro_scale, model.accel_scale
    return sigma


def _turn(state: State, rot_ns: Floats) -> Floats:
    """Rotation of the first knot since an attitude: (3,) rad, axes n."""
    return np.asarray(rotation_log(mmt(state.rot_ns[..., :1], rot_ns))[:, 0])
