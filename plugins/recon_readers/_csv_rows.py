"""Which rows of a sheet a sensor reported: with a time of their own, valid, and new."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from recon.rows import Metric, warning
from recon.tables import Array
from recon_readers._csv_mapping import Stream
from recon_readers._csv_sheet import Cells, Sheet
from recon_readers._csv_time import Clock
from recon_readers._fresh_rows import Seen, gnss_rows, imu_rows, see
from recon_readers._limits import MOST_FAULTY
from recon_readers._mapping_parts import Valid
from recon_readers._time_order import Mask, in_order, repeating

NS: Final = 1_000_000_000
STANDING: Final = 1.0 / 3.6
"""m/s; receivers at rest report up to this."""


@dataclass(frozen=True)
class Part:
    """A stream in one file, before it is made.

    columns : indices of the columns by group
    """

    mapping: Stream
    columns: Mapping[str, tuple[int, ...]]


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
        *_dropped(sheet, mapping.stream, faults, late),
    ]
    return Fresh(rows, tuple(learnt))


def _dropped(sheet: Sheet, stream: str, faults: Mask, late: Mask) -> list[Metric]:
    """What is to be told of rows (n,) that are dropped, those among them whose time is missing or runs backwards."""
    if not faults.any():
        return []
    what = f"time is missing, repeats or runs backwards in {int(faults.sum())} of {len(faults)} rows"
    first = f"first in line {sheet.place(int(faults.argmax()), 0)[0]}"
    learnt = [Metric("rows_dropped", float(faults.sum()), method=stream, note=f"{what}, {first}")]
    for name, mask in (("rows_of_one_time", faults & ~late), ("rows_out_of_order", faults & late)):
        learnt += [Metric(name, float(mask.sum()), method=stream)] * bool(mask.any())
    return [*learnt, warning(f"dropped from {sheet.path.name}, {stream}: {what}, {first}")]


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
