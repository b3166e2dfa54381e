"""Batches whose output cannot be written: what is told, what is kept, and that the same command goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleets import BATCH, finish, fleet, results
from plugin_files import install

from recon.fleet.driver import MOST_UNWRITTEN

HAS_FULL = Path(os.sep, "dev", "full").exists()


def _on_a_full_disk(folder: Path, drives: dict[str, str], more: str = "") -> Path:
    """A batch file whose exporter fills the disk."""
    module = (
        "from recon import Exporter, hookimpl\n"
        "def full(folder, about, params):\n"
        "    (folder / 'x').write_bytes(b'x')\n"
        "    with open('/dev/full', 'wb') as file:\n"
        "        file.write(b'x' * 100)\n"
        "@hookimpl\n"
        "def declare_exporters():\n"
        "    yield Exporter(name='full', summary='Fills the disk.', run=full)\n"
    )
    file = fleet(folder, drives, f"{BATCH}exports: [full]\n{more}")
    install(folder / "site", "full", modules={"full.py": module}, points={"exporter.full": "full"})
    return file


@pytest.mark.skipif(not HAS_FULL, reason="there is no device that is always full")
def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path) -> None:
    file = _on_a_full_disk(tmp_path, {"A/d0": "good 1"})
    code, out, errors = finish(file)
    assert code == 6
    result = file.parent / "results/vehicle=A/drive=d0"
    told = f"failed: vehicle=A/drive=d0: not_written: {result}/exports/full could not be written: no space left on "
    assert told in errors
    assert "1 of them may go well another time: the same command does them again" in out
    assert results(file.parent / "results") == {}


@pytest.mark.skipif(not HAS_FULL, reason="there is no device that is always full")
@pytest.mark.parametrize("retries", [0, 1])
def test_a_fleet_is_not_worked_through_where_nothing_can_be_written(retries: int, tmp_path: Path) -> None:
    drives = {f"A/d{number}": "good 1" for number in range(2 * MOST_UNWRITTEN)}
    file = _on_a_full_disk(tmp_path, drives, f"retries: {retries}\n")
    code, out, errors = finish(file, "--json")
    facts = json.loads(out)
    assert code == 8
    assert (facts["stopped"], facts["recorded"]) == (True, False)
    assert len(facts["failures"]) == (0 if retries else MOST_UNWRITTEN - 1)
    first, *hints = errors[errors.index("error: ") :].splitlines()
    assert first.startswith(f"error: none of the last {MOST_UNWRITTEN} drives was written, the last one: ")
    assert hints[-1] == "  what is done is kept; the same command goes on from there"
    file.write_text(file.read_text(encoding="utf-8").replace("exports: [full]\n", ""), encoding="utf-8")
    assert finish(file)[0] == 0
    assert len(results(file.parent / "results")) == len(drives)


SUMMED_UP_WITHOUT_ROOM = """
import resource, sys
from recon.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
sys.exit(main(["batch", sys.argv[1]]))
"""
"""A limit on the size of files stands for the disk: the table of all jobs is larger."""


@pytest.mark.skipif(sys.platform == "win32", reason="the limit on the size of files is one of POSIX")
def test_a_disk_that_is_full_when_the_results_are_summed_up_is_told(tmp_path: Path) -> None:
    file = fleet(tmp_path, {"A/d0": "good 1", "A/d1": "good 2"})
    assert finish(file)[0] == 0
    root = file.parent / "results"
    calm = results(root)
    (root / "jobs.parquet").unlink()
    environment = {**os.environ, "PYTHONPATH": str(file.parent / "site")}
    command = [sys.executable, "-c", SUMMED_UP_WITHOUT_ROOM, str(file)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 8, done.stderr
    assert "jobs.parquet could not be written: file too large" in done.stderr
    assert finish(file)[0] == 0
    assert results(root) == calm
    assert pq.read_table(root / "jobs.parquet").num_rows == 2


@pytest.mark.skipif(sys.platform != "linux", reason="needs a folder in which not even root may write: /sys of Linux")
def test_an_output_that_may_not_be_written_gives_one_sentence(tmp_path: Path) -> None:
    file = fleet(tmp_path, {"A/d0": "good 1"}, BATCH.replace("output: results", "output: /sys/kernel"))
    code, _, errors = finish(file)
    assert code == 8
    assert errors.startswith("error: /sys/kernel/.lock could not be written: ")
