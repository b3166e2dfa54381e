"""`recon plugins`: what is installed, and what a stage takes, reads and writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, bad_option, registry_of
from recon.cli._stage import as_text, described
from recon.errors import PluginError
from recon.problems import did_you_mean, one_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from recon.registry import Registry


def plugins(
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[ROLE | show NAME]", help="One role only, or one stage in full.")
    ] = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """List the stages that are installed, or show one of them.

    Example: recon plugins show filter.resample
    """
    registry = registry_of(blocked, first_party_only)
    match words or []:
        case ["show", name]:
            shown: Any = described(name, registry)
            told = as_text(shown)
        case ["show"]:
            raise bad_option("'show' needs the name of a stage", "'recon plugins' lists them")
        case []:
            shown = _listed(registry, None)
            told = _list_text(shown)
        case [role]:
            shown = _listed(registry, _known_role(role))
            told = _list_text(shown)
        case _:
            raise bad_option("too many words", "write 'recon plugins ROLE' or 'recon plugins show NAME'")
    if as_json:
        console.write_json(shown)
    else:
        console.write(told)


def _known_role(role: str) -> str:
    from recon.stages import ROLES

    singular = role.removesuffix("s")
    if singular not in ROLES:
        hint = f"write 'recon plugins show {role}'" if "." in role else did_you_mean(role, ROLES)
        raise bad_option(f"there is no role '{role}'", hint or f"roles are {one_of(list(ROLES))}")
    return singular


def _listed(registry: Registry, only: str | None) -> list[dict[str, Any]]:
    """A record for each stage, by role; `broken` is the reason why a stage cannot be used."""
    from recon.stages import ROLES

    found = []
    for role in [only] if only else ROLES:
        for key in registry.names(role):
            summary, broken = "", ""
            try:
                summary = registry.get(key).summary
            except PluginError as error:
                broken = error.message
            source = registry.source(key)
            found.append(
                {
                    "name": key,
                    "role": role,
                    "summary": summary,
                    "distribution": source.distribution,
                    "distribution_version": source.version,
                    "broken": broken,
                }
            )
    return found


def _list_text(stages: Sequence[dict[str, Any]]) -> str:
    if not stages:
        return "none is installed"
    rows = []
    for stage in stages:
        what = f"BROKEN: {stage['broken']}" if stage["broken"] else stage["summary"]
        rows.append((stage["name"], f"{stage['distribution']} {stage['distribution_version']}", what))
    return console.table(rows, indent=0)
