"""Drives with several boxes in one vehicle, whose places, mountings and clocks are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import Floats, conjugate, from_euler, multiply, rotate
from recon.tables import replace, time_ns, times, vector
from recon_simulators.drive import DriveParams, simulate_drive

LAG_S, DRIFT = 1.234, 50e-6
"""What the clocks of further boxes show more in mid-drive, and what they gain; every other box to the other side."""
APART = 1.5
"""m, from the first box to each further one."""
SHARED = {"position": 0.7, "velocity": 0.2}
"""Of the variance of errors of GNSS what is common to all receivers of a vehicle: satellites and the air for positions,
which change slowly and hardly reach velocities; the rest is reflections and the noise of each.
"""
_EXACT = {
    "imu_rate": 20.0, "multipath": 0.0,
    **dict.fromkeys((f"gnss_{name}" for name in ("horizontal", "vertical", "white_horizontal", "white_vertical",
                                                 "velocity", "velocity_vertical")), 0.0),
}  # fmt: skip
_REAR = np.array([-1.0, 0.0, -0.3])
_FIRST = (0.3, 0.05, -0.1)
_SOFT = {
    "body_pitch": np.radians(0.4), "body_roll": np.radians(0.5), "body_bounce": np.radians(0.3), "body_heave": 0.01
}  # fmt: skip


@dataclass(frozen=True)
class Boxes:
    """Streams of the first box' drive; imu and gnss of each box, in its own clock; truth of each: q_1k (4,), lever (3,)
    m, axes of the first, in whose middle the antenna is.
    """

    streams: dict[str, pa.Table]
    imus: list[pa.Table]
    q_1: list[Floats]
    levers: list[Floats]
    lags_s: list[float]
    drifts: list[float]
    q_v1: Floats
    gnss: list[pa.Table]


def boxes(
    seed: int, count: int = 2, duration: float = 600.0, sensors: str = "consumer_mems", receivers: bool = False
) -> Boxes:
    """A drive on a route of its own, as `count` boxes of one kind log it. receivers : each of them has GNSS."""
    rng = np.random.default_rng((seed, 17))
    away = rng.standard_normal((count, 3)) * (1.0, 0.6, 0.4)
    places = APART * away / np.linalg.norm(away, axis=1)[:, None] * (np.arange(count) > 0)[:, None]
    mounts = [_FIRST, *map(tuple, rng.uniform(-0.5, 0.5, (count - 1, 3)) * (6.0, 1.0, 1.0))]
    params = [
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
        for number, (place, mount) in enumerate(zip(places, mounts, strict=True))
    ]
    drives = [simulate_drive(given) for given in params]
    fixes = receivers_of([drive["gnss"] for drive in drives], params) if receivers else [drives[0]["gnss"]]
    q_v = [from_euler(*mount) for mount in mounts]
    signs = [0, *((-1) ** number for number in range(count - 1))]
    imus = [_mistimed(drive["imu"], sign * LAG_S, sign * DRIFT) for drive, sign in zip(drives, signs, strict=True)]
    return Boxes(
        {**drives[0], "gnss": fixes[0]},
        imus,
        [multiply(conjugate(q_v[0]), q) for q in q_v],
        [rotate(conjugate(q_v[0]), place) for place in places],
        [sign * LAG_S for sign in signs],
        [sign * DRIFT for sign in signs],
        q_v[0],
        [_mistimed(table, sign * LAG_S, sign * DRIFT) for table, sign in zip(fixes, signs, strict=False)],
    )


def receivers_of(alone: list[pa.Table], params: list[DriveParams]) -> list[pa.Table]:
    """What receivers of one vehicle report: SHARED of the variance of their errors is one and the same for all.

    alone : as each would report with errors of its own; params : of the drives
    """
    exact = [simulate_drive(given.model_copy(update=_EXACT))["gnss"] for given in params]
    again = params[0].model_copy(update={"seed": params[0].seed + 900, "imu_rate": 20.0})
    of_all = simulate_drive(again)["gnss"]
    return [_mixed(own, true, of_all, exact[0]) for own, true in zip(alone, exact, strict=True)]


def _mixed(own: pa.Table, true: pa.Table, of_all: pa.Table, of_all_true: pa.Table) -> pa.Table:
    columns = {}
    for name in ("lat", "lon", "height", "vel_e", "vel_n", "vel_u"):
        share = SHARED["velocity" if name.startswith("vel") else "position"]
        common = vector(of_all, name) - vector(of_all_true, name)
        columns[name] = vector(true, name) + np.sqrt(1.0 - share) * (vector(own, name) - vector(true, name))
        columns[name] = columns[name] + np.sqrt(share) * common
    east, north = columns["vel_e"], columns["vel_n"]
    return replace(own, **columns, speed=np.hypot(east, north), course=np.mod(np.arctan2(east, north), 2.0 * np.pi))


def _mistimed(imu: pa.Table, lag_s: float, drift: float) -> pa.Table:
    t_ns = time_ns(imu)
    gained = np.rint((t_ns - t_ns[len(t_ns) // 2]) * drift).astype(np.int64)
    return replace(imu, time=times(t_ns + round(lag_s * 1e9) + gained))
