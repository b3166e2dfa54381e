"""Any delimited text: the mapping tells which column is what, in which unit, along which axis, on which clock.

    - use: reader.csv
      params:
        columns:
          imu:
            time: {column: millis, format: unix, unit: ms}
            axes: FRD
            accel: {columns: [ax, ay, az], unit: g}
            gyro: {columns: [gx, gy, gz], unit: deg/s}

`recon inspect FILE` proposes a mapping for a file that no reader knows; `--set reader.csv.columns=@MAPPING.yaml` gives
one to any pipeline. The streams of a drive may stand in one file, with blanks or repeated values where a sensor did not
report, or in a file each; a mapping serves all files of a drive, of which each holds some of its streams.

Vectors whose axes are told come along forward, left, up, or east, north, up; others as logged. What the mapping says
and the text shows becomes rows of `metrics`; a row that is not used is counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from recon.declaration import Schemas
from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import STREAMS, Schema
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams
from recon_readers._columns import Columns
from recon_readers._csv_mapping import Columns as Mapped
from recon_readers._csv_mapping import schemas
from recon_readers._csv_propose import in_shell, propose
from recon_readers._csv_rows import Others, Part, fresh_rows, together, valid_rows
from recon_readers._csv_sheet import Sheet
from recon_readers._csv_streams import assumptions, locate, make, values_of
from recon_readers._csv_text import WORDS_ALONE, Form, open_sheet, survey
from recon_readers._csv_time import Clock, clock_of, read_times
from recon_readers._mapping_parts import Time
from recon_readers._text_blocks import Text, not_text, plain
from recon_readers._time_order import Times, in_order

UNSURE: Final = 0.3
"""Confidence in any delimited text: what its columns mean, only the mapping tells."""

_TIME, _MISSING, _VALID = "time", "missing", "valid"


class CsvParams(Params):
    """How the text is made, and what its columns mean."""

    columns: Mapped = setting(doc="Which column is what, by stream; 'recon inspect FILE' proposes it.")
    delimiter: Literal["auto", "comma", "semicolon", "tab", "space", "bar"] = setting(
        "auto", doc="What separates two columns."
    )
    decimal: Literal["auto", "point", "comma"] = setting("auto", doc="Decimal mark.")
    header: int | None = setting(None, ge=0, doc="Line of the header, 0 where there is none; found where not given.")
    comment: str = setting("#", max_length=8, doc="What begins a line that is left out.")
    encoding: str = setting("auto", doc="Encoding of the text, such as UTF-8 or cp1252.")

    @property
    def form(self) -> Form:
        """How the text is made."""
        return Form(self.delimiter, self.decimal, self.header, self.comment, self.encoding)


def read(path: Path, params: CsvParams) -> Streams:
    """The streams of the mapping that the file holds, at the rates at which the sensors reported.

    Raises ReadFailed.
    """
    sheet = open_sheet(path, params.form)
    parts, absent = _located(sheet, params.columns)
    rows = _rows(sheet, parts)
    count = len(rows[_MISSING, parts[0].mapping.time])
    streams, told = _streams(sheet, parts, rows)
    if not streams:
        raise ReadFailed(path, "no row holds a measurement", hint="check the mapping, and that the log is complete")
    form = Metric("format", note=f"delimited text: {sheet.about}")
    return {**streams, "metrics": metrics([form, *_counts(sheet, count), *told, *absent])}


def _located(sheet: Sheet, columns: Mapped) -> tuple[list[Part], list[Metric]]:
    """The streams that the file holds, and those that it does not."""
    parts, absent = [], []
    for mapping in columns.streams():
        found = locate(sheet, mapping)
        if found is not None:
            parts.append(found)
        else:
            absent.append(Metric("not_in_file", method=mapping.stream, note="none of its columns is in this file"))
    if not parts:
        first = next(columns.streams())
        source = next(iter(first.sources.values()))
        what = f"it holds none of the streams of the mapping: {sheet.lacks(source.references[0])}"
        raise ReadFailed(sheet.path, what, line=sheet.header_line or None, hint="'recon inspect' proposes a mapping")
    return parts, absent


def _rows(sheet: Sheet, parts: Sequence[Part]) -> Columns:
    """All that is needed of the rows: numbers by index, times and what lacks one by clock, valid rows by stream."""
    clocks = {part.mapping.time for part in parts}
    marks = [part.mapping.valid.column for part in parts if part.mapping.valid]
    references = [*marks, *(reference for time in clocks for reference in time.references)]
    texts = [index for index in map(sheet.find, references) if index is not None]
    numbers = [index for part in parts for indices in part.columns.values() for index in indices]

    def blocks() -> Iterator[tuple[float, dict[Any, Any]]]:
        for cells in sheet.read(numbers, texts):
            found: dict[Any, Any] = dict(cells.numbers)
            for time in clocks:
                found[_TIME, time], found[_MISSING, time] = read_times(sheet, time, cells)
            for part in parts:
                if part.mapping.valid is not None:
                    found[_VALID, part.mapping.stream] = valid_rows(sheet, part.mapping.valid, cells)
            yield cells.share, found

    return Columns.of(blocks())


def _clock(time: Time, rows: Columns) -> Clock:
    return clock_of(time, rows[_TIME, time], rows[_MISSING, time])


def _streams(sheet: Sheet, parts: Sequence[Part], rows: Columns) -> tuple[Streams, list[Metric]]:
    """The streams; takes the numbers out of the rows, so that they and the streams are not there at once."""
    clocks = {time: _clock(time, rows) for time in {part.mapping.time for part in parts}}
    users = Counter(index for part in parts for indices in part.columns.values() for index in indices)

    def take(index: int) -> Array:
        users[index] -= 1
        return rows[index] if users[index] else rows.pop(index)

    values = {part.mapping.stream: values_of(sheet, part, take) for part in parts}
    others = Others("imu" in values, together(values["gnss"]) if "gnss" in values else None)
    streams: Streams = {}
    told: list[Metric] = []
    for part in parts:
        name = part.mapping.stream
        clock, own = clocks[part.mapping.time], values.pop(name)
        fresh = fresh_rows(sheet, part, clock, own, rows.pop((_VALID, name), None), others)
        told += [
            *(replace(row, method=name) for row in clock.learnt),
            *fresh.learnt,
            *assumptions(sheet, part, own),
        ]
        table = make(part, clock, own, fresh.rows)
        if table is not None:
            streams[name] = table
    return streams, told


def _counts(sheet: Sheet, count: int) -> list[Metric]:
    """How many rows there were, and what of the text is no row of it."""
    found = [Metric("rows_read", float(count))]
    if sheet.above:
        text = "above the first row, neither header nor comments"
        found.append(Metric("lines_left_out", float(sheet.above), note=text))
    if sheet.cut_line is not None:
        text = f"the last row, line {sheet.cut_line}, was cut off"
        found += [Metric("rows_cut_off", 1.0, note=text), warning(f"dropped from {sheet.path.name}: {text}")]
    return found


def lines(path: Path, params: CsvParams, stream: str, t_ns: Times) -> Times:
    """Lines that hold rows of a stream at these times, 0 where none does: (n,). Of several of one time, the first."""
    sheet = open_sheet(path, params.form)
    parts, _ = _located(sheet, params.columns)
    part = next((part for part in parts if part.mapping.stream == stream), None)
    if part is None:
        return np.zeros(len(t_ns), dtype=np.int64)
    clock = _clock(part.mapping.time, _rows(sheet, [part]))
    timed = np.flatnonzero(in_order(clock.t_ns, clock.missing))
    own = clock.t_ns[timed]
    at = np.searchsorted(own, t_ns).clip(max=len(own) - 1)
    found = np.array([sheet.place(int(row), 0)[0] for row in timed[at]], dtype=np.int64)
    return np.asarray(np.where(own[at] == t_ns, found, 0))


def plan(inputs: Mapping[str, Schema], params: CsvParams) -> Schemas:
    """The streams and columns of the mapping; which of them a file holds, only the file tells."""
    return schemas(params.columns.streams())


def sniff(path: Path, head: bytes) -> Sniff:
    """Never sure: what the columns mean, only the mapping tells."""
    if not head:
        return Sniff(0.0, "no file with contents")
    fault = not_text(head)
    if fault:
        return Sniff(0.0, fault[0])
    try:
        found = survey(path, Text.of(path, plain(head)), Form())
    except ReadFailed as error:
        return Sniff(UNSURE if error.what == WORDS_ALONE else 0.0, error.what)
    kind = f"it looks like delimited text ({found.about})"
    proposed = f"'recon inspect {in_shell(path)} > mapping.yaml' proposes a mapping"
    return Sniff(UNSURE, f"{kind}: {proposed}; check it, and give it with '--set reader.csv.columns=@mapping.yaml'")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of any delimited text."""
    yield Reader(
        name="csv",
        summary="Any delimited text, by a mapping of its columns.",
        params=CsvParams,
        run=read,
        sniff=sniff,
        lines=lines,
        propose=propose,
        writes={name: STREAMS[name].possible() for name in Mapped.model_fields},
        plan=plan,
        references=("RFC 4180", "IS-GPS-200, 20.3.3.5.2.4", "IERS Bulletin C", "ISO 8601-1:2019"),
    )
