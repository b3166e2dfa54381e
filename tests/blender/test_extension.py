"""The extension as an artist has it: one file, installed into an empty profile, a log, a button, a film."""

from __future__ import annotations

import json
import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from blender_scenes import assert_curves_hold, blender_on_the_path, bpy_python, look, run_inside

import recon
from recon.check import check, with_exports
from recon.cli import main
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.registry import Registry
from recon_exporters.blender import find_blender

USE = Path(__file__).with_name("use_extension.py")
IMPACT = 233


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    """Made by the command, with wheels that pip fetches."""
    folder = tmp_path_factory.mktemp("extension")
    assert main(["blender-extension", "--platform", "linux-x64", "--out", str(folder)]) == 0
    (made,) = folder.iterdir()
    return made


@pytest.fixture(scope="module", params=[bpy_python, blender_on_the_path])
def used(request, archive, logs, tmp_path_factory):
    """What the extension does in a Blender: the folder with its scene, what the script found, the program."""
    program = find_blender(request.param())
    folder, profile = tmp_path_factory.mktemp("artist"), tmp_path_factory.mktemp("profile")
    places = {"RESOURCES": profile, "CONFIG": profile / "config", "SCRIPTS": profile / "scripts"}
    env = {f"BLENDER_USER_{name}": str(path) for name, path in places.items()}
    log = logs / "physycom_crash" / "crash_01.txt"
    said = run_inside(program, USE, str(archive), str(log), str(folder), **env)
    assert (folder / "facts.json").is_file(), said
    return folder, json.loads((folder / "facts.json").read_text(encoding="utf-8")), program


def test_blenders_own_tool_finds_nothing_wrong_with_it(archive):
    python = bpy_python()
    ask = "import bpy; print(bpy.utils.resource_path('LOCAL'))"
    home = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.splitlines()[-1]
    tool = Path(home, "scripts", "addons_core", "bl_pkg", "cli", "blender_ext.py")
    done = subprocess.run([python, str(tool), "validate", str(archive)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_manifest_names_every_wheel_but_numpys(archive):
    with zipfile.ZipFile(archive) as inside:
        manifest = inside.read("recon_dynamics/blender_manifest.toml").decode()
        wheels = {name.rpartition("/")[2] for name in inside.namelist() if name.endswith(".whl")}
    named = set(re.findall(r'"\./wheels/(.*\.whl)"', manifest))
    assert {wheel.partition("-")[0] for wheel in wheels - named} == {"numpy"}
    assert {"recon_dynamics", "pyarrow", "scipy", "pydantic_core"} <= {wheel.partition("-")[0] for wheel in named}


def test_it_installs_and_offers_the_pipelines_that_it_brings(used):
    _, facts, _ = used
    assert facts["installed"] == ["FINISHED"]
    assert {"thesis", "best_accuracy"} <= set(facts["pipelines"])


def test_one_press_makes_a_scene_that_moves_as_the_trajectory_does_at_every_key(used):
    folder, facts, program = used
    assert facts["reconstruct"] == ["FINISHED"]
    assert facts["scene"] == "drive"
    seen = look(program, folder, IMPACT)
    assert_curves_hold(seen, recon.open(folder / "drive").trajectory.table)
    assert [mark for mark in seen.facts["markers"] if mark[0].startswith("crash")] == [["crash 62.8 m/s²", IMPACT]]
    red, green, blue = np.moveaxis(seen.picture(IMPACT), -1, 0)
    assert ((blue > 0.25) & (blue > 2.5 * red) & (blue > 1.2 * green)).sum() > 300  # the car, in its paint
    assert seen.picture(IMPACT)[:10].mean() > 0.5  # a bright sky


def test_what_recon_warned_of_is_a_text_in_the_file(used):
    _, facts, _ = used
    assert "warning: no GNSS positions" in facts["told"]


def test_an_older_result_is_loaded_with_other_options(used):
    _, facts, _ = used
    assert facts["load"] == [["FINISHED"], ["FINISHED"]]
    # 11 s at 25 frames a second, no longer slow; the first frame is 1, and the last row just before the end.
    assert facts["frames"] in (275, 276)
    assert facts["scenes"] == 4  # Blender's own, and one for each press


def test_a_vehicle_of_ones_own_is_in_every_film_and_stays_in_its_own_scene_as_it_was(used):
    """Parked at (3, 4), half a metre up: so high it is above the ground of the film, too."""
    _, facts, _ = used
    mine = facts["my car"]
    assert (mine["parent"], mine["at"]) == (None, [3.0, 4.0, 0.5])
    assert sorted(mine["from the vehicle"]) == ["drive.001", "drive.002"]
    for shown in mine["from the vehicle"].values():
        # products of single precision, tens of metres from the origin
        assert np.abs(np.array(shown) - (0.0, 0.0, 0.5)).max() < 1e-4


def test_what_is_set_in_the_panel_and_only_that_is_passed_on_with_its_unit(used):
    """As a pipeline takes it: with its units, on the steps that it has."""
    _, facts, _ = used
    settings = [word for word in facts["words"] if "=" in word]
    assert settings == [
        "fuser.map.wheels=false",
        "aligner.lever_arm.lever_arm=[1.2 m, 0 m, 0.3 m]",
        "exporter.blender.start=55 s",
        "exporter.blender.end=66 s",
        "exporter.blender.slow_motion=1",
        "exporter.blender.blender=none",
    ]
    pipeline = with_exports(Pipeline.from_file("crash"), ["blender"])
    plan, problems = check(pipeline, Registry.installed(), [Override.from_option(text) for text in settings])
    assert problems == []
    assert [step.params.lever_arm for step in plan.steps if step.id == "aligner.lever_arm"] == [(1.2, 0.0, 0.3)]


def test_what_is_wrong_is_said_in_recons_words(used):
    _, facts, _ = used
    assert facts["without a log"].strip() == "Error: Choose a log first"
    assert "no reader knows this file" in facts["not a log"]
    assert facts["not a log"].count("rror: ") == 1  # Blender's own word for it


def test_a_log_and_a_run_that_are_not_there_are_told_by_their_paths_and_stay_told_in_the_panel(used):
    folder, facts, _ = used
    lost, run = f"There is no file {folder / 'lost.txt'}", f"{folder} is not the folder of a finished run"
    assert facts["lost log"] == [f"Error: {lost}\n", lost]
    assert facts["no run"] == [f"Error: {run}: it holds no manifest.json\n", f"{run}: it holds no manifest.json"]


def test_a_message_that_names_an_option_of_the_terminal_says_where_in_the_panel_it_goes(used):
    _, facts, _ = used
    assert "--set reader.csv.columns=@mapping.yaml" in facts["unknown columns"]
    assert facts["unknown columns"].strip().endswith("here settings go into Result > More, without --set")
    assert "Result > More" not in facts["not a log"]


def test_a_quotation_mark_that_is_not_closed_is_told_and_the_next_press_works(used):
    _, facts, _ = used
    assert facts["open quotation"].strip() == (
        "Error: More: a quotation mark is not closed: fuser.weighted_average.weight='0.01"
    )
    assert facts["reconstruct"] == ["FINISHED"]


def test_each_press_is_a_step_of_undo(used):
    _, facts, _ = used
    assert facts["undo"] == [["UNDO"], ["UNDO"]]


def test_cancelled_work_ends_and_leaves_nothing(used):
    _, facts, _ = used
    assert facts["cancelled"] == [True, True, ["letter.txt"]]


def test_work_ends_with_the_file_that_it_was_begun_in(used):
    _, facts, _ = used
    assert facts["left alone"] == [True, False, ["letter.txt"]]


def test_blender_itself_imports_nothing_that_recon_brings(used):
    """So that other extensions keep the NumPy and Arrow that they know."""
    _, facts, _ = used
    assert not {"recon", "pyarrow", "scipy", "pydantic"} & set(facts["imported"])


def test_an_unknown_platform_is_told(capsys):
    assert main(["blender-extension", "--platform", "windows"]) == 2
    said = capsys.readouterr().err
    assert "there is no platform 'windows'" in said
    assert "windows-x64" in said
