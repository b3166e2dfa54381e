"""What is lost where `fuser.map` follows a drive rather than smooths all of it, and what it costs.

    python tests/benchmarks/live.py [--drives 10] [--first 1] [--seconds 900] [--lag 10]

Simulated drives, the receiver never silent; a second in thirty from the fifth minute on, when the start is over. Each
of them is told by `fuser.map` over the whole drive; over all that had been logged `lag` later, which is the most that
can be known then; and by `recon live`. The last lines are medians of their ratios, and in brackets in how many drives
these are below 1.2: horizontal, vertical, velocity, heading. Time is that of the processor, for each second of the
drive at 100 Hz.
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
EVERY_S = 30.0
NS = 10**9


def errors(found: pa.Table, reference: pa.Table) -> np.ndarray:
    """RMS: horizontal m, vertical m, velocity m/s, heading of the vehicle deg."""
    at, there = time_ns(found), time_ns(reference)
    pos, vel = (matrix(found, g) - interpolate(at, there, matrix(reference, g)) for g in ("pos", "vel"))
    yaw = to_euler(matrix(found, "q"))[0] - to_euler(matrix(reference, "q")[np.searchsorted(there, at)])[0]
    squares = ((pos[:, :2] ** 2).sum(axis=1), pos[:, 2] ** 2, (vel**2).sum(axis=1), np.degrees(wrap_angle(yaw)) ** 2)
    return np.sqrt([square.mean() for square in squares])


def fused(drive: dict[str, pa.Table], until_ns: int | None = None) -> pa.Table:
    """The trajectory of all that was logged by then."""
    imu, gnss = (
        table if until_ns is None else select_rows(table, time_ns(table) < until_ns)
        for table in (drive["imu"], drive["gnss"])
    )
    made = fuse_map(imu=imu, gnss=gnss, wheel=None, attitude=None, events=None, params=MapParams())
    return made["trajectory"]


def chosen(found: pa.Table, at_ns: list[int]) -> pa.Table:
    """The second before each of these times."""
    time = time_ns(found)
    return select_rows(found, np.any([(time > at - NS) & (time <= at) for at in at_ns], axis=0))


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
    parser.add_argument("--first", type=int, default=1, help="number of the first drive")
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--lag", type=float, default=10.0)
    options = parser.parse_args()
    print(
        "       horizontal m          vertical m            velocity m/s          heading deg           processor s/s"
    )
    print("drive  whole  known  live    whole  known  live    whole  known  live    whole  known  live    median  95 %")
    found = []
    for seed in range(options.first, options.first + options.drives):
        drive = simulate_drive(
            DriveParams(
                motion="mixed", sensors="study_two", duration=options.seconds, seed=seed, route=seed, outages=(),
                outage_rate=0.0,
            )
        )  # fmt: skip
        zero = int(time_ns(drive["imu"])[0])
        at_ns = [zero + round(s * NS) for s in np.arange(SINCE_S + EVERY_S, options.seconds - options.lag, EVERY_S)]
        known = [chosen(fused(drive, at + round(options.lag * NS)), [at]) for at in at_ns]
        rows, taken = follow(drive, options.lag)
        told = chosen(fused(drive), at_ns), pa.concat_tables(known), chosen(rows, at_ns)
        all_errors = np.array([errors(table, drive["reference"]) for table in told])
        found.append(all_errors)
        shown = "   ".join("  ".join(f"{error:.3f}" for error in three) for three in all_errors.T)
        later = taken[int(SINCE_S) :]
        print(f"{seed:5d}  {shown}   {np.median(later):.3f}   {np.quantile(later, 0.95):.3f}", flush=True)
    show(np.array(found))


def show(found: np.ndarray) -> None:
    """Medians of (drives, 3, 4) errors, their ratios, and in how many drives these are within a fifth.

    That of what is known by then to the whole drive is what the lag costs, however it is told.
    """
    print("all    " + "   ".join("  ".join(f"{error:.3f}" for error in three) for three in np.median(found, axis=0).T))
    whole, known, live = np.moveaxis(found, 1, 0)
    for name, ratio in (
        ("known / whole", known / whole),
        ("live / known", live / known),
        ("live / whole", live / whole),
    ):
        print(
            f"{name:14s} "
            + "  ".join(
                f"{r:.2f} ({n} of {len(found)})"
                for r, n in zip(np.median(ratio, axis=0), (ratio < 1.2).sum(axis=0), strict=True)
            )
        )


if __name__ == "__main__":
    main()
