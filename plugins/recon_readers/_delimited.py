"""Text files of numbers in columns that tabs or spaces part, read columnar; every complaint names line and column.

The file is taken in two steps: `survey` finds separator, width, header and a last row that was cut off, `parse` turns
the rows into Arrow columns. Only where that fails are lines looked at one by one.

The first column is a time in seconds. It is read as a decimal of 18 places and cut to whole nanoseconds, never through
a double, which at 5e8 s resolves 60 ns.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon_readers._text_blocks import HEAD_BYTES, Text
from recon_readers._time_text import TIME_TYPE

TAB: Final = b"\t"
SPACE: Final = b" "

BLANK: Final = ("", "nan", "NaN", "NAN", "-nan", "-NaN", "nan(ind)", "-nan(ind)", "null", "NULL", "NA", "N/A")
BLANK_BYTES: Final = frozenset(text.encode() for text in BLANK)
_NUMBER: Final = re.compile(rb"[+-]?(?:(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][+-]?\d++)?|(?i:inf(?:inity)?))")
_TIME: Final = re.compile(rb"[+-]?(?:\d{1,18}(?:\.\d{0,18})?|\.\d{1,18})(?:[eE][+-]?\d\d?)?")
_DECIMAL_COMMA: Final = re.compile(rb"[+-]?\d+,\d+")
_MARKS: Final = ((b";", "semicolons"), (b",", "commas"), (b"|", "vertical bars"))
_LOOK_AT: Final = 20
_LONGEST_HEADER: Final = 100
_SHOWN: Final = 30


@dataclass(frozen=True)
class Survey:
    """Where the rows of a text lie and how they are made.

    header : the lines above the first row, without blank ones
    start, end : offsets of the first row and behind the last whole one; first_line : line number of the first row
    width : number of columns
    cut_line : number of the last line if it was cut off and is left out
    """

    path: Path
    text: Text
    header: tuple[str, ...]
    start: int
    end: int
    first_line: int
    separator: bytes
    width: int
    cut_line: int | None

    def rows(self) -> Iterator[tuple[int, bytes]]:
        """Line number and line of every row."""
        nothing = b" " if self.separator == TAB else None
        first = self.first_line
        for block in self.text.blocks(self.start, self.end):
            for number, line in enumerate(block.split(b"\n"), first):
                if line.strip(nothing) and not line.lstrip().startswith(b"#"):
                    yield number, line
            first += block.count(b"\n")

    def place(self, row: int, column: int) -> tuple[int, int]:
        """Line and column, 1-based, of one field; both its numbers count from 0."""
        number, line = next(islice(self.rows(), row, None))
        return number, _offset(line, self.separator, column) + 1


def header_of(path: Path, head: bytes) -> tuple[str, ...]:
    """The lines above the first row, without blank ones. Raises ReadFailed where no row comes."""
    return _header(path, head)[2]


def survey(path: Path, text: Text, widths: Sequence[int]) -> Survey:
    """Find header, separator, number of columns (one of `widths`) and a cut last row. Raises ReadFailed."""
    start, first_line, header = _header(path, text.head)
    top = [line for line in text.head[start : start + HEAD_BYTES].split(b"\n") if line.strip()][:_LOOK_AT]
    top = [line for line in top if not line.lstrip().startswith(b"#")]
    if not top:
        raise ReadFailed(path, "it holds no rows", hint="check that the log was copied completely")
    found = Counter(shape for shape in (_shape(line, widths) for line in top) if shape is not None)
    if not found:
        raise _wrong_shape(path, first_line, top[0], widths)
    width = found.most_common(1)[0][0][1]
    separator = SPACE if (SPACE, width) in found else TAB
    end, cut_line = _cut_off(text, start, separator, width)
    if end <= start:
        raise ReadFailed(path, "its only row is cut off", line=first_line, hint="check that the log was copied whole")
    return Survey(path, text, header, start, end, first_line, separator, width, cut_line)


def parse(found: Survey, names: Sequence[str]) -> Iterator[tuple[float, pa.Table]]:
    """The rows as columns, block by block: the first as decimals, the others as doubles, null where blank or NaN.

    With each block comes what part of the text has been read. Raises ReadFailed with line and column for a row of
    another width and for text where a number belongs.
    """
    done = found.start
    for block in found.text.blocks(found.start, found.end):
        done += len(block)
        yield done / found.end, _of_block(found, block, names)


def _of_block(found: Survey, block: bytes, names: Sequence[str]) -> pa.Table:
    try:
        return _columns(block, found.separator, names)
    except pa.ArrowInvalid:
        pass
    try:
        return _columns(_tidied(found, block), found.separator, names)
    except pa.ArrowInvalid as error:
        raise _first_fault(found, names, str(error)) from error


def _columns(rows: bytes, separator: bytes, names: Sequence[str]) -> pa.Table:
    from pyarrow import csv

    kinds = {names[0]: TIME_TYPE, **{name: pa.float64() for name in names[1:]}}
    if not rows.strip(b" \n"):
        return pa.schema(list(kinds.items())).empty_table()
    return csv.read_csv(
        pa.BufferReader(rows),
        read_options=csv.ReadOptions(column_names=list(names)),
        parse_options=csv.ParseOptions(delimiter=separator.decode(), quote_char=False),
        convert_options=csv.ConvertOptions(column_types=kinds, null_values=list(BLANK)),
    )


def values(found: Survey) -> NDArray[np.float64]:
    """The rows of the right width as numbers, whatever they hold: (n, width), NaN where there is no number."""
    rows = [fields(line, found.separator, found.width) for _, line in found.rows()]
    numbers = [[_number(part) for part in row] for row in rows if len(row) == found.width]
    return np.array(numbers, dtype=np.float64).reshape(-1, found.width)


def _number(part: bytes) -> float:
    return float(part) if _NUMBER.fullmatch(part) else math.nan


def fields(line: bytes, separator: bytes, width: int) -> list[bytes]:
    """The fields of a line; tabs at its end that are more than `width` needs are left out."""
    if separator == SPACE:
        return line.split()
    parts = [part.strip(b" ") for part in line.split(TAB)]
    while len(parts) > width and not parts[-1]:
        parts.pop()
    return parts


def _header(path: Path, text: bytes) -> tuple[int, int, tuple[str, ...]]:
    """Offset and line number of the first row, and the lines above it.

    A line belongs to the header if it begins with # or if none of its fields is a number.
    """
    start, number = 0, 1
    header: list[str] = []
    while start < len(text):
        if len(header) > _LONGEST_HEADER:
            what = f"no number in its first {_LONGEST_HEADER} lines"
            raise ReadFailed(path, what, hint="check that it is the right file")
        stop = text.find(b"\n", start)
        stop = len(text) if stop < 0 else stop
        line = text[start:stop].strip()
        if line and not line.startswith(b"#") and any(_NUMBER.fullmatch(part) for part in re.split(rb"[\s,;|]+", line)):
            break
        if line:
            header.append(line.decode("utf-8", "replace"))
        start, number = stop + 1, number + 1
    return min(start, len(text)), number, tuple(header)


def _shape(line: bytes, widths: Sequence[int]) -> tuple[bytes, int] | None:
    for width in sorted(widths, reverse=True):
        parts = fields(line, TAB, width)
        if len(parts) == width and not any(b" " in part for part in parts):
            return TAB, width
    count = len(line.split())
    return (SPACE, count) if count in widths else None


def _wrong_shape(path: Path, number: int, line: bytes, widths: Sequence[int]) -> ReadFailed:
    for mark, name in _MARKS:
        if len(line.rstrip(mark).split(mark)) in widths:
            what = f"{name} part the columns, not tabs or spaces"
            return ReadFailed(path, what, line=number, hint="put tabs or spaces in their place")
    wanted = f"{', '.join(str(width) for width in widths[:-1])} or {widths[-1]}"
    count = len(fields(line, TAB, 1)) if TAB in line else len(line.split())
    what = f"a row of {count} column{'s' * (count != 1)}, where tabs or spaces part {wanted} columns"
    return ReadFailed(path, what, line=number, hint="check that it is the right file")


def _cut_off(text: Text, start: int, separator: bytes, width: int) -> tuple[int, int | None]:
    """Offset behind the last whole row, and the number of the line that was cut off behind it.

    A last line is cut if fields are missing, or if no line end follows and its last number has fewer decimals than
    the one above: the rest of it may be lost.
    """
    tail, first = text.tail, max(start - text.tail_at, 0)
    end = len(tail.rstrip(b"\n\0"))
    begin = max(tail.rfind(b"\n", first, end) + 1, first)
    while begin > first and not tail[begin:end].strip():
        end = begin - 1
        begin = max(tail.rfind(b"\n", first, end) + 1, first)
    last = fields(tail[begin:end], separator, width)
    whole = len(last) >= width or tail[begin:end].lstrip().startswith(b"#")
    if whole and tail[end : end + 1] != b"\n" and begin > first:
        above = tail[max(tail.rfind(b"\n", first, begin - 1) + 1, first) : begin - 1]
        whole = _decimals(last[-1:]) >= _decimals(fields(above, separator, width)[-1:])
    if whole:
        return text.tail_at + end, None
    return text.tail_at + begin, text.line_at(text.tail_at + begin)


def _decimals(field: list[bytes]) -> int:
    """Digits behind the point; -1 where the field is no number."""
    if not field or not _NUMBER.fullmatch(field[0]):
        return -1
    return len(field[0].partition(b".")[2])


def _tidied(found: Survey, body: bytes) -> bytes:
    """The rows without comments, padding, and tabs at the end. Lines stay where they are."""
    if b"#" in body:
        body = re.sub(rb"(?m)^[ \t]*#.*$", b"", body)
    return single_spaces(body) if found.separator == SPACE else _trimmed_tabs(body, found.width)


def single_spaces(body: bytes) -> bytes:
    """Rows whose columns one space parts, none before and none behind. Lines stay where they are."""
    body = body.replace(TAB, SPACE)
    while b"  " in body:
        body = body.replace(b"  ", SPACE)
    return body.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(SPACE)


def _trimmed_tabs(body: bytes, width: int) -> bytes:
    while b"  " in body:
        body = body.replace(b"  ", SPACE)
    for loose, tight in ((b" \t", TAB), (b"\t ", TAB), (b"\n ", b"\n"), (b" \n", b"\n")):
        body = body.replace(loose, tight)
    body = body.strip(SPACE)
    return re.sub(rb"(?m)^((?:[^\t\n]*\t){%d}[^\t\n]*)\t+$" % (width - 1), rb"\1", body)


def _first_fault(found: Survey, names: Sequence[str], reason: str) -> ReadFailed:
    """Look for the line that the columnar reader did not take."""
    for number, line in found.rows():
        fault = _fault_in(found, names, number, line)
        if fault is not None:
            return fault
    return ReadFailed(found.path, f"it cannot be read as numbers: {reason.splitlines()[0]}", hint="check its format")


def _fault_in(found: Survey, names: Sequence[str], number: int, line: bytes) -> ReadFailed | None:
    parts = fields(line, found.separator, found.width)
    if len(parts) != found.width:
        what = f"a row of {len(parts)} columns among rows of {found.width}"
        return ReadFailed(found.path, what, line=number, hint="repair the line or delete it")
    for index, part in enumerate(parts):
        if part in BLANK_BYTES or (_NUMBER if index else _TIME).fullmatch(part):
            continue
        column = _offset(line, found.separator, index) + 1
        shown = part[:_SHOWN].decode("ascii", "replace")
        if _DECIMAL_COMMA.fullmatch(part):
            what, hint = f"'{shown}' has a decimal comma", "write numbers with a decimal point"
        else:
            what, hint = f"{names[index]} is {shown!r}, which is no number", "repair the line or delete it"
        return ReadFailed(found.path, what, line=number, column=column, hint=hint)
    return None


def _offset(line: bytes, separator: bytes, column: int) -> int:
    """Where in the line a field begins."""
    if separator == SPACE:
        return [match.start() for match in re.finditer(rb"\S+", line)][column]
    begin = sum(len(part) + 1 for part in line.split(TAB)[:column])
    return begin + len(line[begin:]) - len(line[begin:].lstrip(b" "))
