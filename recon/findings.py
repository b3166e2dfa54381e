"""What analyzer.doctor found, as rows of metrics hold it: for those who only read it (recon.doctor puts it right)."""

from __future__ import annotations

import json
from typing import Any, Final

import pyarrow as pa

PREFIX: Final = "finding_"
"""Metrics of that name are findings."""


def findings_in(metrics: pa.Table | None) -> list[dict[str, Any]]:
    """The findings among rows of metrics, each as `recon.doctor.as_data` gives it, perhaps with `evidence`."""
    if metrics is None:
        return []
    rows = metrics.select(["name", "note"]).to_pylist()
    return [json.loads(row["note"]) for row in rows if (row["name"] or "").startswith(PREFIX)]
