"""Doing without plugins, two that claim one name, one that needs a newer recon, and who ran what."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from plugin_files import install

import recon
from recon.cli import main
from recon.errors import ConfigError, PluginBroken, PluginConflict, PluginNotFound
from recon.registry import Registry
from recon.requirement import canonical, unmet

READER = """
from recon import GNSS, Reader, Sniff, build, hookimpl
import numpy as np


def read(path, params):
    speed = np.loadtxt(path, ndmin=1, skiprows=1)
    return {"gnss": build(GNSS, time=np.arange(len(speed)) * 1_000_000_000, speed=speed)}


def sniff(path, head):
    return Sniff(0.9 if head.startswith(b"speeds") else 0.0, "first word")


@hookimpl
def declare_readers():
    yield Reader(name="speeds", summary="A speed in each line.", run=read, sniff=sniff,
                 writes={"gnss": GNSS.only("speed")})
"""
STAGES = """
from recon import GNSS, SAME, Exporter, Filter, hookimpl, replace, vector


def double(*, gnss, params):
    return {"gnss": replace(gnss, speed=2.0 * vector(gnss, "speed"))}


def count(*, gnss, folder, about, params):
    (folder / "rows.txt").write_text(str(gnss.num_rows), encoding="utf-8")
    return [folder / "rows.txt"]


@hookimpl
def declare_filters():
    yield Filter(name="double", summary="Doubles the speed.", run=double, reads={"gnss": GNSS.need("speed")},
                 writes={"gnss": SAME})


@hookimpl
def declare_exporters():
    yield Exporter(name="count", summary="Rows.", run=count, reads={"gnss": GNSS.need("speed")})
"""
POINTS = {"reader.speeds": "strange_reader", "filter.double": "strange_stages", "exporter.count": "strange_stages"}
PIPELINE = "name: strange\nsteps:\n  - use: reader.speeds\n  - use: filter.double\n"


class Ended(NamedTuple):
    code: int
    out: str
    err: str


Cli = Callable[..., Ended]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A folder on the path that holds the distribution Strange_Plugins; a log and a pipeline in the working one."""
    folder = tmp_path / "site"
    modules = {"strange_reader.py": READER, "strange_stages.py": STAGES}
    install(folder, "Strange_Plugins", "1.2", modules=modules, points=POINTS)
    work = tmp_path / "work"
    work.mkdir()
    (work / "drive.txt").write_text("speeds\n1\n2.5\n", encoding="utf-8")
    (work / "strange.yaml").write_text(PIPELINE, encoding="utf-8")
    monkeypatch.chdir(work)
    monkeypatch.syspath_prepend(str(folder))
    yield folder
    for name in [name for name in sys.modules if name.startswith(("strange_", "newer_"))]:
        del sys.modules[name]


@pytest.fixture
def cli(site: Path, capsys: pytest.CaptureFixture[str]) -> Cli:
    def run(*words: str) -> Ended:
        capsys.readouterr()
        return Ended(main(words), *capsys.readouterr())

    return run


# --- doing without --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["filter.double", "Strange_Plugins", "strange-plugins"])
def test_a_blocked_stage_is_told_where_it_is_named(cli: Cli, name: str) -> None:
    ended = cli("run", "strange.yaml", "drive.txt", "--no-plugin", name)
    assert ended.code == 2
    assert (
        "strange.yaml:4:10: error: the stage 'filter.double' (Strange_Plugins 1.2) is blocked by "
        f"--no-plugin {name}; leave the option away, or use another stage\n"
    ) in ended.err
    assert not Path("drive-strange").exists()


def test_stages_of_others_are_blocked_and_never_imported(cli: Cli) -> None:
    ended = cli("validate", "strange.yaml", "--first-party-only")
    assert ended.code == 2
    assert ended.out.splitlines() == [
        f"strange.yaml:{line}:10: error: the stage '{key}' (Strange_Plugins 1.2) is blocked by --first-party-only; "
        "leave the option away, or use another stage"
        for line, key in ((3, "reader.speeds"), (4, "filter.double"))
    ]
    assert not {"strange_reader", "strange_stages"} & set(sys.modules)


def test_what_is_not_blocked_works(cli: Cli) -> None:
    assert cli("run", "strange.yaml", "drive.txt", "--no-plugin", "exporter.count").code == 0
    assert cli("run", "simulated_drive", "--first-party-only", "--set", "simulator.drive.motion=rest").code == 0


def test_several_may_be_blocked(cli: Cli) -> None:
    ended = cli("validate", "strange.yaml", "--no-plugin", "filter.double", "--no-plugin", "reader.speeds")
    assert ended.out.count("is blocked by --no-plugin") == 2


def test_a_blocked_reader_is_not_asked(cli: Cli) -> None:
    assert cli("inspect", "drive.txt").code == 0
    for words in (["inspect", "drive.txt"], ["convert", "drive.txt", "converted"]):
        ended = cli(*words, "--first-party-only")
        assert ended.code == 4
        assert "drive.txt: no reader knows this file" in ended.err
        assert "speeds" not in ended.err.partition("no reader knows")[2]


def test_parameters_for_a_blocked_reader_are_told(cli: Cli) -> None:
    Path("auto.yaml").write_text("steps: [{use: reader.auto, params: {reader.speeds: {}}}]", encoding="utf-8")
    assert cli("validate", "auto.yaml").code == 0
    ended = cli("validate", "auto.yaml", "--no-plugin", "reader.speeds")
    assert "error: the stage 'reader.speeds' (Strange_Plugins 1.2) is blocked by --no-plugin reader.speeds" in ended.out


def test_a_blocked_exporter_exports_nothing(cli: Cli) -> None:
    assert cli("run", "strange.yaml", "drive.txt").code == 0
    ended = cli("export", "drive-strange", "count", "--no-plugin", "strange-plugins")
    assert ended.code == 2
    assert "the stage 'exporter.count' (Strange_Plugins 1.2) is blocked by --no-plugin strange-plugins" in ended.err
    assert cli("export", "drive-strange", "count").code == 0


def test_lists_and_schemas_leave_out_what_is_blocked(cli: Cli) -> None:
    for words in (["plugins"], ["schema"]):
        assert "filter.double" in cli(*words).out
        assert "filter.double" not in cli(*words, "--first-party-only").out
        ended = cli(*words, "--no-plugin", "filter.double")
        assert "filter.double" not in ended.out
        assert "reader.speeds" in ended.out
    ended = cli("plugins", "show", "filter.double", "--first-party-only")
    assert ended.code == 3
    assert ended.err.startswith("error: the stage 'filter.double' (Strange_Plugins 1.2) is blocked by --first-party")


def test_a_name_that_blocks_nothing_is_refused(cli: Cli) -> None:
    ended = cli("run", "strange.yaml", "drive.txt", "--no-plugin", "filter.duoble", "--no-plugin", "unheard-of")
    assert ended.code == 2
    assert ended.err.splitlines() == [
        "--no-plugin filter.duoble: error: there is neither a stage nor a distribution 'filter.duoble'; "
        "did you mean 'filter.double'?",
        "--no-plugin unheard-of: error: there is neither a stage nor a distribution 'unheard-of'; see 'recon plugins'",
    ]


def test_python_does_the_same_by_a_registry(site: Path) -> None:
    with pytest.raises(ConfigError, match="is blocked by --first-party-only"):
        recon.run("strange.yaml", "drive.txt", registry=Registry.installed(first_party_only=True))
    without = Registry.installed(block=["filter.double"])
    assert "filter.double" not in without
    with pytest.raises(PluginNotFound, match=r"is blocked by --no-plugin filter\.double"):
        without.get("filter.double")
    assert recon.run("strange.yaml", "drive.txt").recording["gnss"]["speed"].to_pylist() == [2.0, 5.0]


def test_a_record_handed_over_takes_the_place_of_a_blocked_stage(site: Path) -> None:
    record = Registry.installed().get("filter.double")
    assert Registry.installed(first_party_only=True).with_records(record).get("filter.double") is record


# --- two claims, a newer recon --------------------------------------------------------------------------------------


def test_of_two_that_claim_one_name_the_one_that_is_left_is_used(site: Path) -> None:
    install(
        site, "other-plugins", "4.0", modules={"strange_other.py": STAGES}, points={"filter.double": "strange_other"}
    )
    with pytest.raises(PluginConflict) as caught:
        Registry.installed().get("filter.double")
    assert "Strange_Plugins 1.2 (strange_stages)" in caught.value.message
    assert "other-plugins 4.0 (strange_other)" in caught.value.message
    assert "--no-plugin DISTRIBUTION" in caught.value.hint
    left = Registry.installed(block=["strange-plugins"])
    assert left.get("filter.double").run.__module__ == "strange_other"
    assert left.source("filter.double").distribution == "other-plugins"


def needing(site: Path, requirement: str) -> None:
    """A distribution that asks for a recon, with a stage whose module needs what no recon has yet."""
    module = "from recon import what_comes_later\n"
    install(site, "recon-newer", "1.2", modules={"newer_stage.py": module}, points={"filter.newer": "newer_stage"})
    with (site / "recon_newer-1.2.dist-info" / "METADATA").open("a", encoding="utf-8") as metadata:
        metadata.write(f"Requires-Dist: numpy\nRequires-Dist: {requirement}\n")


def test_a_plugin_made_for_a_newer_recon_says_so_before_it_is_imported(cli: Cli, site: Path) -> None:
    needing(site, "recon-dynamics>=9")
    sentence = f"recon-newer 1.2 needs recon-dynamics>=9, this is {recon.__version__}"
    with pytest.raises(PluginBroken) as caught:
        Registry.installed().get("filter.newer")
    assert (caught.value.message, caught.value.hint) == (sentence, "update recon")
    assert "newer_stage" not in sys.modules
    assert f"BROKEN: {sentence}" in cli("plugins").out
    Path("newer.yaml").write_text("steps: [{use: reader.speeds}, {use: filter.newer}]", encoding="utf-8")
    ended = cli("run", "newer.yaml", "drive.txt")
    assert (ended.code, ended.err) == (3, f"error: {sentence}\n  update recon\n")


def test_one_that_is_content_with_this_recon_is_imported(site: Path) -> None:
    needing(site, "recon-dynamics>=0.1")
    with pytest.raises(PluginBroken, match="what_comes_later"):
        Registry.installed().get("filter.newer")


@pytest.mark.parametrize(
    ("requirement", "needed"),
    [
        ("recon-dynamics", ""),
        ("recon-dynamics>=1.4", ""),
        ("recon-dynamics>=1.4.0.0", ""),
        ("recon-dynamics>=1.5", "recon-dynamics>=1.5"),
        ("Recon_Dynamics >= 1.10", "recon-dynamics>=1.10"),
        ("recon-dynamics[test]<3,>=2", "recon-dynamics>=2"),
        ("recon.dynamics (~=1.4.1)", "recon-dynamics~=1.4.1"),
        ("recon-dynamics~=1.3", ""),
        ("recon-dynamics>1.4", "recon-dynamics>1.4"),
        ("recon-dynamics>1.3.9", ""),
        ("recon-dynamics==1.5.*", "recon-dynamics==1.5"),
        ("recon-dynamics===2.0", "recon-dynamics===2.0"),
        ("recon-dynamics<1,!=1.7,<=0.9", ""),
        ("recon-dynamics>=1.4rc1", ""),
        ("recon-dynamics>=9; extra == 'all'", ""),
        ("recon-dynamics-extras>=9", ""),
        ("numpy>=9", ""),
    ],
)
def test_lower_bounds_are_compared_by_the_numbers_of_the_release(requirement: str, needed: str) -> None:
    assert unmet(["pyarrow>=17", requirement], "1.4") == needed
    assert unmet([requirement], "1.4.0rc2") == needed


def test_names_of_distributions_are_compared_as_installers_do() -> None:
    assert canonical("Recon__Dynamics") == canonical("recon.dynamics") == "recon-dynamics"


# --- who ran what ---------------------------------------------------------------------------------------------------


def test_the_manifest_names_the_distribution_and_version_of_each_step(cli: Cli) -> None:
    assert cli("run", "strange.yaml", "drive.txt").code == 0
    manifest = json.loads(Path("drive-strange/manifest.json").read_text(encoding="utf-8"))
    ran = [(step["use"], step["distribution"], step["distribution_version"]) for step in manifest["plan"]]
    assert ran == [("reader.speeds", "Strange_Plugins", "1.2"), ("filter.double", "Strange_Plugins", "1.2")]


def test_behind_reader_auto_the_manifest_names_the_distribution_that_read(cli: Cli) -> None:
    Path("auto.yaml").write_text("steps: [{use: reader.auto}, {use: filter.double}]", encoding="utf-8")
    assert cli("run", "auto.yaml", "drive.txt").code == 0
    learnt = json.loads(Path("drive-auto/manifest.json").read_text(encoding="utf-8"))["steps"][0]["metrics"]
    (row,) = [row for row in learnt if row["name"] == "reader_distribution"]
    assert (row["method"], row["note"]) == ("reader.speeds", "Strange_Plugins 1.2")
