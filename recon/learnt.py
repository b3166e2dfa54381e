"""What steps learnt and assumed, as people read it: rows of metrics whose content is for programs, in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from recon.rounding import rounded
from recon.storage.json_text import to_json


def legible(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of metrics with a value and a note that people understand; most are as they were.

    `reader` holds how sure the choice of a reader is, `reader_parameters` the parameters of that reader as JSON.
    """
    if row["name"] == "reader" and row.get("value") is not None:
        return {**row, "value": None, "note": f"{row['note']}; the choice is {100.0 * row['value']:.0f} % sure"}
    if row["name"] == "reader_parameters":
        return {**row, "note": parameters_text(json.loads(row["note"])) or "it has none"}
    return dict(row)


def parameters_text(params: Mapping[str, Any]) -> str:
    """`gravity = 9.80665, sensor = none`; numbers are in SI."""
    return ", ".join(f"{name} = {_value(value)}" for name, value in params.items())


def _value(value: Any) -> str:
    if value is None or value == "":
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return rounded(value, digits=6)
    if isinstance(value, Mapping):
        return f"({parameters_text(value)})" if value else "none"
    return value if isinstance(value, str) else to_json(value)
