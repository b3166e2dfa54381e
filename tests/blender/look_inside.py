"""Run by a Python that has bpy, or by Blender: what a scene holds, as numbers, and pictures of it.

look_inside.py FOLDER FRAME...      writes FOLDER/found.json, FOLDER/found.npz and FOLDER/seen_<frame>.png
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np


def curves_of(block):
    action, data = block.animation_data.action, block.animation_data
    if bpy.app.version < (4, 4, 0):
        return action.fcurves
    return action.layers[0].strips[0].channelbag(data.action_slot).fcurves


def keys_of(block):
    """Frames and values of every curve, by "<block> <path> <index>"."""
    found = {}
    for curve in curves_of(block):
        flat = np.zeros(2 * len(curve.keyframe_points), dtype=np.float32)
        curve.keyframe_points.foreach_get("co", flat)
        found[f"{block.name} {curve.data_path} {curve.array_index}"] = flat.reshape(-1, 2)
    return found


def letters(name):
    """Points of the letters that an object's nodes write at this frame: (n, 3)."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = bpy.data.objects[name].evaluated_get(depsgraph).to_mesh()
    return [list(vertex.co) for vertex in mesh.vertices]


def main(folder, frames):
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    scene = bpy.context.scene
    animated = [thing for thing in bpy.data.objects if thing.animation_data]
    keys = {
        name: values
        for block in [*animated, bpy.data.node_groups["numbers"]]
        for name, values in keys_of(block).items()
    }
    overview, world = bpy.data.objects["camera overview"], scene.rigidbody_world
    moments = {}
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    for frame in frames:
        scene.frame_set(frame)
        moments[frame] = {
            "vehicle": [list(row) for row in bpy.data.objects["vehicle"].matrix_world],
            "wheel": list(bpy.data.objects["wheel rear left"].rotation_euler)
            if "wheel rear left" in bpy.data.objects
            else [],
            "letters": letters("numbers follow"),
        }
        scene.render.filepath = str(folder / f"seen_{frame}.png")
        bpy.ops.render.render(write_still=True)
    facts = {
        "version": list(bpy.app.version),
        "fps": scene.render.fps,
        "frames": [scene.frame_start, scene.frame_end],
        "camera": scene.camera.name,
        "overview": [overview.data.clip_end, overview.location.z],
        "objects": sorted(thing.name for thing in bpy.data.objects),
        "bake": [world.point_cache.frame_start, world.point_cache.frame_end] if world else [],
        "markers": [[mark.name, mark.frame] for mark in scene.timeline_markers],
        "properties": {
            name: getattr(value, "to_list", lambda value=value: value)()
            for name, value in scene.items()
            if name != "cycles"
        },
        "moments": moments,
    }
    (folder / "found.json").write_text(json.dumps(facts, default=str), encoding="utf-8")
    np.savez(folder / "found.npz", **keys)


if __name__ == "__main__":
    *_, place, shown = sys.argv
    main(Path(place), [int(frame) for frame in shown.split(",")])
