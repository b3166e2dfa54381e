"""A text log in pieces, each a small log of its own: the header, and whole lines that came since."""

from __future__ import annotations

from typing import Final

_NUMBERS: Final = b"0123456789+-.$"
_MOST_HEADER: Final = 100
"""Lines; a log that begins with more of them is not of numbers."""


class Pieces:
    """Cuts bytes at line ends, and puts the log's header before each piece.

    The header is what stands before the first line that begins like a row: with a digit, a sign, or `$` of NMEA.
    """

    def __init__(self) -> None:
        self._header: bytes | None = None
        self._rest = b""
        self._taken = 0
        self.begins = 0
        """Byte of the log at which the rows of the last piece begin."""

    def cut(self, data: bytes) -> bytes:
        """The piece that ends with the last whole line; b"" while there is none."""
        self._rest += data
        end = self._rest.rfind(b"\n") + 1
        lines, rest = self._rest[:end], self._rest[end:]
        if self._header is None:
            size = _header_size(lines)
            if size is None:
                return b""
            self._header = lines[:size]
            self._taken = size
            lines = lines[size:]
        self._rest, self.begins = rest, self._taken
        self._taken += len(lines)
        return self._header + lines if lines else b""

    @classmethod
    def going_on(cls, head: bytes, offset: int) -> Pieces:
        """For a log that is read from a byte where a row begins. head : its first bytes, with all of the header"""
        pieces = cls()
        pieces._header, pieces._taken = head[: _header_size(head) or 0], offset
        return pieces

    def last(self) -> bytes:
        """The piece of a last line without an end."""
        return self.cut(b"\n") if self._rest.strip() else b""


def _header_size(lines: bytes) -> int | None:
    """Bytes before the first row; None where no row has come yet."""
    size = 0
    for number, line in enumerate(lines.splitlines(keepends=True)):
        text = line.lstrip(b"\xef\xbb\xbf \t\"'")
        if (text[:1] and text[0] in _NUMBERS) or number == _MOST_HEADER:
            return size
        size += len(line)
    return None
