"""Batches whose processes are killed: nothing that is done is lost, and nothing half-done looks whole."""

from __future__ import annotations

import json
import signal
import sys
import time
from pathlib import Path
from random import Random

import psutil
import pyarrow.parquet as pq
import pytest
from fleets import BATCH, begin, children, finish, fleet, keys, killing_one_a_second, results, wait_for

from recon.cli import main
from recon_executors import _worker

SLOW = {f"{vehicle}/d{number}": f"slow {number + 1}" for vehicle in "AB" for number in range(10)}
"""Drives that take 0.2 s each, so that a batch lasts long enough to be killed in its midst."""


def alive_after(processes: list[psutil.Process], seconds: float) -> list[psutil.Process]:
    """Those that have not ended by then; one that has, and that nobody asked for its exit code, is a zombie."""
    deadline = time.monotonic() + seconds
    while processes and time.monotonic() < deadline:
        processes = [one for one in processes if is_at_work(one)]
        time.sleep(0.01)
    return processes


def is_at_work(process: psutil.Process) -> bool:
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[tuple[str, str]]]:
    """What the slow drives give when nothing happens."""
    file = fleet(tmp_path_factory.mktemp("calm"), SLOW)
    assert finish(file)[0] == 0
    return results(file.parent / "results")


def test_workers_end_within_a_second_of_their_driver(tmp_path: Path) -> None:
    file = fleet(tmp_path, {f"A/d{number}": "sleep 1" for number in range(4)})
    with begin(file) as driver:
        deadline = time.monotonic() + 60.0
        while len(workers := children(psutil.Process(driver.pid))) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(2.0)  # they have imported all, and sleep in their drives
        driver.kill()
        assert alive_after(workers, 1.0) == []
        driver.communicate()


def test_a_driver_killed_ten_times_loses_nothing(tmp_path: Path, calm: dict) -> None:
    file = fleet(tmp_path, SLOW)
    root = file.parent / "results"
    rng = Random(8)
    done = 0
    for _ in range(10):
        with begin(file) as driver:
            if done < len(SLOW) - 1:
                wait_for(root, done + 1)
            time.sleep(rng.uniform(0.0, 0.3))
            driver.kill()
            driver.communicate()
        found = results(root)
        assert {key: found[key] for key in found} == {key: calm[key] for key in found}, "a result is not whole"
        assert len(found) >= done, "a result that was there is gone"
        done = len(found)
    assert finish(file)[0] == 0
    assert results(root) == calm
    jobs = pq.read_table(root / "jobs.parquet", columns=["vehicle", "drive", "status"]).to_pylist()
    assert {f"vehicle={row['vehicle']}/drive={row['drive']}" for row in jobs if row["status"] == "ok"} == keys(SLOW)
    assert not (root / ".scratch").exists()


@pytest.mark.parametrize("executor", ["local", "dask"])
def test_workers_killed_at_random_cost_no_drive_its_result(executor: str, tmp_path: Path) -> None:
    """Any of them, also the last one."""
    if executor == "dask":
        pytest.importorskip("distributed")
    drives = {f"A/d{number}": f"slow {number + 1}" for number in range(100)}
    file = fleet(tmp_path, drives, BATCH + "retries: 50\n")
    begun = time.monotonic()
    with begin(file, "--json", "--executor", executor) as driver:
        wait_for(file.parent / "results", 1)
        with killing_one_a_second(lambda: children(psutil.Process(driver.pid)), begun) as killed:
            out, errors = driver.communicate(timeout=200)
    assert killed, "nobody was killed, so nothing was tried"
    assert driver.returncode == 0, errors
    assert json.loads(out)["done"] == 100
    assert set(results(file.parent / "results")) == keys(drives)


def test_a_batch_goes_on_when_all_its_workers_die_at_once(tmp_path: Path) -> None:
    file = fleet(tmp_path, SLOW, BATCH + "retries: 1\n")
    with begin(file, "--json") as driver:
        wait_for(file.parent / "results", 1)
        workers = children(psutil.Process(driver.pid))
        for worker in workers:
            worker.kill()
        out, errors = driver.communicate(timeout=200)
    assert len(workers) == 3
    assert driver.returncode == 0, errors
    assert json.loads(out)["done"] == len(SLOW)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows forks no process")
def test_what_a_dead_job_leaves_running_does_not_hold_the_batch(tmp_path: Path) -> None:
    """The job's own child has its end of the pipe, too, so the pipe alone never says that the job is dead."""
    file = fleet(tmp_path, {"A/orphan": "orphan 1", "B/good": "good 1"})
    code, _, errors = finish(file)
    assert code == 6
    assert "failed: vehicle=A/drive=orphan: died: its process ended with exit code 9\n" in errors
    assert results(file.parent / "results").keys() == keys(["B/good"])


def test_a_process_does_so_many_jobs_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a stage leaks, files that stay open for one, is gone with the process."""
    monkeypatch.setattr(_worker, "MOST_JOBS", 2)
    file = fleet(tmp_path, {f"A/d{number}": "pid 1" for number in range(5)}, BATCH.replace("workers: 3", "workers: 1"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    assert main(["batch", str(file)]) == 0
    first, second, third, fourth, fifth = (path.read_text() for path in sorted(tmp_path.rglob("*.pid")))
    assert (first, third) == (second, fourth)
    assert len({first, third, fifth}) == 3


def test_two_batches_on_one_output_are_refused_and_a_dead_one_does_not_count(tmp_path: Path) -> None:
    file = fleet(tmp_path, {**SLOW, "C/sleep": "sleep 1"})  # which never ends
    with begin(file) as first:
        wait_for(file.parent / "results", 1)
        code, _, errors = finish(file)
        assert code == 2
        assert "another batch is at work on" in errors
        first.kill()
        first.communicate()
    (file.parent / "logs/C/sleep.txt").unlink()
    assert finish(file)[0] == 0


@pytest.mark.skipif(sys.platform == "win32", reason="on Windows SIGTERM ends a process without a word")
def test_an_interruption_ends_a_batch_in_order(tmp_path: Path) -> None:
    file = fleet(tmp_path, {**SLOW, "C/sleep": "sleep 1"})
    with begin(file) as driver:
        wait_for(file.parent / "results", 1)
        workers = children(psutil.Process(driver.pid))
        driver.send_signal(signal.SIGTERM)  # as Ctrl-C, which a shell lets its background processes ignore
        _, errors = driver.communicate(timeout=20)
    assert driver.returncode == 143
    assert "what is done is kept; the same command goes on from there" in errors
    assert "Traceback" not in errors
    assert alive_after(workers, 1.0) == []
    assert not (file.parent / "results/.scratch").exists()
