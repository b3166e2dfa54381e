"""Help, version, and command lines that are wrong."""

from __future__ import annotations

import pytest
from cli_box import Cli

import recon
from recon.cli import _report

VERBS = (
    *("run", "validate", "inspect", "plugins", "export", "convert", "demo", "schema", "new-plugin"),
    "blender-extension",
)


def test_without_a_verb_it_shows_help_that_names_all_of_them(cli: Cli) -> None:
    ended = cli()
    assert ended.code == 0
    assert ended == cli("--help")
    for verb in VERBS:
        assert f"\n  {verb} " in ended.out


def test_every_verb_has_help_with_an_example(cli: Cli) -> None:
    for verb in VERBS:
        ended = cli(verb, "--help")
        assert ended.code == 0
        assert f"Example: recon {verb}" in ended.out


def test_the_version_is_that_of_the_package(cli: Cli) -> None:
    assert cli("--version") == (0, f"recon {recon.__version__}\n", "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rnu"], "no such command 'rnu'"),
        (["run"], "missing argument 'PIPELINE'"),
        (["run", "box.yaml", "--ouch"], "no such option: --ouch"),
        (["validate", "box.yaml", "--format", "xml"], "'xml' is not one of"),
    ],
)
def test_a_wrong_command_line_is_told_in_two_plain_lines(cli: Cli, words: list[str], message: str) -> None:
    ended = cli(*words)
    assert (ended.code, ended.out) == (2, "")
    first, second = ended.err.splitlines()
    assert first.startswith("error: ")
    assert message in first
    assert "--help' shows what it takes" in second


def test_an_unforeseen_error_is_one_sentence_without_a_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert _report(KeyError("x"), verbose=False) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: this is a fault of recon")
    assert line.endswith("KeyError: 'x'")


def test_the_list_of_verbs_is_wrapped_in_a_narrow_terminal_and_not_cut() -> None:
    from recon.cli._app import _command

    told = _command().make_context("recon", [], terminal_width=80, max_content_width=80).get_help()
    assert "..." not in told.partition("Commands:")[2]
    assert "units, axes, clocks, samples, receiver." in " ".join(told.split())
