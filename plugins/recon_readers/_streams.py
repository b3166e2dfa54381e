"""Columns of a log to a stream: what cannot be is left out and counted, and times rise.

For readers of logs in which single rows may be damaged.
"""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon.schema import Schema, group_of, spread
from recon.tables import Array, build
from recon_readers._columns import kept
from recon_readers._limits import LIMITS
from recon_readers._time_order import Mask, Times, in_order, repeating

WHOLE: Final = ("fix", "satellites")
SIGMAS: Final = ("pos_std", "vel_std", "att_std")
_LIMITS: Final = {**LIMITS, "pos": (-1e7, 1e7), "acc": (-1e6, 1e6)}
_SIGMA_LIMITS: Final = (0.0, 1e6)
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
            found[name] = _possible(source, name, values, learnt)
    _without_zero_place(found)
    valued = np.zeros(len(t_ns), dtype=bool)
    for name, values in found.items():
        if name not in WHOLE and group_of(name) not in SIGMAS:
            valued |= np.isfinite(values)
    untimed = missing | (np.abs(t_ns) > _LATEST_NS)
    timed = in_order(np.where(untimed, 0, t_ns) if untimed.any() else t_ns, untimed)
    rows = timed & ~repeating(t_ns, [timed]) & valued
    _count(source, "time is missing, repeats or is out of order", int((valued & ~rows).sum()), learnt)
    if not valued.all():
        learnt.append(
            Metric("rows_without_value", float((~valued).sum()), note=f"of {len(valued)} rows of {source.name}")
        )
    if not rows.any():
        return None, learnt
    for name in list(found):
        found[name] = kept(found[name], rows)
    there = dict.fromkeys(group_of(name) for name, values in found.items() if np.isfinite(values).any())
    columns = {
        name: _integers(values) if name in WHOLE else values
        for name, values in found.items()
        if group_of(name) in there
    }
    return build(schema.only(*there), time=kept(t_ns, rows), **columns), learnt


def _columns(schema: Schema, group: str, values: Array) -> dict[str, Array]:
    """A group as columns."""
    return {group: values} if values.ndim == 1 else dict(zip(spread(group, schema.names), values.T, strict=True))


def _possible(source: Source, name: str, values: Array, learnt: list[Metric]) -> Array:
    """The values without those that no vehicle shows."""
    values = np.asarray(values, dtype=np.float64)
    group = group_of(name)
    if group in SIGMAS:
        with np.errstate(invalid="ignore"):
            return np.where((values > _SIGMA_LIMITS[0]) & (values < _SIGMA_LIMITS[1]), values, np.nan)
    low, high = _LIMITS.get(group, (-1e12, 1e12))
    outside = (values < low) | (values > high)
    if outside.any():
        first = int(outside.argmax())
        what = f"{name} of {values[first]:.6g} lies outside {low:g} to {high:g}"
        line = source.line(first) if source.line is not None else None
        if outside.sum() > 0.5 * np.isfinite(values).sum():
            raise ReadFailed(source.path, what, line=line, hint="the file is damaged, or of another unit or format")
        _count(source, what + (f", first in line {line}" if line else ""), int(outside.sum()), learnt)
    lost = outside | np.isinf(values)
    possible = np.where(lost, np.nan, values) if lost.any() else values
    return np.mod(possible, 2.0 * np.pi) if name == "course" else possible


def _without_zero_place(found: dict[str, Array]) -> None:
    """A position of exactly 0, 0 is no fix."""
    if "lat" in found and "lon" in found:
        no_fix = ((found["lat"] == 0.0) & (found["lon"] == 0.0)) | np.isnan(found["lat"]) | np.isnan(found["lon"])
        for name in ({"lat", "lon", "height"} & found.keys()) if no_fix.any() else ():
            found[name] = np.where(no_fix, np.nan, found[name])


def _count(source: Source, what: str, count: int, learnt: list[Metric]) -> None:
    if count:
        learnt.append(Metric("values_left_out", float(count), method=source.name, note=what))
        learnt.append(warning(f"left out of {source.path.name}, {source.name}: {what} ({count} times)"))


def _integers(values: Array) -> pa.Array:
    return pa.array(values, from_pandas=True).cast(pa.int32(), safe=False)
