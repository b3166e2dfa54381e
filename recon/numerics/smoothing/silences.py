"""What happened while the IMU was silent, by the motion before and after."""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.smoothing.estimate import Estimate
from recon.numerics.smoothing.soa import Floats, mv
from recon.numerics.smoothing.state import SCALES

LONGEST_S: Final = 2.0


def jolts(found: Estimate) -> Floats:
    """Horizontal change of velocity that the samples miss in each interval with a silence, by its sigma: (K,), else 0.

    The sigma is that of what driving does in a silence: recon.numerics.smoothing.disturbances. Of silences beyond
    LONGEST_S nothing is told, as anything may happen in them.
    """
    state, made, ends = found.solved.state, found.solved.increments, found.solved.ends
    disturbed, length = found.smoother.disturbed, found.solved.ends.duration
    scale = np.repeat((state.common[SCALES] - made.scale)[:, None], len(length), axis=1)
    known = (
        mv(made.velocity_gyro, state.gyro_bias[:, :-1] - made.gyro_bias)
        + mv(made.velocity_accel, state.accel_bias[:, :-1] - made.accel_bias)
        + mv(made.velocity_gyro_scale, scale[:3])
        + mv(made.velocity_accel_scale, scale[3:])
    )
    missed = ends.velocity_n - mv(state.rot_ns[..., :-1], known)
    _, moved = disturbed.missed()
    sigma = np.sqrt((found.solved.noise.accel**2 + moved) * length)
    short = (disturbed.gap_s > 0.0) & (disturbed.gap_s < LONGEST_S)
    return np.where(short, np.hypot(missed[0], missed[1]) / sigma, 0.0)
