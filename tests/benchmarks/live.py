"""What is lost where `fuser.map` follows a drive rather than smooths all of it, and what it costs.

    python tests/benchmarks/live.py [--drives 10] [--seconds 900] [--lag 10]

Simulated drives, the receiver never silent; rows from the fifth minute on, when the start is over. Time is that of the
processor, for each second of the drive at 100 Hz.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import to_euler
from recon.numerics.signals import interpolate, wrap_angle
from recon.tables import matrix, select_rows, time_ns
from recon_fusers._map_live import LiveMap
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

SINCE_S = 300.0


def errors(found: pa.Table, reference: pa.Table) -> np.ndarray:
    """RMS: horizontal m, vertical m, velocity m/s, heading of the vehicle deg."""
    found = select_rows(found, time_ns(found) > time_ns(reference)[0] + round(SINCE_S * 1e9))
    at, there = time_ns(found), time_ns(reference)
    pos, vel = (matrix(found, g) - interpolate(at, there, matrix(reference, g)) for g in ("pos", "vel"))
    yaw = to_euler(matrix(found, "q"))[0] - to_euler(matrix(reference, "q")[np.searchsorted(there, at)])[0]
    squares = ((pos[:, :2] ** 2).sum(axis=1), pos[:, 2] ** 2, (vel**2).sum(axis=1), np.degrees(wrap_angle(yaw)) ** 2)
    return np.sqrt([square.mean() for square in squares])


def follow(drive: dict[str, pa.Table], lag: float) -> tuple[pa.Table, np.ndarray]:
    """The final rows, and the time of the processor for each second of the drive."""
    live, parts, taken = LiveMap(MapParams(), lag), [], []
    zero = int(time_ns(drive["imu"])[0])
    for second in range(int((time_ns(drive["imu"])[-1] - zero) // 10**9) + 1):
        start, stop = zero + second * 10**9, zero + (second + 1) * 10**9
        new = {}
        for name in ("imu", "gnss"):
            a, b = np.searchsorted(time_ns(drive[name]), [start, stop])
            new[name] = drive[name].slice(a, b - a)
        begun = time.process_time()
        told = live.advance(new)
        taken.append(time.process_time() - begun)
        parts += [told["trajectory"]] if "trajectory" in told else []
    return pa.concat_tables(parts), np.array(taken)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--lag", type=float, default=10.0)
    options = parser.parse_args()
    print("drive  horizontal m    vertical m      velocity m/s    heading deg     processor s/s")
    print("       whole  live     whole  live     whole  live     whole  live     median  95 %")
    ratios = []
    for seed in range(1, options.drives + 1):
        drive = simulate_drive(
            DriveParams(
                motion="mixed", sensors="study_two", duration=options.seconds, seed=seed, route=seed, outages=(),
                outage_rate=0.0,
            )
        )  # fmt: skip
        whole = fuse_map(
            imu=drive["imu"], gnss=drive["gnss"], wheel=None, attitude=None, events=None, params=MapParams()
        )
        rows, taken = follow(drive, options.lag)
        both = errors(whole["trajectory"], drive["reference"]), errors(rows, drive["reference"])
        ratios.append(both[1] / both[0])
        shown = "   ".join(f"{a:.3f}  {b:.3f}" for a, b in zip(*both, strict=True))
        later = taken[int(SINCE_S) :]
        print(f"{seed:5d}  {shown}   {np.median(later):.3f}   {np.quantile(later, 0.95):.3f}", flush=True)
    print("median of live / whole: " + "  ".join(f"{ratio:.2f}" for ratio in np.median(ratios, axis=0)))


if __name__ == "__main__":
    main()
