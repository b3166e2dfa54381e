"""The panel in the sidebar of the 3D view, tab "recon": the button and what it needs, further options folded below."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from .settings import OPTIONS


class _Panel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "recon"


class Main(_Panel, bpy.types.Panel):
    """Log, method, button; or how far the work is."""

    bl_idname = "RECON_PT_main"
    bl_label = "Vehicle motion"

    def draw(self, context: Any) -> None:
        """Called by Blender."""
        given, layout = context.window_manager.recon, self.layout
        inputs = layout.column()
        inputs.enabled = not given.running
        for name in ("log", "pipeline", *OPTIONS[given.pipeline]):
            inputs.prop(given, name)
        if given.running:
            _progress(layout, given)
        else:
            button = layout.row()
            button.scale_y = 1.6
            button.operator("recon.reconstruct", icon="PLAY")
        if given.status and not given.running:
            for line in _lines(given.status):
                layout.label(text=line)


class Film(_Panel, bpy.types.Panel):
    """Frames, window, slow motion, camera, video."""

    bl_idname = "RECON_PT_film"
    bl_label = "Film"
    bl_parent_id = "RECON_PT_main"

    def draw(self, context: Any) -> None:
        """Called by Blender."""
        _draw(self.layout, context, *OPTIONS["film"], "own")


class Doubt(_Panel, bpy.types.Panel):
    """What shows how far the result can be trusted."""

    bl_idname = "RECON_PT_doubt"
    bl_label = "Doubt"
    bl_parent_id = "RECON_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Any) -> None:
        """Called by Blender."""
        _draw(self.layout, context, *OPTIONS["doubt"])


class Solver(_Panel, bpy.types.Panel):
    """The rigid-body solver after a crash."""

    bl_idname = "RECON_PT_solver"
    bl_label = "After the crash"
    bl_parent_id = "RECON_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Any) -> None:
        """Called by Blender."""
        _draw(self.layout, context, *OPTIONS["solver"])


class Result(_Panel, bpy.types.Panel):
    """Where the result goes, and an older one to load."""

    bl_idname = "RECON_PT_result"
    bl_label = "Result"
    bl_parent_id = "RECON_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Any) -> None:
        """Called by Blender."""
        _draw(self.layout, context, "folder", "more", "result")
        self.layout.operator("recon.load_result", icon="FILE_FOLDER")


CLASSES = (Main, Film, Doubt, Solver, Result)


def _draw(layout: Any, context: Any, *names: str) -> None:
    given = context.window_manager.recon
    for name in names:
        layout.prop(given, name)


def _progress(layout: Any, given: Any) -> None:
    if bpy.app.version >= (4, 0, 0):
        layout.progress(text=given.status, factor=given.progress)
    else:
        layout.label(text=f"{given.progress:.0%} {given.status}")
    layout.operator("recon.cancel", icon="CANCEL")


def _lines(text: str, width: int = 44) -> list[str]:
    """Words in lines: a label does not wrap."""
    return textwrap.wrap(text, width)
