"""What a batch costs beyond its pipeline, and how it grows with the fleet.

    python tests/benchmarks/fleet.py [scaling] [rate] [overhead] [memory] [planning] [--drives 100000] [--tiny 10000]

scaling    the same simulated drives through three pipelines, on one worker, on one for each core, and in as many
           batches of one worker
rate       drive-hours per core-hour of best_accuracy on one worker, drives of ten minutes and of an hour
overhead   many drives of a few rows: time per job of a batch, less that of the pipeline alone in one process
memory     peak memory of the driver over 1 000 jobs and over --drives jobs, whose work is left away
planning   globbing and planning of --drives files, and going on where all of them are done
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import psutil

import recon
from recon.fleet import driver
from recon.fleet.driver import State
from recon.jobs import Outcome
from recon.recording import Recording
from recon.registry import Registry
from recon.schema import IMU
from recon.stages import Executor
from recon.storage import write_recording
from recon.tables import build

BATCH: Final = """\
recon: 1
batch: benchmark
pipeline: {pipeline}
inputs: [{{glob: '{logs}/*/*'}}]
output: {output}
executor: {{use: executor.local, params: {{workers: {workers}}}}}
"""
TINY: Final = "recon: 1\nname: tiny\nsteps:\n  - use: reader.parquet\n"
DIFFERENT: Final = 4
"""Simulated drives of each length; more would take longer than what is measured."""
BATCHES: Final = {"few": 4, "many": 28}
"""Drives for each core in the two batches by whose difference times are measured."""
VEHICLES: Final = 100
PEAK: Final = """
import json, sys
sys.path.insert(0, sys.argv[1])
import fleet
print(fleet.peak_mb(sys.argv[2]))
"""


def batch_file(folder: Path, pipeline: str, output: str, workers: int = 1, logs: str = "logs") -> Path:
    file = folder / f"{output}.yaml"
    file.write_text(BATCH.format(pipeline=pipeline, output=output, workers=workers, logs=logs), encoding="utf-8")
    return file


def quiet(state: State) -> None:
    """Progress that nobody sees."""


def timed(file: Path) -> float:
    """Seconds of a batch after its planning; every drive must be done."""
    fleet = driver.load(file, Registry.installed())
    started = time.perf_counter()
    report = driver.run(fleet, quiet)
    assert not report.failures, report.failures[0].outcome.text
    return time.perf_counter() - started


def spent() -> float:
    """Processor time of all workers that have ended, s; 0 on Windows, which does not tell it."""
    times = psutil.Process().cpu_times()
    return getattr(times, "children_user", 0.0) + getattr(times, "children_system", 0.0)


@dataclass(frozen=True)
class Counting:
    """A job that only computes: it needs neither memory nor disk."""

    key: str
    timeout: float | None = None
    memory: int | None = None

    def run(self) -> Outcome:
        total = 0
        for number in range(8_000_000):
            total += number
        return Outcome(self.key)

    def lost(self, code: str, text: str) -> Outcome:
        return Outcome(self.key, code, text)


def scaling_of_computing() -> None:
    """The executor alone: jobs of some tenths of a second, in rounds of one worker and of all, against their noise."""
    import fleet  # as workers know this module

    from recon_executors.local import LocalParams, local

    cores, found = core_count(), []
    for _ in range(5):
        each = {}
        for workers in (1, cores):
            jobs = [fleet.Counting(str(number)) for number in range(32 * workers)]
            started = time.perf_counter()
            assert all(outcome.ok for outcome in local(jobs, LocalParams(workers=workers)))
            each[workers] = (time.perf_counter() - started) / len(jobs)
        found.append(each[1] / each[cores] / cores)
    told = ", ".join(f"{share:.2f}" for share in sorted(found))
    print(f"jobs that only compute, {cores} workers against one: {told} W (goal 0.85 W)", flush=True)


def core_count() -> int:
    return len(psutil.Process().cpu_affinity()) if hasattr(psutil.Process, "cpu_affinity") else psutil.cpu_count()


def scaling(folder: Path) -> None:
    """Beside it what the machine allows: as many batches of one worker at once that know nothing of each other.

    Times are those of a drive in a batch that goes on, without the start of the workers and the last drives, at which
    some of them have nothing left to do. Where a drive takes more processor time on all cores than on one, it waits for
    memory or cache that they share.
    """
    scaling_of_computing()
    for pipeline, seconds in (("best_accuracy", 600.0), ("smartphone", 3600.0), ("thesis", 3600.0)):
        scaling_of(pipeline, seconds, folder / pipeline)
        shutil.rmtree(folder / pipeline)


def scaling_of(pipeline: str, seconds: float, folder: Path) -> None:
    cores, drives = core_count(), simulated(folder / "made", seconds)
    whole, parts = folder / "whole", [folder / f"part{number}" for number in range(cores)]
    link_batches(drives, whole, cores)
    for part in parts:
        link_batches(drives, part)
    alone, spread = steady(whole, pipeline, cores), steady(whole, pipeline, cores, workers=cores)
    with ThreadPoolExecutor(cores) as threads:
        apart = list(threads.map(lambda part: steady(part, pipeline), parts))
    allowed = sum(alone.took / each.took for each in apart) / cores
    print(
        f"{pipeline}, drives of {seconds / 60:.0f} min: one each {alone.took:.3f} s with one worker, {spread.took:.3f} "
        f"s with {cores}: {alone.took / spread.took / cores:.2f} W (goal 0.85 W); the machine allows {cores} batches "
        f"of one worker {allowed:.2f} W; processor time of a drive {alone.worked:.2f} s and {spread.worked:.2f} s; "
        f"starting takes {alone.begun:.1f} s and {spread.begun:.1f} s",
        flush=True,
    )


@dataclass(frozen=True)
class Steady:
    """A drive in a batch that goes on. took, worked : s of the clock and of processors; begun : s, until it goes on."""

    took: float
    worked: float
    begun: float


def steady(place: Path, pipeline: str, times: int = 1, workers: int = 1) -> Steady:
    """Two batches of different length: their difference is without the start of the workers and without their end."""
    marks = []
    for batch in BATCHES:
        worked = spent()
        took = timed(batch_file(place, pipeline, f"{batch}-{workers}", workers, batch))
        marks.append((took, spent() - worked))
    few, many = (times * count for count in BATCHES.values())
    took, worked = (np.array(marks[1]) - marks[0]) / (many - few)
    return Steady(took, worked, marks[0][0] - few * took)


def rate(folder: Path) -> None:
    for seconds in (600.0, 3600.0):
        place = folder / f"{seconds:.0f}"
        link_batches(simulated(place / "made", seconds), place)
        drive = steady(place, "best_accuracy")
        print(
            f"best_accuracy: {seconds / drive.took:.0f} drive-hours per core-hour, drives of {seconds / 60.0:.0f} min "
            f"on one worker (goal 1500); its start takes {drive.begun:.1f} s"
        )


def simulated(folder: Path, seconds: float) -> list[Path]:
    """A few drives as they are logged, IMU at 100 Hz and GNSS without the truth."""
    for number in range(DIFFERENT):
        parameters = {"simulator.drive.duration": f"{seconds} s", "simulator.drive.seed": number}
        made = recon.run("simulated_drive", **parameters).recording
        write_recording(Recording({name: made[name] for name in ("imu", "gnss")}), folder / f"d{number}")
    return sorted(folder.iterdir())


def link_batches(drives: list[Path], folder: Path, times: int = 1) -> None:
    """Folders of BATCHES, so many drives of one vehicle in each, times `times`: links to those there are."""
    for batch, count in BATCHES.items():
        for number in range(times * count):
            source = drives[number % len(drives)]
            shutil.copytree(source, folder / batch / "A" / f"d{number}", copy_function=os.link)


def write_files(folder: Path, count: int) -> None:
    """So many small files, whose content nobody reads."""
    for vehicle in range(VEHICLES):
        (folder / f"logs/v{vehicle}").mkdir(parents=True)
    for number in range(count):
        (folder / f"logs/v{number % VEHICLES}/d{number}.txt").write_text(f"{number}\n", encoding="utf-8")


def write_tiny(folder: Path, count: int) -> None:
    """So many drives of 20 rows, in our own format: all that a job does is its overhead."""
    rows = np.arange(20)
    still = np.tile([0.0, 0.0, 9.81], (len(rows), 1))
    imu = build(IMU, time=rows * 10_000_000, accel=still, gyro=0.0 * still)
    (whole,) = (path for path in write_recording(Recording({"imu": imu}), folder) if path.stem == "imu")
    for number in range(count):
        place = folder / f"logs/v{number % VEHICLES}/d{number}"
        place.mkdir(parents=True)
        shutil.copy(whole, place)


def overhead(folder: Path, count: int) -> None:
    write_tiny(folder, count)
    (folder / "tiny.yaml").write_text(TINY, encoding="utf-8")
    registry = Registry.installed()
    logs = sorted((folder / "logs/v0").iterdir())[:50]
    recon.run(folder / "tiny.yaml", logs[0], folder / "warm", registry=registry)
    started = time.perf_counter()
    for log in logs:
        recon.run(folder / "tiny.yaml", log, folder / "alone" / log.stem, registry=registry)
    alone = (time.perf_counter() - started) / len(logs)
    job = timed(batch_file(folder, "tiny.yaml", "results")) / count
    print(f"pipeline alone: {alone * 1e3:.1f} ms; job of a batch, on one worker: {job * 1e3:.1f} ms")
    print(f"overhead: {(job - alone) * 1e3:.1f} ms for each of {count} jobs (goal 15 ms)")


def idle() -> Registry:
    """What is installed, and beside it an executor whose jobs are done without work."""
    record = Executor(name="idle", summary="Nothing.", run=lambda jobs, params: (Outcome(job.key) for job in jobs))
    return Registry.installed().with_records(record)


def peak_mb(file: str) -> float:
    """Peak memory of a driver whose jobs are done without work."""
    driver.run(driver.load(Path(file), idle(), "idle"), quiet)
    info = psutil.Process().memory_info()
    if hasattr(info, "peak_wset"):
        return info.peak_wset / 1e6
    status = Path("/proc/self/status")  # what resource tells on Linux is also of the process that began this one
    if status.exists():
        (line,) = (line for line in status.read_text(encoding="utf-8").splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) / 1e3
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def memory(folder: Path, count: int) -> None:
    peaks = {}
    for jobs in (1_000, count):
        write_files(folder / str(jobs), jobs)
        file = batch_file(folder / str(jobs), "thesis", "results")
        here = str(Path(__file__).parent)
        told = subprocess.run([sys.executable, "-c", PEAK, here, str(file)], check=True, capture_output=True, text=True)
        peaks[jobs] = float(told.stdout)
    print("driver: " + ", ".join(f"{peak:.0f} MB for {jobs} jobs" for jobs, peak in peaks.items()))


@contextmanager
def told(what: str) -> Iterator[None]:
    """Print how long the block took, and how much of it this process was at work: the disk and others are the rest."""
    started, worked = time.perf_counter(), time.process_time()
    yield
    took = f"{time.perf_counter() - started:.1f} s, {time.process_time() - worked:.1f} s of it processor time"
    print(f"{what}: {took}", flush=True)


def planning(folder: Path, count: int) -> None:
    write_files(folder, count)
    file = batch_file(folder, "thesis", "results")
    with told(f"globbing and planning of {count} files (goal 20 s)"):
        fleet = driver.load(file, idle(), "idle")
    write_finished(folder, fleet)
    with told(f"resume and compaction of {count} results of which nothing is known"):
        driver.run(fleet, quiet)
    with told(f"resume over {count} finished jobs, planning included (goal 30 s)"):
        report = driver.run(driver.load(file, idle(), "idle"), quiet)
    assert report.kept == count
    shutil.rmtree(folder / "results" / next(iter(fleet.drives)).key)
    with told("the same where one is made anew, with compaction"):
        report = driver.run(driver.load(file, idle(), "idle"), quiet)
    assert report.done == 1


def write_finished(folder: Path, fleet: driver.Fleet) -> None:
    """For every drive the manifest of a result that was made, with its own name and input."""
    made = recon.run("simulated_drive", out=folder / "drive", **{"simulator.drive.duration": "60 s"})
    manifest = dict(recon.run("thesis", folder / "drive", folder / "made").manifest)
    assert made.folder is not None
    manifest["plan"] = fleet.plans[""]
    manifest["steps"] = [{**step, "rows": {**step["rows"], "events": 0}} for step in manifest["steps"]]
    job = {"input": "@input", "bytes": "@bytes", "modified_ns": "@modified"}
    whole = {"made_of": "@mark", **manifest, "environment": {**manifest["environment"], "job": job}}
    text = json.dumps(whole, indent=1) + "\n"  # once: a hundred thousand times would take longer than what is measured
    for drive in fleet.drives:
        bytes_, modified = drive.stamp or (0, 0)
        own = text.replace("@mark", fleet.mark(drive, (bytes_, modified))).replace("@input", str(drive.place))
        own = own.replace('"@bytes"', str(bytes_)).replace('"@modified"', str(modified))
        target = folder / "results" / drive.key
        target.mkdir(parents=True)
        (target / "manifest.json").write_text(own, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", default=["scaling", "rate", "overhead", "memory", "planning"])
    parser.add_argument("--drives", type=int, default=100_000)
    parser.add_argument("--tiny", type=int, default=10_000)
    options = parser.parse_args()
    for part in options.parts:
        started = time.perf_counter()
        folder = Path(tempfile.mkdtemp(prefix=f"recon-{part}-"))
        try:
            if part == "scaling":
                scaling(folder)
            elif part == "rate":
                rate(folder)
            elif part == "overhead":
                overhead(folder, options.tiny)
            elif part == "memory":
                memory(folder, options.drives)
            else:
                planning(folder, options.drives)
        finally:
            shutil.rmtree(folder)
        print(f"({part} took {time.perf_counter() - started:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
