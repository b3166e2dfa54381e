"""The two buttons: a log, or an older result, becomes a scene. Both run `recon` beside Blender until there is a plan.

Pressed in the panel they are modal: Blender stays usable, the panel shows the step, Escape or "Cancel" ends the work.
Called by a script they return when all is done.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy

from .._blender import build
from .running import PACKAGES, Work
from .settings import absolute, export_words, more_words, result_of, run_words

INTERVAL = 0.2
"""s between two looks at the process."""
TEXT = "recon"


@dataclass(frozen=True)
class Task:
    """What a button asks of recon, from what the panel asked for.

    missing : what has to be given first, "" where nothing is missing; words : for the command line of recon
    result : folder of the run whose scene is shown
    """

    missing: Callable[[Any], str]
    words: Callable[[Any], list[str]]
    result: Callable[[Any], Path]


def no_log(given: Any) -> str:
    """What has to be given before a log can be reconstructed; "" where it is there."""
    if not given.log:
        return "Choose a log first"
    if not absolute(given.log).exists():
        return f"There is no file {absolute(given.log)}"
    try:
        more_words(given)
    except ValueError:
        return f"More: a quotation mark is not closed: {given.more}"
    return ""


def no_run(given: Any) -> str:
    """What has to be given before a run can be shown; "" where it is there."""
    if not given.result:
        return "Choose the folder of a finished run first"
    folder = absolute(given.result)
    there = (folder / "manifest.json").is_file()
    return "" if there else f"{folder} is not the folder of a finished run: it holds no manifest.json"


class _Working:
    """An operator that waits for recon and then builds the scene that it planned; one press is one step of undo."""

    bl_options = frozenset({"UNDO"})
    task: Task
    work: Work
    timer: Any

    def execute(self, context: Any) -> set[str]:
        """All at once, as scripts call it."""
        if not self._begin(context):
            return {"CANCELLED"}
        self.work.process.wait()
        return self._end(context)

    def invoke(self, context: Any, _event: Any) -> set[str]:
        """Step by step, as the panel calls it."""
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        self.timer = manager.event_timer_add(INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: Any, event: Any) -> set[str]:
        """A look at the process, by the timer."""
        given = context.window_manager.recon
        if event.type == "ESC" or given.cancelled:
            self.work.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        given.progress, given.status = self.work.progress()
        for area in context.screen.areas if context.screen else ():
            area.tag_redraw()
        if not self.work.finished():
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        return self._end(context)

    def cancel(self, context: Any) -> None:
        """Called by Blender where it ends or opens another file: recon does not go on alone."""
        self.work.cancel()
        context.window_manager.recon.running = False

    def _begin(self, context: Any) -> bool:
        given = context.window_manager.recon
        missing = self.task.missing(given)
        if given.running:
            self.report({"ERROR"}, "It is running already")  # type: ignore[attr-defined]
            return False
        if missing:
            given.status = missing
            self.report({"ERROR"}, missing)  # type: ignore[attr-defined]
            return False
        try:
            self.work = Work.start(self.task.words(given), PACKAGES.search_path())
        except OSError as error:  # as of a full disk, where the wheels are unpacked
            given.status = f"recon cannot be started: {error}"
            self.report({"ERROR"}, given.status)  # type: ignore[attr-defined]
            return False
        given.running, given.cancelled, given.progress, given.status = True, False, 0.0, "starting"
        return True

    def _end(self, context: Any) -> set[str]:
        given = context.window_manager.recon
        given.running, given.progress = False, 0.0
        if given.cancelled:
            given.status = "cancelled"
            return {"CANCELLED"}
        failure = self.work.failure()
        if failure:
            given.status = failure
            self.report({"ERROR"}, failure)  # type: ignore[attr-defined]
            return {"CANCELLED"}
        folder = self.task.result(given)
        _note(self.work.said)
        show(context, folder, given.own)
        given.result, given.status = str(folder), f"done: {folder.name}"
        return {"FINISHED"}


class Reconstruct(_Working, bpy.types.Operator):
    """Reconstruct the log and show the drive as a new scene."""

    bl_idname = "recon.reconstruct"
    bl_label = "Reconstruct"
    task = Task(no_log, run_words, result_of)


class LoadResult(_Working, bpy.types.Operator):
    """Show a run that recon made before as a new scene."""

    bl_idname = "recon.load_result"
    bl_label = "Load result"
    task = Task(no_run, export_words, lambda given: absolute(given.result))


class Cancel(bpy.types.Operator):
    """End the work; nothing half-written is left."""

    bl_idname = "recon.cancel"
    bl_label = "Cancel"

    def execute(self, context: Any) -> set[str]:
        """The operator at work sees it."""
        context.window_manager.recon.cancelled = True
        return {"FINISHED"}


CLASSES = (Reconstruct, LoadResult, Cancel)


def show(context: Any, run: Path, own: Any) -> None:
    """The plan of a run as a scene of its own, seen through its camera; the artist's other scenes stay as they are."""
    scene = bpy.data.scenes.new(run.name)
    if context.window is not None:
        context.window.scene = scene
    with context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        build(run / "exports" / "blender", own)
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D":
            view = area.spaces.active
            view.region_3d.view_perspective = "CAMERA"
            view.shading.type, view.shading.use_scene_world, view.shading.use_scene_lights = "MATERIAL", True, True


def _note(said: list[str]) -> None:
    """What recon told, warnings among it, as a text in the file."""
    text = bpy.data.texts.get(TEXT) or bpy.data.texts.new(TEXT)
    text.from_string("\n".join(said) + "\n")
