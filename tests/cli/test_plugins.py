"""`recon plugins`: the stages, and one of them in full."""

from __future__ import annotations

import json

import pytest
from cli_box import Cli

import recon
from recon.parameters import bind


def test_the_list_names_stage_distribution_and_what_is_broken(cli: Cli) -> None:
    ended = cli("plugins")
    assert ended.code == 0
    lines = {line.split()[0]: line for line in ended.out.splitlines()}
    assert lines["filter.wait"].split() == ["filter.wait", "box-plugin", "2.5", "Waits."]
    assert "BROKEN: box_broken (box-plugin 2.5) cannot be imported: ModuleNotFoundError" in lines["filter.broken"]
    told = {stage["name"]: stage for stage in json.loads(cli("plugins", "filter", "--json").out)}
    assert {stage["role"] for stage in told.values()} == {"filter"}
    assert told["filter.wait"]["broken"] == ""
    assert told["filter.broken"]["broken"]


def test_one_stage_is_shown_in_full(cli: Cli) -> None:
    ended = cli("plugins", "show", "simulator.still")
    assert ended.code == 0
    assert "simulator.still  version 1  (box-plugin 2.5, box_plugin)" in ended.out
    assert "  pause  number        0 s      s     Time that the last 10 samples come late.\n" in ended.out
    assert "    accel_x, accel_y, accel_z  m/s^2  sensor  specific_force\n" in ended.out
    told = json.loads(cli("plugins", "show", "filter.wait", "--json").out)
    assert told["parameters"][0]["unit"] == "s"
    assert told["yaml"] == "- use: filter.wait\n  params:\n    time: 0 s\n"
    assert told["reads"]["imu"]["columns"][0]["name"] == "accel_x"


def test_what_a_record_declares_of_itself_is_shown(cli: Cli) -> None:
    assert "\ncapabilities: sniff\n" in cli("plugins", "show", "reader.still").out
    assert "capabilities" not in cli("plugins", "show", "detector.shock").out
    assert "\ncapabilities: every_stream, repeats\n" in cli("plugins", "show", "exporter.csv").out
    assert "\nreads\n  every stream\n" in cli("plugins", "show", "exporter.csv").out


def test_the_step_that_is_shown_is_that_of_the_defaults(cli: Cli) -> None:
    registry = recon.Registry.installed()
    for key in ("reader.auto", "reader.physycom", "simulator.drive", "filter.resample", "exporter.csv", "filter.wait"):
        step = json.loads(cli("plugins", "show", key, "--json").out)["yaml"]
        (pasted,) = recon.Pipeline.from_text(f"steps:\n{step}").steps
        stage = registry.get(key)
        assert bind(stage.params, pasted.params, key) == (stage.params(), [])


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["show", "filter.wiat"], 3, "error: there is no stage 'filter.wiat'\n  did you mean 'filter.wait'?\n"),
        (["show", "filter.broken"], 3, "error: box_broken (box-plugin 2.5) cannot be imported"),
        (["fliter"], 2, "error: there is no role 'fliter'; did you mean 'filter'?\n"),
        (["filter.wait"], 2, "write 'recon plugins show filter.wait'\n"),
        (["show", "a", "b"], 2, "error: too many words"),
        (["show"], 2, "error: 'show' needs the name of a stage; 'recon plugins' lists them\n"),
    ],
)
def test_a_stage_that_cannot_be_shown_is_told(cli: Cli, words: list[str], code: int, message: str) -> None:
    ended = cli("plugins", *words)
    assert ended.code == code
    assert message in ended.err
