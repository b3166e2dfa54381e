"""The drive as an animated Blender scene: a car that moves as the trajectory says, in a file that an artist can use.

    scene.json, scene.npz   the plan of the scene as data (see _blender_plan)
    build_scene.py          with the folder scene_builder, which needs Blender's bpy and numpy alone, makes the scene
    scene.blend             the scene, where a Blender from 3.4 on was found
    still.png, frames/      pictures, where `render` asks for them
    HOW_TO_OPEN.txt         what to do where none was found

Blender's axes are those of the local frame: x east, y north, z up, in m about the first position that is shown; the
anchor on the Earth is in the properties of the scene. The place of the vehicle is the middle of the car on the ground:
no log tells where in the car its box was. Doubt can be seen: the path is dashed where GNSS is silent, `tube` shows
standard deviations, `ghost` a second run. With `solver` the motion after a crash is no measurement at all, but what a
rigid box of that mass, restitution and friction would do on a level ground.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa

from recon.errors import DataError, NothingToExport, PluginError
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import quantity, setting
from recon.rows import spans
from recon.schema import EVENTS, GNSS, TRAJECTORY
from recon.stages import Exporter
from recon.storage import read_recording
from recon_exporters._blender_events import Json
from recon_exporters._blender_film import Film, SceneParams, film_of
from recon_exporters._blender_plan import motion_of, plan

ENTRY: Final = '''"""Makes scene.blend from scene.json and scene.npz beside this file:

blender --background --python build_scene.py
"""

import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.dont_write_bytecode = True
sys.path.insert(0, str(FOLDER))

from scene_builder import main

main(FOLDER)
'''
STEP: Final = 0.05
"""Frames that a change of pace takes: Blender makes one key of two that are closer than a hundredth."""
HOW_TO_OPEN: Final = (
    "Blender, from https://www.blender.org, makes scene.blend by this command in this folder:\n"
    "blender --background --python build_scene.py\n"
)


class BlenderParams(SceneParams):
    """The film, its pictures, and the Blender that makes them."""

    camera: Literal["follow", "top", "driver", "overview"] = setting(
        "follow", doc="The camera through which the scene is seen; all four are in the file."
    )
    render: Literal["none", "still", "animation"] = setting("none", doc="Pictures to make: none, one, or every frame.")
    still: float | None = quantity(
        None,
        "s",
        ge=0,
        doc="When the picture is taken, after the start of the trajectory; none: at a crash, or halfway.",
    )
    resolution: tuple[int, int] = setting((1280, 720), doc="Width and height of pictures in pixels.")
    samples: int = setting(32, ge=1, le=65536, doc="Rays for each pixel: more are smoother and slower.")
    vehicle: str = setting("", doc="A .blend whose objects take the place of the car; forward is x, up z, in m.")
    video: str = setting("", doc="A video of the drive that is shown behind the scene, in step with it.")
    video_start: float = quantity(0.0, "s", doc="When the video begins, after the start of the trajectory.")
    solver: bool = setting(
        False, doc="After the first crash Blender's rigid-body solver moves the vehicle, no longer the log."
    )
    mass: float = quantity(1300.0, "kg", gt=0, le=1e6, doc="Of the vehicle, for the solver.")
    restitution: float = setting(0.2, ge=0, le=1, doc="Of vehicle and ground, for the solver: 1 loses no energy.")
    friction: float = setting(0.7, ge=0, le=10, doc="Coefficient of vehicle on ground, for the solver.")
    blender: str = setting(
        "", doc="Blender, or a Python that has bpy; 'none' runs none. By default the one on the path, or this Python."
    )


def blender(
    *,
    trajectory: pa.Table,
    gnss: pa.Table | None,
    events: pa.Table | None,
    streams: Mapping[str, pa.Table],
    folder: Path,
    about: RunInfo,
    params: BlenderParams,
) -> list[Path]:
    """Write the scene into the folder; the paths of its files.

    Raises NothingToExport where the film would show no row with a place, an attitude and a velocity, or the solver no
    crash; DataError where the ghost or the video is not there; PluginError where the Blender that is named is not
    there, or fails.
    """
    program = find_blender(params.blender)
    scene, arrays = plan(trajectory, gnss, events, _ghost(params.ghost, streams), streams, about, params)
    scene["look"] = _look(trajectory, events, params)
    text = json.dumps(scene, indent=1, allow_nan=False) + "\n"
    (folder / "scene.json").write_text(text, encoding="utf-8", newline="\n")
    np.savez_compressed(folder / "scene.npz", **arrays)  # type: ignore[arg-type]
    (folder / "build_scene.py").write_text(ENTRY, encoding="utf-8", newline="\n")
    (folder / "scene_builder").mkdir()
    for module in files("recon_exporters").joinpath("_blender").iterdir():
        if module.name.endswith(".py"):
            (folder / "scene_builder" / module.name).write_bytes(module.read_bytes())
    if program:
        run_builder(program, folder)
    else:
        (folder / "HOW_TO_OPEN.txt").write_text(HOW_TO_OPEN, encoding="utf-8", newline="\n")
    return sorted(path for path in folder.rglob("*") if path.is_file())


def find_blender(wanted: str) -> list[str]:
    """The command that runs a script in Blender; empty where there is no Blender, or none is wanted.

    Raises PluginError where the program that is named is not there.
    """
    if wanted == "none":
        return []
    found = shutil.which(wanted or "blender")
    if found is None and wanted:
        raise PluginError(f"exporter.blender: there is no program '{wanted}'", "name Blender or a Python that has bpy")
    if found is None:
        return [sys.executable] if find_spec("bpy") is not None else []
    if Path(found).stem.lower().startswith("python"):
        return [found]
    return [found, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]


def own_environment(program: list[str]) -> dict[str, str]:
    """The variables with which Blender finds its own Python and packages, and no other's.

    A Blender that a Linux distribution built, unlike those of blender.org, asks PYTHONHOME and PYTHONPATH, and takes
    the first python3.x on the PATH for its own, with its packages: pyenv's, or that of an active virtual environment.
    The Python that runs this keeps what it was started with.
    """
    quiet = {"PYTHONDONTWRITEBYTECODE": "1"}
    if program[0] == sys.executable:
        return {**os.environ, **quiet}
    others = {name: value for name, value in os.environ.items() if not name.upper().startswith("PYTHON")}
    beside = str(Path(program[0]).resolve().parent)
    return {**others, "PATH": os.pathsep.join((beside, os.environ.get("PATH", os.defpath))), **quiet}


def run_builder(program: list[str], folder: Path) -> None:
    """Make the scene. Raises PluginError with Blender's last word where it fails."""
    command, own = [*program, str((folder / "build_scene.py").resolve())], own_environment(program)
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=own, check=False)
    if done.returncode or not (folder / "scene.blend").is_file():
        said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        last = next((line for line in reversed(said) if "Error" in line), said[-1] if said else "it said nothing")
        raise PluginError(f"exporter.blender: Blender failed: {last.strip()}", f"the command was {' '.join(command)}")


def _ghost(name: str, streams: Mapping[str, pa.Table]) -> pa.Table | None:
    """The trajectory of the second vehicle. Raises DataError where it is not there, ReadFailed where it is broken."""
    if not name:
        return None
    if name in streams:
        return streams[name]
    if not Path(name).is_dir():
        raise DataError(f"ghost: '{name}' is neither a stream nor a folder", f"streams are {', '.join(streams)}")
    other = read_recording(Path(name))
    if "trajectory" not in other:
        raise DataError(f"ghost: the run in '{name}' has no trajectory")
    return other["trajectory"]


def _look(trajectory: pa.Table, events: pa.Table | None, params: BlenderParams) -> Json:
    """What the builder is to show and to render; the picture's frame among it."""
    t_ns = motion_of(trajectory).t_ns
    crashes = spans(events, "crash")
    film = film_of(t_ns, crashes, params)
    shown = t_ns[film.shows(t_ns)]
    moments: list[Any] = [begin for begin, _ in crashes if film.shows(np.array([begin]))[0]]
    moment = moments[0] if moments else int(shown[len(shown) // 2])
    if params.still is not None:
        moment = film.start_ns + round(params.still * 1e9)
    return {
        "camera": params.camera,
        "video": _video(params),
        "render": params.render,
        "still": float(film.frame_of(np.array([moment]))[0]),
        "resolution": list(params.resolution),
        "samples": params.samples,
        "solver": _handover(film, [end for begin, end in crashes if begin in moments], params),
        "vehicle": str(Path(params.vehicle).resolve()) if params.vehicle else "",
    }


def _video(params: BlenderParams) -> Json | None:
    """The video, and when it begins. Raises DataError where it is not there."""
    if not params.video:
        return None
    if not Path(params.video).is_file():
        raise DataError(f"video: there is no file '{params.video}'")
    return {"file": str(Path(params.video).resolve()), "start": params.video_start}


def _handover(film: Film, ends: list[int], params: BlenderParams) -> Json | None:
    """When the solver takes over, and with what; `pace` is how fast its time runs, as (frame, share) pairs.

    Raises NothingToExport where it should and no crash is in the film.
    """
    if not params.solver:
        return None
    if not ends:
        text = "solver: no event of kind 'crash' begins in the film"
        raise NothingToExport(text, "detector.crash and detector.shock find them")
    share = params.fps * np.diff(film.seconds) / np.diff(film.frames)
    pace = np.column_stack((np.column_stack((film.frames[:-1], film.frames[1:] - STEP)).ravel(), np.repeat(share, 2)))
    return {
        "frame": math.ceil(film.frame_of(np.array(ends[:1]))[0]),
        "mass": params.mass,
        "restitution": params.restitution,
        "friction": params.friction,
        "pace": pace.tolist(),
    }


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of Blender scenes."""
    yield Exporter(
        name="blender",
        summary="The drive as an animated Blender scene: car, path coloured by speed, cameras, events, doubt.",
        params=BlenderParams,
        run=blender,
        reads={
            "trajectory": TRAJECTORY.need("pos", "vel", "q", maybe=("pos_std",)),
            "gnss": GNSS.need("time", maybe=("lat", "lon", "height"), optional=True),
            "events": EVENTS.need("end_time", "kind", "value", "unit", optional=True),
        },
        every_stream=True,
        repeats=False,  # Blender writes addresses of its memory
        references=("Rajamani (2012), 2.2", "Shepard (1968)"),
    )
