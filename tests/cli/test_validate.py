"""`recon validate`: every problem with its place."""

from __future__ import annotations

import json
from pathlib import Path

from cli_box import Cli


def test_a_valid_file_is_a_line(cli: Cli) -> None:
    assert cli("validate", "box.yaml") == (0, "box.yaml: pipeline 'box' is valid, 2 steps\n", "")


def test_every_problem_of_every_file_is_printed_with_its_place(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text(
        "name: 5\nsteps:\n  - use: reader.auto\n  - use: filter.wiat\n    params: {a: b}\n"
    )
    ended = cli("validate", "bad.yaml", "box.yaml", "gone.yaml")
    assert ended.code == 2
    assert ended.out.splitlines() == [
        "box.yaml: pipeline 'box' is valid, 2 steps",
        "bad.yaml:1:7: error: name must be text; put it in quotes",
        "bad.yaml:4:10: error: there is no stage 'filter.wiat'; did you mean 'filter.wait'?",
        "gone.yaml: error: there is no such file",
    ]


def test_problems_for_programs_are_json_and_for_github_annotations(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("steps: [{use: filter.wiat}]")
    ended = cli("validate", "bad.yaml", "box.yaml", "--format", "json")
    (problem, *_) = json.loads(ended.out)
    assert (problem["file"], problem["line"], problem["column"]) == ("bad.yaml", 1, 15)
    assert ended.code == 2
    ended = cli("validate", "bad.yaml", "--format", "github")
    assert ended.out.startswith("::error file=bad.yaml,line=1,col=15,")
    assert json.loads(cli("validate", "box.yaml", "--format", "json").out) == []


def test_a_stage_that_is_broken_is_exit_3_only_where_it_is_used(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("steps: [{use: reader.auto}, {use: filter.broken}]")
    ended = cli("validate", "bad.yaml", "box.yaml")
    assert ended.code == 3
    assert "bad.yaml: error: box_broken (box-plugin 2.5) cannot be imported: ModuleNotFoundError" in ended.out
    assert "box.yaml: pipeline 'box' is valid" in ended.out


def test_a_batch_file_is_checked_with_its_pipeline(cli: Cli, tmp_path: Path) -> None:
    text = "batch: june\npipeline: box.yaml\ninputs: [{glob: '*.txt'}]\noutput: results\n"
    (tmp_path / "june.yaml").write_text(text)
    assert cli("validate", "june.yaml") == (0, "june.yaml: batch 'june' is valid\n", "")
    (tmp_path / "june.yaml").write_text(text + "defaults: {filter.wait: {tme: 1 s}}\n")
    ended = cli("validate", "june.yaml")
    assert ended.code == 2
    assert ended.out == "june.yaml:5:26: error: filter.wait has no parameter 'tme'; did you mean 'time'?\n"
