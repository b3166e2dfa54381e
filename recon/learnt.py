"""What steps learnt and assumed, as people read it: rows of metrics whose content is for programs, in words."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, Final

from recon.rounding import rounded
from recon.storage.json_text import to_json

CLOCK: Final = "assumed_clock_offset"
"""The metric in which a reader tells by how many s it took the clock of the log to be ahead of UTC."""


def legible(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of metrics with a value and a note that people understand; most are as they were.

    `reader` holds how sure the choice of a reader is, `reader_parameters` the parameters of that reader as JSON.
    """
    if row["name"] == "reader" and row.get("value") is not None:
        return {**row, "value": None, "note": f"{row['note']}; the choice is {100.0 * row['value']:.0f} % sure"}
    if row["name"] == "reader_parameters":
        return {**row, "note": parameters_text(json.loads(row["note"])) or "it has none"}
    return dict(row)


def utc(rows: Iterable[Mapping[str, Any]]) -> str:
    """`UTC`, and with it what a reader assumed of the log's clock, by its rows of metrics."""
    ahead = [row["value"] for row in rows if row["name"] == CLOCK and row["value"] is not None]
    return f"UTC (the log's clock taken for UTC{ahead[0] / 3600.0:+g} h)" if ahead else "UTC"


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
