"""`recon schema` and `recon demo`."""

from __future__ import annotations

import json
from pathlib import Path

from cli_box import Cli, entries


def test_the_schema_is_printed_or_written(cli: Cli, tmp_path: Path) -> None:
    printed = json.loads(cli("schema").out)
    assert cli("schema", "--out", "recon.schema.json") == (0, "recon.schema.json\n", "")
    assert json.loads((tmp_path / "recon.schema.json").read_text()) == printed


def test_the_demo_compares_with_the_truth_and_is_not_overwritten(cli: Cli, tmp_path: Path) -> None:
    ended = cli("demo")
    assert ended.code == 0
    assert "against the truth\n" in ended.out
    assert "position, horizontal [m]" in ended.out
    assert "rms error against the reference  best_accuracy  thesis\n" in ended.out
    assert entries(tmp_path / "recon-demo") == {"drive", "best_accuracy", "thesis"}
    again = cli("demo")
    assert (again.code, again.out) == (2, "")
