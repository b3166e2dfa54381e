"""How a delimited text is made: encoding, delimiter, header, decimal mark, and a last row that was cut off."""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

from recon.errors import ReadFailed
from recon_readers._csv_records import (
    DELIMITERS,
    NUMBER,
    WITH_COMMA,
    Record,
    fields,
    is_row,
    raw_fields,
    records,
    width_of,
)
from recon_readers._csv_sheet import Sheet
from recon_readers._lines import COPIED
from recon_readers._text_blocks import HEAD_BYTES, Text, check_regular, not_text, unreadable

MOST_COLUMNS: Final = 4096
WORDS_ALONE: Final = "it holds a line of words, perhaps a header, and no row of numbers"
_LOOK_AT: Final = 200
_WITH_POINT: Final = re.compile(rb"\s*[+-]?\d+\.\d+(?:[eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class Form:
    """How a text is made, as far as the user told it; None and "auto" stand for what the text shows.

    delimiter : a key of DELIMITERS; decimal : "point" or "comma"; header : line number, 0 for none
    comment : what begins a line that is left out; encoding : name of a codec
    """

    delimiter: str = "auto"
    decimal: str = "auto"
    header: int | None = None
    comment: str = "#"
    encoding: str = "auto"


def open_sheet(path: Path, form: Form) -> Sheet:
    """Find out how a text is made. Raises ReadFailed for what is no delimited text."""
    text, encoding = _load(path, form.encoding)
    return survey(path, text, form, encoding)


def survey(path: Path, text: Text, form: Form, encoding: str = "UTF-8") -> Sheet:
    """As `open_sheet`, of a text in UTF-8 with line ends \\n."""
    comment = form.comment.encode()
    head = text.head
    if text.size > HEAD_BYTES:
        head = head[: max(head.rfind(b"\n", 0, HEAD_BYTES), 0) or HEAD_BYTES]
    top = list(islice(records(head, b""), _LOOK_AT))
    rows = [record for record in top if not (comment and record[2].lstrip().startswith(comment))]
    if form.header:
        rows = [record for record in rows if record[0] > form.header]
    if not rows:
        raise ReadFailed(path, "it holds no rows", hint=COPIED)
    delimiter, width = _shape(path, rows, form.delimiter)
    first, header = _header(top, rows, delimiter, width, form)
    if first is None:
        what = WORDS_ALONE if len(rows) == 1 and width > 2 else "it has no whole row that holds a number"
        raise ReadFailed(path, what, hint="check that the log is complete")
    names = tuple(_words(header[2].lstrip().removeprefix(comment), delimiter, width)) if header else ()
    end, cut_line = _whole_end(text, first, delimiter, width)
    if end <= first[1]:
        raise ReadFailed(path, "its only row is cut off", line=first[0], hint=COPIED)
    decimal = form.decimal if form.decimal != "auto" else _decimal(rows, delimiter)
    above = sum(record[1] < first[1] for record in rows) - (header in rows)
    return Sheet(
        path, text, encoding, delimiter, decimal, comment, names, header[0] if header else 0, above, width,
        first[1], first[0], end, cut_line,
    )  # fmt: skip


def _load(path: Path, encoding: str) -> tuple[Text, str]:
    """The text as UTF-8 with line ends \\n, and how it was encoded. Raises ReadFailed."""
    names = [encoding] if encoding != "auto" else _encodings(path)
    for name in names:
        try:
            text = Text.open(path, name)
            break
        except (UnicodeError, LookupError) as error:
            if name == names[-1]:
                reason = "there is no such encoding" if isinstance(error, LookupError) else "the file is not"
                what = f"it cannot be read as {name}: {reason}"
                raise ReadFailed(path, what, hint="set reader.csv's encoding") from error
    if not text.head.strip():
        raise ReadFailed(path, "the file is empty", hint=COPIED)
    fault = not_text(text.head[:HEAD_BYTES])
    if fault:
        raise ReadFailed(path, fault[0], hint=fault[1])
    return text, name


def _encodings(path: Path) -> list[str]:
    """Encodings that a file may have, the likeliest first; the last one takes any bytes, or its mark tells it."""
    check_regular(path)
    try:
        with path.open("rb") as file:
            mark = file.read(2)
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error
    return ["UTF-16"] if mark in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else ["UTF-8", "ISO-8859-1"]


def _words(header: bytes, delimiter: str, width: int) -> list[str]:
    words = [word.decode("utf-8", "replace").replace("\n", " ") for word in fields(header, delimiter)]
    return [*words, ""][:width]


def _shape(path: Path, rows: Sequence[Record], delimiter: str) -> tuple[str, int]:
    """The delimiter that parts most records into equally many columns, and how many these are."""
    best: tuple[int, str, int] = (0, "", 0)
    for name in DELIMITERS if delimiter == "auto" else (delimiter,):
        counts = Counter(width_of(text, name) for _, _, text in rows)
        width, count = max(((w, c) for w, c in counts.items() if w > 1), key=lambda it: it[1], default=(0, 0))
        if count > best[0]:
            best = (count, name, width)
    if not best[0] or best[0] < len(rows) / 2:
        hint = "set reader.csv's delimiter, or name the reader of its format"
        raise ReadFailed(path, "no delimiter parts its rows into columns", line=rows[0][0], hint=hint)
    if best[2] > MOST_COLUMNS:
        raise ReadFailed(path, f"a row has {best[2]} columns", line=rows[0][0], hint="check its line ends")
    return best[1], best[2]


def _header(
    top: Sequence[Record], rows: Sequence[Record], delimiter: str, width: int, form: Form
) -> tuple[Record | None, Record | None]:
    """The first row, and the record of the header, None where there is none."""
    first = next((record for record in rows if is_row(record[2], delimiter, width)), None)
    if first is None or form.header == 0:
        return first, None
    if form.header is not None:
        return first, next((record for record in top if record[0] == form.header), None)
    comment = form.comment.encode()
    blank_end = not fields(first[2], delimiter)[-1]
    for record in reversed([record for record in top if record[1] < first[1]]):
        words = fields(record[2].lstrip().removeprefix(comment), delimiter)
        while len(words) > width and not words[-1]:
            words.pop()
        if len(words) == width or (blank_end and len(words) == width - 1 and delimiter != "space"):
            return first, record
    return first, None


def _decimal(rows: Sequence[Record], delimiter: str) -> str:
    if delimiter == "comma" or not any(b"," in text for _, _, text in rows):
        return "point"
    parts = [part for _, _, text in rows for part in fields(text, delimiter)]
    commas = sum(bool(WITH_COMMA.fullmatch(part)) for part in parts)
    return "comma" if commas > sum(bool(_WITH_POINT.fullmatch(part)) for part in parts) else "point"


def _whole_end(text: Text, first: Record, delimiter: str, width: int) -> tuple[int, int | None]:
    """Offset behind the last whole row, and the number of the line that was cut off behind it.

    A last row is cut if fields are missing or a quote is not closed, or if no line end follows and its last number has
    fewer decimals than the one above: the rest of it may be lost. Raises ReadFailed where whole rows follow the quote.
    """
    tail, start = text.tail, max(first[1] - text.tail_at, 0)
    end = len(tail.rstrip(b"\n\0 "))
    if (text.quotes - text.head.count(b'"', 0, first[1]) - tail.count(b'"', end)) % 2:
        opened = tail.rfind(b'"', start, end)
        begin = max(tail.rfind(b"\n", start, opened) + 1, start)
        line = text.line_at(text.tail_at + begin) if opened >= 0 else text.line_of_last(b'"')
        if opened < 0 or any(is_row(row, delimiter, width) for row in tail[begin:end].split(b"\n")[1:]):
            what = "a quote is opened in this line and never closed"
            raise ReadFailed(text.path, what, line=line, hint="repair the line or delete it")
        return text.tail_at + begin, line
    begin, above, last = _last_two(tail, start, end)
    parts = fields(last, delimiter)
    whole = len(raw_fields(last, delimiter)) >= width
    if whole and tail[end : end + 1] != b"\n" and above:
        whole = _decimals(parts[-1]) >= _decimals(fields(above, delimiter)[-1])
    if whole:
        return text.tail_at + end, None
    return text.tail_at + begin, text.line_at(text.tail_at + begin)


def _last_two(text: bytes, start: int, end: int) -> tuple[int, bytes, bytes]:
    """Offset of the last record, the one above it ("" where there is none) and the last one."""
    begin = _begin(text, start, end)
    return begin, text[_begin(text, start, begin - 1) : begin - 1] if begin > start else b"", text[begin:end]


def _begin(text: bytes, start: int, end: int) -> int:
    """Where the record begins that ends at `end`."""
    quotes = 0
    while True:
        begin = max(text.rfind(b"\n", start, end) + 1, start)
        quotes += text.count(b'"', begin, end)
        if begin == start or quotes % 2 == 0:
            return begin
        end = begin - 1


def _decimals(field: bytes) -> int:
    """Digits behind the decimal mark; -1 where the field is no number."""
    return len(re.split(rb"[.,]", field + b".")[1]) if NUMBER.fullmatch(field) else -1
