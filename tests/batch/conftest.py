"""A batch file over six good drives."""

from __future__ import annotations

from pathlib import Path

import pytest
from fleets import BATCH, fleet
from small_fleet import GOOD


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A batch file over good drives, run in this process."""
    file = fleet(tmp_path, GOOD, BATCH.replace("executor.local, params: {workers: 3}", "executor.serial"))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return file
