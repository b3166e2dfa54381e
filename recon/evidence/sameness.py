"""Two results held against each other, number by number: the first difference in words.

Two numbers are the same if they differ by no more than a share of 1e-9 of the size of the larger one. In a stream, the
size of a number is at least the root mean square of its column: a velocity that passes through zero is known no better
there. In a row of metrics it is at least its sigma, or its limits. Everything else, times included, must be equal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.recording import Recording
from recon.schema import APPENDED
from recon.tables import Array, meta, schema_of

TOLERANCE: Final = 1e-9

_ABSENT: Final = object()
_SIZES: Final = ("value", "sigma", "low", "high")


def unlike(sealed: Recording, again: Recording) -> str:
    """The first difference of two recordings; "" where all numbers are the same."""
    if list(sealed) != list(again):
        return f"its streams are {', '.join(sealed)}, and now {', '.join(again)}"
    for name, table in sealed.items():
        fault = _unlike_tables(table, again[name], name)
        if fault:
            return f"{name}{fault}"
    return unlike_data(dict(sealed.meta), dict(again.meta), "meta")


def _unlike_tables(one: pa.Table, other: pa.Table, stream: str) -> str:
    if schema_of(one) != schema_of(other):
        return ": its columns, units or frames are others now"
    if one.num_rows != other.num_rows:
        return f" has {one.num_rows} rows, and now {other.num_rows}"
    sizes = _sizes_of_rows(one) if stream in APPENDED else None
    for name in one.column_names:
        fault = _unlike_columns(one[name], other[name], sizes)
        if fault:
            return f".{name}, {fault}"
    fault = unlike_data(meta(one), meta(other), "")
    return f": its facts differ: {fault}" if fault else ""


def _sizes_of_rows(table: pa.Table) -> Array:
    """Largest number of each row of events or metrics: (n,)."""
    columns = [np.abs(_doubles(table[name])) for name in _SIZES if name in table.column_names]
    return np.asarray(np.nan_to_num(np.array(columns)).max(axis=0, initial=0.0))


def _unlike_columns(one: pa.ChunkedArray, other: pa.ChunkedArray, sizes: Array | None) -> str:
    if one.equals(other):
        return ""
    if pa.types.is_list(one.type):
        lengths = [[None if item is None else len(item) for item in column.to_pylist()] for column in (one, other)]
        if lengths[0] != lengths[1]:
            return "lists of other lengths"
        return _unlike_columns(_flat(one), _flat(other), None)
    if not pa.types.is_floating(one.type):
        pairs = zip(one.to_pylist(), other.to_pylist(), strict=True)
        return next((f"row {row}: {a!r}, and now {b!r}" for row, (a, b) in enumerate(pairs, 1) if a != b), "")
    return _unlike_numbers(_doubles(one), _doubles(other), sizes)


def _flat(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """The items of all lists of a column."""
    return pa.chunked_array([column.combine_chunks().flatten()])


def _doubles(column: pa.ChunkedArray) -> Array:
    return np.asarray(column.combine_chunks().to_numpy(zero_copy_only=False), dtype=np.float64)


def _unlike_numbers(one: Array, other: Array, sizes: Array | None) -> str:
    """The first pair of numbers (n,) that is not the same; sizes : (n,) at least that of each, None for the column's.

    NaN, infinities and missing values must be where they were.
    """
    finite = np.isfinite(one) & np.isfinite(other)
    if sizes is None:
        known = one[finite]
        sizes = np.full(len(one), np.sqrt(np.mean(known**2)) if len(known) else 0.0)
    size = np.maximum(np.maximum(np.abs(one), np.abs(other)), sizes)
    with np.errstate(invalid="ignore"):
        alike = (one == other) | (np.isnan(one) & np.isnan(other))
        same = np.where(finite, np.abs(one - other) <= TOLERANCE * size, alike)
    if same.all():
        return ""
    row = int(np.argmin(same))
    return f"row {row + 1}: {one[row].item()!r}, and now {other[row].item()!r}"


def unlike_data(one: Any, other: Any, where: str) -> str:
    """As `unlike`, of JSON data: the place of the first difference, and both values."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        keys = list(dict.fromkeys([*one, *other]))
        pairs: list[tuple[Any, Any, Any]] = [(k, one.get(k, _ABSENT), other.get(k, _ABSENT)) for k in keys]
    elif _is_list(one) and _is_list(other):
        pairs = [(i, a, b) for i, (a, b) in enumerate(zip_longest(one, other, fillvalue=_ABSENT), 1)]
    else:
        return "" if _same_data(one, other) else f"{where}: {_shown(one)}, and now {_shown(other)}"
    for key, a, b in pairs:
        fault = unlike_data(a, b, f"{where}.{key}" if where else str(key))
        if fault:
            return fault
    return ""


def _is_list(data: Any) -> bool:
    return isinstance(data, Sequence) and not isinstance(data, str)


def _same_data(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float | int):
        return math.isclose(one, other, rel_tol=TOLERANCE)
    return type(one) is type(other) and bool(one == other)


def _shown(value: Any) -> str:
    text = "nothing" if value is _ABSENT else repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
