"""Options that several verbs share, and what their texts mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

import typer

from recon.errors import ConfigError
from recon.problems import Problem, Where, did_you_mean, one_of

if TYPE_CHECKING:
    from recon.overrides import Override
    from recon.registry import Registry

Inputs: TypeAlias = Annotated[
    list[Path] | None, typer.Argument(metavar="INPUT", help="Log file or folder; several are one drive.")
]
Settings: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="STEP.PARAM=VALUE", help="Set a parameter; @FILE reads the value from YAML."),
]
Store: TypeAlias = Annotated[
    str | None, typer.Option("--store", metavar="KIND", help="How streams are kept: parquet or mcap.")
]
Overwrite: TypeAlias = Annotated[bool, typer.Option("--overwrite", help="Replace an older result.")]
_TIME: Final = "'120s' (after the first row) or an ISO time."
Start: TypeAlias = Annotated[
    str | None, typer.Option("--from", metavar="A", help=f"Leave out the rows before: {_TIME}")
]
Stop: TypeAlias = Annotated[str | None, typer.Option("--to", metavar="B", help="Leave out the rows after, likewise.")]
AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Blocked: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--no-plugin", metavar="NAME", help="Do without a stage, or without all stages of a distribution."),
]
FirstPartyOnly: TypeAlias = Annotated[
    bool, typer.Option("--first-party-only", help="Do without the stages of all other distributions.")
]


def registry_of(blocked: Sequence[str] | None, first_party_only: bool) -> Registry:
    """The stages that `--no-plugin` and `--first-party-only` leave. Raises ConfigError."""
    from recon.registry import Registry

    return Registry.installed(block=blocked or (), first_party_only=first_party_only)


def overrides_of(settings: Sequence[str] | None) -> list[Override]:
    """What `--set` asks for. Raises ConfigError with the problems of all of them."""
    from recon.overrides import Override

    found: list[Override] = []
    problems: list[Problem] = []
    for option in settings or ():
        try:
            found.append(Override.from_option(option))
        except ConfigError as error:
            problems += error.problems
    if problems:
        raise ConfigError(problems)
    return found


def bad_option(text: str, hint: str, option: str = "") -> ConfigError:
    """What to raise where the words of a command make no sense. option : the one that is meant, with its value"""
    return ConfigError([Problem(Where(option) if option else None, "bad-option", text, hint)])


def check_store(store: str | None) -> None:
    """Raises ConfigError for a kind of store that there is not."""
    from recon.storage import STORES

    if store is not None and store not in STORES:
        hint = did_you_mean(store, STORES) or f"write {one_of(STORES)}"
        raise bad_option(f"there is no store '{store}'", hint, f"--store {store}")
