"""`recon` beside one more distribution, in a working directory that holds a log and a pipeline."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from cli_box import PIPELINE, PLUGIN, STAGES, Cli, Ended

from recon.cli import main


@pytest.fixture(scope="session")
def distribution(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for the path that holds one more distribution, with a broken stage."""
    folder = tmp_path_factory.mktemp("path")
    (folder / "box_plugin.py").write_text(PLUGIN)
    (folder / "box_broken.py").write_text("import no_such_package\n")
    about = folder / "box_plugin-2.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: box-plugin\nVersion: 2.5\n")
    points = [f"{stage} = box_plugin" for stage in STAGES] + ["filter.broken = box_broken"]
    (about / "entry_points.txt").write_text("\n".join(["[recon.plugins]", *points, ""]))
    return folder


@pytest.fixture
def cli(distribution: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Cli:
    """`recon` in an empty working directory that holds a log, `drive.txt`, and a pipeline, `box.yaml`."""
    monkeypatch.syspath_prepend(distribution)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive.txt").write_text("still 100\n")
    (tmp_path / "box.yaml").write_text(PIPELINE)

    def run(*words: str) -> Ended:
        code = main(words)
        return Ended(code, *capsys.readouterr())

    return run


@pytest.fixture
def environment(distribution: Path, tmp_path: Path) -> Mapping[str, str]:
    """Environment of processes of their own, which find what this one finds."""
    (tmp_path / "drive.txt").write_text("still 100\n")
    (tmp_path / "slow.yaml").write_text(PIPELINE + "    params: {time: 60 s}\n")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(distribution), *filter(None, sys.path)])}
