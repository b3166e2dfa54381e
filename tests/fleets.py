"""Small fleets of drives that go well or wrong in one way each, for tests of batches."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from random import Random
from threading import Event, Thread

import psutil
from plugin_files import install

READER = '''
"""Reads drives of a line of text: what happens, and a number."""

import os
import time

import numpy as np

from recon import IMU, Reader, build, hookimpl
from recon.errors import NotEnoughData
from recon.fleet.root import LocalRoot
from recon.parameters import Params, setting

commit = LocalRoot.commit


class TroubleParams(Params):
    rows: int = setting(50, gt=0, doc="Rows of the imu.")


def trouble(path, params):
    what, number = path.read_text().split()
    if what == "short":
        raise NotEnoughData("imu", needed="10 s", found="1 s")
    if what == "garble":
        raise RuntimeError("no \\udcff wheel " + 5000 * "!")
    if what == "late":
        LocalRoot.commit = lambda *put: (commit(*put), os._exit(9))
    if what == "raise":
        raise RuntimeError("a wheel came off")
    if what == "kill":
        os._exit(9)
    if what == "orphan":
        if os.fork() == 0:
            time.sleep(600)
        os._exit(9)
    if what == "pid":
        path.with_suffix(".pid").write_text(str(os.getpid()))
    if what == "sleep":
        time.sleep(600)
    if what == "eat":
        held = []
        while True:
            held.append(np.ones(5_000_000))
    if what == "change":
        path.write_text(f"change {number} ")
    if what == "slow":
        time.sleep(0.2)
    if what == "once" and not path.with_suffix(".tried").exists():
        path.with_suffix(".tried").touch()
        os._exit(9)
    t = np.arange(params.rows)
    force = np.column_stack([np.sin(t * float(number)), 0.0 * t, 9.8 + 0.0 * t])
    return {"imu": build(IMU, time=t * 10_000_000, accel=force, gyro=0.0 * force)}


@hookimpl
def declare_readers():
    yield Reader(name="trouble", summary="Drives for tests.", run=trouble, params=TroubleParams, writes={"imu": IMU})
'''

PIPELINE = "recon: 1\nname: short\nsteps:\n  - use: reader.trouble\n  - use: detector.shock\n"

BATCH = """\
recon: 1
batch: test
pipeline: short.yaml
inputs: [{glob: 'logs/*/*.txt'}]
output: results
executor: {use: executor.local, params: {workers: 3}}
"""


def fleet(folder: Path, drives: Mapping[str, str], batch: str = BATCH) -> Path:
    """A batch file with its pipeline, its reader in `site` and its logs: text by "vehicle/drive"."""
    install(folder / "site", "trouble", modules={"trouble.py": READER}, points={"reader.trouble": "trouble"})
    (folder / "short.yaml").write_text(PIPELINE, encoding="utf-8")
    for name, text in drives.items():
        path = folder / "logs" / f"{name}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    file = folder / "batch.yaml"
    file.write_text(batch, encoding="utf-8")
    return file


def begin(file: Path, *options: str) -> subprocess.Popen[str]:
    """`recon batch` in a process of its own."""
    path = os.pathsep.join([str(file.parent / "site"), *filter(None, sys.path)])
    return subprocess.Popen(
        [sys.executable, "-m", "recon", "batch", str(file), *options],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(file: Path, *options: str) -> tuple[int, str, str]:
    """Exit code, output and errors of `recon batch`."""
    with begin(file, *options) as process:
        out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def wait_for(root: Path, count: int) -> None:
    """Until so many results are there; a minute at most."""
    deadline = time.monotonic() + 60.0
    while len(list(root.glob("vehicle=*/drive=*/manifest.json"))) < count:
        assert time.monotonic() < deadline, "the batch does not get on"
        time.sleep(0.02)


def children(process: psutil.Process) -> list[psutil.Process]:
    """Those that it began, and theirs."""
    try:
        return process.children(recursive=True)
    except psutil.NoSuchProcess:
        return []


@contextmanager
def killing_one_a_second(victims: Callable[[], list[psutil.Process]], begun: float) -> Iterator[list[int]]:
    """Kill any of those that there are, one a second in the mean and at random; yields whom it killed.

    begun : monotonic time when the batch was begun; on a machine so busy that its first result took more than two
        seconds, a second is longer by as much: else workers would die faster than they can be started
    """
    rng, over, killed = Random(1), Event(), []
    second = max(1.0, 0.5 * (time.monotonic() - begun))

    def kill() -> None:
        while not over.wait(second * rng.expovariate(1.0)):
            if found := victims():
                victim = rng.choice(found)
                with suppress(psutil.NoSuchProcess):
                    victim.kill()
                    killed.append(victim.pid)

    killer = Thread(target=kill)
    killer.start()
    try:
        yield killed
    finally:
        over.set()
        killer.join()


def results(root: Path) -> dict[str, list[tuple[str, str]]]:
    """By job, name and hash of every file of each whole result, as its manifest has them."""
    found = {}
    for path in root.glob("vehicle=*/drive=*/manifest.json"):
        manifest = json.loads(path.read_text(encoding="utf-8"))
        key = path.parent.relative_to(root).as_posix()
        found[key] = [(output["file"], output["sha256"]) for output in manifest["outputs"]]
    return found


def made(root: Path) -> dict[str, str]:
    """When each result was begun."""
    paths = root.glob("vehicle=*/drive=*/manifest.json")
    read = {path: json.loads(path.read_text(encoding="utf-8")) for path in paths}
    return {path.parent.relative_to(root).as_posix(): one["environment"]["started"] for path, one in read.items()}


def keys(drives: Iterable[str]) -> set[str]:
    """Folders of the results of "vehicle/drive"."""
    return {"vehicle={}/drive={}".format(*name.split("/")) for name in drives}
