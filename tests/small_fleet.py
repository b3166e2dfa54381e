"""Six drives that all go well, and what `recon batch` says of them."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from recon.cli import main

GOOD = {f"{vehicle}/d{number}": f"good {number + 1}" for vehicle in ("A12", "B7") for number in range(3)}


def rows(root: Path) -> list[dict]:
    """Rows of jobs.parquet, but for the times, which have more digits than Python's."""
    return pq.read_table(root / "jobs.parquet").drop_columns(["modified", "started"]).to_pylist()


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    capsys.readouterr()
    assert main([*words, "--json"]) in (0, 6)
    return json.loads(capsys.readouterr().out)
