"""A run that is killed at any moment leaves a whole result or none.

    python tests/fuzz/kills.py --kills 100 [--seed N]

`recon run thesis --export csv --overwrite`, in both stores, is killed after a random part of the time that it takes,
half of the times near its end, where results get their names. Half of the runs replace an older result. Lanes of runs
go beside each other; a run that ends before its kill does not count.
After each kill the folder must be absent, or all that its manifests list must be there with the hash that they list.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, repeat
from pathlib import Path
from random import Random
from typing import Final

import recon

RECON: Final = (sys.executable, "-m", "recon", "run")
DRIVE_S: Final = 60
"""Length of the log: short, and yet long enough for a straight road to be found on it."""
PARTS: Final = ((0.0, 1.0), (0.7, 1.2))
"""Of the time that a run takes: when it is killed."""


def command(log: Path, out: Path, store: str) -> list[str]:
    return [*RECON, "thesis", str(log), "--out", str(out), "--store", store, "--export", "csv", "--overwrite"]


def lane(log: Path, folder: Path, kills: int, rng: Random) -> tuple[Counter[str], list[str]]:
    """Kill so many runs one after the other: how many were found in which state, and what was wrong behind which."""
    out, older = folder / "result", folder / "older"
    states: Counter[str] = Counter()
    faults: list[str] = []
    start = time.perf_counter()
    subprocess.run(command(log, older, "parquet"), check=True, capture_output=True)
    whole_s = time.perf_counter() - start
    while states["killed"] < kills:
        shutil.rmtree(out, ignore_errors=True)
        if rng.random() < 0.5:
            shutil.copytree(older, out)
        before = {path.name for path in folder.rglob(".*")}
        delay_s = whole_s * rng.uniform(*rng.choice(PARTS))
        running = subprocess.Popen(
            command(log, out, rng.choice(("parquet", "mcap"))), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(delay_s)
        ended = running.poll() is not None
        running.kill()
        running.wait()
        left = {path.name for path in folder.rglob(".*")} - before
        states["ended before" if ended else "killed"] += 1
        states["left a temporary name behind"] += any(".partial-" in name or ".replaced-" in name for name in left)
        states["left no result"] += not out.exists()
        states["left an older result"] += unchanged(out, older)
        faults += [f"killed after {delay_s:.3f} s: {fault}" for fault in faults_of(out)]
    return states, faults


def unchanged(out: Path, older: Path) -> bool:
    manifest = out / "manifest.json"
    return manifest.is_file() and manifest.read_bytes() == (older / "manifest.json").read_bytes()


def faults_of(out: Path) -> list[str]:
    """What is wrong with a folder that looks like a result."""
    if not out.exists():
        return []
    try:
        kept = recon.open(out).recording
    except recon.ReconError as error:
        return [str(error)]
    exports = [folder / "export.json" for folder in out.glob("exports/[!.]*")]
    lost = chain.from_iterable(map(unlike, (out / "manifest.json", *exports)))
    return [*lost, *(["it holds no trajectory"] if "trajectory" not in kept else [])]


def unlike(manifest: Path) -> Iterator[str]:
    """Files that are not as a manifest lists them, and the manifest itself where there is none."""
    if not manifest.is_file():
        yield f"there is no {manifest}"
        return
    for entry in json.loads(manifest.read_text(encoding="utf-8"))["outputs"]:
        file = manifest.parent / entry["file"]
        content = file.read_bytes() if file.is_file() else b""
        if (len(content), hashlib.sha256(content).hexdigest()) != (entry["bytes"], entry["sha256"]):
            yield f"{file} is not what {manifest.name} lists"


def campaign(kills: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Share the kills between lanes, as many as there are processors."""
    count = min(os.cpu_count() or 1, kills)
    shares = [kills // count + (number < kills % count) for number in range(count)]
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(count) as pool:
        log = Path(scratch, "log")
        recon.run("simulated_drive", out=log, **{"simulator.drive.duration": f"{DRIVE_S} s"})
        folders = [Path(scratch, f"lane{number}") for number in range(count)]
        for folder in folders:
            folder.mkdir()
        rngs = [Random(f"{seed} {number}") for number in range(count)]
        found = list(pool.map(lane, repeat(log), folders, shares, rngs))
    states = sum((states for states, _ in found), Counter())
    return states, list(chain.from_iterable(faults for _, faults in found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    states, faults = campaign(chosen.kills, chosen.seed)
    told = ", ".join(f"{count} {state}" for state, count in states.items())
    print(f"{told}; {len(faults)} faults")
    print("".join(f"  {fault}\n" for fault in faults), end="")
    raise SystemExit(bool(faults))


if __name__ == "__main__":
    main()
