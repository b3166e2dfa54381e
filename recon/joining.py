"""One recording from several files of one drive.

    accelerometer and gyroscope in two files     columns that complement each other become one stream
    a log cut into pieces                        rows that follow each other become one stream; rows that two pieces
                                                 both hold are taken once
    two sensors of one kind                      are kept side by side as `imu`, `imu_2`, ...

What belongs to two drives, or contradicts itself, is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError
from recon.recording import Recording
from recon.rows import Metric, warning
from recon.schema import APPENDED
from recon.tables import append, meta, select_rows, time_ns, with_meta
from recon.units import duration_text

LONGEST_PAUSE_NS: Final = 600 * 1_000_000_000
"""Files further apart in time are two drives."""
MOST_OVERLAP: Final = 0.5
"""Pieces of a log share less than this part of the shorter one; what shares more was logged side by side."""


@dataclass(frozen=True)
class _Part:
    """A table and the files that it comes from."""

    table: pa.Table
    files: tuple[str, ...]


def combine(recordings: Sequence[Recording], read: Collection[str] = ()) -> tuple[Recording, list[Metric]]:
    """One recording of all streams, and what is to be told of it.

    read : names of the streams that are read on purpose, of which nothing is to be told

    Streams that cannot be joined keep the order given, the one with more columns first. Raises DataError where two
    hold the same, contradict each other where they overlap, or are more than ten minutes apart.
    """
    _refuse_twins(recordings)
    _refuse_two_drives(recordings)
    parts, learnt = _without_overlap(recordings)
    gathered: dict[str, list[_Part]] = {}
    for number, recording in enumerate(parts, start=1):
        for name, table in recording.items():
            gathered.setdefault(name, []).append(_Part(table, (_name(recording, number),)))
    streams: dict[str, pa.Table] = {}
    for name, found in gathered.items():
        first, *others = _merge(name, found)
        streams[name] = first.table
        for number, part in enumerate(others, start=2):
            streams[f"{name}_{number}"] = part.table
            if f"{name}_{number}" not in read:
                learnt.append(warning(_beside(name, number, part, first)))
    sources = [source for recording in recordings for source in recording.meta.get("sources", [])]
    return Recording(streams, {"sources": sources} if sources else {}), learnt


def _beside(name: str, number: int, part: _Part, first: _Part) -> str:
    return (
        f"{name}_{number} ({', '.join(part.files)}) is a further sensor beside {name} ({', '.join(first.files)}); "
        f"steps read {name} unless told otherwise"
    )


def _name(recording: Recording, number: int) -> str:
    return ", ".join(recording.meta.get("sources", [])) or f"recording {number}"


# --- what is refused ------------------------------------------------------------------------------------------------


def _refuse_twins(recordings: Sequence[Recording]) -> None:
    for (one, first), (other, second) in combinations(enumerate(recordings, start=1), 2):
        data, again = _data(first), _data(second)
        if data and data.keys() == again.keys() and all(table.equals(again[name]) for name, table in data.items()):
            names = f"{_name(first, one)} and {_name(second, other)}"
            raise DataError(f"{names} hold the same rows", "name each file of the drive once")


def _data(recording: Recording) -> dict[str, pa.Table]:
    return {name: table for name, table in recording.items() if name not in APPENDED and table.num_rows}


def _refuse_two_drives(recordings: Sequence[Recording]) -> None:
    found = [(recording.span_ns(), _name(recording, number)) for number, recording in enumerate(recordings, start=1)]
    spans = sorted((span, name) for span, name in found if span is not None)
    end = spans[0][0][1] if spans else 0
    for (_, before), ((start, stop), name) in pairwise(spans):
        if start - end > LONGEST_PAUSE_NS:
            apart = duration_text((start - end) * 1e-9)
            raise DataError(f"{before} and {name} are two drives: they are {apart} apart", "run them one by one")
        end = max(end, stop)


# --- rows that two pieces hold --------------------------------------------------------------------------------------


def _without_overlap(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Metric]]:
    """The recordings without rows that an earlier piece of the same log holds too, in the order given."""
    parts, learnt = list(recordings), []
    starts = {index: span[0] for index, part in enumerate(parts) if (span := part.span_ns()) is not None}
    for early, late in combinations(sorted(starts, key=lambda index: starts[index]), 2):
        names = f"{_name(parts[early], early + 1)} and {_name(parts[late], late + 1)}"
        shared = _shared_rows(parts[early], parts[late], names)
        if shared:
            parts[late] = _after(parts[late], parts[early])
            note = f"rows that {names} both hold are taken once"
            learnt.append(Metric("rows_joined", float(shared), note=note))
    return parts, learnt


def _shared_rows(early: Recording, late: Recording, names: str) -> int:
    """How many rows two pieces of one log both hold, of the stream that has most there; 0 where they are no pieces.

    Raises DataError where two pieces differ in what they share.
    """
    names_of_both = [name for name in late if name in early and name not in APPENDED]
    both = [(early[name], late[name]) for name in names_of_both if _alike(early[name], late[name])]
    overlaps = [(_during(first, second), _during(second, first), first, second) for first, second in both]
    if not overlaps:
        return 0
    one, other, first, second = max(overlaps, key=lambda found: found[1].num_rows)
    if not (one.num_rows and other.num_rows):
        return 0
    if _agree(one, other):
        return int(other.num_rows)
    lasting = np.ptp(np.concatenate([time_ns(one), time_ns(other)]))
    if lasting >= MOST_OVERLAP * min(np.ptp(time_ns(first)), np.ptp(time_ns(second))):
        return 0
    what = f"{names} overlap by {duration_text(lasting * 1e-9)} ({other.num_rows} rows) and differ there"
    raise DataError(what, "cut the overlap from one of them, or run them one by one")


def _alike(first: pa.Table, second: pa.Table) -> bool:
    """Can two tables be pieces of one stream? They have times, the same columns and the same facts."""
    names = set(first.column_names)
    return "time" in names and names == set(second.column_names) and meta(first) == meta(second)


def _during(table: pa.Table, other: pa.Table) -> pa.Table:
    """The rows from the first to the last time of another table."""
    t_ns, span = time_ns(table), time_ns(other)
    return select_rows(table, (t_ns >= span[0]) & (t_ns <= span[-1])) if len(span) else table.slice(0, 0)


def _agree(first: pa.Table, second: pa.Table) -> bool:
    """Do most rows have a time of the other table, and at those times the same values, as far as both have one?"""
    times, own, others = np.intersect1d(time_ns(first), time_ns(second), return_indices=True)
    if 2 * len(times) < max(first.num_rows, second.num_rows):
        return False
    one, other = select_rows(first, own), select_rows(second, others)
    return all(_same(one[name], other[name]) for name in one.column_names)


def _same(one: pa.ChunkedArray, other: pa.ChunkedArray) -> bool:
    """Equal wherever both have a value."""
    import pyarrow.compute as pc  # slow import: only when used

    if pa.types.is_nested(one.type):  # which pc.equal does not take
        both = pc.and_(one.is_valid(), other.is_valid())
        return bool(one.filter(both).equals(other.filter(both)))
    return bool(pc.all(pc.fill_null(pc.equal(one, other), True)).as_py())


def _after(late: Recording, early: Recording) -> Recording:
    """The later piece without what lies in the times of the earlier one."""
    rest = {}
    for name, table in late.items():
        if name not in APPENDED and name in early and _alike(early[name], table) and early[name].num_rows:
            t_ns, span = time_ns(table), time_ns(early[name])
            table = select_rows(table, (t_ns < span[0]) | (t_ns > span[-1]))
        rest[name] = table
    return Recording(rest, late.meta)


# --- streams of one name --------------------------------------------------------------------------------------------


def _merge(name: str, parts: Sequence[_Part]) -> list[_Part]:
    if name in APPENDED:
        return _folded(parts, append)
    merged = list(parts)
    if all("time" in part.table.column_names for part in parts):
        for join in (_continued, _complemented, _continued):  # pieces, then sensors, then pieces logged as one file
            merged = _folded(merged, join)
    return sorted(merged, key=lambda part: -len(part.table.column_names))


def _folded(parts: Sequence[_Part], join: Callable[[pa.Table, pa.Table], pa.Table | None]) -> list[_Part]:
    """Each table joined to the first one before it that `join` joins it to."""
    merged: list[_Part] = []
    for part in parts:
        for index, other in enumerate(merged):
            joined = join(other.table, part.table)
            if joined is not None:
                merged[index] = _Part(joined, tuple(dict.fromkeys([*other.files, *part.files])))
                break
        else:
            merged.append(part)
    return merged


def _continued(first: pa.Table, second: pa.Table) -> pa.Table | None:
    """Two tables of the same columns and facts that follow each other in time as one, None for any others."""
    if not _alike(first, second):
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
