"""Two results held against each other, number by number: the first difference in words.

Two numbers are the same if they differ by no more than a share of 1e-9 of the size of the larger one. In a stream, the
size of a number is at least the root mean square of its column: a velocity that passes through zero is known no better
there. In a row of metrics it is at least its sigma, or its limits. Everything else, times included, must be equal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from recon.recording import Recording
from recon.schema import APPENDED
from recon.tables import Array, meta, schema_of

TOLERANCE: Final = 1e-9
ROUNDING: Final = 1e-4
"""Of its size: what numbers move at most where only rounding differs. Sigmas of what a log hardly tells move farthest,
by a part in 1e5, for a processor's rounding of 1e-16 grows with the condition of the normal equations."""
SAME_BYTES: Final = "same bytes"
SAME_NUMBERS: Final = "same numbers"
ROUNDED: Final = "rounded otherwise"
OTHER: Final = "other"

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
        if fault is not None:
            return f".{name}, row {fault.row + 1}{_called(one, fault.row)}: {fault.text}"
    told = unlike_data(meta(one), meta(other), "")
    return f": its facts differ: {told}" if told else ""


def _sizes_of_rows(table: pa.Table) -> Array:
    """Largest number of each row of events or metrics: (n,)."""
    columns = [np.abs(_doubles(table[name])) for name in _SIZES if name in table.column_names]
    return np.asarray(np.nan_to_num(np.array(columns)).max(axis=0, initial=0.0))


class Fault(NamedTuple):
    """The first row of a column that is not the same, from 0, and how."""

    row: int
    text: str


def _called(table: pa.Table, row: int) -> str:
    """What a row of events or metrics is about; "" for any other."""
    words = [table[name][row].as_py() for name in ("step", "name", "kind") if name in table.column_names]
    return f" ({' '.join(str(word) for word in words)})" if words else ""


def _unlike_columns(one: pa.ChunkedArray, other: pa.ChunkedArray, sizes: Array | None) -> Fault | None:
    if one.equals(other):
        return None
    if pa.types.is_list(one.type):
        return _unlike_lists(one, other)
    if not pa.types.is_floating(one.type):
        pairs = enumerate(zip(one.to_pylist(), other.to_pylist(), strict=True))
        return next((Fault(row, f"{a!r}, and now {b!r}") for row, (a, b) in pairs if a != b), None)
    return unlike_numbers(_doubles(one), _doubles(other), sizes)


def _unlike_lists(one: pa.ChunkedArray, other: pa.ChunkedArray) -> Fault | None:
    """As `_unlike_columns`, of lists of numbers: their items are one column."""
    lengths = [[len(item or ()) for item in column.to_pylist()] for column in (one, other)]
    changed = next((row for row, (a, b) in enumerate(zip(*lengths, strict=True)) if a != b), None)
    if changed is not None:
        return Fault(changed, f"{lengths[0][changed]} numbers, and now {lengths[1][changed]}")
    flat = [_doubles(pa.chunked_array([column.combine_chunks().flatten()])) for column in (one, other)]
    fault = unlike_numbers(flat[0], flat[1], None)
    return fault and Fault(int(np.searchsorted(np.cumsum(lengths[0]), fault.row, "right")), fault.text)


def _doubles(column: pa.ChunkedArray) -> Array:
    return np.asarray(column.combine_chunks().to_numpy(zero_copy_only=False), dtype=np.float64)


def shares(one: Array, other: Array, sizes: Array | None = None) -> Array:
    """How far apart two columns are, of the size of each pair: (n,); NaN where what is not finite is not the same.

    sizes : (n,) at least the size of each, None for the column's root mean square
    """
    finite = np.isfinite(one) & np.isfinite(other)
    if sizes is None:
        known = one[finite]
        sizes = np.full(len(one), np.sqrt(np.mean(known**2)) if len(known) else 0.0)
    size = np.maximum(np.maximum(np.abs(one), np.abs(other)), sizes)
    with np.errstate(invalid="ignore", divide="ignore"):
        alike = (one == other) | (np.isnan(one) & np.isnan(other))
        return np.where(alike, 0.0, np.where(finite, np.abs(one - other) / size, np.nan))


def unlike_numbers(one: Array, other: Array, sizes: Array | None = None) -> Fault | None:
    """The first pair of numbers (n,) that is not the same; sizes : as of `shares`.

    NaN, infinities and missing values must be where they were.
    """
    apart = shares(one, other, sizes)
    same = apart <= TOLERANCE
    if same.all():
        return None
    row = int(np.argmin(same))
    far = f", {apart[row]:.1e} of its size apart" if math.isfinite(apart[row]) else ""
    return Fault(row, f"{one[row].item()!r}, and now {other[row].item()!r}{far}")


class Kinship(NamedTuple):
    """How alike a stream came out again: SAME_BYTES, SAME_NUMBERS within TOLERANCE, ROUNDED within ROUNDING, or OTHER.

    size : how far a number moved at most, of its size; sigmas : a value, of the sigma beside it; None where untold
    """

    stream: str
    how: str
    size: float | None = None
    sigmas: float | None = None


def kinships(sealed: Recording, again: Recording) -> list[Kinship]:
    """How alike each sealed stream is to the one of the same name."""
    return [_kinship(name, table, again.get(name)) for name, table in sealed.items()]


def _kinship(stream: str, one: pa.Table, other: pa.Table | None) -> Kinship:
    if other is None or schema_of(one) != schema_of(other) or one.num_rows != other.num_rows:
        return Kinship(stream, OTHER)
    if one.equals(other, check_metadata=True):
        return Kinship(stream, SAME_BYTES)
    sizes, moved = _sizes_of_rows(one) if stream in APPENDED else None, {}
    for name in one.column_names:
        numbers = _numbers(one[name]), _numbers(other[name])
        if numbers[0] is None or numbers[1] is None or len(numbers[0]) != len(numbers[1]):
            if not one[name].equals(other[name]):
                return Kinship(stream, OTHER)
            continue
        moved[name] = shares(numbers[0], numbers[1], sizes if len(numbers[0]) == one.num_rows else None)
    size = max((float(np.nan_to_num(share, nan=np.inf).max(initial=0.0)) for share in moved.values()), default=0.0)
    same = SAME_NUMBERS if size <= TOLERANCE else ROUNDED if size <= ROUNDING else OTHER
    how = OTHER if unlike_data(meta(one), meta(other), "") else same
    return Kinship(stream, how, size if np.isfinite(size) else None, _in_sigmas(one, other))


def _numbers(column: pa.ChunkedArray) -> Array | None:
    """The numbers of a column, or in its lists; None of any other."""
    if pa.types.is_list(column.type):
        column = pa.chunked_array([column.combine_chunks().flatten()])
    return _doubles(column) if pa.types.is_floating(column.type) else None


def _in_sigmas(one: pa.Table, other: pa.Table) -> float | None:
    """How far a value moved at most, of the sigma in the column that goes with it; None where there is none."""
    found = []
    for name in one.column_names:
        group, _, axis = name.rpartition("_")
        sigmas = [n for n in ("sigma" if name == "value" else "", f"{group}_std_{axis}") if n in one.column_names]
        if not sigmas:
            continue
        value, now, sigma = (_doubles(column) for column in (one[name], other[name], one[sigmas[0]]))
        known = np.isfinite(value) & np.isfinite(now) & (sigma > 0.0)
        found += [float((np.abs(now - value)[known] / sigma[known]).max())] if known.any() else []
    return max(found, default=None)


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
