"""JSON Schema of pipeline and batch files, for editors that complete and check YAML.

It is made of the stages at hand: the parameters of each hang on the name behind `use:`. It tells the form; whether the
streams of a pipeline fit together, `recon validate` tells.

Reference: JSON Schema, draft 2020-12.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

from recon.batch import BYTES, ON_ERROR
from recon.errors import PluginError
from recon.parameters import json_schema
from recon.pipeline import FORMAT
from recon.registry import Registry
from recon.stages import ROLES, Executor, Exporter, Reader, role_of
from recon.storage import STORES

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"

Json: TypeAlias = dict[str, Any]

_QUANTITY: Final = r"^\s*[0-9.].*[^0-9.\s]"
_SIZE: Final = rf"^[0-9]+(\.[0-9]*)?\s*({'|'.join(BYTES)})$"


def yaml_schema(registry: Registry) -> Json:
    """One schema document: a pipeline or a batch file. A stage that cannot be used may have any parameters."""
    keys = [key for role in ROLES for key in registry.names(role)]
    definitions: Json = {}
    needs: dict[str, list[str]] = {}
    for key in keys:
        definitions |= _params(key, registry)
        needs[key] = definitions[key].pop("required", [])
    return {
        "$schema": DIALECT,
        "title": "recon: a pipeline or a batch file",
        "oneOf": [_ref("pipeline"), _ref("batch")],
        "$defs": {
            "pipeline": _pipeline(),
            "batch": _batch(keys),
            "step": _step([key for key in keys if role_of(key) != Executor.role], needs),
            "executor": _uses([key for key in keys if role_of(key) == Executor.role], needs),
            "overrides": _overrides(keys),
            **definitions,
        },
    }


def _params(key: str, registry: Registry) -> Json:
    """Definition of a stage's parameters under its key, and the definitions that it refers to."""
    try:
        stage = registry.get(key)
    except PluginError as error:
        return {key: {"type": ["object", "null"], "description": error.message}}
    schema = _moved(json_schema(stage.params), key)
    parts = {f"{key}.{name}": part for name, part in schema.pop("$defs", {}).items()}
    schema |= {"title": key, "description": stage.summary, "type": ["object", "null"]}
    if isinstance(stage, Reader) and stage.delegates:
        schema["properties"] |= {name: _ref(name) for name in registry.names(Reader.role) if name != key}
    return {key: schema, **parts}


def _moved(schema: Any, key: str) -> Any:
    """A copy whose references lead to definitions that are named after the stage."""
    if isinstance(schema, list):
        return [_moved(part, key) for part in schema]
    if not isinstance(schema, Mapping):
        return schema
    moved = {name: _moved(part, key) for name, part in schema.items()}
    if isinstance(moved.get("$ref"), str):
        moved["$ref"] = moved["$ref"].replace("#/$defs/", f"#/$defs/{key}.", 1)
    return moved


def _pipeline() -> Json:
    return _object(
        "A pipeline: steps, read from top to bottom.",
        {
            "recon": {"const": FORMAT, "description": "Number of the format."},
            "name": _text("Default: the name of the file."),
            "about": _text("What it does, in a sentence."),
            "store": {"enum": list(STORES), "description": "How streams are kept."},
            "steps": {"type": "array", "minItems": 1, "items": _ref("step")},
        },
        required=["steps"],
    )


def _step(keys: Sequence[str], needs: Mapping[str, list[str]]) -> Json:
    step = _uses(keys, needs)
    ports: Json = {"type": ["object", "null"], "additionalProperties": {"type": "string"}}
    step["properties"] |= {
        "id": _text("Default: what stands after use."),
        "in": {**ports, "description": "Streams to read, by port."},
        "out": {**ports, "description": "Streams to write, by port."},
    }
    return step


def _uses(keys: Sequence[str], needs: Mapping[str, list[str]]) -> Json:
    """An object with `use`, and the `params` that belong to it."""
    properties = {
        "use": {"enum": list(keys), "description": "<role>.<name>, see 'recon plugins'."},
        "params": {"type": ["object", "null"], "description": "Parameters by name; a quantity has its unit."},
    }
    uses = _object("A stage and its parameters.", properties, required=["use"])
    choices = [
        {
            "if": {"properties": {"use": {"const": key}}, "required": ["use"]},
            "then": {
                "properties": {"params": {**_ref(key), "required": needs[key]}},
                "required": ["params"] if needs[key] else [],
            },
        }
        for key in keys
    ]
    return {**uses, "allOf": choices} if choices else uses


def _overrides(keys: Sequence[str]) -> Json:
    return {
        "type": ["object", "null"],
        "description": "Parameters by step: its id, its stage, or a reader behind reader.auto.",
        "properties": {key: _ref(key) for key in keys if role_of(key) != Executor.role},
        "additionalProperties": {"type": "object"},
    }


def _batch(keys: Sequence[str]) -> Json:
    exporters = [key for key in keys if role_of(key) == Exporter.role]
    names = [*(key.partition(".")[2] for key in exporters), *exporters]
    named = "'parent N' for the N-th folder above the file, 'stem', or a regex with a group of this name."
    glob = {"glob": _text("Pattern of files."), "vehicle": _text(named), "drive": _text(named)}
    listed = {"list": _text("CSV file with the columns path, vehicle, drive.")}
    places = [_object("Files.", glob, required=["glob"]), _object("A list.", listed, required=["list"])]
    return _object(
        "A batch file: one pipeline over many recordings.",
        {
            "recon": {"const": FORMAT, "description": "Number of the format."},
            "batch": _text("Name of the batch."),
            "pipeline": _text("A shipped name or a file."),
            "inputs": {"type": "array", "minItems": 1, "items": {"oneOf": places}},
            "output": _text("Folder for the results."),
            "defaults": _ref("overrides"),
            "vehicles": {"type": ["object", "null"], "additionalProperties": _ref("overrides")},
            "exports": {"type": ["array", "null"], "items": {"enum": names}},
            "executor": _ref("executor"),
            "on_error": {"enum": list(ON_ERROR)},
            "retries": {"type": "integer", "minimum": 0},
            "timeout": {"type": "string", "pattern": _QUANTITY, "examples": ["10 min"]},
            "memory": {"type": "string", "pattern": _SIZE, "examples": ["2 GB"]},
            "resume": {"type": "boolean"},
        },
        required=["batch", "pipeline", "inputs", "output"],
    )


def _object(description: str, properties: Json, required: list[str]) -> Json:
    return {
        "description": description,
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


def _text(description: str) -> Json:
    return {"type": "string", "description": description}


def _ref(name: str) -> Json:
    return {"$ref": f"#/$defs/{name}"}
