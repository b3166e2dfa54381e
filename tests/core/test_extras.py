"""A package that is not installed is one sentence with the command; anything else that is wrong stays what it is."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

from recon.errors import PluginError
from recon.extras import missing, needs

ROOT = Path(__file__).parents[2]


def test_a_missing_package_is_one_sentence_with_the_command():
    with (
        pytest.raises(PluginError) as caught,
        needs("exporter.own", "Nothing", extra="own"),
    ):
        import no_such_package_at_all  # noqa: F401
    assert str(caught.value) == 'exporter.own needs Nothing\n  pip install "recon-dynamics[own]"'
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    assert caught.value.exit_code == 3


def test_a_module_of_ours_that_is_missing_is_a_fault_of_ours(monkeypatch):
    monkeypatch.setitem(sys.modules, "recon.nowhere", None)
    with pytest.raises(ModuleNotFoundError), needs("exporter.own", "Nothing", extra="own"):
        import recon.nowhere  # noqa: F401


def test_what_is_there_passes():
    with needs("exporter.own", "json", extra="own"):
        import json
    assert json.dumps(1) == "1"
    assert str(missing("a", "b", "c")).startswith("a needs b")


def test_every_extra_that_is_named_is_declared():
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    files = [path for folder in ("recon", "plugins") for path in (ROOT / folder).rglob("*.py")]
    named = {
        name
        for path in files
        for name in re.findall(r'(?:needs|missing)\(.*extra="(\w+)"', path.read_text(encoding="utf-8"))
    }
    assert len(named) > 5
    assert named - {"own"} <= set(declared)
