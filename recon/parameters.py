"""Parameters of stages: typed, documented, in SI inside, written with units by people.

    class LowpassParams(Params):
        cutoff: float = quantity(12.0, "Hz", gt=0, doc="Frequency at which the gain is one half.")
        order: int = setting(4, gt=0, doc="Order of the filter before it runs forward and back.")

In text (YAML, `--set`, overrides) a quantity is written with its unit, "12 Hz", and a bare number is refused. In
Python a float is in SI: LowpassParams(cutoff=12.0).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails

from recon.errors import PluginInvalid
from recon.problems import Problem, did_you_mean, one_of
from recon.units import UnitError, convert, format_quantity, parse_quantity, si_unit
from recon.yaml_nodes import Node

_IN_TEXT: Final = {"in_text": True}
_LIMITS: Final = ("gt", "ge", "lt", "le")
_CHOICE: Final = re.compile(r"'([^']*)'")
_NUMBER: Final = "must be a number"
_WORDINGS: Final = {
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
    "float_type": _NUMBER,
    "finite_number": "must be a finite number",
    "int_type": "must be a whole number",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping",
    "literal_error": "must be {expected}",
    "missing": "has too few entries",
    "too_long": "has too many entries",
}
"""pydantic's kinds of error in words for somebody who has never heard of it."""

_TYPES: Final[Mapping[Any, str]] = {
    float: "number",
    int: "whole number",
    bool: "true or false",
    str: "text",
    dict: "mapping",
    tuple: "list",
    list: "list",
    NoneType: "none",
    Any: "anything",
}


def setting(default: Any = ..., *, doc: str, **limits: Any) -> Any:
    """A parameter without a unit: a count, a choice, a switch. limits : gt, ge, lt, le, min_length, max_length."""
    return Field(default, description=doc, **limits)


def quantity(default: Any, unit: str, *, doc: str, **limits: float) -> Any:
    """A parameter with a unit. The default and the limits (gt, ge, lt, le) are given in `unit`, kept in SI.

    default : a number, a tuple of numbers, None, or ... for a parameter that must be given
    """
    si = si_unit(unit)
    if isinstance(default, tuple):
        value: Any = tuple(convert(part, unit, si) for part in default)
    else:
        value = default if default in (None, ...) else convert(default, unit, si)
    inside = {name: convert(limit, unit, si) if name in _LIMITS else limit for name, limit in limits.items()}
    return Field(value, description=doc, json_schema_extra={"unit": unit}, **inside)  # type: ignore[call-overload]


@dataclass(frozen=True)
class ParamInfo:
    """What a user needs to know of one parameter; type in words, default and unit as a person writes them."""

    name: str
    type: str
    default: str
    unit: str
    doc: str


class Params(BaseModel):
    """Base of every parameter class. Frozen; unknown names are refused; numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, validate_default=False)

    @field_validator("*", mode="before")
    @classmethod
    def _from_text(cls, value: Any, info: ValidationInfo) -> Any:
        name = info.field_name or ""
        unit = unit_of(cls, name)
        if unit:
            value = _in_si(value, unit, in_text=bool(info.context))
        wanted = cls.model_fields[name].annotation
        wants_tuple = tuple in (get_origin(wanted), *map(get_origin, get_args(wanted)))
        return _tuples(value) if wants_tuple else value

    @classmethod
    def describe(cls) -> list[ParamInfo]:
        """Every parameter with its type, default, unit and meaning."""
        return [
            ParamInfo(
                name, _type_name(info.annotation), _shown_default(cls, name), unit_of(cls, name), info.description or ""
            )
            for name, info in cls.model_fields.items()
        ]

    def as_text(self) -> dict[str, Any]:
        """Every parameter as YAML would hold it; read back, it gives the same values to the last bit."""
        return {name: _as_text(value, unit_of(type(self), name)) for name, value in self.model_dump().items()}

    def as_si(self) -> dict[str, Any]:
        """Every parameter as JSON data, numbers in SI."""
        data: dict[str, Any] = self.model_dump(mode="json")
        return data


class NoParams(Params):
    """For stages that have nothing to set."""


def unit_of(params: type[Params], name: str) -> str:
    """Unit in which a person writes the parameter, "" where it has none."""
    extra = params.model_fields[name].json_schema_extra
    return str(extra.get("unit", "")) if isinstance(extra, dict) else ""


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _in_si(value: Any, unit: str, *, in_text: bool) -> Any:
    if isinstance(value, str):
        return parse_quantity(value, into=si_unit(unit))
    if isinstance(value, list | tuple):
        return type(value)(_in_si(part, unit, in_text=in_text) for part in value)
    if in_text and isinstance(value, int | float) and not isinstance(value, bool):
        raise UnitError(f"a unit is missing: write for example '{value} {unit}'")
    return value


def _as_text(value: Any, unit: str) -> Any:
    if isinstance(value, list | tuple):
        return [_as_text(part, unit) for part in value]
    if unit and isinstance(value, int | float):
        return format_quantity(value, unit)
    return value


def _shown_default(params: type[Params], name: str) -> str:
    info = params.model_fields[name]
    if info.is_required():
        return "required"
    value = _as_text(info.get_default(call_default_factory=True), unit_of(params, name))
    return "none" if value is None else _shown(value)


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _type_name(annotation: Any) -> str:
    """A type in words for somebody who writes YAML."""
    parts = get_args(annotation)
    kind = get_origin(annotation) or annotation
    if kind is Literal:
        return one_of([str(part) for part in parts])
    if kind in (Union, UnionType):
        return " or ".join(_type_name(part) for part in parts)
    if kind in (tuple, list) and parts:
        count = "" if parts[-1] is Ellipsis or kind is list else f"{len(parts)} "
        return f"list of {count}{_plural(_type_name(parts[0]))}"
    return _TYPES.get(kind, getattr(kind, "__name__", str(kind)))


def _plural(noun: str) -> str:
    head, of, rest = noun.partition(" of ")
    return noun if " or " in head else f"{head}s{of}{rest}"


def bind(params: type[Params], node: Node, owner: str) -> tuple[Params | None, list[Problem]]:
    """Parameters from a YAML mapping, or every problem with its place.

    owner : how messages call the one whose parameters these are, for example "fuser.map"
    Raises PluginInvalid where the class itself fails.
    """
    try:
        return params.model_validate(node.plain(), context=_IN_TEXT), []
    except ValidationError as error:
        return None, [_problem(params, node, owner, detail) for detail in error.errors()]
    except Exception as error:  # a constructor or a validator is somebody else's code
        text = f"{owner}: its class {params.__name__} raises {type(error).__name__}: {error}"
        raise PluginInvalid(text, "tell its author, or uninstall it") from error


def _problem(params: type[Params], node: Node, owner: str, detail: ErrorDetails) -> Problem:
    path = list(detail["loc"])
    name = str(path[0]) if path else ""
    if detail["type"] == "extra_forbidden":
        text = f"{owner} has no parameter '{name}'"
        known = did_you_mean(name, params.model_fields) or f"it has {', '.join(sorted(params.model_fields)) or 'none'}"
        return Problem(node.where_of_key(name), "unknown-parameter", text, known)
    if detail["type"] == "missing" and len(path) == 1:
        doc = params.model_fields[name].description or ""
        return Problem(node.where, "missing-parameter", f"{owner} needs the parameter '{name}'", doc)
    value = node.at(path)
    subject = f"{owner}: {name}" if name else owner
    text = f"{subject}: {_reason(detail, unit_of(params, name) if name else '')}"
    hint = did_you_mean(value.value, _CHOICE.findall(text)) if isinstance(value.value, str) else ""
    return Problem(value.where, "bad-parameter", text, hint if detail["type"] == "literal_error" else "")


def _reason(detail: ErrorDetails, unit: str) -> str:
    """Why a value is refused; limits in the unit of the parameter."""
    facts = detail.get("ctx", {})
    wording = _WORDINGS.get(detail["type"])
    if wording is None:
        said = str(facts.get("error", detail["msg"]))
        return f"{said[:1].lower()}{said[1:]}"
    shown = {key: format_quantity(fact, unit) if unit and key in _LIMITS else fact for key, fact in facts.items()}
    return wording.format(**shown) + (f" with a unit like {unit}" if unit and wording == _NUMBER else "")


def json_schema(params: type[Params]) -> dict[str, Any]:
    """JSON Schema of the parameters as written in YAML: quantities are texts with a unit."""
    schema = params.model_json_schema()
    for name, entry in schema.get("properties", {}).items():
        unit = entry.pop("unit", "")
        if unit:
            _as_quantity(entry, unit)
            if "default" in entry:
                entry["default"] = _as_text(params.model_fields[name].get_default(), unit)
    return dict(schema)


def _as_quantity(entry: dict[str, Any], unit: str) -> None:
    """Turn a number's schema, wherever it stands in the entry, into one of a text with a unit."""
    if entry.get("type") == "number":
        for key in ("exclusiveMinimum", "minimum", "exclusiveMaximum", "maximum"):
            entry.pop(key, None)
        entry.update(type="string", pattern=r"^\s*[-+]?[0-9.].*[^0-9.\s]", examples=[f"1 {unit}"])
    for part in (*entry.get("anyOf", []), *entry.get("prefixItems", []), entry.get("items")):
        if isinstance(part, dict):
            _as_quantity(part, unit)
