"""What a viewer should notice, while it lasts: captions above the display, and an arrow for the force of a crash."""

from __future__ import annotations

from typing import Any

import numpy as np

from .keyframes import CONSTANT, animate
from .materials import from_hex, glowing, grid_faces, mesh, thing, translucent
from .views import PLATE, letters, no_light

FORCE = "#D55E00"
"""As in the drawing of the report."""
HEIGHT, GAP = 0.034, 0.006
"""Of a caption, in widths of the picture, and what is between it and what stands below."""
HALF_LENGTH, HALF_WIDTH = 2.16, 0.90
"""m, the outline that the arrow points at."""
SPACE, SHAFT, HEAD = 0.25, 1.6, 0.7
"""m from the outline to the tip; lengths of the two parts of the arrow."""
THIN, WIDE, SIDES = 0.11, 0.30, 24
"""m, radius of the shaft and of the broad end of the head; corners of both."""
ALOFT = 0.9
"""m above the ground, the tip."""
TILT = np.radians(30.0)
"""The arrow comes down that steeply, or the cameras behind and inside would see its end alone."""


def captions(collection: Any, corners: Any, told: Any) -> None:
    """White letters on a plate of their own, for every camera. corners : the empties of the displays"""
    if not told:
        return
    white, dark = glowing("caption", (1.0, 1.0, 1.0)), translucent("caption plate", from_hex("#7a3300"), 0.85)
    wide, _ = PLATE
    plate = mesh("caption plate", [(0, 0, 0), (wide, 0, 0), (wide, HEIGHT, 0), (0, HEIGHT, 0)], [(0, 1, 2, 3)], [dark])
    texts = {caption["text"]: letters(caption["text"], white, 0.019) for caption in told}
    for name, corner in corners.items():
        for caption in told:
            low = PLATE[1] + GAP + caption["row"] * (HEIGHT + GAP)
            text = thing(collection, f"caption {name}", texts[caption["text"]], corner)
            text.location = (0.012, low + 0.011, 0.0)
            behind = thing(collection, f"caption plate {name}", plate, corner)
            behind.location = (0.0, low, -0.002)
            for part in (text, behind):
                no_light(part)
                _shown(part, caption["spans"])


def force(collection: Any, vehicle: Any, told: Any) -> None:
    """An arrow that moves with the vehicle and points at it from where the force came; none where nobody told it.

    Its direction from above is what is meant: how steep it is says nothing.
    """
    if told is None:
        return
    angle = told["angle"]
    cos, sin = np.cos(angle), np.sin(angle)
    outline = min(HALF_LENGTH / max(abs(cos), 1e-9), HALF_WIDTH / max(abs(sin), 1e-9))
    arrow = thing(collection, "force", mesh("force", *_arrow(), [glowing("force", from_hex(FORCE))]), vehicle)
    arrow.location = ((outline + SPACE) * cos, (outline + SPACE) * sin, ALOFT)
    arrow.rotation_euler = (0.0, -TILT, angle)
    arrow.visible_shadow = False
    _shown(arrow, [told["span"]])


def _arrow() -> tuple[Any, list[tuple[int, ...]]]:
    """Vertices (4 SIDES, 3) and faces of an arrow whose tip is the origin and which comes from +x."""
    turn = np.arange(SIDES) * 2.0 * np.pi / SIDES
    ring = np.column_stack((np.zeros(SIDES), np.cos(turn), np.sin(turn)))
    rings = [(0.0, 0.0), (HEAD, WIDE), (HEAD, THIN), (HEAD + SHAFT, THIN)]
    points = np.concatenate([ring * radius + (x, 0.0, 0.0) for x, radius in rings])
    end = tuple(range(3 * SIDES, 4 * SIDES))
    return points, [*map(tuple, grid_faces(4, SIDES, closed=True).tolist()), end]


def _shown(part: Any, spans: Any) -> None:
    """It is there from one frame to another, as often as there are spans, and at no other time."""
    when = [0.0, *(frame for span in spans for frame in span)]
    hidden = [1.0, *([0.0, 1.0] * len(spans))]
    animate(part, "OBJECT", when, [("hide_render", 0, hidden), ("hide_viewport", 0, hidden)], CONSTANT)
