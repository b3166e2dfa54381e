"""Blender is started so that the Python of nobody else takes over."""

from __future__ import annotations

import os
import sys
import venv

import pytest
from blender_scenes import blender_on_the_path, bpy_python, run_inside

from recon_exporters.blender import find_blender, own_environment

ASK = "import sys, numpy\nsys.stdout.write(f'prefix {sys.prefix}; numpy {numpy.__file__}')\n"


@pytest.mark.parametrize("named", [bpy_python, blender_on_the_path])
def test_a_python_that_is_first_on_the_path_does_not_take_over(named, tmp_path, monkeypatch):
    """An environment without a package, as pyenv's or an active one may be, and packages that are not Blender's."""
    program = find_blender(named())
    venv.create(tmp_path / "other", symlinks=os.name != "nt")
    (tmp_path / "wrong" / "numpy").mkdir(parents=True)
    (tmp_path / "wrong" / "numpy" / "__init__.py").write_text("raise ImportError('not that of Blender')")
    (tmp_path / "ask.py").write_text(ASK)
    folder = tmp_path / "other" / ("Scripts" if os.name == "nt" else "bin")
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("VIRTUAL_ENV", str(tmp_path / "other"))
    monkeypatch.setenv("PYTHONHOME", str(tmp_path / "other"))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "wrong"))
    said = run_inside(program, tmp_path / "ask.py")
    assert "numpy " in said, said
    assert str(tmp_path) not in said.rpartition("prefix")[2]


def test_the_python_that_runs_recon_keeps_its_packages(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "where_bpy_lies")
    assert own_environment([sys.executable])["PYTHONPATH"] == "where_bpy_lies"
    assert "PYTHONPATH" not in own_environment(["/opt/blender/blender"])
