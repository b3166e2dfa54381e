"""What a camera gains in half a minute without GNSS, where nothing is assumed of wheels.

    cd tests && python -m benchmarks.camera [SEEDS]

Each seed is another drive of `nonstop` with a poor IMU and a receiver that is good to centimetres: what fixes err by
slowly no camera can know. Streets beside the way are rendered, 320 x 240 pixels ten times a second, while GNSS is away;
fuser.map with `wheels: false`, without and with `integrator.visual_odometry`, and both once more with a speed that is
1 % off. Four columns where fixes come again behind the outage, and four where the log ends with it. Horizontal error in
the outage, root mean square; in brackets over its sigma. A drive takes 15 s of one core.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import map_drives
import numpy as np
import pyarrow as pa
from filmed_drives import filmed

from recon import Streams, build, matrix, time_ns
from recon.schema import WHEEL
from recon.tables import select_rows
from recon_fusers.map import MapParams, fuse_map

SEEDS: Final = 20
OUTAGE: Final = (90.0, 120.0)
POOR: Final = {
    "accel_noise": 5e-3,
    "gyro_noise": np.radians(0.1),
    "gyro_bias_walk": np.radians(0.03),
    "accel_bias_walk": 3e-3,
}
CASES: Final = {"neither": (False, False), "camera": (True, False), "speed": (False, True), "both": (True, True)}


def drive(seed: int) -> Streams:
    """Two and a half minutes with an outage."""
    return map_drives.drive("nonstop", "rtk", seed=seed, duration=150.0, outages=(OUTAGE,), **POOR)


def motions(made: Streams, folder: Path) -> pa.Table:
    """The stream visual of the outage."""
    times = OUTAGE[0] + np.arange(round(10.0 * (OUTAGE[1] - OUTAGE[0])) + 1) / 10.0
    return filmed(made, times, folder).found()["visual"]


def speeds(made: Streams, seed: int) -> pa.Table:
    """The stream wheel."""
    t_ns, speed = time_ns(made["reference"])[::10], np.linalg.norm(matrix(made["reference"], "vel"), axis=1)[::10]
    return build(WHEEL, time=t_ns, speed=1.01 * speed + 0.05 * np.random.default_rng(seed).standard_normal(len(t_ns)))


def ended(streams: Streams) -> Streams:
    """What of these streams is before the end of the outage."""
    stop_ns = time_ns(streams["reference"])[0] + round(OUTAGE[1] * 1e9)
    some = (name for name, table in streams.items() if name in ("imu", "gnss", "reference", "visual", "wheel"))
    cut = {name: select_rows(streams[name], time_ns(streams[name]) < stop_ns) for name in some}
    return {**streams, **cut}


def errors(made: Streams, visual: pa.Table | None, wheel: pa.Table | None) -> tuple[float, float]:
    """Horizontal error in the outage, m, and the same over its sigma."""
    found = fuse_map(
        imu=made["imu"], gnss=made["gnss"], wheel=wheel, attitude=None, visual=visual, params=MapParams(wheels=False)
    )
    apart = map_drives.errors(made, found)
    return apart.horizontal(OUTAGE), apart.over_sigma(OUTAGE)


def main() -> None:
    """Print a line for each drive, root mean squares, and medians."""
    found = []
    print("seed " + " ".join(f"{end + name:>14s}" for end in ("", "ends, ") for name in CASES))
    for seed in range(1, 1 + (int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS)):
        made = drive(seed)
        with tempfile.TemporaryDirectory() as folder:
            whole = {**made, "visual": motions(made, Path(folder)), "wheel": speeds(made, seed)}
        found.append(
            [
                errors(streams, streams["visual"] if sees else None, streams["wheel"] if rolls else None)
                for streams in (whole, ended(whole))
                for sees, rolls in CASES.values()
            ]
        )
        print(f"{seed:4d} {_row(found[-1])}", flush=True)
    print(f"rms  {_row(np.sqrt(np.mean(np.square(found), axis=0)))}")
    print(f"half {_row(np.median(found, axis=0))}")


def _row(cells: Iterable[Iterable[float]]) -> str:
    return " ".join(f"{error:7.2f} ({over:4.2f})" for error, over in cells)


if __name__ == "__main__":
    main()
