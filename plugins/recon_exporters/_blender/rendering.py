"""Pictures of the scene, on the processor alone, so that they look the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy


def prepare(scene: Any, look: Any) -> None:
    """How pictures are made, by whoever asks for them."""
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", look["samples"]
    scene.cycles.use_denoising = _denoise(scene)
    scene.render.image_settings.file_format = "PNG"


def render(scene: Any, folder: Path, look: Any) -> None:
    """Write `still.png` or `frames/0001.png` and so on, as the plan asks."""
    if look["render"] == "still":
        scene.render.filepath = str(folder / "still.png")
        bpy.ops.render.render(write_still=True)
    elif look["render"] == "animation":
        scene.render.filepath = str(folder / "frames" / "####")
        bpy.ops.render.render(animation=True)


def _denoise(scene: Any) -> bool:
    """Is there a filter against noise? Not every Blender was built with one."""
    try:
        scene.cycles.denoiser = "OPENIMAGEDENOISE"
    except TypeError:
        return False
    return True
