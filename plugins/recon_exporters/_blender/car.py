"""A passenger car of primitives, its wheels turning and steering; or whatever a .blend of the user's own holds.

The origin is on the ground below the middle of the car; x forward, y left, z up (ISO 8855). Lengths in m.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .keyframes import animate, move
from .materials import from_hex, glowing, grid_faces, mesh, solid, thing, translucent

# x of the station; half of the width; heights of sill, waist, shoulder and top
BODY = np.array(
    [
        (-2.16, 0.66, 0.40, 0.58, 0.80, 0.90),
        (-2.08, 0.80, 0.27, 0.57, 0.87, 0.98),
        (-1.45, 0.87, 0.21, 0.55, 0.90, 1.00),
        (-0.20, 0.88, 0.19, 0.52, 0.88, 0.96),
        (0.90, 0.87, 0.19, 0.52, 0.85, 0.94),
        (1.50, 0.85, 0.21, 0.50, 0.79, 0.87),
        (2.00, 0.78, 0.26, 0.47, 0.69, 0.75),
        (2.14, 0.62, 0.36, 0.47, 0.60, 0.64),
    ]
)
# z of the ring; x of its rear and front end; half of the width
CABIN = ((0.86, -1.80, 1.05, 0.77), (1.38, -1.18, 0.16, 0.60), (1.46, -1.02, -0.02, 0.50))
BOX = 0.5 * np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
BOX_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRACK = 1.61
WHEEL_WIDTH = 0.22
SPOKES = 5
PAINT = "#0072B2"
GHOST = "#E69F00"


def vehicle(collection: Any, plan: Any, arrays: Any, own: Any) -> Any:
    """The animated empty "vehicle" with the car as its children.

    own : an object, or the path of a .blend; "" for the car made here
    """
    frames = arrays["frame"]
    root = thing(collection, "vehicle", None)
    root.empty_display_type = "ARROWS"
    root["speed"] = 0.0
    move(root, frames, arrays["position"], arrays["q"], [('["speed"]', 0, arrays["speed"])])
    if own and isinstance(own, str):
        _append(collection, root, own)
    elif own:
        _show_again(collection, root, own)
    else:
        _shell(collection, root, solid("paint", from_hex(PAINT), roughness=0.25, metallic=0.3))
        _wheels(collection, root, plan, arrays)
    return root


def ghost(collection: Any, arrays: Any) -> None:
    """A second car, translucent, without wheels that turn."""
    root = thing(collection, "ghost", None)
    move(root, arrays["ghost_frame"], arrays["ghost_position"], arrays["ghost_q"])
    clear = translucent("ghost", from_hex(GHOST), 0.4)
    _body(collection, root, "ghost body", [clear])
    _cabin(collection, root, "ghost cabin", clear, clear)


def _append(collection: Any, root: Any, path: str) -> None:
    """All objects of another file below the vehicle, as they stand about the origin; forward is their x."""
    with bpy.data.libraries.load(path) as (there, here):
        here.objects = there.objects
    for part in here.objects:
        collection.objects.link(part)
        if part.parent is None:
            part.parent = root


def _show_again(collection: Any, root: Any, own: Any) -> None:
    """An object with all below it, as it stands on z = 0, once more: itself it stays in its scene as it is."""
    parts = bpy.data.collections.new(own.name)
    for part in (own, *own.children_recursive):
        parts.objects.link(part)
    parts.instance_offset = (*own.matrix_world.translation[:2], 0.0)
    again = thing(collection, own.name, None, root)
    again.instance_type, again.instance_collection = "COLLECTION", parts


def _shell(collection: Any, root: Any, paint: Any) -> None:
    """Everything of the car but its wheels."""
    dark = solid("dark", from_hex("#15171a"), roughness=0.7)
    glass = solid("glass", from_hex("#10161c"), roughness=0.08, metallic=0.2)
    _body(collection, root, "body", [paint])
    _cabin(collection, root, "cabin", glass, paint)
    _pillars(collection, root, paint)
    lamps = {"headlamp": ("#fff6e0", 2.06, 0.58, 0.60), "tail lamp": ("#c01818", -2.12, 0.60, 0.80)}
    for name, (color, x, y, z) in lamps.items():
        for side in (-1.0, 1.0):
            _box(collection, root, name, (x, side * y, z), (0.10, 0.26, 0.10), glowing(name, from_hex(color)))
    _box(collection, root, "grille", (2.13, 0.0, 0.50), (0.06, 0.9, 0.12), dark)
    for x in (-1.0, 1.0):
        _box(collection, root, "bumper", (x * 2.10, 0.0, 0.36), (0.12, 1.36, 0.10), dark)
    for side in (-1.0, 1.0):
        _box(collection, root, "mirror", (0.62, side * 0.88, 0.98), (0.12, 0.16, 0.12), paint)


def _body(collection: Any, root: Any, name: str, materials: Any) -> None:
    """The lower body: rings of eight points across, from the rear to the front, smoothed."""
    x, wide, sill, waist, shoulder, top = BODY.T
    wide, sill = 1.06 * wide, sill - 0.05  # smoothing draws it in
    half = [(0.86 * wide, sill), (wide, waist), (0.95 * wide, shoulder), (0.72 * wide, top)]
    ring = [*half, *((-y, z) for y, z in reversed(half))]
    points = np.stack([np.column_stack((x, y, z)) for y, z in ring], axis=1)
    count = points.shape[1]
    last = (len(points) - 1) * count
    ends = [tuple(range(count))[::-1], tuple(range(last, last + count))]
    faces = [*map(tuple, grid_faces(len(points), count, closed=True).tolist()), *ends]
    _soft(thing(collection, name, mesh(name, points.reshape(-1, 3), faces, materials, smooth=True), root))


def _cabin(collection: Any, root: Any, name: str, glass: Any, roof: Any) -> None:
    """Windows all around with a roof on them."""
    points = [
        (x, y, z)
        for z, rear, front, half in CABIN
        for x, y in ((rear, -half), (front, -half), (front, half), (rear, half))
    ]
    faces = [*map(tuple, grid_faces(3, 4, closed=True).tolist()), (8, 9, 10, 11)]
    data = mesh(name, points, faces, [glass, roof], which=[0] * 4 + [1] * 5)
    made = thing(collection, name, data, root)
    bevel = made.modifiers.new("bevel", "BEVEL")
    bevel.width, bevel.segments = 0.03, 3


def _pillars(collection: Any, root: Any, paint: Any) -> None:
    """Bars in the colour of the body over the edges of the windows, and one between the doors."""
    (low, rear, front, half), (high, rear_up, front_up, half_up) = CABIN[0], CABIN[1]
    bars = bpy.data.curves.new("pillars", "CURVE")
    bars.dimensions, bars.bevel_depth = "3D", 0.028
    bars.use_fill_caps = True
    bars.materials.append(paint)
    for side in (-1.0, 1.0):
        for x, x_up in ((rear, rear_up), (front, front_up), (-0.35, -0.40)):
            bar = bars.splines.new("POLY")
            bar.points.add(1)
            bar.points.foreach_set("co", [x, side * half, low, 1.0, x_up, side * half_up, high, 1.0])
    thing(collection, "pillars", bars, root)


def _wheels(collection: Any, root: Any, plan: Any, arrays: Any) -> None:
    """Four wheels that roll; those in front hang on empties that steer."""
    radius, frames = plan["wheel_radius"], arrays["frame"]
    data = _wheel(radius)
    arch = solid("arch", from_hex("#0b0c0d"), roughness=0.9)
    for place, x in (("front", 0.5 * plan["wheelbase"]), ("rear", -0.5 * plan["wheelbase"])):
        for hand, side in (("left", 1.0), ("right", -1.0)):
            hub = thing(collection, f"hub {place} {hand}", None, root)
            hub.location = (x, side * 0.5 * TRACK, radius)
            hub.empty_display_size = 0.2
            if place == "front":
                animate(hub, "OBJECT", frames, [("rotation_euler", 2, arrays["steering"])])
            wheel = thing(collection, f"wheel {place} {hand}", data, hub)
            animate(wheel, "OBJECT", frames, [("rotation_euler", 1, arrays["wheel_angle"])])
            well = mesh("arch", *_cylinder(radius + 0.05, 0.36), [arch])
            thing(collection, f"arch {place} {hand}", well, root).location = (x, side * 0.725, radius + 0.01)


def _wheel(radius: float) -> Any:
    """A tyre with a rim of spokes on both sides, about its own middle; it rolls about y."""
    tyre = solid("tyre", from_hex("#17181a"), roughness=0.85)
    rim = solid("rim", from_hex("#c4c8cc"), roughness=0.3, metallic=0.8)
    length = 0.68 * radius
    bar = BOX * (0.06, 1.04 * WHEEL_WIDTH, length) + (0.0, 0.0, 0.5 * length)
    turns = np.arange(SPOKES) * 2.0 * np.pi / SPOKES
    spokes = [_turned(bar, turn) for turn in turns]
    points, faces = _cylinder(radius, WHEEL_WIDTH)
    hoops = [points, *spokes]
    starts = np.cumsum([0, *(len(part) for part in hoops[:-1])])
    every = [tuple(corner + start for corner in face) for start in starts[1:].tolist() for face in BOX_FACES]
    which = [0] * len(faces) + [1] * len(every)
    return mesh("wheel", np.concatenate(hoops), [*faces, *every], [tyre, rim], which=which)


def _turned(points: Any, angle: float) -> Any:
    """Points (n, 3) turned about y."""
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([(cos, 0.0, -sin), (0.0, 1.0, 0.0), (sin, 0.0, cos)])


def _cylinder(radius: float, width: float, sides: int = 40) -> tuple[Any, list[tuple[int, ...]]]:
    """Vertices (2 sides, 3) and faces of a cylinder about y."""
    angle = np.arange(sides) * 2.0 * np.pi / sides
    rim = np.column_stack((radius * np.sin(angle), np.zeros(sides), radius * np.cos(angle)))
    half = np.array([0.0, 0.5 * width, 0.0])
    points = np.concatenate((rim - half, rim + half))
    caps = [tuple(range(sides))[::-1], tuple(range(sides, 2 * sides))]
    return points, [*map(tuple, grid_faces(2, sides, closed=True).tolist()), *caps]


def _box(collection: Any, root: Any, name: str, place: Any, size: Any, material: Any) -> None:
    made = thing(collection, name, mesh(name, BOX * size, BOX_FACES, [material]), root)
    made.location = place
    bevel = made.modifiers.new("bevel", "BEVEL")
    bevel.width, bevel.segments = 0.2 * min(size), 2


def _soft(made: Any) -> None:
    smooth = made.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 2
