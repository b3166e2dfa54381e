"""Records of a delimited text and their fields, for looking at a text by eye; columns are read by `_csv_sheet`.

Reference: RFC 4180, whose quotes may hold delimiters and line ends.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, TypeAlias

from recon_readers._delimited import SPACE

DELIMITERS: Final = {"tab": b"\t", "semicolon": b";", "comma": b",", "bar": b"|", "space": SPACE}
"""By name; of two that part a text equally well the first is taken."""
NUMBER: Final = re.compile(rb"\s*[+-]?(?:\d++(?:[.,]\d*+)?|[.,]\d++)(?:[eE][+-]?\d++)?\s*")
WITH_COMMA: Final = re.compile(rb"\s*[+-]?\d+,\d+(?:[eE][+-]?\d+)?\s*")
"""A number whose decimal mark is a comma."""

Record: TypeAlias = tuple[int, int, bytes]
"""Line number, offset and text of a record."""


def records(text: bytes, comment: bytes) -> Iterator[Record]:
    """The records of a text that are neither blank nor comments; quotes may hold line ends."""
    offset, number = 0, 1
    while offset < len(text):
        begin, first, quotes = offset, number, 0
        while True:
            stop = text.find(b"\n", offset)
            stop = len(text) if stop < 0 else stop
            quotes += text.count(b'"', offset, stop)
            offset, number = stop + 1, number + 1
            if offset >= len(text) or quotes % 2 == 0:
                break
        record = text[begin:stop]
        if record.strip(b" ") and not (comment and record.lstrip().startswith(comment)):
            yield first, begin, record


def raw_fields(record: bytes, delimiter: str) -> list[bytes]:
    """The fields of a record as they stand, each with the delimiter behind it."""
    if delimiter == "space":
        return re.findall(rb"\s*\S+", record)
    mark = re.escape(DELIMITERS[delimiter])
    if b'"' not in record:
        parts = record.split(DELIMITERS[delimiter])
        return [part + DELIMITERS[delimiter] for part in parts[:-1]] + parts[-1:]
    found = re.findall(rb'((?:"(?:[^"]|"")*+"?|[^"%s])*+)(%s|\Z)' % (mark, mark), record)
    fields = [part + end for part, end in found]
    return fields[:-1] if len(fields) > 1 and found[-2][1] == b"" else fields


def width_of(record: bytes, delimiter: str) -> int:
    """How many fields a record has."""
    if delimiter == "space":
        return len(record.split())
    return len(raw_fields(record, delimiter)) if b'"' in record else record.count(DELIMITERS[delimiter]) + 1


def fields(record: bytes, delimiter: str) -> list[bytes]:
    """The fields of a record, without quotes, spaces around them, and delimiters."""
    mark = DELIMITERS[delimiter]
    parts = (part.removesuffix(mark).strip() for part in raw_fields(record, delimiter))
    return [part[1:-1].replace(b'""', b'"').strip() if part[:1] == b'"' else part for part in parts]


def is_row(record: bytes, delimiter: str, width: int) -> bool:
    """Has it as many fields, a number among them?"""
    parts = fields(record, delimiter)
    return len(parts) == width and any(NUMBER.fullmatch(part) for part in parts)
