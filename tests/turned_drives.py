"""What a box logs that turns in its mount, or is flung out of it. Its biases and scale errors stay in its own axes."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from recon import Streams, matrix, seconds
from recon.numerics.rotation import Floats, conjugate, from_rotvec, rotate, to_rotvec
from recon.tables import replace


def turned(log: Streams, q_old_new: Floats, at_s: float, lasts_s: float = 1.5) -> pa.Table:
    """The imu of a box that turns steadily about one axis.

    log : of simulator.drive; q_old_new : (4,), its axes since then to those of before
    """
    share = np.clip((seconds(log["imu"]) - at_s) / lasts_s, 0.0, 1.0)
    return _turning(log, to_rotvec(q_old_new), share, ((share > 0.0) & (share < 1.0)) / lasts_s)


def flung(log: Streams, q_old_new: Floats, at_s: float, lasts_s: float = 0.4) -> pa.Table:
    """The same, from rest to rest."""
    share = np.clip((seconds(log["imu"]) - at_s) / lasts_s, 0.0, 1.0)
    return _turning(log, to_rotvec(q_old_new), share**2 * (3.0 - 2.0 * share), 6.0 * share * (1.0 - share) / lasts_s)


def _turning(log: Streams, rotvec: Floats, share: Floats, rate: Floats) -> pa.Table:
    """rotvec : (3,) rad, share of it : (n,), and rate : (n,) per s"""
    back = conjugate(from_rotvec(share[:, None] * rotvec))
    known = {row["name"]: row["value"] for row in log["metrics"].to_pylist()}
    found = {}
    for name, more in (("accel", 0.0), ("gyro", rate[:, None] * rotvec)):
        bias = matrix(log["imu_truth"], f"{name}_bias")
        gain = 1.0 + np.array([known[f"true_{name}_scale_{axis}"] for axis in "xyz"])
        true = (matrix(log["imu"], name) - bias) / gain
        found[name] = gain * (rotate(back, true) + more) + bias
    return replace(log["imu"], **found)
