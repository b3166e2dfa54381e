"""The command accuracy.py, with one short drive of each kind, gives every number that it promises."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

COMMAND = Path(__file__).with_name("accuracy.py")
SIMULATED = ("accuracy", "insurance", "peers", "times")
MAY_BE_NONE = ("outage", "outages", "worst")
"""Beginnings of the names of numbers that a drive without outages does not have."""


def run(out: Path, *arguments: str) -> tuple[str, dict[str, Any]]:
    own = {name: value for name, value in os.environ.items() if name != "RECON_TEST_DATA"}
    command = [sys.executable, str(COMMAND), "--drives", "1", "--minutes", "3", "--json", str(out), *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", env={**own, "PYTHONIOENCODING": "utf-8"}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, json.loads(out.read_text(encoding="utf-8"))


def missing(found: Any, *names: str) -> Iterator[tuple[str, ...]]:
    """Where in nested numbers there is none."""
    if found is None:
        yield names
    elif isinstance(found, dict):
        for name, value in found.items():
            yield from missing(value, *names, name)
    elif isinstance(found, list):
        for value in found:
            yield from missing(value, *names)


def test_every_kind_of_drive_is_measured(tmp_path: Path) -> None:
    """Three minutes hold at most 60 s of outages and a stop of 30 s: a fuser that works is within 10 m and 5 deg."""
    text, found = run(tmp_path / "numbers.json")
    assert [f"## {name}" in text for name in (*SIMULATED, "comma2k19")] == [True] * 5
    assert "Left out: neither --logs nor RECON_TEST_DATA" in text
    places = [names for section in SIMULATED for names in missing(found[section], section)]
    assert [names for names in places if not any(name.startswith(MAY_BE_NONE) for name in names)] == []
    rows = [row for section in ("accuracy", "insurance") for rows in found[section].values() for row in rows]
    assert max(row["horizontal"] for row in rows) < 10.0
    assert max(row["heading"] for row in rows) < 5.0
    peers = {"fuser.map", "ekf_rts", *(["gtsam_batch", "gtsam_scatter", "gtsam_untold"] if find_spec("gtsam") else [])}
    assert all(set(solvers) == peers for solvers in found["peers"].values())


def test_the_real_segment_is_bridged(tmp_path: Path, logs: Path) -> None:
    """Twenty seconds without a fix: beyond 20 m something is broken, whatever the noise."""
    text, found = run(tmp_path / "numbers.json", "--only", "comma2k19", "--logs", str(logs))
    assert "fuser.map (1)" in text
    assert list(missing(found)) == []
    assert found["comma2k19"][0]["fuser.map"]["worst"] < 20.0
