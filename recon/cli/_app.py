"""The typer application: the verbs, and how a command line is taken apart."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Any, Final

import typer
from typer.main import get_command

from recon import __version__
from recon.cli import _console as console
from recon.cli.allan import allan
from recon.cli.batch import batch
from recon.cli.blender_extension import blender_extension
from recon.cli.compare import compare
from recon.cli.convert import convert
from recon.cli.demo import demo
from recon.cli.doctor import doctor
from recon.cli.evaluate import evaluate
from recon.cli.explain import explain
from recon.cli.export import export
from recon.cli.fleet import fleet
from recon.cli.inspect import inspect
from recon.cli.live import live
from recon.cli.measure import measure
from recon.cli.new_plugin import new_plugin
from recon.cli.outages import outages
from recon.cli.plugins import plugins
from recon.cli.run import run
from recon.cli.schema import schema
from recon.cli.seal import seal
from recon.cli.validate import validate
from recon.cli.verify import verify
from recon.cli.view import view
from recon.errors import ConfigError

UNWRAPPED: Final = 1000
"""Characters in a line of help off a terminal."""

_VERBS: Final = (
    *(run, live, batch, fleet, validate, inspect, doctor, evaluate, compare, measure, outages, allan),
    *(explain, seal, verify),
    *(plugins, export, view, convert, demo, schema, new_plugin, blender_extension),
)
_USAGE_ERROR: Final[Any] = typer.BadParameter.__base__  # typer does not export its name


def invoke(words: Sequence[str]) -> int:
    """Run one command line; returns the exit code. Whatever a verb raises passes."""
    try:
        with _command().make_context("recon", list(words)) as context:
            context.command.invoke(context)
    except typer.Exit as end:
        return end.exit_code
    except _USAGE_ERROR as error:
        message = error.format_message().rstrip(".")
        path = error.ctx.command_path if error.ctx else "recon"
        console.write_error(f"error: {message[:1].lower()}{message[1:]}\n  '{path} --help' shows what it takes")
        return ConfigError.exit_code
    return 0


def _command() -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    width = {"max_content_width": 120} if sys.stdout.isatty() else {"terminal_width": UNWRAPPED}
    settings = {"help_option_names": ["-h", "--help"], **width}
    app.callback(invoke_without_command=True, context_settings=settings)(_top)
    for verb in _VERBS:
        about = (verb.__doc__ or "").partition("\n")[
            0
        ]  # as a whole: what is not given as short_help is cut at the width
        app.command(short_help=about)(console.only_results()(verb))
    return get_command(app)


def _top(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    verbose: Annotated[
        bool, typer.Option("-v", "--verbose", help="Anywhere in the line: show where an error came from.")
    ] = False,  # taken out of the line before it gets here
) -> None:
    """What a vehicle did, from the log of its sensors.

    Example: recon run thesis drive.txt
    """
    if version:
        console.write(f"recon {__version__}")
    elif context.invoked_subcommand is None:
        console.write(context.get_help())
