"""The command figures.py, with short drives, makes every figure that it names."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

COMMAND = Path(__file__).with_name("figures.py")
SIMULATED = {
    "fig_2_2_4_rotations",
    "fig_4_1_gnss_at_rest",
    "fig_4_3_vertical_alignment",
    "fig_4_5_horizontal_alignment",
    "fig_6_1_synthetic_trajectory",
    "fig_6_2_integration_error",
    "fig_6_4_city_path",
    "fig_6_6_smoothness",
    "fig_6_7_height",
    "fig_9_1_bases",
    "fig_9_1_symplectic",
}
CRASH = "fig_6_3_parabola_and_trapezoid"


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    own = {name: value for name, value in os.environ.items() if name != "RECON_TEST_DATA"}
    command = [sys.executable, str(COMMAND), "--quick", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", env={**own, "PYTHONIOENCODING": "utf-8"}
    )


def made(folder: Path) -> set[str]:
    """Names of the figures of which both files can be read."""
    for path in folder.glob("*.svg"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")
    for path in folder.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")
    names = {path.stem for path in folder.glob("*.svg")}
    assert names == {path.stem for path in folder.glob("*.png")}
    return names


def test_without_real_logs_all_but_the_crash_is_drawn_and_the_reason_is_told(tmp_path: Path) -> None:
    done = run("--out", tmp_path / "new" / "figures")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert made(tmp_path / "new" / "figures") == SIMULATED
    assert "Figure 6.3 is left out" in done.stdout
    assert all(f"{name}\n" in done.stdout for name in SIMULATED)


def test_with_real_logs_the_crash_is_drawn_too(tmp_path: Path, logs: Path) -> None:
    done = run("--out", tmp_path, "--logs", logs)
    assert done.returncode == 0, done.stderr
    assert made(tmp_path) == {*SIMULATED, CRASH}
    assert "left out" not in done.stdout


@pytest.mark.parametrize("content", [(), ("physycom_crash",)])
def test_a_folder_without_the_crash_log_is_refused(tmp_path: Path, content: tuple[str, ...]) -> None:
    for name in content:
        (tmp_path / "logs" / name).mkdir(parents=True)
    done = run("--out", tmp_path / "out", "--logs", tmp_path / "logs")
    assert done.returncode == 2
    assert "physycom_crash/crash_01.txt" in done.stderr
    assert not (tmp_path / "out").exists()
