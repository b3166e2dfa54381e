"""A scene as Blender itself has it, for tests: looked into by a Blender of its own.

RECON_BPY_PYTHON names a Python that has bpy; Blender on the path is tried beside it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.tables import matrix, time_ns
from recon_exporters.blender import own_environment

INSIDE = Path(__file__).with_name("blender") / "look_inside.py"
SINGLE = 2.0**-24
"""Relative rounding to single precision."""


@dataclass(frozen=True)
class Seen:
    """A scene that Blender opened: its plan, its keys, and what it told."""

    plan: Any
    arrays: dict[str, Any]
    curves: dict[str, Any]
    facts: Any
    folder: Path

    def picture(self, frame: int) -> Any:
        """(180, 320, 3) between 0 and 1, as displayed."""
        from matplotlib.image import imread

        return imread(self.folder / f"seen_{frame}.png")[..., :3]


def run_inside(program: list[str], script: Path, *words: str, **env: str) -> str:
    """Run a script in Blender; what it said."""
    command = [*program, str(script), *(["--"] if "--python" in program else []), *words]
    own = {**own_environment(program), **env}
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=own, check=False)
    return done.stdout + done.stderr


def look(program: list[str], folder: Path, *frames: int) -> Seen:
    """Open the scene of a folder in Blender and draw these frames of it."""
    said = run_inside(program, INSIDE, str(folder), ",".join(map(str, frames)))
    assert (folder / "found.npz").is_file(), said
    with np.load(folder / "scene.npz") as arrays, np.load(folder / "found.npz") as curves:
        facts = json.loads((folder / "found.json").read_text(encoding="utf-8"))
        plan = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        return Seen(plan, dict(arrays), dict(curves), facts, folder)


def bpy_python() -> str:
    named = os.environ.get("RECON_BPY_PYTHON", "")
    if not named:
        pytest.skip("RECON_BPY_PYTHON does not name a Python that has bpy")
    return named


def blender_on_the_path() -> str:
    found = shutil.which("blender")
    if found is None:
        pytest.skip("there is no program 'blender'")
    return found


def assert_curves_hold(seen: Seen, trajectory: Any) -> None:
    """Place and attitude of the vehicle are those of the trajectory at every key."""
    rows = np.searchsorted(time_ns(trajectory), seen.arrays["time"])
    position = matrix(trajectory, "pos")[rows] - seen.plan["origin"]
    q = matrix(trajectory, "q")[rows]
    for axis in range(3):
        curve = seen.curves[f"vehicle location {axis}"]
        assert np.abs(curve[:, 1] - position[:, axis]).max() <= SINGLE * np.abs(position[:, axis]).max()
        assert np.abs(curve[:, 0] - seen.arrays["frame"]).max() <= SINGLE * seen.arrays["frame"][-1]
    found = np.stack([seen.curves[f"vehicle rotation_quaternion {axis}"][:, 1] for axis in range(4)], axis=1)
    # One rotation has two signs; the product of two unit quaternions misses 1 by the roundings of four terms.
    assert np.abs(np.abs(np.sum(found * q, axis=1)) - 1.0).max() < 8 * SINGLE
    assert (np.sum(found[1:] * found[:-1], axis=1) > 0.9).all()
