"""What analyzer.doctor found, as rows of metrics hold it: for those who only read it (recon.doctor puts it right)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final

import pyarrow as pa

from recon.rounding import rounded, with_unit

STAGE: Final = "analyzer.doctor"
"""It looks for them."""
PREFIX: Final = "finding_"
"""Metrics of that name are findings."""


def findings_in(metrics: pa.Table | None) -> list[dict[str, Any]]:
    """The findings among rows of metrics, each as `recon.doctor.as_data` gives it, perhaps with `evidence`."""
    if metrics is None:
        return []
    rows = metrics.select(["name", "note"]).to_pylist()
    return [json.loads(row["note"]) for row in rows if (row["name"] or "").startswith(PREFIX)]


def value_text(one: Mapping[str, Any]) -> str:
    """The value of a finding with its unit, for people; "" where it has none."""
    value, unit = one["value"], one.get("unit", "")
    if value is None or isinstance(value, str):
        return value or ""
    if unit == "s" and 0.0 < abs(value) < 0.1:
        value, unit = 1e3 * value, "ms"
    return with_unit(rounded(value, digits=3), unit)
