"""Animation written in bulk: a hundred thousand keys take a tenth of a second; one by one they would take minutes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

CONSTANT, LINEAR = 0, 1
"""What is between two keys: the value of the first, or a straight line."""


def animate(target: Any, kind: str, frames: Any, curves: Iterable[tuple[str, int, Any]], between: int = LINEAR) -> None:
    """Give a data block its animation.

    kind : its id_type, "OBJECT" or "NODETREE"; frames : (n,); curves : data path, index, values (n,)
    """
    action = bpy.data.actions.new(target.name)
    data = target.animation_data_create()
    data.action = action
    owner = _curves_of(action, data, target, kind)
    for path, index, values in curves:
        curve = owner.new(path, index=index)
        points = curve.keyframe_points
        points.add(len(frames))
        points.foreach_set("co", np.column_stack((frames, values)).astype(np.float32).ravel())
        points.foreach_set("interpolation", np.full(len(frames), between, dtype=np.int32))
        curve.update()


def _curves_of(action: Any, data: Any, target: Any, kind: str) -> Any:
    """Where the curves of an action are: since 4.4 in the channels of a slot."""
    if bpy.app.version < (4, 4, 0):
        return action.fcurves
    slot = action.slots.new(id_type=kind, name=target.name)
    strip = action.layers.new("motion").strips.new(type="KEYFRAME")
    data.action_slot = slot
    return strip.channelbag(slot, ensure=True).fcurves


def move(thing: Any, frames: Any, position: Any, q: Any = None, more: Iterable[tuple[str, int, Any]] = ()) -> None:
    """Animate place, attitude where there is one, and what else is to move with them.

    frames : (n,); position : (n, 3) m; q : (n, 4) scalar first; more : further curves
    """
    curves = [("location", axis, position[:, axis]) for axis in range(3)]
    if q is not None:
        thing.rotation_mode = "QUATERNION"
        curves += [("rotation_quaternion", axis, q[:, axis]) for axis in range(4)]
    animate(thing, "OBJECT", frames, [*curves, *more])


def show_frame(scene: Any, frame: float) -> None:
    """Go to a frame; the fraction counts."""
    whole = int(np.floor(frame))
    scene.frame_set(whole, subframe=frame - whole)
