"""One stage in full, as its author and a writer of YAML need it: as JSON data and as text."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import TYPE_CHECKING, Any

from recon.cli import _console as console
from recon.cli._columns import column_rows

if TYPE_CHECKING:
    from recon.declaration import Stage
    from recon.registry import Registry
    from recon.schema import Change, Column, Schema


def described(key: str, registry: Registry) -> dict[str, Any]:
    """A stage as JSON data. Raises PluginError."""
    stage, source = registry.get(key), registry.source(key)
    parameters = [asdict(parameter) for parameter in stage.params.describe()]
    return {
        "name": stage.key,
        "summary": stage.summary,
        "version": stage.version,
        "distribution": source.distribution,
        "distribution_version": source.version,
        "module": source.module,
        "capabilities": _capabilities(stage),
        "parameters": [parameter for parameter in parameters if not _delegates(stage)],
        "parameters_of_readers": _delegates(stage),
        "reads": {
            port: {"optional": need.optional, "columns": [_column(column) for column in need.columns]}
            for port, need in stage.reads.items()
        },
        "writes": {name: _effect(effect) for name, effect in stage.writes.items()},
        "writes_depend_on_reads": stage.plan is not None,
        "references": list(stage.references),
        "yaml": _yaml(stage),
    }


def _delegates(stage: Stage) -> bool:
    from recon.stages import Reader

    return isinstance(stage, Reader) and stage.delegates


def _capabilities(stage: Stage) -> dict[str, Any]:
    """What the record declares of itself beyond what every record does; a function of its own counts as True."""
    from recon.declaration import Stage

    common = {field.name for field in fields(Stage)} - {"every_stream"}
    own = {field.name: getattr(stage, field.name) for field in fields(stage) if field.name not in common}
    return {name: True if callable(value) else value for name, value in own.items() if value}


def _yaml(stage: Stage) -> str:
    """The stage as a step of a pipeline, or as the executor of a batch file, with its defaults.

    A parameter that must be given has a placeholder; one whose default is none is left out.
    """
    from recon.pipeline import Pipeline, Step
    from recon.problems import Where
    from recon.stages import Executor
    from recon.yaml_nodes import Node

    where = Where(f"<{stage.key}>")
    given: dict[str, Any] = {} if _delegates(stage) else stage.params.model_construct().as_text()
    for parameter in stage.params.describe():
        if parameter.default == "required":
            given[parameter.name] = f"<{', '.join(filter(None, (parameter.type, parameter.unit)))}>"
    params = Node.of({name: value for name, value in given.items() if value is not None}, where)
    _, _, text = Pipeline("", (Step(stage.key, stage.key, params, where),)).to_yaml().partition("steps:\n")
    return text.replace("-", "executor:\n ", 1) if isinstance(stage, Executor) else text


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


def as_text(stage: dict[str, Any]) -> str:
    """What `described` gives, for a console."""
    origin = f"{stage['distribution']} {stage['distribution_version']}, {stage['module']}"
    lines = [f"{stage['name']}  version {stage['version']}  ({origin})", stage["summary"]]
    if stage["capabilities"]:
        lines += ["", f"capabilities: {', '.join(map(_capability, stage['capabilities'].items()))}"]
    lines += ["", "parameters", _parameter_table(stage)]
    for verb in ("reads", "writes"):
        lines += ["", verb]
        for name, stream in stage[verb].items():
            lines += [f"  {name}{_stream_note(stream)}", *_stream_lines(stream)]
        if not stage[verb]:
            whole = verb == "reads" or stage["writes_depend_on_reads"]
            every = whole and stage["capabilities"].get("every_stream")
            lines.append("  every stream" if every else "  no stream")
    if stage["writes_depend_on_reads"]:
        lines.append("  (of these, what the streams that it reads allow)")
    if stage["references"]:
        lines += ["", "references", *(f"  {reference}" for reference in stage["references"])]
    lines += ["", "in YAML", *(f"  {line}" for line in stage["yaml"].splitlines())]
    return "\n".join(lines)


def _capability(declared: tuple[str, Any]) -> str:
    name, value = declared
    if isinstance(value, dict):
        value = ", ".join(f"{key}={part}" for key, part in value.items())
    elif isinstance(value, tuple):
        value = " and ".join(map(str, value))
    return name if value is True else f"{name} {value}"


def _parameter_table(stage: dict[str, Any]) -> str:
    if stage["parameters_of_readers"]:
        return "  those of other readers, each under the reader's name"
    rows = [(p["name"], p["type"], p["default"], p["unit"], p["doc"]) for p in stage["parameters"]]
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
