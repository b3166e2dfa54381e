"""Columns of a sheet to streams: in SI, along the axes forward, left, up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.numerics.axes import is_earth, turn
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import Metric, warning
from recon.schema import STREAMS, Column, spread
from recon.tables import Array, build, with_meta
from recon.units import convert
from recon_readers._columns import at_rows, kept
from recon_readers._csv_mapping import Stream, gnss_facts
from recon_readers._csv_rows import Part
from recon_readers._csv_sheet import Sheet
from recon_readers._csv_time import Clock
from recon_readers._limits import FASTEST_TURN, LIMITS, USUAL_SIZE
from recon_readers._mapping_parts import Accel, Source, Vector
from recon_readers._time_order import Mask, slots

NS: Final = 1_000_000_000
_ENOUGH: Final = 100_000
"""Rows from which a median is told."""


def locate(sheet: Sheet, mapping: Stream) -> Part | None:
    """Where a stream's columns are in this file; None where the file holds none of them.

    Raises ReadFailed where it holds some of them only.
    """
    name = sheet.path.name
    groups = [group for group in mapping.sources if fnmatchcase(name, mapping.file_of(group) or "*")]
    found = {group: [sheet.find(ref) for ref in mapping.sources[group].references] for group in groups}
    if not any(index is not None for indices in found.values() for index in indices):
        return None
    valid = (mapping.valid.column,) if mapping.valid else ()
    named = [*mapping.time.references, *valid, *(ref for group in groups for ref in mapping.sources[group].references)]
    for ref in named:
        if sheet.find(ref) is None:
            what = f"{mapping.stream}: {sheet.lacks(ref)}"
            hint = "correct the mapping, or name the file that holds it under 'file'"
            raise ReadFailed(sheet.path, what, line=sheet.header_line or None, hint=hint)
    return Part(mapping, {group: tuple(i for i in indices if i is not None) for group, indices in found.items()})


def values_of(sheet: Sheet, part: Part, take: Callable[[int], Array]) -> dict[str, Array]:
    """Each group as (n, k) in the stream's unit, NaN where there is no value. Raises ReadFailed at impossible ones.

    take : gives the numbers of a column by its index, (n,)
    """
    found = {}
    for group, indices in part.columns.items():
        source = part.mapping.sources[group]
        wanted = STREAMS[part.mapping.stream].columns_of(group)[0]
        columns = [_in_unit(take(index), source, wanted) for index in indices]
        values = np.array(columns).T  # each column in one piece, as the table will have it
        _check_limits(sheet, group, indices, values, wanted)
        found[group] = values
    if "lat" in found and "lon" in found:
        no_fix = (found["lat"] == 0.0) & (found["lon"] == 0.0)
        for name in {"lat", "lon", "height"} & found.keys():
            found[name] = np.where(no_fix, np.nan, found[name])
    return found


def _in_unit(values: Array, source: Source, wanted: Column) -> Array:
    for number in source.invalid:
        values = np.where(values == number, np.nan, values)
    with np.errstate(over="ignore"):
        return convert(values * source.scale, source.unit or wanted.unit or "1", wanted.unit or "1")


def _check_limits(sheet: Sheet, group: str, indices: tuple[int, ...], values: Array, wanted: Column) -> None:
    low, high = LIMITS.get(group, (-1e12, 1e12))
    outside = (values < low) | (values > high)
    if outside.any():
        row, axis = (int(number) for number in np.argwhere(outside)[0])
        what = f"{group} of {values[row, axis]:.6g} {wanted.unit} lies outside {low:g} to {high:g}"
        hint = "check unit and scale in the mapping, name the number under 'invalid', or repair the line"
        if group == "lat" and abs(values[row, axis]) <= 180.0:
            hint = f"are latitude and longitude swapped? else {hint}"
        raise sheet.refused(row, indices[axis], what, hint)


def make(part: Part, clock: Clock, values: dict[str, Array], rows: Mapping[str, Mask]) -> pa.Table | None:
    """The stream. Rows of one time that update different sensors become one; null where a sensor said nothing.

    values : by group, emptied as they become columns, so that both are not there at once
    """
    some = np.logical_or.reduce(list(rows.values()))
    if not some.any():
        return None
    t_ns = kept(clock.t_ns, some)
    begins, slot = slots(t_ns)
    count = int(slot[-1]) + 1
    schema = STREAMS[part.mapping.stream]
    columns: dict[str, Any] = {}
    for group, mask in rows.items():
        own, at = values.pop(group), slot[mask[some]]
        index, signs = _axes(part.mapping, group, own.shape[1])
        for name, axis, sign in zip(spread(group, schema.names), index, signs, strict=True):
            column = at_rows(kept(own[:, axis], mask), at, count)
            columns[name] = _typed(column if sign > 0.0 else -column, schema[name])
    table = build(schema.only(*rows), time=kept(t_ns, begins), **columns)
    told, scale = ("absolute", "UTC") if clock.absolute else ("relative", None)
    return with_meta(table, clock=told, time_scale=scale, **_facts(part))


def _typed(values: Array, column: Column) -> Any:
    if column.name == "course":
        return np.mod(values, 2.0 * np.pi)
    return values if column.type == pa.float64() else pa.array(values, from_pandas=True).cast(column.type, safe=False)


def _axes(mapping: Stream, group: str, width: int) -> tuple[Sequence[int], Sequence[float]]:
    """Which column is which component along forward, left, up, or east, north, up, and its sign.

    Specific force points up at rest.
    """
    source = mapping.sources[group]
    if not isinstance(source, Vector):
        return range(width), [1.0] * width
    down = -1.0 if isinstance(source, Accel) and source.at_rest == "down" else 1.0
    axes = mapping.axes_of(group)
    if not axes:
        return range(width), [down] * width
    index, signs = turn(axes)
    return index, [1.0] * width if group.endswith("std") else [down * sign for sign in signs]


def _facts(part: Part) -> dict[str, str | None]:
    axes = next((part.mapping.axes_of(group) for group in ("accel", "gyro", "mag") if group in part.columns), "")
    return {"format": "csv", "axes": axes or None, **gnss_facts(part.mapping, part.columns)}


def assumptions(sheet: Sheet, part: Part, values: Mapping[str, Array]) -> list[Metric]:
    """What the mapping said of each group, and where the values contradict it."""
    found = []
    for group, indices in part.columns.items():
        source = part.mapping.sources[group]
        parts = [", ".join(sheet.title(index) for index in indices)]
        parts += [f"in {source.unit}"] * bool(source.unit) + [f"times {source.scale:g}"] * (source.scale != 1.0)
        if isinstance(source, Vector):
            axes = part.mapping.axes_of(group)
            parts.append(f"axes {axes}" if axes else "axes as logged, taken for right-handed")
        if isinstance(source, Accel):
            parts.append(f"at rest {source.at_rest}")
            found += _doubts(part.mapping, source, _some(values[group]))
        found.append(Metric(f"column_{group}", method=part.mapping.stream, note=", ".join(parts)))
    if "gyro" in values:
        rates = np.abs(_some(values["gyro"]))
        rates = rates[~np.isnan(rates)]
        if len(rates) and np.percentile(rates, 99) > FASTEST_TURN:
            text = f"a hundredth of the rates exceed {FASTEST_TURN:g} rad/s: is the gyroscope's unit deg/s?"
            found.append(warning(text))
    facts = gnss_facts(part.mapping, part.columns)
    found += [Metric(f"assumed_{key}", note=facts[key]) for key in ("height_datum", "heading_kind") if key in facts]
    return found


def _some(values: Array) -> Array:
    """Rows enough for a median."""
    return values[:: max(len(values) // _ENOUGH, 1)]


def _doubts(mapping: Stream, source: Accel, values: Array) -> list[Metric]:
    size = np.linalg.norm(values, axis=1) / STANDARD_GRAVITY
    size = size[~np.isnan(size)]
    if not len(size) or source.at_rest == "zero":
        return []
    found = []
    if not USUAL_SIZE[0] <= np.median(size) <= USUAL_SIZE[1]:
        text = f"the median acceleration is {np.median(size):.4g} g where a vehicle feels about 1 g"
        found.append(warning(f"{text}: check the unit of accel, or map 'at_rest: zero' if gravity is removed"))
    axes = mapping.axes_of("accel")
    index, signs = _axes(mapping, "accel", values.shape[1])
    up = signs[2] * np.nanmedian(values[:, index[2]]) / STANDARD_GRAVITY
    if axes and up < -USUAL_SIZE[0]:
        other = "up" if source.at_rest == "down" else "down"
        text = f"accelerations point down ({up:.2f} g) where a still accelerometer feels gravity's reaction upwards"
        found.append(warning(f"{text}: check axes {axes}, or map 'at_rest: {other}'"))
    if is_earth(axes):
        text = "accelerations along axes of the Earth do not tell where the vehicle's front is"
        found.append(warning(text))
    return found
