"""`recon plugins`: what is installed, and what a stage takes, reads and writes."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from recon.cli import _console as console
from recon.cli._columns import column_rows
from recon.cli._options import AsJson
from recon.errors import ConfigError, PluginError
from recon.problems import Problem, did_you_mean, one_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from recon.registry import Registry
    from recon.schema import Change, Column, Schema


def plugins(
    words: Annotated[
        list[str] | None, typer.Argument(metavar="[ROLE | show NAME]", help="One role only, or one stage in full.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the stages that are installed, or show one of them.

    Example: recon plugins show filter.resample
    """
    from recon.registry import Registry

    registry = Registry.installed()
    match words or []:
        case ["show", name]:
            shown: Any = _described(name, registry)
            told = _stage_text(shown)
        case []:
            shown = _listed(registry, None)
            told = _list_text(shown)
        case [role]:
            shown = _listed(registry, _known_role(role))
            told = _list_text(shown)
        case _:
            raise _unknown("too many words", "write 'recon plugins ROLE' or 'recon plugins show NAME'")
    if as_json:
        console.write_json(shown)
    else:
        console.write(told)


def _known_role(role: str) -> str:
    from recon.stages import ROLES

    singular = role.removesuffix("s")
    if singular not in ROLES:
        hint = f"write 'recon plugins show {role}'" if "." in role else did_you_mean(role, ROLES)
        raise _unknown(f"there is no role '{role}'", hint or f"roles are {one_of(list(ROLES))}")
    return singular


def _unknown(text: str, hint: str) -> ConfigError:
    return ConfigError([Problem(None, "bad-option", text, hint)])


# --- the list -------------------------------------------------------------------------------------------------------


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


# --- one stage ------------------------------------------------------------------------------------------------------


def _described(key: str, registry: Registry) -> dict[str, Any]:
    """A stage as JSON data. Raises PluginError."""
    stage, source = registry.get(key), registry.source(key)
    return {
        "name": stage.key,
        "summary": stage.summary,
        "version": stage.version,
        "distribution": source.distribution,
        "distribution_version": source.version,
        "module": source.module,
        "parameters": [asdict(parameter) for parameter in stage.params.describe()],
        "reads": {
            port: {"optional": need.optional, "columns": [_column(column) for column in need.columns]}
            for port, need in stage.reads.items()
        },
        "writes": {name: _effect(effect) for name, effect in stage.writes.items()},
        "writes_depend_on_reads": stage.plan is not None,
        "references": list(stage.references),
    }


def _column(column: Column) -> dict[str, Any]:
    facts = {"name": column.name, "unit": column.unit, "frame": column.frame, "quantity": column.quantity}
    return {**facts, "optional": column.optional}


def _effect(effect: Schema | Change) -> dict[str, Any]:
    """What becomes of a stream: new as a whole, or changed."""
    from recon.schema import Schema

    if isinstance(effect, Schema):
        return {"new": True, "columns": [_column(column) for column in effect.columns]}
    return {
        "new": False,
        "columns": [_column(column) for column in effect.adds],
        "frames": dict(effect.frames),
        "quantities": dict(effect.quantities),
        "drops": list(effect.drops),
    }


def _stage_text(stage: dict[str, Any]) -> str:
    origin = f"{stage['distribution']} {stage['distribution_version']}, {stage['module']}"
    lines = [f"{stage['name']}  version {stage['version']}  ({origin})", stage["summary"]]
    lines += ["", "parameters", _parameter_table(stage["parameters"])]
    for verb in ("reads", "writes"):
        lines += ["", verb]
        for name, stream in stage[verb].items():
            lines += [f"  {name}{_stream_note(stream)}", *_stream_lines(stream)]
        if not stage[verb]:
            lines.append("  no stream")
    if stage["writes_depend_on_reads"]:
        lines.append("  (of these, what the streams that it reads allow)")
    if stage["references"]:
        lines += ["", "references", *(f"  {reference}" for reference in stage["references"])]
    return "\n".join(lines)


def _parameter_table(parameters: Iterable[dict[str, Any]]) -> str:
    rows = [(p["name"], p["type"], p["default"], p["unit"], p["doc"]) for p in parameters]
    return console.table([("name", "type", "default", "unit", "meaning"), *rows]) if rows else "  none"


def _stream_note(stream: dict[str, Any]) -> str:
    if stream.get("optional"):
        return "  (may be absent)"
    if stream.get("new", True):
        return ""
    changes = any(stream[key] for key in ("columns", "frames", "quantities", "drops"))
    return "  (as it was read, but for:)" if changes else "  (as it was read)"


def _stream_lines(stream: dict[str, Any]) -> list[str]:
    rows = column_rows(stream["columns"])
    lines = [console.table(rows, indent=4)] if rows else []
    lines += [f"    {group} is then in frame {frame}" for group, frame in stream.get("frames", {}).items()]
    lines += [f"    {group} is then {quantity}" for group, quantity in stream.get("quantities", {}).items()]
    return lines + [f"    {group} is gone" for group in stream.get("drops", ())]
