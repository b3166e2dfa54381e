"""A batch on a Dask cluster of processes of their own gives what one process gives."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from fleets import BATCH, begin, children, finish, fleet, keys, killing_one_a_second, results, wait_for

pytest.importorskip("distributed")

DRIVES = {f"{vehicle}/d{number}": f"good {number + 1}" for vehicle in "AB" for number in range(5)}


@dataclass
class Cluster:
    """A scheduler on loopback, and the processes that keep its two workers alive."""

    address: str
    keepers: list[psutil.Process]

    def workers(self) -> list[psutil.Process]:
        """Dask's and those of the jobs beside them, without what Python starts to tidy up behind them."""
        found = [child for keeper in self.keepers for child in children(keeper)]
        return [process for process in found if "resource_tracker" not in command_of(process)]


def command_of(process: psutil.Process) -> str:
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    about = tmp_path / "scheduler.json"
    scheduler = ("dask_scheduler", "--port", "0")
    worker = ("dask_worker", "--nthreads", "1")
    path = os.pathsep.join([str(tmp_path / "spread" / "site"), *filter(None, sys.path)])
    options = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(about))
    with ExitStack() as stack:
        started = []
        for module, *own in (scheduler, worker, worker):
            command = [sys.executable, "-m", f"distributed.cli.{module}", *own, *options]
            process = subprocess.Popen(
                command,
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": path},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            started.append(psutil.Process(process.pid))
            stack.callback(process.wait)
            stack.callback(process.terminate)
            deadline = time.monotonic() + 60.0
            while not about.exists():
                assert time.monotonic() < deadline, "the scheduler does not start"
                time.sleep(0.1)
        yield Cluster(json.loads(about.read_text(encoding="utf-8"))["address"], started[1:])


def on(cluster: Cluster) -> str:
    return BATCH.replace(
        "executor.local, params: {workers: 3}", f"executor.dask, params: {{address: '{cluster.address}'}}"
    )


def test_two_workers_give_the_bytes_that_one_process_gives(cluster: Cluster, tmp_path: Path) -> None:
    alone = fleet(tmp_path / "alone", DRIVES)
    assert finish(alone, "--executor", "serial")[0] == 0
    bad = {"C/kill": "kill 1", "C/sleep": "sleep 1"}
    file = fleet(tmp_path / "spread", {**DRIVES, **bad}, on(cluster) + "timeout: 20 s\n")
    code, out, errors = finish(file, "--json")
    assert code == 6, errors
    failures = {failure["job"]: failure["code"] for failure in json.loads(out)["failures"]}
    assert failures == {"vehicle=C/drive=kill": "died", "vehicle=C/drive=sleep": "timed_out"}
    assert set(results(file.parent / "results")) == keys(DRIVES)
    assert results(file.parent / "results") == results(alone.parent / "results")


def test_workers_and_jobs_killed_at_random_cost_no_drive_its_result(cluster: Cluster, tmp_path: Path) -> None:
    drives = {f"A/d{number}": f"slow {number + 1}" for number in range(20)}
    file = fleet(tmp_path / "spread", drives, on(cluster) + "retries: 50\n")
    begun = time.monotonic()
    with begin(file, "--json") as driver:
        wait_for(file.parent / "results", 1)
        with killing_one_a_second(cluster.workers, begun) as killed:
            out, errors = driver.communicate(timeout=200)
    assert killed, "nobody was killed, so nothing was tried"
    assert driver.returncode == 0, errors
    assert json.loads(out)["done"] == len(drives)


def test_a_scheduler_that_does_not_answer_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "2s")
    nobody = "executor.dask, params: {address: 'tcp://127.0.0.1:9'}"
    file = fleet(tmp_path, DRIVES, BATCH.replace("executor.local, params: {workers: 3}", nobody))
    code, _, errors = finish(file)
    assert code == 3
    assert "no scheduler answers at tcp://127.0.0.1:9" in errors
