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
PARKED = (3.0, 4.0, 0.5)


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


def parked_car():
    """An object of the artist's own, somewhere in the scene that was there first."""
    car = bpy.data.objects.new("my car", bpy.data.meshes.new("my car"))
    bpy.data.scenes["Scene"].collection.objects.link(car)
    car.location = PARKED
    bpy.data.scenes["Scene"].view_layers[0].update()
    return car


def seen_in_films(car):
    """Where an object is in its own scene, and by scene how far the one shown there is from the vehicle."""
    depsgraphs = {scene.name: scene.view_layers[0].depsgraph for scene in car_films(car)}
    away = {}
    for name, depsgraph in depsgraphs.items():
        depsgraph.update()
        shown = [each.matrix_world.copy() for each in depsgraph.object_instances if each.object.original == car]
        root = next(each for each in bpy.data.scenes[name].objects if each.name.startswith("vehicle"))
        away[name] = [list(root.evaluated_get(depsgraph).matrix_world.inverted() @ one.translation) for one in shown]
    return {"parent": car.parent, "at": list(car.matrix_world.translation), "from the vehicle": away}


def car_films(car):
    """The scenes that have an instance of it."""
    return [
        scene
        for scene in bpy.data.scenes
        if any(each.instance_collection and car.name in each.instance_collection.objects for each in scene.objects)
    ]


def main(archive, log, folder):
    before = {name.partition(".")[0] for name in sys.modules}
    facts = {"installed": sorted(install(archive))}
    given = bpy.context.window_manager.recon
    facts["pipelines"] = [item.identifier for item in given.bl_rna.properties["pipeline"].enum_items]
    facts["without a log"] = pressed(bpy.ops.recon.reconstruct)
    given.log, given.result = str(folder / "lost.txt"), str(folder)
    facts["lost log"] = [pressed(bpy.ops.recon.reconstruct), given.status]
    facts["no run"] = [pressed(bpy.ops.recon.load_result), given.status]
    given.log, given.folder = str(folder / "table.csv"), str(folder / RUN)
    (folder / "table.csv").write_text("a,b,c\n" + "1.0,2.0,3.0\n" * 9, encoding="utf-8")
    facts["unknown columns"] = pressed(bpy.ops.recon.reconstruct)
    (folder / "table.csv").unlink()
    given.log = str(folder / "letter.txt")
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
    given.own = parked_car()
    given.slow_motion = 1.0
    facts["load"] = [pressed(bpy.ops.recon.load_result) for _ in range(2)]
    facts["frames"] = bpy.context.scene.frame_end
    facts["my car"] = seen_in_films(given.own)
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
