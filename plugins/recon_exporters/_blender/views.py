"""Cameras, and what they show beside the scene: speed, time, and what the colours of the path mean.

follow     behind and above the vehicle, on a path of its own     top        60 m of ground from above, north up
driver     at the windscreen                                      overview   the whole path from above, north up
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from .keyframes import animate, move
from .materials import from_hex, glowing, mesh, thing, translucent
from .scenery import CLASSES, speed_colors

SENSOR = 36.0
"""mm, the width of the film of every camera."""
ABOVE = 400.0
"""m by which the camera on top is above the highest point, and the chart still higher."""
TOP_WIDTH = 60.0
"""m that the camera on top shows from left to right."""
FAR = 50_000.0
"""m that a camera sees."""
NEAR = {"follow": 1.0, "driver": 0.3, "top": 2.0}
"""m from a camera to its display: before all that it sees, the driver's inside of the car, and large enough that
letters keep their shape kilometres from the origin, where single precision leaves 0.5 mm."""
PLATE = (0.235, 0.13)
"""Width and height of what the display stands on, in widths of the picture."""


@dataclass(frozen=True)
class View:
    """A camera, and how wide its picture is, in m, at `near` m before it."""

    thing: Any
    near: float
    width: float


def cameras(scene: Any, collection: Any, vehicle: Any, arrays: Any, resolution: Any) -> dict[str, View]:
    """The four cameras by name."""
    scene.render.resolution_x, scene.render.resolution_y = resolution
    made = {
        "follow": _perspective(collection, "follow", 32.0),
        "driver": _perspective(collection, "driver", 20.0),
        "top": _perspective(collection, "top", SENSOR * ABOVE / TOP_WIDTH),
    }
    _follow(collection, made["follow"].thing, vehicle, arrays)
    driver = made["driver"].thing
    driver.parent = vehicle
    driver.location = (0.62, 0.32, 1.28)
    driver.rotation_euler = (np.radians(87.0), 0.0, np.radians(-90.0))
    top, place = made["top"].thing, arrays["position"]
    animate(top, "OBJECT", arrays["frame"], [("location", axis, place[:, axis]) for axis in (0, 1)])
    top.location.z = float(place[:, 2].max()) + ABOVE
    return {**made, "overview": _overview(collection, place, resolution)}


def _perspective(collection: Any, name: str, lens: float) -> View:
    camera, near = bpy.data.cameras.new(name), NEAR[name]
    camera.sensor_fit, camera.sensor_width, camera.lens = "HORIZONTAL", SENSOR, lens
    camera.clip_start, camera.clip_end = 0.2 * near, FAR
    return View(thing(collection, f"camera {name}", camera), near, near * SENSOR / lens)


def _follow(collection: Any, camera: Any, vehicle: Any, arrays: Any) -> None:
    move(camera, arrays["frame"], arrays["follow"])
    aim = thing(collection, "aim", None, vehicle)
    aim.location, aim.empty_display_size = (1.0, 0.0, 0.9), 0.2
    track = camera.constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis = aim, "TRACK_NEGATIVE_Z", "UP_Y"


def _overview(collection: Any, place: Any, resolution: Any) -> View:
    """The camera above all of a path (n, 3) m."""
    low, high = place.min(axis=0), place.max(axis=0)
    across = max(float(high[0] - low[0]), float(high[1] - low[1]) * resolution[0] / resolution[1])
    width = 1.25 * across + 20.0
    camera = bpy.data.cameras.new("overview")
    camera.type, camera.sensor_fit, camera.ortho_scale = "ORTHO", "HORIZONTAL", width
    up = 2.0 * (ABOVE + width)
    camera.clip_end = up + FAR
    overview = thing(collection, "camera overview", camera)
    overview.location = (*(0.5 * (low + high))[:2], float(high[2]) + up)
    return View(overview, 1.0, width)


def chart(collection: Any, overview: View, vehicle: Any, way: Any) -> None:
    """The path and the vehicle as the overview draws them: a broad line and a dot."""
    height = overview.thing.location.z - 2.0
    dot = thing(collection, "chart vehicle", _disc(0.010 * overview.width, glowing("chart vehicle", (0.0, 0.0, 0.0))))
    dot.location.z = height + 0.5
    stay = dot.constraints.new("COPY_LOCATION")
    stay.target, stay.use_z = vehicle, False
    parts = [dot]
    if way is not None:
        line = way.data.copy()
        line.extrude = 0.004 * overview.width
        parts.append(thing(collection, "chart path", line))
        parts[-1].location.z = height
        parts[-1].scale.z = 0.0
    for part in parts:
        no_light(part)


def _disc(radius: float, material: Any) -> Any:
    angle = np.arange(24) * 2.0 * np.pi / 24.0
    points = radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(24)))
    return mesh("disc", points, [tuple(range(24))], [material])


def no_light(part: Any) -> None:
    """Neither shadow nor reflection: it is drawn on the picture, not part of the scene."""
    part.visible_shadow = part.visible_diffuse = part.visible_glossy = False


def display(collection: Any, views: Any, arrays: Any, top_speed: float, resolution: Any) -> dict[str, Any]:
    """Speed, time and the scale of colours in the lower left corner of every picture; lengths in widths of it.

    returns : by camera the empty in that corner, which scales what hangs on it
    """
    corners = {}
    numbers = _numbers(arrays)
    scale, plate = _scale(), _plate()
    white = glowing("display", (1.0, 1.0, 1.0))
    bottom = -0.5 * resolution[1] / resolution[0]
    for name, view in views.items():
        corner = thing(collection, f"display {name}", None, view.thing)
        corner.location = (-0.48 * view.width, (bottom + 0.02) * view.width, -view.near)
        corner.scale = (view.width, view.width, view.width)
        corner.empty_display_size = 0.01
        corners[name] = corner
        shown = thing(collection, f"numbers {name}", bpy.data.meshes.new("numbers"), corner)
        shown.modifiers.new("numbers", "NODES").node_group = numbers
        shown.location = (0.012, 0.062, 0.0)
        parts = [shown]
        for data, place in ((plate, (0.0, 0.0, -0.002)), (scale, (0.012, 0.030, 0.0))):
            part = thing(collection, f"{data.name} {name}", data, corner)
            part.location = place
            parts.append(part)
        for text, x in (("0", 0.012), (f"{3.6 * top_speed:.0f} km/h", 0.152)):
            label = thing(collection, f"label {name}", letters(text, white, 0.016), corner)
            label.location = (x, 0.012, 0.0)
            parts.append(label)
        for part in parts:
            no_light(part)
    return corners


def letters(body: str, material: Any, size: float) -> Any:
    """A text, as high as `size`."""
    text = bpy.data.curves.new("label", "FONT")
    text.body, text.size = body, size
    text.materials.append(material)
    return text


def _plate() -> Any:
    wide, high = PLATE
    corners = [(0.0, 0.0, 0.0), (wide, 0.0, 0.0), (wide, high, 0.0), (0.0, high, 0.0)]
    return mesh("plate", corners, [(0, 1, 2, 3)], [translucent("plate", from_hex("#101418"), 0.72)])


def _scale() -> Any:
    """The classes of speed, slow to fast, as squares in a row."""
    x = np.linspace(0.0, 0.21, CLASSES + 1)
    points = [(a, b, 0.0) for b in (0.0, 0.014) for a in x.tolist()]
    step = CLASSES + 1
    faces = [(i, i + 1, i + 1 + step, i + step) for i in range(CLASSES)]
    colors = [glowing(f"scale {index}", color) for index, color in enumerate(speed_colors())]
    return mesh("scale", points, faces, colors, which=range(CLASSES))


def _numbers(arrays: Any) -> Any:
    """Nodes that write speed and time; their values are animated, so that no script has to run in the file."""
    tree = bpy.data.node_groups.new("numbers", "GeometryNodeTree")
    if bpy.app.version < (4, 0, 0):
        tree.outputs.new("NodeSocketGeometry", "Geometry")
    else:
        tree.interface.new_socket(name="Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    white = glowing("numbers", (1.0, 1.0, 1.0))
    join = tree.nodes.new("GeometryNodeJoinGeometry")
    for name, decimals, unit, size, up in (("speed", 0, " km/h", 0.040, 0.024), ("time", 2, " s", 0.020, -0.006)):
        tree.links.new(_written(tree, name, decimals, unit, size, up), join.inputs[0])
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = white
    tree.links.new(join.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    values = {"speed": 3.6 * arrays["speed"], "time": arrays["elapsed"]}
    curves = [(f'nodes["{name}"].outputs[0].default_value', 0, value) for name, value in values.items()]
    animate(tree, "NODETREE", arrays["frame"], curves)
    return tree


def _written(tree: Any, name: str, decimals: int, unit: str, size: float, up: float) -> Any:
    """Socket of the letters of an animated value with its unit."""
    texts = ("ShaderNodeValue", "FunctionNodeValueToString", "GeometryNodeStringJoin", "FunctionNodeInputString")
    value, digits, joined, suffix = (tree.nodes.new(kind) for kind in texts)
    kinds = ("GeometryNodeStringToCurves", "GeometryNodeRealizeInstances", "GeometryNodeFillCurve")
    letters, whole, filled = (tree.nodes.new(kind) for kind in kinds)
    moved = tree.nodes.new("GeometryNodeTransform")
    value.name, suffix.string = name, unit
    digits.inputs["Decimals"].default_value = decimals
    letters.inputs["Size"].default_value = size
    moved.inputs["Translation"].default_value = (0.0, up, 0.0)
    tree.links.new(value.outputs[0], digits.inputs["Value"])
    tree.links.new(suffix.outputs[0], joined.inputs["Strings"])  # the last that is linked comes first
    tree.links.new(digits.outputs[0], joined.inputs["Strings"])
    tree.links.new(joined.outputs[0], letters.inputs["String"])
    for one, other in ((letters, whole), (whole, filled), (filled, moved)):
        tree.links.new(one.outputs[0], other.inputs[0])
    return moved.outputs[0]
