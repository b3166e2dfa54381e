"""A physycom file as it is, in its own units: opening it, refusing what cannot be, counting rows, voicing doubts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import Metric, warning
from recon.tables import Array, vector
from recon.units import duration_text
from recon_readers import _delimited, _text_blocks, _time_text
from recon_readers._columns import Columns
from recon_readers._limits import MOST_FAULTY, USUAL_SIZE
from recon_readers._physycom_json import read_records
from recon_readers._physycom_layouts import (
    ACCEL,
    CENTURY_S,
    EARLIEST_S,
    GYRO,
    LATEST_S,
    PLACE,
    SAME_ABS_G,
    WIDTHS,
    Layout,
    layout_of,
)
from recon_readers._text_blocks import Text
from recon_readers._time_order import Mask, Times, in_order, never_falling, pauses, repeating

LIMITS: Final[Mapping[str, tuple[float, float, str]]] = {
    "time": (0.0, CENTURY_S, "s since 2000"),
    "lat": (-90.0, 90.0, "deg"),
    "lon": (-180.0, 180.0, "deg"),
    "height": (-1000.0, 10_000.0, "m"),
    "heading": (-180.0, 360.0, "deg"),
    "speed": (0.0, 600.0, "km/h"),
    "fix": (0.0, 9.0, ""),
    **dict.fromkeys(ACCEL, (-1000.0, 1000.0, "g")),
    **dict.fromkeys(GYRO, (-10_000.0, 10_000.0, "deg/s")),
}
"""Least and largest value that a box in a vehicle can report; others mean a damaged row, another unit or format.

Roads lie between -430 m and 5900 m, satellite heights of a first fix err by kilometres. No wheeled vehicle in service
is faster than 600 km/h. The widest ranges of sensors that such boxes hold are 400 g and 4000 deg/s.
"""
_HINTS: Final = {
    "time": "write the times as seconds since 2000",
    **dict.fromkeys(ACCEL, "repair the line, or set 'gravity' to the acceleration that the file writes as 1"),
}

FEW: Final = 10
"""Values that may be missing from a column without a warning, if they are no larger share than that."""
SAME_TIME_S: Final = 0.01
"""timestamp_rel as a float of 24 bits resolves 8 ms after a day."""


@dataclass(frozen=True)
class Log:
    """A file as it is: n rows in its own units.

    time_ns : (n,) ns since 2000 by the clock of the box
    untimed : (n,) bool, rows whose time is missing or does not fit those around them; `open_log` gives them the time
        of a row beside them, so that times never fall
    columns : by name (n,), NaN where blank
    cut_line : line of a last row that was cut off and is not among the n
    place : (row, column name) -> line and column, 1-based, or None where the format has no lines
    """

    path: Path
    format: str
    about: str
    time_ns: Times
    untimed: Mask
    columns: Columns
    cut_line: int | None
    place: Callable[[int, str], tuple[int, int] | None]

    def group(self, names: Iterable[str]) -> list[Array]:
        """The columns of these names that are there: (n,) each, NaN in rows whose time cannot be used."""
        found = [self.columns[name] for name in names if name in self.columns]
        return [np.where(self.untimed, np.nan, values) for values in found] if self.untimed.any() else found

    @property
    def first_ns(self) -> int:
        """Time of the first row that has one, ns since 2000; 0 where none has."""
        return int(self.time_ns[np.argmin(self.untimed)])

    def refused(self, row: int, column: str, what: str, hint: str) -> ReadFailed:
        """The error that names a field."""
        place = self.place(row, column)
        if place is None:
            return ReadFailed(self.path, f"record {row + 1}: {what}", hint=hint)
        return ReadFailed(self.path, what, line=place[0], column=place[1], hint=hint)

    def line(self, row: int) -> str:
        """How people find a row."""
        place = self.place(row, "time")
        return f"record {row + 1}" if place is None else f"line {place[0]}"


def open_log(
    path: Path, sensor: Literal["accelerometer", "gyroscope"] | None, units: Mapping[str, float]
) -> tuple[Log, list[Metric]]:
    """Read a file of any format, without values that cannot be; and what was left out.

    sensor : what four columns hold where the header does not tell
    units : by column, its unit in that of LIMITS where it has another one
    Raises ReadFailed, and DataError where `sensor` must tell.
    """
    text = _text_blocks.load(path)
    log = _of_json(path, text) if text.head.lstrip()[:1] in (b"[", b"{") else _of_text(path, text, sensor)
    log, learnt = _within_limits(log, units)
    usable = in_order(log.time_ns, log.untimed)
    return replace(log, time_ns=never_falling(log.time_ns, usable), untimed=~usable), learnt


def _of_text(path: Path, text: Text, sensor: Literal["accelerometer", "gyroscope"] | None) -> Log:
    found = _delimited.survey(path, text, WIDTHS)
    layout = layout_of(found, sensor)
    columns = Columns.of(_blocks(found, layout), repeated=PLACE)
    time_ns, missing = columns.pop("time"), columns.pop("missing")
    header = f"header '{found.header[-1][:80]}'" if found.header else "no header"
    about = f"{found.width} columns, {'tabs' if found.separator == _delimited.TAB else 'spaces'}, {header}"

    def place(row: int, column: str) -> tuple[int, int]:
        return found.place(row, layout.columns.index(column))

    return Log(path, layout.name, about, time_ns, missing, columns, found.cut_line, place)


def _blocks(found: _delimited.Survey, layout: Layout) -> Iterator[tuple[float, dict[str, NDArray[Any]]]]:
    """Times in ns, whether they are missing, and the other columns, NaN where blank."""
    for share, table in _delimited.parse(found, layout.columns):
        time_ns, missing = _time_text.whole_ns(table["time"])
        numbers = {name: vector(table, name, gaps=True) for name in layout.columns[1:]}
        yield share, {"time": time_ns, "missing": missing, **numbers}


def _of_json(path: Path, text: Text) -> Log:
    table = read_records(path, text.whole())
    time_ns, missing = _time_text.whole_ns(table["time"])
    columns = Columns({name: vector(table, name, gaps=True) for name in table.column_names if name != "time"})
    return Log(path, "GNSS JSON", "records", time_ns, missing, columns, None, lambda row, column: None)


def _within_limits(log: Log, units: Mapping[str, float]) -> tuple[Log, list[Metric]]:
    """Take values that no vehicle and no clock can show out of the log, which is given back, and count them.

    Raises ReadFailed at the first one of a column that holds many: then they are of another unit or format.
    """
    columns, untimed, learnt = log.columns, log.untimed, []
    for name, (low, high, unit) in LIMITS.items():
        values = log.time_ns * 1e-9 if name == "time" else columns.get(name)
        if values is None:
            continue
        values = values * units.get(name, 1.0)
        outside = (values < low) | (values > high)
        if not outside.any():
            continue
        row, count = int(outside.argmax()), int(outside.sum())
        shown = name if name == "time" else f"{name} {values[row]:.10g}"
        what = f"{shown} lies outside {low:g} to {high:.10g} {unit}".rstrip()
        if count >= MOST_FAULTY * len(outside):
            raise log.refused(row, name, what, _HINTS.get(name, "repair the lines; leave blank what is not known"))
        note = f"{what} in {count} of {len(outside)} rows, first in {log.line(row)}"
        learnt += [Metric("values_outside_limits", float(count), method=name, note=note)]
        learnt += [warning(f"left out of {log.path.name}: {note}")]
        if name == "time":
            untimed = untimed | outside
        else:
            columns[name] = np.where(outside, np.nan, columns[name])
    return replace(log, untimed=untimed), learnt


def account(log: Log, sensors: Mapping[str, Mask]) -> tuple[Mask, list[Metric]]:
    """Rows whose time can be used, (n,) bool, and the count of all rows that were read.

    sensors : by name (n,) bool, rows that the sensor reported. Raises ReadFailed where the time of too many rows is
    missing, repeats or is out of line.
    """
    n, cut = len(log.time_ns), log.cut_line is not None
    again = repeating(log.time_ns, sensors.values()) & ~log.untimed
    faults = log.untimed | again
    empty = ~np.logical_or.reduce(list(sensors.values())) & ~faults
    reasons = [f"the last row, line {log.cut_line}, was cut off"] if cut else []
    if faults.any():
        count, first = int(faults.sum()), int(faults.argmax())
        what = f"time is missing, repeats or is out of line in {count} of {n} rows, first "
        if count >= MOST_FAULTY * n:
            raise log.refused(first, "time", f"{what}here", "sort the rows, or cut the log where its clock jumped")
        reasons.append(f"{what}in {log.line(first)}")
    warnings = [warning(f"dropped from {log.path.name}: {reason}") for reason in reasons]
    if empty.any():
        reasons.append(f"{int(empty.sum())} rows update no sensor, first {log.line(int(empty.argmax()))}")
    dropped = int(faults.sum()) + int(empty.sum()) + cut
    counts = [
        Metric("rows_read", float(n + cut)),
        Metric("rows_used", float(n + cut - dropped)),
        Metric("rows_dropped", float(dropped), note="; ".join(reasons)),
        *(
            Metric(name, float(mask.sum()))
            for name, mask in (("rows_of_one_time", again), ("rows_out_of_order", log.untimed))
            if mask.any()
        ),
    ]
    return ~faults, counts + warnings


def missing_values(log: Log, sensors: Mapping[str, tuple[Mask, Sequence[str]]]) -> list[Metric]:
    """How many values are missing from rows of a sensor, by column, with a warning where they are more than a few.

    sensors : by name the rows that it reported, (n,) bool, none standing for all, and its columns
    """
    found = []
    for sensor, (reported, names) in sensors.items():
        rows = reported if reported.any() else ~log.untimed
        for name in names:
            if name not in log.columns:
                continue
            blank = np.isnan(log.columns[name]) & rows
            count, total = int(blank.sum()), int(rows.sum())
            if count:
                line = log.line(int(blank.argmax()))
                note = f"{name} is missing in {count} of {total} rows of {sensor}, first in {line}"
                found.append(Metric("values_missing", float(count), method=name, note=note))
                found += [warning(note)] * (count > min(FEW, MOST_FAULTY * total))
    return found


def doubts(log: Log, gravity: float) -> list[Metric]:
    """Warnings where columns contradict each other, or the times or accelerations are not those of a vehicle.

    gravity : m/s^2, acceleration that the file writes as 1
    """
    found = []
    first_s = log.first_ns * 1e-9
    if first_s < EARLIEST_S:
        found.append(warning("the times begin before 2003: the clock of the box was not set, dates mean nothing"))
    if first_s > LATEST_S:
        found.append(warning("the times lie after 2038: if they count from 1970, every date is 30 years late"))
    found += _pauses(log)
    if "ax" in log.columns:
        size = np.sqrt(sum(values**2 for values in log.group(ACCEL)))
        found += _unusual_size(size[~np.isnan(size)] * (gravity / STANDARD_GRAVITY))
        if "abs" in log.columns:
            found += _disagreement(log, "|a|", size - log.columns["abs"], SAME_ABS_G, "g")
    if "relative" in log.columns:
        since = (log.time_ns - log.time_ns[0]) * 1e-9 - log.group(["relative"])[0]
        known = since[~np.isnan(since)]
        centre = np.median(known) if len(known) else 0.0
        found += _disagreement(log, "timestamp_rel", since - centre, SAME_TIME_S, "s")
    return found


def _pauses(log: Log) -> list[Metric]:
    rows = np.flatnonzero(~log.untimed)
    after = pauses(log.time_ns[rows])
    if not len(after):
        return []
    lasting = np.diff(log.time_ns[rows])[after] * 1e-9
    longest = int(lasting.argmax())
    text = f"no rows for {duration_text(lasting[longest])} after {log.line(int(rows[after[longest]]))}"
    more = f", the longest of {len(after)} pauses of more than an hour" if len(after) > 1 else ""
    return [warning(f"{text}{more}: are these several drives?")]


def _unusual_size(size: Array) -> list[Metric]:
    if not len(size) or USUAL_SIZE[0] <= np.median(size) <= USUAL_SIZE[1]:
        return []
    text = f"the median acceleration is {np.median(size):.4g} g where a vehicle feels about 1 g"
    return [warning(f"{text}: set 'gravity' to the acceleration that the file writes as 1, such as 1 m/s^2")]


def _disagreement(log: Log, name: str, difference: Array, limit: float, unit: str) -> list[Metric]:
    wrong = np.abs(difference) > limit
    if wrong.sum() <= MOST_FAULTY * len(wrong):
        return []
    row = int(wrong.argmax())
    text = f"{name} differs by more than {limit:g} {unit} from the other columns in {int(wrong.sum())} of {len(wrong)}"
    return [warning(f"{text} rows, first in {log.line(row)}: are the columns those of the format {log.format}?")]
