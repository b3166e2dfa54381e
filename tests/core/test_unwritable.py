"""A place where nothing can be written, or that is no place: one sentence and the exit code, whatever the command."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from recon.cli import main


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box at rest for two minutes."""
    folder = tmp_path_factory.mktemp("log")
    pipeline = folder / "rest.yaml"
    params = "{motion: rest, duration: 2 min, imu_rate: 50 Hz}"
    pipeline.write_text(f"name: rest\nsteps:\n  - {{use: simulator.drive, params: {params}}}\n", encoding="utf-8")
    assert main(["run", str(pipeline), "--out", str(folder / "log")]) == 0
    return folder / "log"


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a file in it: below that nobody can write, an administrator neither."""
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("not a folder", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        "doctor LOG --write file/fixed.yaml",
        "allan LOG --plot file/allan.png",
        "schema --out file/schema.json",
        "blender-extension --out file",
        "live best_accuracy LOG/streams/imu.parquet --out file/drive.mcap",
        "outages LOG --out file/outages",
        "convert LOG file/drive.mcap",
        "run best_accuracy LOG --out file/run",
    ],
)
def test_a_place_below_a_file_is_told_in_one_sentence(
    command: str, log: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("LOG", str(log)) for word in command.split()]) in (2, 8)
    told = capsys.readouterr().err.splitlines()
    assert [line for line in told if line.startswith(("error: file/", "error: there cannot be"))]
    assert [path.name for path in place.iterdir()] == ["file"]


def test_the_doctor_does_not_write_a_pipeline_in_place_of_a_folder(
    log: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("fixed.yaml").mkdir()
    assert main(["doctor", str(log), "--write", "fixed.yaml", "--overwrite"]) == 2
    assert capsys.readouterr().err == "error: --write: fixed.yaml is a folder; name a file\n"


def test_a_plot_of_no_known_kind_is_refused_before_any_work(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["allan", "nothing", "--plot", "allan.doc"]) == 2
    assert capsys.readouterr().err == "error: --plot allan.doc is no picture; write NAME.png or NAME.svg\n"


@pytest.mark.skipif(not hasattr(os, "symlink") or os.name == "nt", reason="links need a right there")
@pytest.mark.parametrize(
    "command", ["run best_accuracy loop", "run best_accuracy loop --out result", "convert loop new"]
)
def test_a_link_that_leads_to_itself_is_no_log(command: str, place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop").symlink_to("loop")
    assert main(command.split()) == 4
    assert "error: loop: there is no such file or folder" in capsys.readouterr().err.splitlines()
