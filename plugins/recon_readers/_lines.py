"""Texts with one record per line, of which damaged lines are left out and counted, not the file refused.

read_lines      the columns wanted of a text of delimited rows, block by block, so that the text is never held; only
                where a block holds a damaged row are its lines looked at one by one
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon.tables import vector
from recon_readers._columns import Columns
from recon_readers._delimited import BLANK, BLANK_BYTES
from recon_readers._text_blocks import Text
from recon_readers._time_text import TIME_TYPE, whole_ns

COPIED: Final = "check that the log was copied completely"
_NUMBER: Final = re.compile(rb"[+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,3})?")
_TIME: Final = re.compile(rb"[+-]?(?:\d{1,18}(?:\.\d{0,18})?|\.\d{1,18})")
_SPACES: Final = re.compile(rb"  +")


@dataclass(frozen=True)
class Form:
    """How rows are made.

    names : of all columns; kinds : of those that are wanted, float64, TIME_TYPE or string
    separator : one byte, b" " for any run of blanks; comment : what begins a line that is none
    quotes : may fields stand in quotes, which hold no separators? comma : is the decimal mark a comma?
    """

    names: Sequence[str]
    kinds: Mapping[str, pa.DataType]
    separator: bytes = b" "
    comment: bytes = b""
    quotes: bool = False
    comma: bool = False

    def tidied(self, block: bytes) -> bytes:
        """Lines without quotes, comments and more blanks than part the fields, with decimal points."""
        body = block.replace(b'"', b"") if self.quotes else block
        body = body.replace(b",", b".") if self.comma else body
        if self.separator == b" ":
            body = _SPACES.sub(b" ", body.replace(b"\t", b" "))
            body = body.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
        if self.comment and self.comment in body:
            body = re.sub(rb"(?m)^[ \t]*" + re.escape(self.comment) + rb"[^\n]*$", b"", body)
        return body

    def fields(self, line: bytes) -> list[bytes]:
        """The fields of a tidied line."""
        return line.split() if self.separator == b" " else [part.strip(b" ") for part in line.split(self.separator)]

    def takes(self, line: bytes, *, values: bool = True) -> bool:
        """Is the tidied line a whole row? values : also look at what stands in the wanted columns."""
        parts = self.fields(line)
        if len(parts) != len(self.names):
            return False
        return not values or all(
            _fits(part, self.kinds.get(name)) for part, name in zip(parts, self.names, strict=True)
        )


def numbers(table: pa.Table) -> dict[Any, NDArray[Any]]:
    """Doubles as they are, NaN where blank; of a time `name` in whole ns, and in `no_name` whether it is blank."""
    found: dict[Any, NDArray[Any]] = {}
    for name in table.column_names:
        if table[name].type == TIME_TYPE:
            found[name], found[f"no_{name}"] = whole_ns(table[name])
        else:
            found[name] = vector(table, name, gaps=True)
    return found


@dataclass
class Lines:
    """Whole rows of a text.

    columns : those that were made of the columns wanted; rows : how many
    skipped : number of damaged lines that were left out; first_skipped : the first
    start, end, first_line : offsets of the first row and behind the last whole one, number of the first line
    """

    path: Path
    text: Text
    form: Form
    start: int
    end: int
    first_line: int
    skipped: int = 0
    first_skipped: int = 0
    rows: int = 0
    columns: Columns = field(default_factory=lambda: Columns({}))

    def line(self, row: int) -> int:
        """Number of the line, 1-based, in which a row stands."""
        strict = self.skipped > 0
        rows = (
            number + at
            for number, _, body in self.blocks()
            for at, line in enumerate(body.split(b"\n"))
            if line.strip() and self.form.takes(line, values=strict)
        )
        return next(islice(rows, row, None), self.first_line)

    def blocks(self) -> Iterator[tuple[int, float, bytes]]:
        """Number of the first line of each block of rows, the part of the text up to its end, and its tidied lines."""
        number, done = self.first_line, self.start
        for block in self.text.blocks(self.start, self.end):
            done += len(block)
            yield number, done / self.end, self.form.tidied(block)
            number += block.count(b"\n")

    def leave_out(self, numbers: Sequence[int]) -> None:
        """Count damaged lines."""
        if numbers:
            self.first_skipped = min(numbers[0], self.first_skipped or numbers[0])
            self.skipped += len(numbers)

    def learnt(self) -> list[Metric]:
        """How many lines there were, and what was left out."""
        found = [Metric("rows_read", float(self.rows + self.skipped))]
        if self.skipped:
            note = f"damaged, the first in line {self.first_skipped}"
            found.append(Metric("lines_skipped", float(self.skipped), note=note))
            found.append(warning(f"left out of {self.path.name}: {self.skipped} lines, {note}"))
        return found


def read_lines(
    path: Path,
    text: Text,
    form: Form,
    made: Callable[[pa.Table], Mapping[Any, NDArray[Any]]] = numbers,
    *,
    start: int = 0,
    first_line: int = 1,
) -> Lines:
    """The whole rows of a text. Raises ReadFailed where there is none.

    made : makes columns, (n,) each, of the columns wanted of one block
    start, first_line : offset of the rows and number of their first line
    """
    end = _whole_end(text, form, start)
    lines = Lines(path, text, form, start, end, first_line)
    lines.columns = Columns.of(_made(lines, made))
    if end < text.size:
        lines.leave_out([first_line + text.lines - text.head.count(b"\n", 0, start)])
    if not lines.rows:
        raise ReadFailed(path, "it holds no whole row", line=first_line, hint=COPIED)
    return lines


def _made(
    lines: Lines, made: Callable[[pa.Table], Mapping[Any, NDArray[Any]]]
) -> Iterator[tuple[float, Mapping[Any, NDArray[Any]]]]:
    """Columns block by block, with the part of the text so far."""
    for number, share, body in lines.blocks():
        try:
            table = _columns(body, lines.form)
        except pa.ArrowInvalid:
            good, bad = _sorted_out(body, lines.form)
            lines.leave_out([number + at for at in bad])
            table = _columns(good, lines.form)
        lines.rows += table.num_rows
        if table.num_rows:
            yield share, made(table)


def _fits(part: bytes, kind: pa.DataType | None) -> bool:
    """Can a field be read as the type of its column, None where it is not wanted?"""
    if kind is None or part in BLANK_BYTES:
        return True
    if kind == pa.string():
        return part.isascii()
    return bool((_TIME if kind == TIME_TYPE else _NUMBER).fullmatch(part))


def _whole_end(text: Text, form: Form, start: int) -> int:
    """Offset behind the last whole line.

    The last line was cut off where no line end follows, and a field is missing or has fewer digits than the one above.
    """
    tail = text.tail[max(start - text.tail_at, 0) :]
    *above, last = tail.rsplit(b"\n", 2)
    if not last.strip():
        return text.size
    parts, before = (form.fields(form.tidied(line)) for line in (last, b"".join(above[-1:])))
    cut = len(parts) != len(form.names) or (len(before) == len(parts) and _decimals(parts[-1]) < _decimals(before[-1]))
    return text.size - len(last) if cut else text.size


def _decimals(field: bytes) -> int:
    return len(field.partition(b".")[2])


def _sorted_out(body: bytes, form: Form) -> tuple[bytes, list[int]]:
    """The whole rows of a block as a text, and the places among its lines of those that are none."""
    good, bad = [], []
    for number, line in enumerate(body.split(b"\n")):
        if not line.strip():
            continue
        if form.takes(line):
            good.append(form.separator.join(form.fields(line)))
        else:
            bad.append(number)
    return b"\n".join([*good, b""]), bad


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
