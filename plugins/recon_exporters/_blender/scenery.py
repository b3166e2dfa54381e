"""What the drive leads through: light, ground, the path coloured by speed, the tube of doubt, GNSS fixes."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import bpy
import numpy as np

from .materials import checkered, from_hex, glowing, grid_faces, mesh, solid, thing, translucent

SCALE = ("#3b528b", "#21918c", "#5ec962", "#fde725")
"""From slow to fast: viridis without its darkest quarter; it rises in lightness for every eye."""
CLASSES = 16
"""Of speed, from 0 to the highest, a colour each."""
FIX = "#E69F00"
DOUBT = "#CC79A7"
PATH_WIDTH = 0.5
"""m"""
LIFT = 0.02
"""m by which what is drawn on the strip lies above it."""


def speed_colors() -> list[tuple[float, float, float]]:
    """Colours of the classes of speed, linear."""
    steps = np.linspace(0.0, len(SCALE) - 1.0, CLASSES)
    channels = np.array([from_hex(color) for color in SCALE]).T
    return list(zip(*(np.interp(steps, range(len(SCALE)), channel).tolist() for channel in channels), strict=True))


def sky_and_sun(scene: Any, collection: Any) -> None:
    """A clear day, the same in every engine: colours are shown as they are."""
    world = bpy.data.worlds.new("day")
    world.use_nodes = True
    sky = next(node for node in world.node_tree.nodes if node.bl_idname == "ShaderNodeBackground")
    sky.inputs["Color"].default_value = (*from_hex("#bcd3e6"), 1.0)
    sky.inputs["Strength"].default_value = 0.75
    scene.world = world
    scene.view_settings.view_transform = "Standard"
    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.angle = 2.6, np.radians(2.0)
    sun = thing(collection, "sun", light)
    sun.rotation_euler = (np.radians(38.0), np.radians(12.0), np.radians(35.0))


def ground(collection: Any, arrays: Any) -> None:
    """The land, and the strip below the path."""
    x, y = np.meshgrid(arrays["ground_x"], arrays["ground_y"])
    vertices = np.column_stack((x.ravel(), y.ravel(), arrays["ground_z"].T.ravel()))
    squares = checkered("ground", from_hex("#8f9a86"), from_hex("#99a48f"), 10.0)
    thing(collection, "ground", mesh("ground", vertices, grid_faces(*x.shape), [squares], smooth=True))
    strip = arrays["strip"]
    if len(strip) > 1:
        grey = solid("strip", from_hex("#6d7075"), roughness=0.95)
        thing(collection, "strip", mesh("strip", strip.reshape(-1, 3), grid_faces(len(strip), 2), [grey]))


def path(collection: Any, arrays: Any, top_speed: float) -> Any:
    """A flat curve with a spline for each run of points of one class of speed; None where nothing moved."""
    place, drawn = arrays["path_position"] + (0.0, 0.0, LIFT), arrays["path_drawn"]
    if len(place) < 2:
        return None
    speed = arrays["speed"][arrays["path_row"]]
    number = np.minimum((speed / top_speed * CLASSES).astype(int), CLASSES - 1)
    curve = bpy.data.curves.new("path", "CURVE")
    curve.dimensions, curve.extrude, curve.twist_mode = "3D", 0.5 * PATH_WIDTH, "Z_UP"
    for index, color in enumerate(speed_colors()):
        curve.materials.append(glowing(f"speed {index}", color))
    same = (np.diff(number[:-1]) == 0) & (drawn[1:-1] == drawn[:-2])
    cuts = [0, *(np.flatnonzero(~same) + 1).tolist(), len(place) - 1]
    for first, last in pairwise(cuts):
        if drawn[first]:
            points = place[first : last + 1]
            spline = curve.splines.new("POLY")
            spline.material_index = int(number[first])
            spline.points.add(len(points) - 1)
            spline.points.foreach_set("co", np.column_stack((points, np.ones(len(points)))).astype(np.float32).ravel())
            spline.points.foreach_set("tilt", np.full(len(points), 0.5 * np.pi, dtype=np.float32))
    return thing(collection, "path", curve)


def fixes(collection: Any, arrays: Any) -> None:
    """Small octahedra, all in one mesh."""
    place = arrays["fixes"]
    if not len(place):
        return
    corners = 0.22 * np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    faces = np.array([face for a, b in ((0, 1), (1, 2), (2, 3), (3, 0)) for face in ((a, b, 4), (b, a, 5))])
    vertices = (place[:, None, :] + corners + (0.0, 0.0, 0.25)).reshape(-1, 3)
    every = (faces + len(corners) * np.arange(len(place))[:, None, None]).reshape(-1, 3)
    thing(collection, "GNSS fixes", mesh("GNSS fixes", vertices, every, [glowing("GNSS fix", from_hex(FIX))]))


def tube(collection: Any, arrays: Any) -> None:
    """The tube of doubt, where the plan has one."""
    if "tube" not in arrays or len(arrays["tube"]) < 2:
        return
    rings = arrays["tube"]
    faces = grid_faces(len(rings), rings.shape[1], closed=True)
    clear = translucent("doubt", from_hex(DOUBT), 0.15)
    made = thing(collection, "doubt", mesh("doubt", rings.reshape(-1, 3), faces, [clear], smooth=True))
    made.visible_shadow = False
