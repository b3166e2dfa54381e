"""A stranger's distribution on the path: found, checked and run; broken or doubled, told when it is used."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from plugin_files import install

import recon
from recon.check import check
from recon.errors import PluginBroken, PluginConflict, PluginInvalid
from recon.pipeline import Pipeline, find, shipped
from recon.problems import Where
from recon.registry import Registry, Source
from recon.tables import vector

STAGE = '''
"""Doubles the speed of gnss."""

from recon import GNSS, SAME, Filter, Params, hookimpl, replace, setting, vector


class DoubleParams(Params):
    times: int = setting(2, gt=0, doc="By how much.")


def double(*, gnss, params):
    return {"gnss": replace(gnss, speed=vector(gnss, "speed") * params.times)}


@hookimpl
def declare_filters():
    yield Filter(name="double", summary="Doubles the speed.", params=DoubleParams, run=double,
                 reads={"gnss": GNSS.need("speed")}, writes={"gnss": SAME})
'''
READER = """
from recon import GNSS, Reader, build, hookimpl
import numpy as np


def read(path, params):
    speed = np.loadtxt(path, ndmin=1)
    return {"gnss": build(GNSS, time=np.arange(len(speed)) * 1_000_000_000, speed=speed)}


@hookimpl
def declare_readers():
    yield Reader(name="speeds", summary="A speed in each line.", run=read, writes={"gnss": GNSS.only("speed")})
"""
PIPELINE = "recon: 1\nname: strange\nsteps:\n  - use: reader.speeds\n  - use: filter.double\n"
POINTS = {
    "filter.double": "stranger.double",
    "reader.speeds": "stranger.speeds",
    "pipeline.strange": "stranger:pipelines/strange.yaml",
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A folder on the path of modules; what was imported from it is forgotten afterwards."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    before = set(sys.modules)
    yield folder
    for name in set(sys.modules) - before:
        if name.partition(".")[0] in ("stranger", "other_stranger"):
            del sys.modules[name]


@pytest.fixture
def stranger(place: Path) -> Path:
    modules = {
        "stranger/__init__.py": "",
        "stranger/double.py": STAGE,
        "stranger/speeds.py": READER,
        "stranger/pipelines/strange.yaml": PIPELINE,
    }
    return install(place, "recon-stranger", "1.2.3", modules=modules, points=POINTS)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "speeds.txt"
    path.write_text("1\n2.5\n", encoding="utf-8")
    return path


def broken(place: Path, text: str, **points: str) -> Registry:
    install(
        place,
        "broken-stranger",
        "0.9",
        modules={"stranger/__init__.py": "", "stranger/odd.py": text},
        points={"filter.odd": "stranger.odd", **points},
    )
    return Registry.installed()


def test_its_stages_are_known_without_an_import(stranger):
    registry = Registry.installed()
    assert {"filter.double", "reader.speeds"} <= set(registry)
    assert "pipeline.strange" not in registry
    assert registry.source("filter.double") == Source("recon-stranger", "1.2.3", "stranger.double")
    assert "stranger.double" not in sys.modules


def test_its_pipeline_is_found_by_name_without_an_import(stranger):
    assert find("strange") == stranger / "stranger" / "pipelines" / "strange.yaml"
    assert "thesis" in shipped()
    assert "stranger" not in sys.modules


def test_it_runs_and_the_manifest_names_its_distribution_and_version(stranger, log):
    run = recon.run("strange", log, **{"filter.double.times": 3})
    assert vector(run.recording["gnss"], "speed").tolist() == [3.0, 7.5]
    assert [(step["distribution"], step["distribution_version"]) for step in run.manifest["plan"]] == [
        ("recon-stranger", "1.2.3"),
        ("recon-stranger", "1.2.3"),
    ]


def test_its_parameters_are_checked_like_all_others(stranger):
    text = "steps:\n  - use: reader.speeds\n  - use: filter.double\n    params: {time: 0}\n"
    _, (problem,) = check(Pipeline.from_text(text, "p.yaml"), Registry.installed())
    assert problem.where == Where("p.yaml", 4, 14)
    assert problem.sentence == "filter.double has no parameter 'time'; did you mean 'times'?"


def command(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The command line of another process that has the folder on its path."""
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path}
    line = [sys.executable, "-m", "recon", *words]
    return subprocess.run(line, capture_output=True, text=True, env=environment, check=False)


def test_the_command_lists_checks_and_runs_it(stranger, log, tmp_path):
    listed = command(stranger, "plugins", "--json")
    assert listed.returncode == 0, listed.stderr
    assert "recon-stranger" in listed.stdout
    assert json.loads(listed.stdout)
    validated = command(stranger, "validate", str(find("strange")))
    assert validated.returncode == 0, validated.stderr
    done = command(stranger, "run", "strange", str(log), "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert vector(recon.open(tmp_path / "out").recording["gnss"], "speed").tolist() == [2.0, 5.0]


def test_two_that_claim_one_name_are_both_named(stranger):
    install(
        stranger,
        "other-stranger",
        "4.0",
        modules={"other_stranger.py": STAGE},
        points={"filter.double": "other_stranger"},
    )
    registry = Registry.installed()
    with pytest.raises(PluginConflict) as caught:
        registry.get("filter.double")
    assert "recon-stranger 1.2.3 (stranger.double)" in caught.value.message
    assert "other-stranger 4.0 (other_stranger)" in caught.value.message
    assert caught.value.hint == "uninstall one of them, or block one with --no-plugin DISTRIBUTION"
    assert registry.get("reader.speeds").key == "reader.speeds"


def test_one_that_claims_a_first_party_name_is_a_conflict_too(place):
    install(place, "greedy", modules={"stranger.py": STAGE}, points={"filter.resample": "stranger"})
    with pytest.raises(PluginConflict, match=r"greedy 1\.0 \(stranger\)"):
        Registry.installed().get("filter.resample")


def test_the_same_distribution_twice_on_the_path_is_no_conflict(stranger, tmp_path, monkeypatch):
    copy = install(tmp_path / "copy", "recon-stranger", "1.0.0", points=POINTS)
    monkeypatch.syspath_prepend(str(copy))
    assert Registry.installed().get("filter.double").key == "filter.double"


def test_a_broken_one_is_told_only_when_it_is_used(place, log, stranger):
    registry = broken(place, "import no_such_module\n")
    plan, problems = check(Pipeline.of("fine", "reader.speeds", "filter.double"), registry)
    assert problems == []
    assert len(plan.steps) == 2
    with pytest.raises(PluginBroken) as caught:
        check(Pipeline.of("odd", "reader.speeds", "filter.odd"), registry)
    assert str(caught.value) == (
        "stranger.odd (broken-stranger 0.9) cannot be imported: ModuleNotFoundError: No module named 'no_such_module'\n"
        "  tell its author, or uninstall it"
    )
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def (:\n", r"cannot be imported: SyntaxError"),
        ("1 / 0\n", r"cannot be imported: ZeroDivisionError: division by zero"),
        ("", r"stranger\.odd \(broken-stranger 0\.9\) declares no stage 'filter\.odd'"),
        (
            STAGE,
            r"declares no stage 'filter\.odd': its function declare_filters, marked with @hookimpl, is to yield it",
        ),
        (
            "from recon import hookimpl\n@hookimpl\ndef declare_filtres():\n    return []\n",
            r"cannot be used: .*declare_filtres",
        ),
        ("from recon import hookimpl\n@hookimpl\ndef declare_filters():\n    return 1 / 0\n", r"ZeroDivisionError"),
        ("from recon import hookimpl\n@hookimpl\ndef declare_filters():\n    return 1\n", r"cannot be used: TypeError"),
    ],
)
def test_what_is_wrong_with_a_broken_one_is_said(place, text, message):
    with pytest.raises(PluginBroken, match=message):
        broken(place, text).get("filter.odd")


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ("42", r"stranger\.odd yields a int, which is no record"),
        ("Filter(name='odd', summary='', run=lambda params: {})", r"filter\.odd: the summary is empty"),
        (
            "Filter(name='odd', summary='Odd.', run=lambda *, gnss, params: {})",
            r"its function takes the argument\(s\) \['gnss'\], which it does not declare to read",
        ),
        (
            "Filter(name='odd', summary='Odd.', run=lambda params, /: {})",
            r"filter\.odd: its function does not take the argument\(s\) \['params'\] by name, as they are given",
        ),
    ],
)
def test_a_record_that_breaks_the_rules_is_refused(place, record, message):
    text = f"from recon import Filter, hookimpl\n@hookimpl\ndef declare_filters():\n    yield {record}\n"
    with pytest.raises(PluginInvalid, match=message):
        broken(place, text).get("filter.odd")


def test_a_hook_that_returns_its_record_is_told_to_yield_it(place):
    record = "Filter(name='odd', summary='Odd.', run=lambda params: {})"
    text = f"from recon import Filter, hookimpl\n@hookimpl\ndef declare_filters():\n    return {record}\n"
    message = r"stranger\.odd \(broken-stranger 0\.9\): declare_filters returns filter\.odd, it is to yield it"
    with pytest.raises(PluginInvalid, match=message):
        broken(place, text).get("filter.odd")


def test_a_class_of_parameters_that_raises_is_no_fault_of_recon(place):
    text = (
        "from recon import Filter, Params, hookimpl\n"
        "class OddParams(Params):\n"
        "    def __init__(self, **given):\n"
        "        raise RuntimeError('no licence')\n"
        "@hookimpl\n"
        "def declare_filters():\n"
        "    yield Filter(name='odd', summary='Odd.', run=lambda params: {}, params=OddParams)\n"
    )
    registry = broken(place, text)
    with pytest.raises(PluginInvalid, match=r"filter\.odd: its class OddParams raises RuntimeError: no licence"):
        check(Pipeline.of("odd", "reader.speeds", "filter.odd"), registry)


def test_a_broken_package_does_not_hide_shipped_pipelines(place):
    install(place, "broken-stranger", modules={"stranger/__init__.py": "1 / 0\n"}, points=POINTS)
    assert find("thesis").is_file()
    assert not find("strange").is_file()


def test_a_pipeline_of_a_package_that_is_not_there_is_told_when_it_is_used(place):
    install(place, "broken-stranger", points={"pipeline.lost": "no_such_package:lost.yaml"})
    assert find("thesis").is_file()
    with pytest.raises(recon.ConfigError, match="there is no such file"):
        Pipeline.from_file("lost")


def test_a_pipeline_of_the_same_name_never_takes_the_place_of_a_shipped_one(place):
    package = {"stranger/__init__.py": "", "stranger/thesis.yaml": PIPELINE}
    install(place, "greedy", modules=package, points={"pipeline.thesis": "stranger:thesis.yaml"})
    assert find("thesis").parent != place / "stranger"
