"""After a crash the body goes on as a free rigid body: Blender's solver moves it, no longer the log.

What it then does rests on a mass, a restitution and a friction that somebody assumed, on a level ground, and on a box
in place of the car. Display, wheels and the camera behind keep to the log.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .keyframes import animate, move
from .materials import mesh, thing

SIZE = np.array([4.3, 1.75, 1.1])
"""m; the middle of the box is its centre of mass."""
FLOOR = 2000.0
"""m"""
TAKEN = 3
"""Frames before the handover with which the solver begins: it takes the speed from them."""
SIMULATED = 30.0
"""s for which it moves the vehicle, which lies as it is from then on."""


def hand_over(scene: Any, collection: Any, vehicle: Any, arrays: Any, given: Any) -> None:
    """Let the solver have the vehicle from the frame given; the result is baked into the file."""
    lift = 0.5 * SIZE[2]
    frames, q = arrays["frame"], arrays["q"]
    w, x, y, z = q.T
    up = np.column_stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)))
    middle = arrays["position"] + lift * up
    body = _box(collection, "crash body", SIZE)
    move(body, frames, middle, q)
    vehicle.animation_data_clear()
    vehicle.parent, vehicle.location, vehicle.rotation_quaternion = body, (0.0, 0.0, -lift), (1.0, 0.0, 0.0, 0.0)
    floor = _box(collection, "crash floor", np.array([FLOOR, FLOOR, 1.0]))
    row = min(int(np.searchsorted(frames, given["frame"])), len(frames) - 1)
    heights = 2.0 * (x * z - w * y)[row], 2.0 * (y * z + w * x)[row], up[row, 2]
    reach = 0.5 * float(np.abs(SIZE * heights).sum())  # from the middle down to the lowest corner
    floor.location = middle[row] - np.array([0.0, 0.0, reach + 0.5])
    last = float(np.interp(arrays["elapsed"][row] + SIMULATED, arrays["elapsed"], frames))
    _simulate(scene, body, floor, given, int(np.ceil(last)))


def _box(collection: Any, name: str, size: Any) -> Any:
    """A box that is simulated and never seen."""
    corners = 0.5 * size * np.array([(a, b, c) for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    made = thing(collection, name, mesh(name, corners, faces, []))
    made.display_type, made.hide_render = "WIRE", True
    return made


def _simulate(scene: Any, body: Any, floor: Any, given: Any, last: int) -> None:
    bpy.ops.rigidbody.world_add()
    world = scene.rigidbody_world
    if world.collection is None:
        world.collection = bpy.data.collections.new("crash")
    world.use_split_impulse = True  # a box that touches is not thrown off
    # The solver multiplies what the two bodies have: the floor's share is 1.
    for part, kind, share in ((body, "ACTIVE", given), (floor, "PASSIVE", {"friction": 1.0, "restitution": 1.0})):
        world.collection.objects.link(part)
        part.rigid_body.type = kind
        part.rigid_body.friction, part.rigid_body.restitution = share["friction"], share["restitution"]
        part.rigid_body.collision_margin = 0.0
    body.rigid_body.mass, body.rigid_body.linear_damping = given["mass"], 0.0
    for frame, kinematic in ((1, True), (given["frame"], False)):
        body.rigid_body.kinematic = kinematic
        body.rigid_body.keyframe_insert("kinematic", frame=frame)
    frames, pace = np.array(given["pace"]).T
    animate(scene, "SCENE", frames, [("rigidbody_world.time_scale", 0, pace)])
    cache = world.point_cache
    cache.frame_start, cache.frame_end = max(scene.frame_start, given["frame"] - TAKEN), min(scene.frame_end, last)
    with bpy.context.temp_override(scene=scene, point_cache=cache):
        bpy.ops.ptcache.bake(bake=True)
