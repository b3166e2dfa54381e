"""JSON and names that every program reads: bytes of a file name that are no UTF-8 are escaped, numbers are finite.

Python holds such a byte as a lone surrogate (PEP 383), which neither UTF-8 nor strict JSON parsers take; it is written
as the four characters that a shell would show, `\\xe9`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Final

_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_BYTE_ZERO: Final = 0xDC00
"""PEP 383: the byte b stands as U+DC00 + b."""


def to_json(data: Any, *, indent: int | None = None, sort_keys: bool = False) -> str:
    """The data as JSON of Unicode text. Raises ValueError for a number that is not finite."""
    text = json.dumps(data, indent=indent, sort_keys=sort_keys, ensure_ascii=False, allow_nan=False)
    return _SURROGATE.sub(lambda found: "\\" + _escape(found), text)  # a string of JSON needs the backslash twice


def readable(name: str) -> str:
    """A name as Unicode text."""
    return _SURROGATE.sub(_escape, name)


def name_of(path: Path) -> str:
    """The readable last part of a path, also of one told as `.` or `..`."""
    return readable(path.resolve().name if path.name in ("", "..") else path.name)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    byte = code - _BYTE_ZERO
    return rf"\x{byte:02x}" if 0x80 <= byte <= 0xFF else rf"\u{code:04x}"
