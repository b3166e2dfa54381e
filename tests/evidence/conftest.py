"""A run, its seal, and copies of it that a test may spoil."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from evidence_runs import PIPELINE, write_log

import recon
from recon import evidence


@pytest.fixture(scope="session")
def place(tmp_path_factory) -> Path:
    """A folder with a log, the run of it, and its seal."""
    folder = tmp_path_factory.mktemp("evidence")
    write_log(folder / "drive.txt")
    recon.run(PIPELINE, folder / "drive.txt", folder / "run")
    evidence.seal(folder / "run", folder / "run.zip")
    return folder


@pytest.fixture
def sealed(place, tmp_path) -> Path:
    """A copy of the seal that a test may spoil."""
    return Path(shutil.copy(place / "run.zip", tmp_path / "run.zip"))
