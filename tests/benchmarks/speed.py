"""How long the thesis' pipeline takes, and how that grows with the log.

    python tests/benchmarks/speed.py [--rows 10000 100000 ...] [--repeats 3]

Logs of physycom `fullinertial` text are made from simulated city drives; each run is a process of its own, timed to the
finished folder, with its peak memory. Before it the process runs a log of one minute, which does the imports and loads
the stages, and then times logs of one and of two minutes: what both have in common is the start-up of a run (asking the
readers, the plan, opening and naming files, the manifest), which is told apart from the time that the rows take.
Single times depend on the machine: the slope of time over rows and the ratios between the rows of the table do not.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

import recon
from recon.numerics.rotation import from_rotvec
from recon.numerics.rotation_series import compose
from recon.tables import matrix, seconds, time_ns, vector

ROWS = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000)
EPOCH_2000 = 946_681_200
"""1999-12-31T23:00:00Z in s since 1970: the zero of physycom's clock."""

MINUTE = 6_000
RUN = """
import json, sys, time, recon
minute, two_minutes, log, out = sys.argv[1:]
registry = recon.Registry.installed()
def timed(source, name):
    start = time.perf_counter()
    run = recon.run("thesis", source, out + name, registry=registry)
    return time.perf_counter() - start, run
timed(minute, "-warm")
short = [(timed(minute, f"-1-{k}")[0], timed(two_minutes, f"-2-{k}")[0]) for k in range(12)]
one, two = (min(times) for times in zip(*short))
seconds, run = timed(log, "")
try:
    import resource
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
except ImportError:
    peak = float("nan")
steps = run.manifest["environment"]["step_seconds"]
print(json.dumps({"seconds": seconds, "start_up": 2 * one - two, "peak_mb": peak, "steps": steps}))
"""


def write_log(path: Path, rows: int) -> int:
    """A fullinertial log of so many rows at 100 Hz, each with the last fix; returns its size in bytes."""
    made = recon.run("simulated_drive", **{"simulator.drive.duration": f"{rows / 100} s"}).recording
    imu, gnss = made["imu"], made["gnss"]
    imu = imu.slice(0, rows)
    t_ns, fix_ns = time_ns(imu), time_ns(gnss)
    accel, gyro = matrix(imu, "accel") / 9.80665, np.degrees(matrix(imu, "gyro"))
    last = (
        np.searchsorted(fix_ns, t_ns, side="right") - 1
    )  # a logger repeats the last fix; the first comes with the IMU
    held = {name: np.nan_to_num(vector(gnss, name))[last] for name in ("lat", "lon", "height", "speed", "course")}
    course = np.degrees(held["course"]) % 360.0
    stamps = [f"{ns // 10**9 - EPOCH_2000}.{ns % 10**9 // 10**5:04d}" for ns in t_ns.tolist()]
    numbers = [
        held["lat"].round(7), held["lon"].round(7), held["height"].round(2), course.round(2),
        (held["speed"] * 3.6).round(3), *accel.T.round(5), *gyro.T.round(5),
        np.linalg.norm(accel, axis=1).round(5), seconds(imu).round(4),
    ]  # fmt: skip
    names = [
        "timestamp",
        "lat",
        "lon",
        "alt",
        "heading",
        "speed",
        "ax",
        "ay",
        "az",
        "gx",
        "gy",
        "gz",
        "|a|",
        "time_rel",
    ]
    table = pa.table([pa.array(stamps), *numbers], names=names)
    options = pa.csv.WriteOptions(delimiter="\t", quoting_style="none", include_header=False)
    with path.open("wb") as file:
        file.write(("# " + "\t".join(names) + "\n").encode())
        pa.csv.write_csv(table, file, options)
    return path.stat().st_size


def measure(short: Sequence[Path], log: Path, out: Path, repeats: int) -> dict[str, float]:
    """Least times and largest peak memory over several processes. short : logs of one minute and of two"""
    found = []
    for number in range(repeats):
        command = [sys.executable, "-c", RUN, *map(str, short), str(log), str(out / f"{log.stem}-{number}")]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found.append(json.loads(done.stdout.splitlines()[-1]))
    return {
        "seconds": min(one["seconds"] for one in found),
        "start_up": min(one["start_up"] for one in found),
        "read": min(one["steps"]["reader.auto"] for one in found),
        "peak_mb": max(one["peak_mb"] for one in found),
    }


def composition(samples: int = 1_000_000) -> float:
    """Seconds that the composition of so many rotations takes, the best of five."""
    dq = from_rotvec(np.random.default_rng(0).normal(0.0, 0.01, (samples, 3)))
    times = []
    for _ in range(5):
        start = time.perf_counter()
        compose(dq, np.array([1.0, 0.0, 0.0, 0.0]))
        times.append(time.perf_counter() - start)
    return min(times)


def growth(rows: Sequence[int], times: Sequence[float]) -> list[str]:
    """How the time besides start-up grows: powers of the rows, from several sizes on."""
    n, taken = np.array(rows, dtype=np.float64), np.array(times)
    told = []
    for smallest in (0, 100_000):
        chosen = n >= smallest
        if chosen.sum() > 1:
            slope = np.polyfit(np.log(n[chosen]), np.log(taken[chosen]), 1)[0]
            told.append(f"slope of log time over log rows from {n[chosen][0]:.0f} rows on: {slope:.3f}")
    return told


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=ROWS)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(
            f"{'rows':>9}  {'MB text':>8}  {'start-up, s':>11}  {'rows, s':>8}  {'us/row':>7}  {'read MB/s':>9}"
            f"  {'peak MB':>8}"
        )
        times = []
        short = [Path(folder) / "minute.txt", Path(folder) / "two-minutes.txt"]
        for count, path in enumerate(short, start=1):
            write_log(path, count * MINUTE)
        for rows in options.rows:
            log = Path(folder) / f"{rows}.txt"
            size = write_log(log, rows) / 1e6
            found = measure(short, log, Path(folder), options.repeats)
            times.append(found["seconds"] - found["start_up"])
            print(
                f"{rows:9d}  {size:8.1f}  {found['start_up']:11.3f}  {times[-1]:8.3f}  {times[-1] / rows * 1e6:7.2f}"
                f"  {size / found['read']:9.0f}  {found['peak_mb']:8.0f}",
                flush=True,
            )
    print("\n".join(growth(options.rows, times)))
    print(f"composition of 1 000 000 quaternions: {composition():.3f} s")


if __name__ == "__main__":
    main()
