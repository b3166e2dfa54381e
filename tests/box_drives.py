"""Drives with several boxes in one vehicle, whose places, mountings and clocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import Floats, conjugate, from_euler, multiply, rotate
from recon.tables import replace, time_ns, times
from recon_simulators.drive import DriveParams, simulate_drive

LAG_S, DRIFT = 1.234, 50e-6
"""What the clocks of further boxes show more in mid-drive, and what they gain; every other box to the other side."""
APART = 1.5
"""m, from the first box to each further one."""
_REAR = np.array([-1.0, 0.0, -0.3])
_FIRST = (0.3, 0.05, -0.1)
_SOFT = {
    "body_pitch": np.radians(0.4), "body_roll": np.radians(0.5), "body_bounce": np.radians(0.3), "body_heave": 0.01
}  # fmt: skip


@dataclass(frozen=True)
class Boxes:
    """Streams of the first box' drive; imu of each box; truth of each: q_1k (4,), lever (3,) m, axes of the first."""

    streams: dict[str, pa.Table]
    imus: list[pa.Table]
    q_1: list[Floats]
    levers: list[Floats]
    lags_s: list[float]
    drifts: list[float]
    q_v1: Floats


def boxes(seed: int, count: int = 2, duration: float = 600.0, sensors: str = "consumer_mems") -> Boxes:
    """A drive on a route of its own, as `count` boxes of one kind log it."""
    rng = np.random.default_rng((seed, 17))
    away = rng.standard_normal((count, 3)) * (1.0, 0.6, 0.4)
    places = APART * away / np.linalg.norm(away, axis=1)[:, None] * (np.arange(count) > 0)[:, None]
    mounts = [_FIRST, *map(tuple, rng.uniform(-0.5, 0.5, (count - 1, 3)) * (6.0, 1.0, 1.0))]
    drives = [
        simulate_drive(
            DriveParams(
                motion="mixed",
                route=seed,
                duration=duration,
                sensors=sensors,
                seed=1000 * seed + number,
                rear_axle=tuple(_REAR - place),
                **dict(zip(("mount_yaw", "mount_pitch", "mount_roll"), mount, strict=True)),
                **_SOFT,
            )
        )
        for number, (place, mount) in enumerate(zip(places, mounts, strict=True))
    ]
    q_v = [from_euler(*mount) for mount in mounts]
    signs = [0, *((-1) ** number for number in range(count - 1))]
    imus = [_mistimed(drive["imu"], sign * LAG_S, sign * DRIFT) for drive, sign in zip(drives, signs, strict=True)]
    return Boxes(
        drives[0],
        imus,
        [multiply(conjugate(q_v[0]), q) for q in q_v],
        [rotate(conjugate(q_v[0]), place) for place in places],
        [sign * LAG_S for sign in signs],
        [sign * DRIFT for sign in signs],
        q_v[0],
    )


def _mistimed(imu: pa.Table, lag_s: float, drift: float) -> pa.Table:
    t_ns = time_ns(imu)
    gained = np.rint((t_ns - t_ns[len(t_ns) // 2]) * drift).astype(np.int64)
    return replace(imu, time=times(t_ns + round(lag_s * 1e9) + gained))
