"""What a box logs that turns in its mount."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from recon import matrix, seconds
from recon.numerics.rotation import Floats, conjugate, from_rotvec, rotate, to_rotvec
from recon.tables import replace


def turned(imu: pa.Table, q_old_new: Floats, at_s: float, lasts_s: float = 1.5) -> pa.Table:
    """The imu of a box that turns steadily about one axis. q_old_new : (4,), its axes since then to those of before."""
    rotvec = to_rotvec(q_old_new)
    share = np.clip((seconds(imu) - at_s) / lasts_s, 0.0, 1.0)
    back = conjugate(from_rotvec(share[:, None] * rotvec))
    vectors = {name: rotate(back, matrix(imu, name)) for name in ("accel", "gyro")}
    vectors["gyro"] += np.where((share > 0.0) & (share < 1.0), 1.0, 0.0)[:, None] * rotvec / lasts_s
    return replace(imu, **vectors)
