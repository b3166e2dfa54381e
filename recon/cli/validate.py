"""`recon validate`: every problem of pipelines and batch files, without any data."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

import typer

from recon.cli import _console as console
from recon.cli._options import Blocked, FirstPartyOnly, registry_of
from recon.errors import ConfigError, PluginError
from recon.problems import Problem, Where

if TYPE_CHECKING:
    from recon.registry import Registry

BROKEN: Final = "broken-stage"


class Format(StrEnum):
    """How problems are printed."""

    text = "text"
    json = "json"
    github = "github"


def validate(
    files: Annotated[list[str], typer.Argument(metavar="FILE", help="Pipelines or batch files.")],
    format: Annotated[
        Format, typer.Option(help="How problems are printed; github: annotations of GitHub Actions.")
    ] = Format.text,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
) -> None:
    """Print every problem of pipelines and batch files.

    Example: recon validate pipelines/my_pipeline.yaml
    """
    registry = registry_of(blocked, first_party_only)
    problems: list[Problem] = []
    for file in files:
        what, found = _validated(file, registry)
        problems += found
        if not found and format is not Format.json:
            console.write(f"{file}: {what}")
    if format is Format.json:
        console.write_json([problem.as_dict() for problem in problems])
    elif problems:
        console.write("\n".join(p.as_github() if format is Format.github else p.as_text() for p in problems))
    if problems:
        only_broken = all(problem.code == BROKEN for problem in problems)
        raise typer.Exit(PluginError.exit_code if only_broken else ConfigError.exit_code)


def _validated(file: str, registry: Registry) -> tuple[str, list[Problem]]:
    """What a file is, in words, and its problems."""
    from recon.form import is_batch
    from recon.pipeline import find
    from recon.validation import validate_pipeline
    from recon.yaml_nodes import load_file

    try:
        root = load_file(find(file))
        if is_batch(root):
            from recon.batch import parse
            from recon.batch_plan import check_batch

            batch, problems = parse(root)
            return f"batch '{batch.name}' is valid", problems + check_batch(batch, registry)
        pipeline, problems = validate_pipeline(root, registry)
        count = len(pipeline.steps)
        return f"pipeline '{pipeline.name}' is valid, {count} step{'s' * (count != 1)}", problems
    except ConfigError as error:
        return "", list(error.problems)
    except PluginError as error:
        return "", [Problem(Where(file), BROKEN, error.message, error.hint)]
