"""Rows of the stream `metrics`, as tests ask for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyarrow as pa


def rows_named(streams: Mapping[str, pa.Table], name: str) -> list[dict[str, Any]]:
    """All rows of a name."""
    return [row for row in streams["metrics"].to_pylist() if row["name"] == name]


def row_named(streams: Mapping[str, pa.Table], name: str) -> dict[str, Any]:
    """The one row of a name."""
    (row,) = rows_named(streams, name)
    return row


def rows_by_name(streams: Mapping[str, pa.Table]) -> dict[str, dict[str, Any]]:
    """Every row, the last of each name."""
    return {row["name"]: row for row in streams["metrics"].to_pylist()}


def values_by_name(streams: Mapping[str, pa.Table]) -> dict[str, float]:
    """Every value, the last of each name."""
    return {name: row["value"] for name, row in rows_by_name(streams).items()}
