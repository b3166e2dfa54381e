"""The author's guide, plugins/README.md, does what it says: its snippets are files, modules, commands and tests."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest

from recon.pipeline import Pipeline

GUIDE = Path(__file__).parents[2] / "plugins" / "README.md"
LANGUAGES = {"python", "toml", "yaml", "sh"}


class Snippet(NamedTuple):
    language: str
    text: str
    line: int


def snippets(*languages: str) -> list[Snippet]:
    """The code blocks of the guide, in its order."""
    text = GUIDE.read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    every = [Snippet(block[1], block[2], text.count("\n", 0, block.start()) + 1) for block in found]
    return [one for one in every if not languages or one.language in languages]


def is_test(snippet: Snippet) -> bool:
    return "@contract(" in snippet.text


MODULE, PROJECT = snippets("python")[0].text, snippets("toml")[0].text
PLAIN = [one for one in snippets("python")[1:] if not is_test(one)]
COMMANDS = [line for block in snippets("sh") for line in block.text.splitlines()]


class Place(NamedTuple):
    """Where the guide is followed: a working folder, and what its first plugin is installed into."""

    folder: Path
    site: Path

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A command that finds the plugin."""
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(self.site), *filter(None, sys.path)])}
        command = [sys.executable, "-m", *words]
        return subprocess.run(
            command, cwd=self.folder, env=env, capture_output=True, text=True, encoding="utf-8", check=False
        )


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """The first example as its files, installed by pip."""
    folder = tmp_path_factory.mktemp("guide")
    (folder / "clip.py").write_text(MODULE, encoding="utf-8")
    (folder / "pyproject.toml").write_text(PROJECT, encoding="utf-8")
    return installed(folder)


def installed(folder: Path) -> Place:
    """The distribution in a folder, installed into a folder in it."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    offline = ["--no-deps", "--no-build-isolation", "--target", str(folder / "site")]
    subprocess.run([*pip, *offline, str(folder)], check=True)
    return Place(folder, folder / "site")


def test_every_snippet_is_of_a_kind_that_is_run_here() -> None:
    assert {one.language for one in snippets()} == LANGUAGES


def test_the_first_plugin_is_listed_under_its_distribution(place: Place) -> None:
    (line,) = [line for line in place.run("recon", "plugins").stdout.splitlines() if line.startswith("filter.clip ")]
    assert line.split(maxsplit=3) == ["filter.clip", "recon-clip", "0.1.0", "Limits the accelerations of imu."]


@pytest.mark.parametrize("snippet", PLAIN, ids=lambda snippet: f"line {snippet.line}")
def test_python_snippets_run(snippet: Snippet) -> None:
    subprocess.run([sys.executable, "-c", snippet.text], check=True)


def test_the_first_plugin_keeps_its_laws_by_the_tests_of_the_guide(place: Place) -> None:
    parts = ["from clip import ClipParams", *(one.text for one in snippets("python") if is_test(one))]
    (place.folder / "test_contract.py").write_text("\n\n".join(parts), encoding="utf-8")
    done = place.run("pytest", "-q", "-p", "no:cacheprovider", "test_contract.py")
    assert done.returncode == 0, done.stdout
    assert "filter.clip" in done.stdout


@pytest.mark.parametrize("line", [line for line in COMMANDS if line.startswith("recon ")])
def test_commands_of_recon_work(line: str, place: Place) -> None:
    done = place.run(*shlex.split(line))
    assert done.returncode == 0, done.stderr


def test_other_commands_are_those_of_installers_and_pytest() -> None:
    assert {line.split()[0] for line in COMMANDS} == {"recon", "pip", "pytest"}
    assert {line for line in COMMANDS if line.startswith("pip ")} == {"pip install .", 'pip install -e ".[test]"'}


@pytest.mark.parametrize("snippet", snippets("yaml"), ids=lambda snippet: f"line {snippet.line}")
def test_pipelines_are_valid(snippet: Snippet, place: Place) -> None:
    assert Pipeline.from_text(snippet.text).steps
    (place.folder / "snippet.yaml").write_text(snippet.text, encoding="utf-8")
    done = place.run("recon", "validate", "snippet.yaml")
    assert done.returncode == 0, done.stdout


def test_a_pipeline_that_is_shipped_as_told_is_found_by_its_name(place: Place, tmp_path: Path) -> None:
    shipping, pipeline = snippets("toml")[-1].text, snippets("yaml")[-1].text
    head, _, _ = PROJECT.partition("[project.entry-points")
    (tmp_path / "clip_pipelines").mkdir()
    (tmp_path / "clip_pipelines" / "__init__.py").touch()
    (tmp_path / "clip_pipelines" / "clipped.yaml").write_text(pipeline, encoding="utf-8")
    (tmp_path / "clip.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "pyproject.toml").write_text(head + shipping, encoding="utf-8")
    done = installed(tmp_path).run("recon", "validate", "clipped")
    assert done.stdout == "clipped: pipeline 'clipped' is valid, 2 steps\n", done.stderr


def test_toml_snippets_name_the_group_of_recon() -> None:
    for snippet in snippets("toml"):
        assert "filter.clip" in tomllib.loads(snippet.text)["project"]["entry-points"]["recon.plugins"]
