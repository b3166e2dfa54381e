"""Texts with one record per line, of which damaged lines are left out and counted, not the file refused.

read_lines      the columns wanted of a text of delimited rows, columnar; only where a row is damaged are lines
                looked at one by one
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

import pyarrow as pa

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon_readers._delimited import BLANK, TIME_TYPE

COPIED: Final = "check that the log was copied completely"
_BLANK: Final = frozenset(text.encode() for text in BLANK)
_NUMBER: Final = re.compile(rb"[+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,3})?")
_TIME: Final = re.compile(rb"[+-]?(?:\d{1,18}(?:\.\d{0,18})?|\.\d{1,18})")
_SPACES: Final = re.compile(rb"[ \t]+")


@dataclass(frozen=True)
class Form:
    """How rows are made.

    names : of all columns; kinds : of those that are wanted, float64, TIME_TYPE or string
    separator : one byte, b" " for any run of blanks; comment : what begins a line that is none
    """

    names: Sequence[str]
    kinds: Mapping[str, pa.DataType]
    separator: bytes = b" "
    comment: bytes = b""

    def fields(self, line: bytes) -> list[bytes]:
        """The fields of a line."""
        return line.split() if self.separator == b" " else [part.strip(b" ") for part in line.split(self.separator)]

    def takes(self, line: bytes, *, values: bool = True) -> bool:
        """Is the line a whole row? values : also look at what stands in the wanted columns."""
        parts = self.fields(line)
        if len(parts) != len(self.names):
            return False
        return not values or all(
            _fits(part, self.kinds.get(name)) for part, name in zip(parts, self.names, strict=True)
        )

    def is_row(self, line: bytes) -> bool:
        """Does the line mean to be a row: neither blank nor a comment?"""
        plain = line.strip()
        return bool(plain) and not (self.comment and plain.startswith(self.comment))


@dataclass(frozen=True)
class Lines:
    """Whole rows of a text.

    table : the columns wanted; skipped : number of damaged lines that were left out, first_skipped : the first
    """

    path: Path
    table: pa.Table
    skipped: int
    first_skipped: int
    text: bytes
    first_line: int
    form: Form

    def line(self, row: int) -> int:
        """Number of the line, 1-based, in which a row stands."""
        strict = self.skipped > 0
        lines = enumerate(self.text.split(b"\n"), self.first_line)
        rows = (n for n, line in lines if self.form.is_row(line) and self.form.takes(line, values=strict))
        return next(islice(rows, row, None), self.first_line)

    def learnt(self) -> list[Metric]:
        """How many lines there were, and what was left out."""
        found = [Metric("rows_read", float(self.table.num_rows + self.skipped))]
        if self.skipped:
            note = f"damaged, the first in line {self.first_skipped}"
            found.append(Metric("lines_skipped", float(self.skipped), note=note))
            found.append(warning(f"left out of {self.path.name}: {self.skipped} lines, {note}"))
        return found


def read_lines(path: Path, text: bytes, first_line: int, form: Form) -> Lines:
    """The whole rows of a text. Raises ReadFailed where there is none.

    text : the rows, line ends \\n; first_line : number of the first of its lines
    """
    body = _SPACES.sub(b" ", text).replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ") if _blanks(form) else text
    if form.comment:
        body = re.sub(rb"(?m)^\s*" + re.escape(form.comment) + rb"[^\n]*$", b"", body)
    skipped, first_skipped = 0, 0
    if _is_cut(body, form):
        end = body.rstrip(b"\n").rfind(b"\n") + 1
        skipped, first_skipped = 1, first_line + body.count(b"\n", 0, end)
        body = body[:end]
    try:
        table = _columns(body, form)
    except pa.ArrowInvalid:
        good, bad = _sorted_out(body, form)
        skipped, first_skipped = skipped + len(bad), first_line + bad[0] if bad else first_skipped
        table = _columns(good, form)
    if not table.num_rows:
        raise ReadFailed(path, "it holds no whole row", line=first_line, hint=COPIED)
    return Lines(path, table, skipped, first_skipped, body, first_line, form)


def split_header(text: bytes, mark: bytes) -> tuple[list[str], int]:
    """The lines at the beginning of a text that begin with a mark, and the offset of the first that does not."""
    header: list[str] = []
    start = 0
    while start < len(text) and text[start:].startswith(mark):
        stop = text.find(b"\n", start)
        stop = len(text) if stop < 0 else stop
        header.append(text[start:stop].decode("utf-8", "replace").strip())
        start = min(stop + 1, len(text))
    return header, start


def _fits(part: bytes, kind: pa.DataType | None) -> bool:
    """Can a field be read as the type of its column, None where it is not wanted?"""
    if kind is None or part in _BLANK:
        return True
    if kind == pa.string():
        return part.isascii()
    return bool((_TIME if kind == TIME_TYPE else _NUMBER).fullmatch(part))


def _blanks(form: Form) -> bool:
    return form.separator == b" "


def _is_cut(body: bytes, form: Form) -> bool:
    """Was the last line cut off? No line end follows, and a field is missing or has fewer digits than the one above."""
    if not body or body.endswith(b"\n"):
        return False
    above, _, last = body.rpartition(b"\n")
    parts, before = form.fields(last), form.fields(above.rpartition(b"\n")[2])
    if len(parts) != len(form.names):
        return True
    return len(before) == len(parts) and _decimals(parts[-1]) < _decimals(before[-1])


def _decimals(field: bytes) -> int:
    return len(field.partition(b".")[2])


def _sorted_out(body: bytes, form: Form) -> tuple[bytes, list[int]]:
    """The whole rows as a text, and the places among the lines of those that are none."""
    good, bad = [], []
    for number, line in enumerate(_each_line(body)):
        if not form.is_row(line):
            continue
        if form.takes(line):
            good.append(form.separator.join(form.fields(line)))
        else:
            bad.append(number)
    return b"\n".join([*good, b""]), bad


def _each_line(body: bytes) -> Iterator[bytes]:
    start = 0
    while start < len(body):
        stop = body.find(b"\n", start)
        stop = len(body) if stop < 0 else stop
        yield body[start:stop]
        start = stop + 1


def _columns(rows: bytes, form: Form) -> pa.Table:
    from pyarrow import csv

    if not rows.strip():
        return pa.table({name: pa.array([], kind) for name, kind in form.kinds.items()})
    return csv.read_csv(
        pa.BufferReader(rows),
        read_options=csv.ReadOptions(column_names=list(form.names)),
        parse_options=csv.ParseOptions(delimiter=form.separator.decode(), quote_char=False),
        convert_options=csv.ConvertOptions(
            column_types=dict(form.kinds), include_columns=list(form.kinds), null_values=list(BLANK)
        ),
    )
