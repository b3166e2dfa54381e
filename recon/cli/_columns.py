"""Columns of a stream as rows of a table: those of one vector together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby
from typing import Any


def column_rows(columns: Iterable[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """(names, unit, frame, quantity, remark) for neighbours of one group that have all of these in common.

    columns : with name, unit, frame, quantity, and `optional` or `nulls`, the number of values that are missing
    """
    from recon.schema import ANY, group_of

    def alike(column: Mapping[str, Any]) -> tuple[str, ...]:
        facts = ("" if column[key] == ANY else str(column[key]) for key in ("unit", "frame", "quantity"))
        return (group_of(column["name"]), *facts, _remark(column))

    return [(", ".join(c["name"] for c in same), *key[1:]) for key, same in groupby(columns, alike)]


def _remark(column: Mapping[str, Any]) -> str:
    if column.get("optional"):
        return "may be absent"
    return f"{column['nulls']} missing" if column.get("nulls") else ""
