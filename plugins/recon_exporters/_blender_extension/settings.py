"""What the panel asks for: an option for each parameter of recon that it offers, a property of Blender for each option.

Whatever is left at its default is not passed on: recon's own defaults count, and a pipeline is not asked about a step
that it does not have.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import bpy

from .running import PACKAGES

props = bpy.props

PIPELINES = {
    "thesis": ("The thesis' method", "A step each, for logs with long stops and straight accelerations"),
    "best_accuracy": ("Best accuracy", "The best trajectory of a whole drive, with sigmas, by GNSS and IMU"),
    "driving": ("Driving", "Best accuracy, and harsh braking, turns and the like as events"),
    "crash": ("Crash", "The time around an impact"),
}


class Option(NamedTuple):
    """A parameter of recon in the panel.

    target : STEP.PARAMETER; make, given : the property, and what it is made with; unit : of its numbers
    path : is it a file or folder?
    """

    target: str
    make: Any
    given: Mapping[str, Any]
    unit: str = ""
    path: bool = False


def _choice(name: str, about: str, *values: str) -> dict[str, Any]:
    items = [(value, value.replace("_", " ").capitalize(), "") for value in values]
    return {"name": name, "description": about, "items": items, "default": values[0]}


def _number(name: str, about: str, default: float, low: float, high: float, **more: Any) -> dict[str, Any]:
    return {"name": name, "description": about, "default": default, "min": low, "max": high, **more}


def _path(name: str, about: str, kind: str) -> dict[str, Any]:
    return {"name": name, "description": about, "default": "", "subtype": kind}


_SMOOTHER: dict[str, Option] = {
    "sensor_class": Option(
        "fuser.map.sensor_class",
        props.EnumProperty,
        _choice("Sensors", "What kind of IMU it is", "consumer_mems", "automotive", "industrial", "tactical"),
    ),
    "wheels": Option(
        "fuser.map.wheels",
        props.BoolProperty,
        {"name": "On wheels", "default": True, "description": "It hardly slips"},
    ),
}
"""Of every pipeline that uses it."""

OPTIONS: dict[str, dict[str, Option]] = {
    "thesis": {
        "window": Option(
            "filter.moving_average.window",
            props.FloatProperty,
            _number("Averaging", "s over which vibration is averaged: more is smoother, a peak lower", 0.05, 0.0, 5.0),
            "s",
        ),
        "weight": Option(
            "fuser.weighted_average.weight",
            props.FloatProperty,
            _number("Weight of GNSS", "At each record, between 0 and 1", 0.01, 0.0, 1.0, precision=3),
        ),
    },
    "best_accuracy": _SMOOTHER,
    "driving": _SMOOTHER,
    "crash": {
        **_SMOOTHER,
        "lever_arm": Option(
            "aligner.lever_arm.lever_arm",
            props.FloatVectorProperty,
            {
                "name": "Centre of gravity (m)",
                "description": "From the box to it: forward, left, up",
                "default": (0.0, 0.0, 0.0),
            },
            "m",
        ),
    },
    "film": {
        "fps": Option(
            "exporter.blender.fps", props.IntProperty, _number("Frames per second", "Of the film", 25, 1, 1000)
        ),
        "start": Option(
            "exporter.blender.start",
            props.FloatProperty,
            _number("From (s)", "Where the film begins, s after the start of the log", 0.0, 0.0, 1e6),
            "s",
        ),
        "end": Option(
            "exporter.blender.end",
            props.FloatProperty,
            _number("To (s)", "Where it ends, s after the start of the log; 0: its end", 0.0, 0.0, 1e6),
            "s",
        ),
        "slow_motion": Option(
            "exporter.blender.slow_motion",
            props.FloatProperty,
            _number("Slow motion", "How many times slower the film runs around a crash", 10.0, 1.0, 1000.0),
        ),
        "slow_span": Option(
            "exporter.blender.slow_span",
            props.FloatProperty,
            _number("Around a crash (s)", "How long before and after a crash it runs slowly", 1.0, 0.0, 3600.0),
            "s",
        ),
        "camera": Option(
            "exporter.blender.camera",
            props.EnumProperty,
            _choice("Camera", "Through which the scene is seen", "follow", "top", "driver", "overview"),
        ),
        "vertical": Option(
            "exporter.blender.vertical",
            props.BoolProperty,
            {"name": "Vertical motion", "default": True, "description": "Does the vehicle rise and sink?"},
        ),
        "video": Option(
            "exporter.blender.video",
            props.StringProperty,
            {
                "name": "Video",
                "default": "",
                "subtype": "FILE_PATH",
                "description": "Shown behind the scene, in step with it",
            },
            path=True,
        ),
        "video_start": Option(
            "exporter.blender.video_start",
            props.FloatProperty,
            _number("Video begins (s)", "s after the start of the log", 0.0, -1e6, 1e6),
            "s",
        ),
    },
    "doubt": {
        "tube": Option(
            "exporter.blender.tube",
            props.FloatProperty,
            _number("Tube (sigma)", "Standard deviations that a tube around the path shows", 0.0, 0.0, 100.0),
        ),
        "ghost": Option(
            "exporter.blender.ghost",
            props.StringProperty,
            {
                "name": "Ghost",
                "default": "",
                "subtype": "DIR_PATH",
                "description": "Folder of another run, as a second vehicle",
            },
            path=True,
        ),
    },
    "solver": {
        "solver": Option(
            "exporter.blender.solver",
            props.BoolProperty,
            {
                "name": "Solver after the crash",
                "default": False,
                "description": "Blender's solver moves the vehicle after the first crash, no longer the log",
            },
        ),
        "mass": Option(
            "exporter.blender.mass", props.FloatProperty, _number("Mass (kg)", "Of the vehicle", 1300.0, 1.0, 1e6), "kg"
        ),
        "restitution": Option(
            "exporter.blender.restitution",
            props.FloatProperty,
            _number("Restitution", "1 loses no energy", 0.2, 0.0, 1.0),
        ),
        "friction": Option(
            "exporter.blender.friction", props.FloatProperty, _number("Friction", "On the ground", 0.7, 0.0, 10.0)
        ),
    },
}
"""By the part of the panel that shows them; the first ones belong to a pipeline."""


FILM = ("film", "doubt", "solver")


def pipelines() -> list[tuple[str, str, str]]:
    """Those that the recon that lies beside has: name, label, description."""
    there = PACKAGES.pipelines()
    return [(name, *words) for name, words in PIPELINES.items() if name in there]


def _properties() -> dict[str, Any]:
    made = {
        "log": props.StringProperty(name="Log", subtype="FILE_PATH", description="What the box in the vehicle wrote"),
        "pipeline": props.EnumProperty(name="Method", items=pipelines(), description="How it is reconstructed"),
        "folder": props.StringProperty(
            name="Result", subtype="DIR_PATH", description="Its folder; empty: beside the log"
        ),
        "more": props.StringProperty(name="More", description="Further parameters: STEP.NAME=VALUE STEP.NAME=VALUE"),
        "own": props.PointerProperty(
            name="Own vehicle", type=bpy.types.Object, description="Shown in place of the car: nose along x, on z = 0"
        ),
        "result": props.StringProperty(
            name="Folder", subtype="DIR_PATH", description="Of a run that recon made before"
        ),
        "status": props.StringProperty(options={"SKIP_SAVE"}),
        "progress": props.FloatProperty(min=0.0, max=1.0, options={"SKIP_SAVE"}),
        "running": props.BoolProperty(options={"SKIP_SAVE"}),
        "cancelled": props.BoolProperty(options={"SKIP_SAVE"}),
    }
    for options in OPTIONS.values():
        made.update((name, option.make(**option.given)) for name, option in options.items())
    return made


class Settings(bpy.types.PropertyGroup):
    """What the panel asks for, and how far the work is."""

    __annotations__ = _properties()


def run_words(given: Settings) -> list[str]:
    """`recon` with these words reconstructs the log."""
    log, out = absolute(given.log), result_of(given)
    chosen = words_of(given, given.pipeline, *FILM) + more_words(given)
    return ["run", given.pipeline, str(log), "--out", str(out), "--overwrite", "--export", "blender", *chosen]


def more_words(given: Settings) -> list[str]:
    """`--set` for each of the further parameters. Raises ValueError where a quotation mark is not closed."""
    return _set(shlex.split(given.more))


def export_words(given: Settings) -> list[str]:
    """`recon` with these words makes the scene of an older result."""
    return ["export", str(absolute(given.result)), "blender", *words_of(given, *FILM)]


def result_of(given: Settings) -> Path:
    """Folder of the result."""
    log = absolute(given.log)
    return absolute(given.folder) if given.folder else log.with_name(f"{log.stem}-{given.pipeline}")


def words_of(given: Settings, *parts: str) -> list[str]:
    """`--set` for each option of these parts that is not at its default."""
    found = []
    for part in parts:
        for name, option in OPTIONS[part].items():
            value = getattr(given, name)
            if _as_text(value) != _as_text(option.given["default"]):
                text = json.dumps(str(absolute(value))) if option.path else _as_text(value, option.unit)
                found.append(f"{option.target}={text}")
    return _set([*found, "exporter.blender.blender=none"])


def absolute(path: str) -> Path:
    """A path of Blender's, where // is the folder of the open file."""
    return Path(bpy.path.abspath(path)).resolve()


def _set(assignments: list[str]) -> list[str]:
    return [word for assignment in assignments for word in ("--set", assignment)]


def _as_text(value: Any, unit: str = "") -> str:
    """Blender keeps floats in single precision: six digits are what was typed."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float | int):
        return f"{value:.6g} {unit}".rstrip()
    return value if isinstance(value, str) else f"[{', '.join(_as_text(part, unit) for part in value)}]"
