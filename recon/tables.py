"""Arrow tables to NumPy arrays and back: the only place that touches chunks and metadata.

A stage takes arrays out with `vector` and `matrix`, puts results in with `replace`, or makes a new stream with
`build`. Missing numbers are null in a table and NaN in an array.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ContractError, DataError
from recon.schema import APPENDED, SCHEMA_NUMBER, SEVERAL_AT_A_TIME, STREAMS, TIME_TYPE, Column, Schema, spread

Array: TypeAlias = NDArray[np.float64]
Streams: TypeAlias = dict[str, pa.Table]

_PREFIX = b"recon."


def has(table: pa.Table | None, group: str) -> bool:
    """Is the group there, with at least one value in each of its columns?"""
    if table is None:
        return False
    names = spread(group, table.column_names)
    return bool(names) and all(table[name].null_count < table.num_rows for name in names)


def time_ns(table: pa.Table, name: str = "time") -> NDArray[np.int64]:
    """Time of each row: (n,) ns since 1970-01-01."""
    return np.asarray(_whole(table[name].cast(pa.int64())))


def seconds(table: pa.Table, *, since: int | None = None) -> Array:
    """Time of each row: (n,) s after `since` (ns since 1970), by default after the first row."""
    t_ns = time_ns(table)
    if not len(t_ns):
        return np.zeros(0)
    return np.asarray((t_ns - (t_ns[0] if since is None else since)) * 1e-9)


def vector(table: pa.Table, name: str, *, gaps: bool = False) -> Array:
    """One column: (n,) in its own unit.

    gaps : True gives NaN where a value is missing; False raises DataError there
    """
    column = table[name]
    if column.type != pa.float64():
        column = column.cast(pa.float64())
    values = np.asarray(_whole(column).to_numpy(zero_copy_only=False), dtype=np.float64)
    if not gaps:
        _refuse_gaps(values, table, name)
    return values


def _whole(column: pa.ChunkedArray) -> pa.Array:
    """A column in one piece; Arrow copies even what is in one already."""
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


def matrix(table: pa.Table, group: str, *, gaps: bool = False) -> Array:
    """The columns of a group side by side: (n, k), for example (n, 3) for "accel" and (n, 4) for "q".

    Each column is contiguous in memory, as in the table: sums and norms over the axes then run along the rows.

    gaps : as in `vector`. Raises KeyError where the group is not there.
    """
    names = spread(group, table.column_names)
    if not names:
        raise KeyError(group)
    out = np.empty((len(names), table.num_rows))
    for column, name in zip(out, names, strict=True):
        column[:] = vector(table, name, gaps=gaps)
    return out.T


def vector_or_nan(table: pa.Table, name: str) -> Array:
    """As `vector` with gaps: (n,), NaN throughout where the column is not there."""
    return vector(table, name, gaps=True) if name in table.column_names else np.full(table.num_rows, np.nan)


def matrix_or_nan(table: pa.Table, group: str, width: int = 3) -> Array:
    """As `matrix` with gaps: (n, width), NaN throughout where the group is not there or not that wide."""
    there = len(spread(group, table.column_names)) == width
    return matrix(table, group, gaps=True) if there else np.full((table.num_rows, width), np.nan)


def known_rows(table: pa.Table, *groups: str) -> NDArray[np.bool_]:
    """Rows with a number in every column of these groups: (n,) bool."""
    known = np.ones(table.num_rows, dtype=bool)
    for group in groups:
        for name in spread(group, table.column_names):
            known &= np.isfinite(vector(table, name, gaps=True))
    return known


def measured_axes(table: pa.Table, group: str) -> tuple[Array, list[str]]:
    """As `matrix` with gaps; columns without any value are taken for zero and named, unless all are without."""
    values = matrix(table, group, gaps=True)
    empty = ~np.isfinite(values).any(axis=0)
    if empty.all():
        return values, []
    values[:, empty] = 0.0
    names = spread(group, table.column_names)
    return values, [names[index] for index in np.flatnonzero(empty)]


def _refuse_gaps(values: Array, table: pa.Table, name: str) -> None:
    missing = ~np.isfinite(values)
    if missing.all() and len(values):
        raise DataError(
            f"column {name} holds no number in any of {len(values)} rows", "does the log measure it at all?"
        )
    if missing.any():
        row = int(missing.argmax())
        when = f" ({_moment(table, row)})" if "time" in table.column_names else ""
        count = f"{int(missing.sum())} of {len(values)} rows"
        raise DataError(
            f"column {name} has no finite number in {count}, first in row {row}{when}",
            "put filter.resample before this step, or leave the rows out",
        )


def _moment(table: pa.Table, row: int) -> str:
    """Time of one row as text; Python's datetime would refuse nanoseconds."""
    return str(time_ns(table.slice(row, 1))[0].view("datetime64[ns]"))


def replace(table: pa.Table, **groups: Any) -> pa.Table:
    """The table with other values in some groups; a group that is not there yet is added at the end.

    groups : (n,) for a column, (n, k) for a group, for example accel=(n, 3); a name such as pos gets the suffixes
    of its canonical columns. Everything else keeps its place, its order and its metadata.
    """
    arrays = {name: values for group, data in groups.items() for name, values in _named(group, data, table)}
    for name, values in arrays.items():
        array = _arrow(values, None)
        if name in table.column_names:
            index = table.column_names.index(name)
            table = table.set_column(index, table.schema.field(index).with_type(array.type), array)
        else:
            table = table.append_column(pa.field(name, array.type), array)
    return table


def _named(group: str, data: Any, table: pa.Table | None) -> list[tuple[str, Any]]:
    if not isinstance(data, np.ndarray) or data.ndim == 1:
        return [(group, data)]
    names = spread(group, table.column_names) if table is not None else ()
    names = names or _canonical_columns(group)
    if len(names) != data.shape[1]:
        raise ValueError(f"{group} has {data.shape[1]} columns; it stands for {list(names) or 'no known columns'}")
    return [(name, data[:, index]) for index, name in enumerate(names)]


def _canonical_columns(group: str) -> tuple[str, ...]:
    for schema in STREAMS.values():
        names = spread(group, schema.names)
        if names:
            return names
    return ()


def _arrow(values: Any, kind: pa.DataType | None) -> pa.Array:
    if isinstance(values, pa.Array | pa.ChunkedArray):
        return values if kind is None else values.cast(kind)
    if isinstance(values, np.ndarray) and values.dtype.kind == "f":
        gaps = bool(np.isnan(values).any())  # NumPy finds them in a tenth of the time that Arrow takes to find none
        return pa.array(np.ascontiguousarray(values), type=kind, from_pandas=gaps)
    return pa.array(values, type=kind)


def build(schema: Schema, **groups: Any) -> pa.Table:
    """A new stream of the columns given, stamped with the schema's types, units, frames and quantities.

    groups : by column or group name as in `replace`; `time` as (n,) int64 ns since 1970. Columns of the schema that
    are not given are absent when optional and null otherwise.
    """
    given: dict[str, Any] = {}
    for group, data in groups.items():
        names = spread(group, schema.names)
        if isinstance(data, np.ndarray) and data.ndim == 2:
            if len(names) != data.shape[1]:
                raise ValueError(f"{group} has {data.shape[1]} columns; the schema has {list(names)}")
            given.update({name: data[:, index] for index, name in enumerate(names)})
        elif names == (group,):
            given[group] = data
        else:
            raise ValueError(f"no column '{group}' among {list(schema.names)}")
    rows = len(next(iter(given.values()))) if given else 0
    columns = [column for column in schema.columns if column.name in given or not column.optional]
    arrays = [
        _arrow(given[column.name], column.type) if column.name in given else pa.nulls(rows, column.type)
        for column in columns
    ]
    return pa.Table.from_arrays(arrays, schema=pa.schema([_field(column) for column in columns]))


def _field(column: Column) -> pa.Field:
    facts = {"unit": column.unit, "frame": column.frame, "quantity": column.quantity}
    return pa.field(column.name, column.type, metadata={key: value for key, value in facts.items() if value})


def select_rows(table: pa.Table, choice: NDArray[Any]) -> pa.Table:
    """The rows where a (n,) bool is true, or those that an integer array names; metadata is kept."""
    if choice.dtype != bool:
        return table.take(pa.array(choice))
    return table if choice.all() else table.filter(pa.array(choice))


def meta(table: pa.Table) -> dict[str, Any]:
    """The stream's own facts: anchor, time_scale, height_datum, heading_kind, ..."""
    found = table.schema.metadata or {}
    return {
        key.removeprefix(_PREFIX).decode(): json.loads(value)
        for key, value in found.items()
        if key.startswith(_PREFIX) and key != b"recon.schema"
    }


def with_meta(table: pa.Table, **facts: Any) -> pa.Table:
    """The table with facts added to its own; a fact of None is taken away."""
    merged = {key: value for key, value in {**meta(table), **facts}.items() if value is not None}
    return _stamp(table, merged)


def _stamp(table: pa.Table, facts: Mapping[str, Any]) -> pa.Table:
    coded = {f"recon.{key}": json.dumps(facts[key], sort_keys=True) for key in sorted(facts)}
    return table.replace_schema_metadata({"recon.schema": str(SCHEMA_NUMBER), **coded})


def schema_of(table: pa.Table) -> Schema:
    """The schema that a table's types and field metadata tell."""
    columns = []
    for f in table.schema:
        facts = {key.decode(): value.decode() for key, value in (f.metadata or {}).items()}
        columns.append(
            Column(f.name, facts.get("unit", ""), facts.get("frame", ""), facts.get("quantity", ""), type=f.type)
        )
    return Schema(tuple(columns))


def conform(table: pa.Table, planned: Schema, *, stream: str, step: str) -> pa.Table:
    """The table with the planned column order, types, units, frames and quantities; its own metadata is kept.

    Raises ContractError where it holds what was not planned, lacks what was, a row has no time, or time does not rise.
    """
    here = set(table.column_names)
    unplanned = [name for name in table.column_names if name not in planned]
    missing = [c.name for c in planned.columns if c.name not in here and not c.optional]
    if unplanned or missing:
        parts = [f"returned {unplanned}, which it does not declare"] * bool(unplanned)
        parts += [f"did not return {missing}, which it declares"] * bool(missing)
        raise ContractError(step, f"stream '{stream}': it {' and '.join(parts)}")
    columns = [column for column in planned.columns if column.name in here]
    arrays = [_typed(table[column.name], column, stream, step) for column in columns]
    result = pa.Table.from_arrays(arrays, schema=pa.schema([_field(column) for column in columns]))
    _check_times_known(result, stream, step)
    if stream not in APPENDED and "time" in result.column_names:
        _check_time_rises(result, stream, step, strictly=stream not in SEVERAL_AT_A_TIME)
    return _stamp(result, meta(table))


def _typed(values: pa.ChunkedArray, column: Column, stream: str, step: str) -> pa.ChunkedArray:
    if values.type == column.type:
        return values
    wrong = f"stream '{stream}': column {column.name} is {values.type}, declared as {column.type}"
    if pa.types.is_string(values.type):  # a cast would read numbers from text
        raise ContractError(step, wrong)
    try:
        return values.cast(column.type)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise ContractError(step, wrong) from error


def _check_times_known(table: pa.Table, stream: str, step: str) -> None:
    for field in table.schema:
        if field.type == TIME_TYPE and table[field.name].null_count:
            raise ContractError(step, f"stream '{stream}': {table[field.name].null_count} rows have no {field.name}")


def _check_time_rises(table: pa.Table, stream: str, step: str, *, strictly: bool) -> None:
    t_ns = time_ns(table)
    falls = np.flatnonzero(t_ns[1:] <= t_ns[:-1] if strictly else t_ns[1:] < t_ns[:-1])
    if len(falls):
        row = int(falls[0]) + 1
        raise ContractError(step, f"stream '{stream}': time does not rise at row {row} ({_moment(table, row)})")


def append(first: pa.Table | None, second: pa.Table) -> pa.Table:
    """Rows of the second table after those of the first; columns and metadata as in the second, null where the first
    has no such column.
    """
    if first is None:
        return second
    there = set(first.column_names)
    arrays = [first[f.name] if f.name in there else pa.nulls(first.num_rows, f.type) for f in second.schema]
    return pa.concat_tables([pa.Table.from_arrays(arrays, schema=second.schema), second])


def times(t_ns: Sequence[int] | NDArray[np.int64]) -> pa.Array:
    """An Arrow array of times from ns since 1970-01-01."""
    return pa.array(np.asarray(t_ns, dtype=np.int64)).cast(TIME_TYPE)
