"""A Recording: named streams (Arrow tables) and what is known about them as a whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa

from recon.schema import APPENDED, Schema
from recon.tables import append, meta, schema_of, select_rows, time_ns, with_meta


@dataclass(frozen=True)
class Recording(Mapping[str, pa.Table]):
    """Streams by name. `meta` holds JSON data: where the recording came from.

    A recording is never changed in place: `updated` gives a new one.
    """

    streams: Mapping[str, pa.Table]
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "streams", MappingProxyType(dict(self.streams)))

    def __getitem__(self, name: str) -> pa.Table:
        return self.streams[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.streams)

    def __len__(self) -> int:
        return len(self.streams)

    def __reduce__(self) -> tuple[object, ...]:
        return (Recording, (dict(self.streams), dict(self.meta)))

    def updated(self, streams: Mapping[str, pa.Table]) -> Recording:
        """With the streams given in place of those of the same name."""
        return Recording({**self.streams, **streams}, self.meta)

    def schemas(self) -> dict[str, Schema]:
        """The schema of each stream as its table tells it."""
        return {name: schema_of(table) for name, table in self.items()}

    def span_ns(self) -> tuple[int, int] | None:
        """First and last time of all streams in ns since 1970; None where no stream has a row with a time."""
        timed = [time_ns(t) for t in self.values() if "time" in t.column_names and t.num_rows]
        return (min(int(t.min()) for t in timed), max(int(t.max()) for t in timed)) if timed else None

    def _repr_html_(self) -> str:
        rows = [(name, f"{table.num_rows:,}", ", ".join(table.column_names)) for name, table in self.items()]
        lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        return f"<table><tr><th>stream</th><th>rows</th><th>columns</th></tr>{lines}</table>"


def combine(recordings: Sequence[Recording]) -> Recording:
    """One recording from several files of one drive.

    Streams of one name become one where their columns complement each other (accelerometer and gyroscope in
    separate files) or where they follow each other in time (a log cut into pieces). Otherwise they are kept side
    by side as `imu`, `imu_2`, ... in the order given, the one with more columns first.
    """
    gathered: dict[str, list[pa.Table]] = {}
    for recording in recordings:
        for name, table in recording.items():
            gathered.setdefault(name, []).append(table)
    streams: dict[str, pa.Table] = {}
    for name, tables in gathered.items():
        for number, table in enumerate(_merge(name, tables), start=1):
            streams[name if number == 1 else f"{name}_{number}"] = table
    sources = [source for recording in recordings for source in recording.meta.get("sources", [])]
    return Recording(streams, {"sources": sources} if sources else {})


def _merge(name: str, tables: Sequence[pa.Table]) -> list[pa.Table]:
    if name in APPENDED:
        together: pa.Table | None = None
        for table in tables:
            together = append(together, table)
        return [together]
    merged = list(tables)
    if all("time" in table.column_names for table in tables):
        for join in (_continued, _complemented, _continued):  # pieces, then sensors, then pieces logged as one file
            merged = _folded(merged, join)
    return sorted(merged, key=lambda table: -len(table.column_names))


def _folded(tables: Sequence[pa.Table], join: Callable[[pa.Table, pa.Table], pa.Table | None]) -> list[pa.Table]:
    """Each table joined to the first one before it that `join` joins it to."""
    merged: list[pa.Table] = []
    for table in tables:
        for index, other in enumerate(merged):
            joined = join(other, table)
            if joined is not None:
                merged[index] = joined
                break
        else:
            merged.append(table)
    return merged


def _continued(first: pa.Table, second: pa.Table) -> pa.Table | None:
    """Two tables of the same columns and facts that follow each other in time as one, None for any others."""
    if set(first.column_names) != set(second.column_names) or meta(first) != meta(second):
        return None
    if not (first.num_rows and second.num_rows):
        return first if first.num_rows else second
    early, late = sorted((first, second), key=lambda table: int(time_ns(table)[0]))
    return append(early, late) if time_ns(early)[-1] < time_ns(late)[0] else None


def _complemented(first: pa.Table, second: pa.Table) -> pa.Table | None:
    """Two tables that share no column but the time as one, None for any others."""
    return None if set(first.column_names) & set(second.column_names) - {"time"} else _interleaved(first, second)


def _interleaved(first: pa.Table, second: pa.Table) -> pa.Table:
    """Union of the times of both; a column is null where only the other table has a row."""
    import pyarrow.compute as pc  # slow import: only when used

    t_ns = np.union1d(time_ns(first), time_ns(second))
    columns = [pa.array(t_ns).cast(first["time"].type)]
    fields = [first.schema.field("time")]
    for table in (first, second):
        own = time_ns(table)
        index = np.searchsorted(own, t_ns).clip(max=max(len(own) - 1, 0))
        there = own[index] == t_ns if len(own) else np.zeros(len(t_ns), dtype=bool)
        spread_rows = select_rows(table, index) if len(own) else None
        for name in table.column_names:
            if name == "time":
                continue
            kind = table.schema.field(name).type
            values = spread_rows[name].combine_chunks() if spread_rows is not None else pa.nulls(len(t_ns), kind)
            columns.append(pc.if_else(pa.array(there), values, pa.scalar(None, kind)))
            fields.append(table.schema.field(name))
    joined = pa.Table.from_arrays(columns, schema=pa.schema(fields))
    return with_meta(joined, **{**meta(second), **meta(first)})
