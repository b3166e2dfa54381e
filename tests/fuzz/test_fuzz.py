"""Damaged files give rows or an error of recon; and what finds the exceptions would find one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
CASES = 200


def fuzz(target: str, cases: int = CASES, script: Path = HERE / "run.py") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(script), "--target", target, "--cases", str(cases)]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8")


TARGETS = [
    *("physycom", "csv", "yaml", "parquet", "mcap"),
    *("nmea", "ubx", "vbox", "gpx", "kml", "rtklib", "sbet", "kf_gins", "kitti"),
    *("novatel", "nhtsa", "gpmf"),
    *("foreign_mcap", "rosbag", "ulog", "ardupilot", "mf4"),
    *("sensor_logger", "phyphox", "gnsslogger"),
    *("comma2k19", "navego", "edr_csv", "frames"),
]


NEVER_REFUSED = ("ubx", "novatel")
"""Messages of their own, each with a checksum: whatever is damaged, others are left."""


@pytest.mark.parametrize("target", TARGETS)
def test_damaged_files_give_rows_or_an_error_of_ours(target: str) -> None:
    ended = fuzz(target)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    gave, refused = (int(part.split()[0]) for part in ended.stdout.removeprefix(f"{target}: ").split(",")[:2])
    assert gave + refused == CASES
    assert gave > 0
    assert refused > 0 or target in NEVER_REFUSED


@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("raise KeyError('strange')", "KeyError: 'strange'"),
        ("raise ContractError('step', 'undeclared')", "ContractError: step step: undeclared"),
        ("os._exit(3)", "its process ended with 3"),
        ("time.sleep(60)", "Timeout (0:00:01)!"),
        ("raise ReadFailed(path, 'damaged') from MemoryError()", "it asked for too much memory"),
    ],
)
def test_a_fault_is_found_and_its_seed_is_named(tmp_path: Path, does: str, said: str) -> None:
    script = tmp_path / "broken.py"
    lines = [
        f"import os, sys, time; sys.path.insert(0, {str(HERE)!r})",
        "import run, targets, worker",
        "from recon.errors import ContractError, ReadFailed",
        "worker.LONGEST_S = 1.0",
        "def attempt(path):",
        f"    if path.read_bytes(): {does}",
        "targets.TARGETS['broken'] = targets.Target(lambda: [{'file': b'content ' * 20}], attempt)",
        "if __name__ == '__main__' and sys.argv[1] != '--target': worker.main()",
        "elif __name__ == '__main__': run.WORKER = run.Path(__file__); run.main()",
    ]
    script.write_text("\n".join(lines) + "\n", encoding="utf-8")
    ended = fuzz("broken", 2, script)
    assert ended.returncode == 1, ended.stderr
    assert "2 failed" in ended.stdout
    assert "broken 0 failed" in ended.stdout
    assert "broken 1 failed" in ended.stdout
    assert said in ended.stdout
