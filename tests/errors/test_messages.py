"""One broken pipeline for each kind of problem: pipelines/<name>.yaml gives exactly expected/<name>.txt.

To see what a new file gives: `cd tests/errors && recon validate pipelines/<name>.yaml`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from recon.errors import ConfigError
from recon.registry import Registry
from recon.validation import validate_pipeline
from recon.yaml_nodes import load_file

HERE = Path(__file__).parent
NAMES = sorted(path.stem for path in (HERE / "pipelines").iterdir())


def messages(file: str) -> str:
    try:
        _, problems = validate_pipeline(load_file(file), Registry.installed())
    except ConfigError as error:
        problems = list(error.problems)
    return "".join(f"{problem.as_text()}\n" for problem in problems)


@pytest.mark.parametrize("name", NAMES)
def test_a_broken_pipeline_gives_its_message(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    expected = (HERE / "expected" / f"{name}.txt").read_text(encoding="utf-8")
    assert messages(f"pipelines/{name}.yaml") == expected
    assert expected


def test_every_message_has_its_pipeline() -> None:
    assert sorted(path.stem for path in (HERE / "expected").iterdir()) == NAMES
