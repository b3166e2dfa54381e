"""Builds a Blender scene from the plan of a drive, `scene.json` and `scene.npz` in one folder.

Runs inside of Blender 3.4 to 5.0 and needs nothing but its bpy and numpy. Everything is written by data, never by
operators that depend on a window, so that it runs without a screen. All objects lie in the collection "recon".
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from . import car, crash, keyframes, notices, rendering, scenery, video, views

__all__ = ["build", "main"]


def main(folder: Path) -> None:
    """An empty file becomes the scene; `scene.blend` and the pictures asked for are written beside the plan."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = build(folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"), compress=True)
    rendering.render(scene, folder, _read(folder)["look"])


def build(folder: Path, own: Any = None) -> Any:
    """Add the drive to the current scene, which is returned. own : an object that takes the place of the car."""
    plan = _read(folder)
    with np.load(folder / "scene.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    scene, look = bpy.context.scene, plan["look"]
    top_speed = max(float(arrays["speed"].max()), 1.0)
    collection = bpy.data.collections.new("recon")
    scene.collection.children.link(collection)
    _describe(scene, plan)
    vehicle = car.vehicle(collection, plan, arrays, own or look["vehicle"])
    if look["solver"] is not None:  # now: it walks through the scene for each frame, however much is in it
        crash.hand_over(scene, collection, vehicle, arrays, look["solver"])
    if "ghost_frame" in arrays:
        car.ghost(collection, arrays)
    scenery.sky_and_sun(scene, collection)
    scenery.ground(collection, arrays)
    way = scenery.path(collection, arrays, top_speed)
    scenery.fixes(collection, arrays)
    scenery.tube(collection, arrays)
    cameras = views.cameras(scene, collection, vehicle, arrays, look["resolution"])
    views.chart(collection, cameras["overview"], vehicle, way)
    corners = views.display(collection, cameras, arrays, top_speed, look["resolution"])
    notices.captions(collection, corners, plan["captions"])
    notices.force(collection, vehicle, plan["force"])
    scene.camera = cameras[look["camera"]].thing
    for mark in plan["markers"]:
        scene.timeline_markers.new(mark["name"], frame=mark["frame"])
    if look["video"] is not None:
        video.behind(scene, scene.camera, arrays, look["video"])
    rendering.prepare(scene, look)
    keyframes.show_frame(scene, look["still"])
    return scene


def _read(folder: Path) -> Any:
    return json.loads((folder / "scene.json").read_text(encoding="utf-8"))


def _describe(scene: Any, plan: Any) -> None:
    """Length and speed of the film, units, and where on the Earth it is, as properties of the scene."""
    scene.render.fps = plan["fps"]
    scene.frame_start, scene.frame_end = 1, plan["frames"]
    scene.unit_settings.system = "METRIC"
    scene["name"], scene["start"], scene["axes"] = plan["name"], plan["start"], plan["axes"]
    scene["origin"] = plan["origin"]
    if plan["anchor"] is not None:
        for name, value in plan["anchor"].items():
            scene[f"anchor_{name}"] = value
    scene["warnings"] = "\n".join(plan["warnings"])
