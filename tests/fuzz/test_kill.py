"""A run that is killed at any moment leaves a whole result or none."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzz.kills import faults_of
from helpers import imu_table

import recon
from recon import Pipeline, Recording

KILLS = 25


def test_a_killed_run_leaves_nothing_that_looks_whole_and_is_not() -> None:
    command = [sys.executable, str(Path(__file__).with_name("kills.py")), "--kills", str(KILLS)]
    ended = subprocess.run(command, capture_output=True, text=True, encoding="utf-8")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert f"{KILLS} killed" in ended.stdout
    assert "; 0 faults" in ended.stdout


@pytest.mark.parametrize(
    "damage",
    [
        lambda out: (out / "manifest.json").unlink(),
        lambda out: (out / "streams/trajectory.parquet").unlink(),
        lambda out: (out / "streams/recording.json").write_text('{"streams": ["imu", "trajectory"], "meta": {}}'),
        lambda out: (out / "exports/csv/export.json").unlink(),
        lambda out: (out / "exports/csv/imu.csv").unlink(),
        lambda out: (out / "exports/csv/imu.csv").write_bytes(b"time"),
    ],
)
def test_a_damaged_result_would_be_found(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    out = tmp_path / "result"
    streams = {"imu": imu_table(), "trajectory": imu_table()}
    recon.run(Pipeline.of("keep"), Recording(streams), out, exports=["csv"])
    assert faults_of(out) == []
    damage(out)
    assert faults_of(out)
