"""Rows that stages append: events (when something happened) and metrics (what a stage learnt)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from recon.schema import EVENTS, METRICS
from recon.tables import build, times

WARNING: Final = "warning"


@dataclass(frozen=True)
class Event:
    """Something that lasted from `start_ns` to `end_ns` (ns since 1970): a standstill, a crash, an outage."""

    start_ns: int
    end_ns: int
    kind: str
    value: float | None = None
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Metric:
    """A number that a stage learnt or used. `unit` is SI, or deg where people read it; low and high bound 95 %."""

    name: str
    value: float | None = None
    unit: str = ""
    sigma: float | None = None
    low: float | None = None
    high: float | None = None
    method: str = ""
    note: str = ""


def warning(note: str) -> Metric:
    """A row that the runner shows to the user at the end and keeps in the manifest."""
    return Metric(WARNING, note=note)


def events(items: Iterable[Event]) -> pa.Table:
    """The `events` table of the items, sorted by start."""
    found = sorted(items, key=lambda event: (event.start_ns, event.end_ns))
    return build(
        EVENTS,
        time=times([event.start_ns for event in found]),
        end_time=times([event.end_ns for event in found]),
        kind=pa.array([event.kind for event in found], pa.string()),
        value=pa.array([event.value for event in found], pa.float64(), from_pandas=True),
        unit=pa.array([event.unit for event in found], pa.string()),
        note=pa.array([event.note for event in found], pa.string()),
    )


def metrics(items: Iterable[Metric]) -> pa.Table:
    """The `metrics` table of the items, in their order."""
    found = list(items)
    columns = {
        column.name: pa.array([getattr(item, column.name) for item in found], column.type, from_pandas=True)
        for column in METRICS.columns
    }
    return build(METRICS, **columns)


def warnings_of(table: pa.Table | None) -> list[str]:
    """The notes of the warnings among metrics rows."""
    if table is None:
        return []
    return [row["note"] for row in table.select(["name", "note"]).to_pylist() if row["name"] == WARNING]


def spans(table: pa.Table | None, kind: str) -> list[tuple[int, int]]:
    """(start, end) in ns since 1970 of the events of one kind, sorted by start."""
    if table is None:
        return []
    import pyarrow.compute as pc  # slow import: only when used

    chosen = table.select(["time", "end_time", "kind"]).filter(pc.equal(table["kind"], kind))
    starts = chosen["time"].cast(pa.int64()).to_pylist()
    ends = chosen["end_time"].cast(pa.int64()).to_pylist()
    return sorted(zip(starts, ends, strict=True))
