"""Legal and illegal variations of streams, as logs show them: other chunks, no rows, holes, gaps, wrong times.

Everything follows from a seed; no input is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from recon.schema import group_of
from recon.tables import Streams, select_rows, time_ns, times

Distortion: TypeAlias = Callable[[pa.Table], pa.Table]

_SEED: Final = 7


def variations(inputs: Mapping[str, pa.Table], distort: Distortion) -> Iterator[tuple[str, Streams]]:
    """Each stream distorted alone, with its name, then all of them together."""
    for port, table in inputs.items():
        yield f"'{port}'", {**inputs, port: distort(table)}
    if len(inputs) > 1:
        yield "every stream", {port: distort(table) for port, table in inputs.items()}


def rechunked(table: pa.Table) -> pa.Table:
    """The same rows in chunks of random lengths, one of them empty."""
    rng = np.random.default_rng(_SEED)
    cuts = np.sort(rng.integers(0, table.num_rows + 1, 6))
    bounds = [0, *cuts.tolist(), *cuts[-1:].tolist(), table.num_rows]
    parts = [table.slice(a, b - a) for a, b in pairwise(bounds)]
    columns = [pa.chunked_array([part[n].combine_chunks() for part in parts]) for n in table.column_names]
    return pa.Table.from_arrays(columns, schema=table.schema)


def on_own_memory(table: pa.Table) -> pa.Table:
    """The same table, its numbers in memory of NumPy that nothing else looks at."""
    columns = [pa.array(_numbers(table, f.name)) if _holds_floats(f) else table[f.name] for f in table.schema]
    return pa.Table.from_arrays(columns, schema=table.schema)


def emptied(table: pa.Table) -> pa.Table:
    """No row."""
    return table.slice(0, 0)


def one_row(table: pa.Table) -> pa.Table:
    """The first row."""
    return table.slice(0, 1)


def with_null_rows(table: pa.Table) -> pa.Table:
    """Every number null in a tenth of the rows."""
    gone = pa.array(np.random.default_rng(_SEED).random(table.num_rows) < 0.1)
    return _floats_replaced(table, lambda f: pc.if_else(gone, pa.scalar(None, f.type), table[f.name]))


def with_nan(table: pa.Table) -> pa.Table:
    """NaN, not null, in a tenth of all numbers."""
    rng = np.random.default_rng(_SEED)

    def pierced(field: pa.Field) -> pa.Array:
        values = _numbers(table, field.name)
        values[rng.random(len(values)) < 0.1] = np.nan
        return pa.array(values, field.type)

    return _floats_replaced(table, pierced)


def without_values(table: pa.Table) -> pa.Table:
    """Every number null, as of a sensor that was never heard."""
    return _floats_replaced(table, lambda f: pa.nulls(table.num_rows, f.type))


def without_texts(table: pa.Table) -> pa.Table:
    """Every text null: an event without a kind, a unit or a note."""
    for index, field in enumerate(table.schema):
        if pa.types.is_string(field.type):
            table = table.set_column(index, field, pa.nulls(table.num_rows, field.type))
    return table


def with_gap(table: pa.Table) -> pa.Table:
    """The middle third of the rows left out."""
    third = table.num_rows // 3
    return pa.concat_tables([table.slice(0, third), table.slice(2 * third)])


def with_repeated_times(table: pa.Table) -> pa.Table:
    """Every tenth row twice."""
    rows = np.arange(table.num_rows)
    return select_rows(table, np.repeat(rows, np.where(rows % 10 == 0, 2, 1)))


def with_backward_times(table: pa.Table) -> pa.Table:
    """The middle third of the rows before the first."""
    rows, third = np.arange(table.num_rows), table.num_rows // 3
    return select_rows(table, np.concatenate((rows[third : 2 * third], rows[:third], rows[2 * third :])))


def shifted(table: pa.Table, by_ns: int) -> pa.Table:
    """All its times later by `by_ns`."""
    for index, field in enumerate(table.schema):
        if pa.types.is_timestamp(field.type):
            later = times(time_ns(table, field.name) + by_ns)
            table = table.set_column(index, field, later)
    return table


def without_group(table: pa.Table, group: str) -> pa.Table:
    """Without the columns of a group."""
    return table.drop_columns([name for name in table.column_names if group_of(name) == group])


def _holds_floats(field: pa.Field) -> bool:
    return bool(pa.types.is_floating(field.type))


def _numbers(table: pa.Table, name: str) -> np.ndarray:
    """A copy of a column, (n,), NaN where it is null."""
    return np.array(table[name].combine_chunks().to_numpy(zero_copy_only=False), dtype=np.float64)


def _floats_replaced(table: pa.Table, make: Callable[[pa.Field], pa.Array]) -> pa.Table:
    columns = [make(field) if _holds_floats(field) else table[field.name] for field in table.schema]
    return pa.Table.from_arrays(columns, schema=table.schema)
