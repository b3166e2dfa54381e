"""Run by a Python that has bpy, or by Blender: what an artist does with the extension, in an empty profile.

use_extension.py ZIP LOG FOLDER      installs it, reconstructs the log, loads the result again; writes FOLDER/facts.json
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import bpy

RUN = "drive"


def install(archive):
    if bpy.app.version < (4, 2, 0):
        bpy.ops.preferences.addon_install(filepath=archive)
        return bpy.ops.preferences.addon_enable(module="recon_dynamics")
    return bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)


def pressed(button):
    """How a button ends, and what it reports."""
    try:
        return sorted(button())
    except RuntimeError as error:
        return str(error)


def module_of(part):
    """A module of the extension, whatever Blender calls its package."""
    return next(module for name, module in sys.modules.items() if name.endswith(f"_blender_extension.{part}"))


def cancelled(log, folder):
    """What is left of work that is ended after its first step began."""
    running = module_of("running")
    words = ["run", "thesis", log, "--out", str(folder / "cancelled")]
    work = running.Work.start(words, running.PACKAGES.search_path())
    while not work.said and not work.finished():
        time.sleep(0.01)
    work.cancel()
    return [work.finished(), bool(work.failure()), sorted(path.name for path in folder.iterdir())]


def left_alone(log, folder):
    """What Blender leaves behind that opens another file while a button is at work."""
    running, given = module_of("running"), bpy.context.window_manager.recon
    words = ["run", "thesis", log, "--out", str(folder / "left alone")]
    button = SimpleNamespace(work=running.Work.start(words, running.PACKAGES.search_path()))
    given.running = True
    module_of("operators").Reconstruct.cancel(button, bpy.context)
    return [button.work.finished(), given.running, sorted(path.name for path in folder.iterdir())]


def main(archive, log, folder):
    before = {name.partition(".")[0] for name in sys.modules}
    facts = {"installed": sorted(install(archive))}
    given = bpy.context.window_manager.recon
    facts["pipelines"] = [item.identifier for item in given.bl_rna.properties["pipeline"].enum_items]
    facts["without a log"] = pressed(bpy.ops.recon.reconstruct)
    given.log, given.folder = str(folder / "letter.txt"), str(folder / RUN)
    (folder / "letter.txt").write_text("Dear Sir or Madam,\n", encoding="utf-8")
    facts["not a log"] = pressed(bpy.ops.recon.reconstruct)
    facts["cancelled"] = cancelled(log, folder)
    facts["left alone"] = left_alone(log, folder)
    given.log, given.more = log, "fuser.weighted_average.weight='0.01"
    facts["open quotation"] = pressed(bpy.ops.recon.reconstruct)
    given.more, given.start, given.end, given.slow_motion = "", 55.0, 66.0, 5.0
    facts["reconstruct"] = pressed(bpy.ops.recon.reconstruct)
    facts["scene"] = bpy.context.scene.name
    facts["told"] = bpy.data.texts["recon"].as_string()
    made = folder / RUN / "exports" / "blender"
    for name in ("scene.json", "scene.npz"):  # the next button writes its own
        (folder / name).write_bytes((made / name).read_bytes())
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    given.own = bpy.data.objects.new("my car", bpy.data.meshes.new("my car"))
    given.slow_motion = 1.0
    facts["load"] = pressed(bpy.ops.recon.load_result)
    facts["frames"] = bpy.context.scene.frame_end
    facts["parent of my car"] = given.own.parent.name
    given.pipeline, given.lever_arm, given.wheels = "crash", (1.2, 0.0, 0.3), False
    facts["words"] = module_of("settings").run_words(given)
    facts["scenes"] = len(bpy.data.scenes)
    rna = [getattr(bpy.types, f"RECON_OT_{name}").bl_options for name in ("reconstruct", "load_result")]
    facts["undo"] = [sorted(options) for options in rna]
    facts["imported"] = sorted({name.partition(".")[0] for name in sys.modules} - before)
    (folder / "facts.json").write_text(json.dumps(facts), encoding="utf-8")


if __name__ == "__main__":
    *_, zipped, source, place = sys.argv
    main(zipped, source, Path(place))
