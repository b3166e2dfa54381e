"""Columns of a log to a stream: what cannot be is left out and counted, and times rise.

`stream` is for logs in which single rows may be damaged; `described` for messages, which are whole or not there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.rounding import occasions
from recon.rows import Metric, warning
from recon.schema import Schema, group_of, spread
from recon.tables import Array, build
from recon_readers._columns import kept
from recon_readers._limits import SIGMAS, possible
from recon_readers._time_order import Mask, Times, in_order, repeating

WHOLE: Final = ("fix", "satellites")
_MOST_IMPOSSIBLE: Final = 0.5
"""Share of a column's values: rows of text, without checksums, are damaged one by one."""
_LATEST_NS: Final = 4_200_000_000 * 1_000_000_000
"""The year 2103; and as far before 1970."""


@dataclass(frozen=True)
class Source:
    """Where a stream comes from: the file, how its rows are called, and the line of a row where there are lines."""

    path: Path
    name: str
    line: Callable[[int], int] | None = None


def stream(
    source: Source, schema: Schema, t_ns: Times, missing: Mask, groups: MutableMapping[str, Array]
) -> tuple[pa.Table | None, list[Metric]]:
    """A stream of the rows that have a time and a value, None where none has; and what was left out.

    t_ns : (n,) ns; missing : (n,) bool, rows without a time
    groups : columns (n,) or groups (n, k) in the units of the schema, NaN where there is no value; emptied, so that
        they and the stream are not there at once

    Raises ReadFailed where most values of a column are impossible: then they are of another unit or format.
    """
    learnt: list[Metric] = []
    if not len(t_ns):
        return None, learnt
    found: dict[str, Array] = {}
    for group in list(groups):
        for name, values in _columns(schema, group, groups.pop(group)).items():
            values = np.asarray(values, dtype=np.float64)
            most, line = _MOST_IMPOSSIBLE, source.line
            found[name], told = possible(source.path, source.name, name, values, most=most, line=line)
            learnt += told
    _without_zero_place(found)
    has_value = np.zeros(len(t_ns), dtype=bool)
    for name, values in found.items():
        if name not in WHOLE and group_of(name) not in SIGMAS:
            has_value |= np.isfinite(values)
    untimed = missing | (np.abs(t_ns) > _LATEST_NS)
    timed = in_order(np.where(untimed, 0, t_ns) if untimed.any() else t_ns, untimed)
    rows = timed & ~repeating(t_ns, [timed]) & has_value
    _count(source, "time is missing, repeats or is out of order", int((has_value & ~rows).sum()), learnt)
    if not has_value.all():
        learnt.append(
            Metric("rows_without_value", float((~has_value).sum()), note=f"of {len(has_value)} rows of {source.name}")
        )
    if not rows.any():
        return None, learnt
    for name in list(found):
        found[name] = kept(found[name], rows)
    return described(schema, kept(t_ns, rows), valued(found)), learnt


def described(schema: Schema, t_ns: Times, columns: Mapping[str, Array]) -> pa.Table:
    """A stream of single columns, numbers of any type of the schema. t_ns : (n,) ns that rises; NaN where unknown."""
    if "course" in columns:
        columns = {**columns, "course": np.mod(columns["course"], 2.0 * np.pi)}
    there = Schema(tuple(column for column in schema.columns if column.name in ("time", *columns)))
    typed: dict[str, Any] = {
        name: values
        if there[name].type == pa.float64()
        else pa.array(values, from_pandas=True).cast(there[name].type, safe=False)
        for name, values in columns.items()
    }
    return build(there, time=t_ns, **typed)


def valued(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns of groups that have a value anywhere."""
    groups = {group_of(name) for name, values in columns.items() if np.isfinite(values).any()}
    return {name: values for name, values in columns.items() if group_of(name) in groups}


def _columns(schema: Schema, group: str, values: Array) -> dict[str, Array]:
    """A group as columns."""
    return {group: values} if values.ndim == 1 else dict(zip(spread(group, schema.names), values.T, strict=True))


def _without_zero_place(found: dict[str, Array]) -> None:
    """A position of exactly 0, 0 is no fix."""
    if "lat" in found and "lon" in found:
        no_fix = ((found["lat"] == 0.0) & (found["lon"] == 0.0)) | np.isnan(found["lat"]) | np.isnan(found["lon"])
        for name in ({"lat", "lon", "height"} & found.keys()) if no_fix.any() else ():
            found[name] = np.where(no_fix, np.nan, found[name])


def _count(source: Source, what: str, count: int, learnt: list[Metric]) -> None:
    if count:
        learnt.append(Metric("values_left_out", float(count), method=source.name, note=what))
        learnt.append(warning(f"left out of {source.path.name}, {source.name}: {what} ({occasions(count)})"))
