"""A Recording: named streams (Arrow tables) and what is known about them as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from types import MappingProxyType
from typing import Any

import pyarrow as pa

from recon.schema import Schema
from recon.tables import schema_of, time_ns


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

    def __repr__(self) -> str:
        return f"Recording({', '.join(f'{name}: {table.num_rows:,} rows' for name, table in self.items())})"

    def _repr_html_(self) -> str:
        rows = [(name, f"{table.num_rows:,}", ", ".join(table.column_names)) for name, table in self.items()]
        lines = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        return f"<table><tr><th>stream</th><th>rows</th><th>columns</th></tr>{lines}</table>"
