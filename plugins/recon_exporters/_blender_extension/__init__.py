"""The extension of Blender: a panel in which a log becomes an animated vehicle, without a terminal.

    settings    what the panel asks, as properties of the window manager, and as words for the command line
    running     `recon run` and `recon export` as processes: Blender stays responsive, cancelling ends all of it
    operators   "Reconstruct" and "Load result"; the scene itself is built by the package _blender beside this one
    panel       what is drawn

Runs inside of Blender 4.2 to 5.0 as an extension, in 3.4 as an add-on, and needs of them bpy and numpy alone: recon,
with all that it needs, is used by the other process only, from the wheels that lie beside.
"""

from __future__ import annotations

import bpy

from . import operators, panel, settings

__all__ = ["register", "unregister"]

CLASSES = (settings.Settings, *operators.CLASSES, *panel.CLASSES)


def register() -> None:
    """Called by Blender when the extension is enabled."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.WindowManager.recon = bpy.props.PointerProperty(type=settings.Settings)


def unregister() -> None:
    """Called by Blender when the extension is disabled."""
    del bpy.types.WindowManager.recon
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
