"""Columns of a sheet to streams: which rows a sensor reported, in SI, along the axes forward, left, up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
from recon_readers._csv_mapping import Accel, Source, Stream, Valid, Vector, gnss_facts
from recon_readers._csv_sheet import Cells, Sheet
from recon_readers._csv_time import Clock
from recon_readers._fresh_rows import Seen, gnss_rows, imu_rows, see
from recon_readers._limits import FASTEST_TURN, LIMITS, MOST_FAULTY, USUAL_SIZE
from recon_readers._time_order import Mask, in_order, repeating

NS: Final = 1_000_000_000
_ENOUGH: Final = 100_000
"""Rows from which a median is told."""
STANDING: Final = 1.0 / 3.6
"""m/s; receivers at rest report up to this."""


@dataclass(frozen=True)
class Part:
    """A stream in one file, before it is made.

    columns : indices of the columns by group
    """

    mapping: Stream
    columns: Mapping[str, tuple[int, ...]]


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


@dataclass(frozen=True)
class Others:
    """What else stands in the rows of a stream: is there an IMU, and what does the GNSS receiver show?"""

    imu: bool = False
    gnss: Seen | None = None


@dataclass(frozen=True)
class Fresh:
    """Which rows a sensor reported: (n,) bool by group; and what was found out about them."""

    rows: Mapping[str, Mask]
    learnt: tuple[Metric, ...]


def fresh_rows(
    sheet: Sheet, part: Part, clock: Clock, values: Mapping[str, Array], valid: Mask | None, others: Others
) -> Fresh:
    """Rows that bring a measurement.

    valid : (n,) bool, rows that the mapping calls valid, None where it does not tell

    Raises ReadFailed where the time of too many rows is missing, repeats or runs backwards.
    """
    mapping = part.mapping
    counted = np.ones(len(clock.t_ns), dtype=bool) if valid is None else valid
    notes = []
    if mapping.valid is not None:
        index = sheet.find(mapping.valid.column)
        notes.append((int((~counted).sum()), f"not valid by {sheet.title(index or 0)}"))
    late = ~in_order(clock.t_ns, clock.missing)
    seen = {group: _seen(array, counted & ~late) for group, array in values.items()}
    rows, how = _chosen(part.mapping, clock, seen, values, others)
    same = repeating(clock.t_ns, rows.values()) & ~late
    silent = same & ~np.logical_or.reduce([one.news for one in seen.values()])
    known = np.logical_or.reduce([_known(array) for array in values.values()]) & counted
    faults = (late & known) | (same & ~silent)
    if mapping.same_time == "first":
        notes.append((int((same & ~silent).sum()), "of the time of an earlier one"))
        faults = late & known
    rows = {group: mask & ~late & ~same for group, mask in rows.items()}
    used = np.logical_or.reduce(list(rows.values()))
    _refuse_many(sheet, part, faults, len(clock.t_ns))
    n = len(used)
    notes += [(int((~known & counted).sum()), "blank")]
    notes += [(n - int(used.sum()) - int(faults.sum()) - sum(count for count, _ in notes), "repeated")]
    told = ", ".join(f"{count} {what}" for count, what in notes if count > 0)
    learnt = [
        Metric("rows_used", float(used.sum()), method=mapping.stream, note=f"of {n} rows" + f"; {told}" * bool(told)),
        Metric("fill", method=mapping.stream, note=how),
    ]
    if faults.any():
        what = f"time is missing, repeats or runs backwards in {int(faults.sum())} of {n} rows"
        first = f"first in line {sheet.place(int(faults.argmax()), 0)[0]}"
        learnt.append(Metric("rows_dropped", float(faults.sum()), method=mapping.stream, note=f"{what}, {first}"))
        for name, mask in (("rows_of_one_time", faults & ~late), ("rows_out_of_order", faults & late)):
            learnt += [Metric(name, float(mask.sum()), method=mapping.stream)] * bool(mask.any())
        learnt.append(warning(f"dropped from {sheet.path.name}, {mapping.stream}: {what}, {first}"))
    return Fresh(rows, tuple(learnt))


def valid_rows(sheet: Sheet, valid: Valid, cells: Cells) -> Mask:
    """Rows of a block that the mapping calls valid: (n,) bool."""
    index = sheet.find(valid.column)
    assert index is not None
    coded = pa.array(cells.texts[index].combine_chunks()).dictionary_encode()
    good = [_is_one_of(text, valid.values) for text in coded.dictionary.to_pylist()]
    codes = np.asarray(coded.indices.fill_null(len(good)))
    return np.asarray(np.array([*good, False])[codes])


def _is_one_of(text: str | None, values: tuple[int | float | str, ...]) -> bool:
    if text in {str(value) for value in values}:
        return True
    try:
        return float(text or "nan") in values
    except ValueError:
        return False


def _known(values: Array) -> Mask:
    return np.asarray(~np.isnan(values).all(axis=1))


def _seen(values: Array, usable: Mask) -> Seen:
    """What a group shows, its other rows taken for blank."""
    columns = [values[:, axis] for axis in range(values.shape[1])]
    return see(columns if usable.all() else [np.where(usable, column, np.nan) for column in columns])


def together(values: Mapping[str, Array]) -> Seen:
    """What all groups of a stream show."""
    usable = np.ones(len(next(iter(values.values()))), dtype=bool)
    return _joined({group: _seen(array, usable) for group, array in values.items()})


def _joined(seen: Mapping[str, Seen]) -> Seen:
    known = np.logical_or.reduce([one.known for one in seen.values()])
    return Seen(known, np.logical_or.reduce([one.news for one in seen.values()]))


def _chosen(
    mapping: Stream, clock: Clock, seen: Mapping[str, Seen], values: Mapping[str, Array], others: Others
) -> tuple[dict[str, Mask], str]:
    """Rows by group that hold something new, by the mapping's `keep`; how the others are filled, as a phrase."""
    known = {group: one.known for group, one in seen.items()}
    if mapping.keep == "changes":
        return dict.fromkeys(seen, _joined(seen).news), "rows that repeat the last values are left out"
    sensors = {group: one for group, one in seen.items() if group in ("accel", "gyro")}
    if sensors and mapping.keep == "auto":
        rows, how = imu_rows(sensors, others.gnss)
        some = np.logical_or.reduce(list(rows.values()))
        return {group: rows.get(group, one.known & some) for group, one in seen.items()}, how
    if mapping.keep == "auto" and others.imu:
        place = {group: one for group, one in seen.items() if group in ("lat", "lon")}
        whole = Seen(_joined(seen).known, _joined(place or seen).news)
        found = gnss_rows(np.maximum.accumulate(clock.t_ns), whole, _standing(values))
        if found.held:
            period = "" if found.period_ns is None else f", one each {found.period_ns / NS:.4g} s"
            return {group: one.known & found.fresh for group, one in seen.items()}, f"repeated between reports{period}"
    return known, "every row that holds values is kept"


def _standing(values: Mapping[str, Array]) -> Mask:
    """Rows in which the vehicle stands, (n,) bool; none where nothing tells its speed."""
    moving = values.get("speed", values.get("vel"))
    if moving is None:
        return np.zeros(len(next(iter(values.values()))), dtype=bool)
    return np.asarray(np.linalg.norm(moving, axis=1) < STANDING)


def _refuse_many(sheet: Sheet, part: Part, faults: Mask, n: int) -> None:
    if faults.any() and faults.sum() >= MOST_FAULTY * n:
        row = int(faults.argmax())
        index = sheet.find(part.mapping.time.references[0]) or 0
        what = f"time is missing, repeats or runs backwards in {int(faults.sum())} of {n} rows, first here"
        hint = "sort the rows, cut the log where its clock jumped, or map 'same_time: first' to keep one row of a time"
        raise sheet.refused(row, index, f"{part.mapping.stream}: {what}", hint)


def make(part: Part, clock: Clock, values: dict[str, Array], rows: Mapping[str, Mask]) -> pa.Table | None:
    """The stream. Rows of one time that update different sensors become one; null where a sensor said nothing.

    values : by group, emptied as they become columns, so that both are not there at once
    """
    some = np.logical_or.reduce(list(rows.values()))
    if not some.any():
        return None
    t_ns = kept(clock.t_ns, some)
    begins = np.diff(t_ns, prepend=t_ns[0] - 1) > 0
    slot = np.cumsum(begins, dtype=np.int32) - 1
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
