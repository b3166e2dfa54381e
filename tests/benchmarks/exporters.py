"""How long the exporters that people look at take for an hour at 100 Hz, alone and as a whole command.

    python tests/benchmarks/exporters.py [--run FOLDER] [--hours 1] [--repeats 3] [--only rerun mcap ...]

Without --run a city drive is simulated and reconstructed by `best_accuracy` first, which takes a minute or two. Each
call is a process of its own. "Its own" is the exporter with what it imports, from streams in memory to closed files;
the command is `recon export RUN NAME`, with start-up, reading the Parquet, hashes of what was written and the disk.
Times are the least of the repeats; the processor's time, of all threads, means something on a busy machine too.
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
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import recon

EXPORTERS = ("rerun", "mcap", "report", "map", "plots")
GOALS_S = {"rerun": 1.5, "mcap": 5.0, "report": 3.0}
OWN = """
import json, sys, time
from pathlib import Path
import recon
from recon.manifest import RunInfo
folder, name, out = sys.argv[1:]
run = recon.open(folder)
stage = recon.Registry.installed().get(f"exporter.{name}")
streams = dict(run.recording)
inputs = {port: streams.get(port) for port in stage.reads}
if stage.every_stream:
    inputs["streams"] = streams
about = RunInfo(run.folder.name, run.manifest)
wall, cpu = time.perf_counter(), time.process_time()
stage.run(**inputs, folder=Path(out), about=about, params=stage.params())
print(json.dumps([time.perf_counter() - wall, time.process_time() - cpu]))
"""


def an_hour(folder: Path, hours: float) -> Path:
    """A finished run of `best_accuracy` over a simulated drive."""
    made = recon.run("simulated_drive", out=folder / "drive", **{"simulator.drive.duration": f"{3600 * hours} s"})
    return recon.run("best_accuracy", made.folder, folder / "run").folder


def alone(run: Path, name: str, folder: Path) -> tuple[float, float, float]:
    """Seconds by the clock and of the processor, and MB written."""
    out = Path(tempfile.mkdtemp(dir=folder))
    done = subprocess.run([sys.executable, "-c", OWN, run, name, out], capture_output=True, text=True, check=True)
    size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    shutil.rmtree(out)
    wall, cpu = json.loads(done.stdout)
    return wall, cpu, size * 1e-6


def command(run: Path, name: str) -> tuple[float, float]:
    """Seconds by the clock and of the processor of `recon export RUN NAME`."""
    shutil.rmtree(run / "exports" / name, ignore_errors=True)
    wall, before = time.perf_counter(), os.times()
    subprocess.run([sys.executable, "-m", "recon", "export", run, name], capture_output=True, check=True)
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - wall, cpu


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", type=Path, help="a finished run, which is copied")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=EXPORTERS, default=EXPORTERS)
    chosen = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if chosen.run is None:
            run = an_hour(folder, chosen.hours)
        else:
            run = Path(shutil.copytree(chosen.run, folder / "run", ignore=shutil.ignore_patterns("exports")))
        print("| exporter | its own, s | its own, s of the processor | command, s | of the processor | MB | goal, s |")
        print("|---|---|---|---|---|---|---|")
        for name in chosen.only:
            own = [alone(run, name, folder) for _ in range(chosen.repeats)]
            whole = [command(run, name) for _ in range(chosen.repeats)]
            wall, cpu, size = np.min(own, axis=0)
            wall_all, cpu_all = np.min(whole, axis=0)
            goal = GOALS_S.get(name, "")
            print(f"| {name} | {wall:.2f} | {cpu:.2f} | {wall_all:.2f} | {cpu_all:.2f} | {size:.1f} | {goal} |")


if __name__ == "__main__":
    main()
