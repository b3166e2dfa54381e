"""What the documents name is there: files, headings, stages and their parameters, pipelines, commands that parse."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from recon.cli._app import _command
from recon.pipeline import shipped
from recon.registry import Registry
from recon.stages import ROLES

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    ROOT / "README.md",
    *sorted(p for d in ("pipelines", "plugins", "recon", "tests") for p in (ROOT / d).rglob("*.md")),
]
LINK = re.compile(r"\]\(([^)\s#]*)(?:#([^)\s]+))?\)")
SCRIPT = re.compile(r"(tests/(?:benchmarks|fuzz)/\w+\.py)((?: [^|`\n#]*)?)")
STAGE = re.compile(rf"(?<![\w./])((?:{'|'.join(ROLES)})\.[a-z]\w*)(?:\.([a-z]\w*))?")
IN_A_BLOCK = re.compile(r"^\s*(?:\S+ \| |.*&& \S*/)?recon ([a-z].*)$")
"""A line of a block that runs recon, also behind another program."""
USAGE_ERROR: Any = typer.BadParameter.__base__


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def headings(text: str) -> set[str]:
    """Anchors, as GitHub and others make them of headings."""
    found = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


def broken_links(path: Path, text: str) -> Iterator[str]:
    for target, anchor in LINK.findall(text):
        if target.startswith("http"):
            continue
        there = path.parent / target if target else path
        if not there.exists():
            yield target
        elif anchor and anchor not in headings(text if there == path else text_of(there)):
            yield f"{target}#{anchor}"


def broken_scripts(text: str) -> Iterator[str]:
    """Scripts that are not there, or whose source does not hold an option that they are given."""
    for script, words in SCRIPT.findall(text):
        source = ROOT / script
        if not source.is_file() or any(word not in text_of(source) for word in re.findall(r"--[a-z][a-z-]*", words)):
            yield f"{script}{words}"


def unknown_stages(text: str) -> Iterator[str]:
    """Stages and parameters that nothing declares, but for those of a plugin that the text itself makes."""
    registry, own = Registry.installed(), set(re.findall(r'"(\w+\.\w+)" = ', text))
    for key, parameter in STAGE.findall(text):
        if key in own:
            continue
        known = {info.name for info in registry.get(key).params.describe()} if key in registry else set()
        if key not in registry or (parameter and parameter not in known):
            yield f"{key}.{parameter}".rstrip(".")


def commands(text: str) -> Iterator[tuple[str, bool]]:
    """What stands behind `recon`, and whether it is a line of a block, which is meant to be run as it is."""
    lines, fenced = text.replace("\\\n", " ").splitlines(), False
    for line in lines:
        fenced ^= line.startswith("```")
        found = IN_A_BLOCK.match(line) if fenced or line.startswith("    ") else None
        if found:
            yield found[1], True
        else:
            yield from ((words, False) for words in re.findall(r"`recon ([a-z][^`]*)`", line))


def fault_of(words: list[str], whole: bool) -> str:
    """Why the command line takes no such words; of what is mentioned in passing only the verb and options count."""
    app = _command()
    with app.make_context("recon", [], resilient_parsing=True) as context:
        verb = app.get_command(context, words[0])
        if verb is None:
            return "no such verb"
        if not whole:
            known = {option for parameter in verb.params for option in parameter.opts}
            return ", ".join(word for word in words if word.startswith("--") and word not in known)
        try:
            given = verb.make_context(words[0], words[1:], parent=context).params
        except USAGE_ERROR as error:
            return str(error.format_message())
    pipeline = given.get("pipeline", "")
    unknown = re.fullmatch(r"[a-z_]+", pipeline) and pipeline not in shipped()
    return f"no such pipeline: {pipeline}" if unknown else ""


def broken_commands(text: str) -> Iterator[str]:
    own = set(re.findall(r'"pipeline\.(\w+)" = ', text))
    for command, whole in commands(text):
        words = shlex.split(command.partition(" > ")[0], comments=True)
        fault = fault_of(words, whole) if not own & set(words) else ""
        if fault:
            yield f"recon {command}: {fault}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_what_a_document_names_is_there(path):
    text = text_of(path)
    found = [*broken_links(path, text), *broken_scripts(text), *unknown_stages(text), *broken_commands(text)]
    assert found == []


def test_the_examples_of_the_command_line_parse():
    app = _command()
    with app.make_context("recon", [], resilient_parsing=True) as context:
        verbs = [app.get_command(context, name) for name in app.list_commands(context)]
    examples = [re.search(r"Example: recon (.*)", verb.help)[1] for verb in verbs]
    faults = {example: fault_of(shlex.split(example), whole=True) for example in examples}
    assert {example: fault for example, fault in faults.items() if fault} == {}


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("[a](README.md) [b](https://a.b/c) [c](recon/README.md#conventions)", 0),
        ("[a](READYOU.md)", 1),
        ("[a](recon/README.md#no-such-heading)", 1),
        ("`python tests/benchmarks/storage.py --rows 100`", 0),
        ("`python tests/benchmarks/storage.py --columns 100`", 1),
        ("`python tests/benchmarks/sandcastles.py`", 1),
        ("`fuser.map` with `fuser.map.lever_arm`", 0),
        ("`fuser.mop`", 1),
        ("`fuser.map.leever_arm`", 1),
        ('"filter.clip" = "clip"\n`filter.clip.limit`', 0),
        ("`recon verify --sha256` and `recon plugins`", 0),
        ("`recon verify --sha257`", 1),
        ("`recon verfy`", 1),
        ("    recon run thesis drive.txt --export csv   # and why", 0),
        ("    logger | recon live best_accuracy - --json", 0),
        ("    recon run thesis drive.txt --exprot csv", 1),
        ("    recon run theses drive.txt", 1),
        ("```sh\nrecon convert drive.txt\n```", 1),
    ],
)
def test_the_search_for_what_is_not_there_finds_what_it_should(text, count):
    path = ROOT / "README.md"
    found = [*broken_links(path, text), *broken_scripts(text), *unknown_stages(text), *broken_commands(text)]
    assert len(found) == count, found
