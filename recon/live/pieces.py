"""A text log in pieces, each a small log of its own: the header, and whole lines that came since."""

from __future__ import annotations

from typing import Final

_NUMBERS: Final = b"0123456789+-.$"
_MOST_HEADER: Final = 100
"""Lines; a log that begins with more of them is not of numbers."""


class Pieces:
    """Cuts bytes at line ends, and puts the log's header before each piece.

    The header is what stands before the first line that begins like a row: with a digit, a sign, or `$` of NMEA.

    overlap : bytes of earlier rows, at most, that stand before those of a piece once more: only beside them can a
        reader tell a value that is repeated from one that is new
    """

    def __init__(self, overlap: int = 0) -> None:
        self._header: bytes | None = None
        self._rest = b""
        self._taken = 0
        self._overlap, self._before, self._given = overlap, b"", b""
        self._lines: int | None = 0
        self._dropped: list[int] = []
        self.begins = 0
        """Byte of the log at which the rows of the last piece begin that were in none before."""

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
        if not lines:
            return b""
        known = self._before + self._given
        self._before = _last_lines(known, self._overlap)
        if self._lines is not None:
            self._lines += known.count(b"\n") - self._before.count(b"\n")
        self._given = lines
        return self._header + self._before + lines

    @property
    def overlaps(self) -> bool:
        """Does the last piece begin with rows of earlier ones?"""
        return bool(self._before)

    @property
    def alone(self) -> bytes:
        """The last piece without rows of earlier ones."""
        return (self._header or b"") + self._given

    def forget(self) -> None:
        """Later pieces do not begin with rows from before the last one."""
        if self._lines is not None:
            self._lines += self._before.count(b"\n")
        self._before = b""

    def line(self, number: int | None) -> int | None:
        """Line of the log, from one that is counted in the last piece; None where it is not known."""
        header = (self._header or b"").count(b"\n")
        if number is None or number <= header:
            return number
        if self._lines is None:
            return None
        number += self._lines
        for gone in self._dropped:
            number += gone <= number
        return number

    def without(self, number: int) -> bytes:
        """The last piece without one of its lines, which later pieces do not hold either; b"" where no row is left.

        Raises IndexError where the line, counted in the last piece, is of the header, or beyond the end.
        """
        header = self._header or b""
        at, before = number - 1 - header.count(b"\n"), self._before.count(b"\n")
        if at < 0:
            raise IndexError(number)
        if (line := self.line(number)) is not None:
            self._dropped = sorted([*self._dropped, line])
        if at < before:
            self._before = _without(self._before, at)
        else:
            self._given = _without(self._given, at - before)
        return header + self._before + self._given if self._given else b""

    @classmethod
    def going_on(cls, head: bytes, offset: int, overlap: int = 0) -> Pieces:
        """For a log that is read from a byte where a row begins. head : its first bytes, with all of the header"""
        pieces = cls(overlap)
        pieces._header, pieces._taken, pieces._lines = head[: _header_size(head) or 0], offset, None
        return pieces

    def last(self) -> bytes:
        """The piece of a last line without an end."""
        return self.cut(b"\n") if self._rest.strip() else b""


def _without(rows: bytes, at: int) -> bytes:
    """Rows less one. Raises IndexError."""
    lines = rows.split(b"\n")  # as the lines are counted: not at every sign that ends a line of text
    if at >= len(lines) - 1:
        raise IndexError(at)
    return b"\n".join(lines[:at] + lines[at + 1 :])


def _last_lines(rows: bytes, most: int) -> bytes:
    """Whole lines at the end, at most so many bytes."""
    if len(rows) <= most:
        return rows
    return rows[rows.find(b"\n", len(rows) - most - 1) + 1 :]


def _header_size(lines: bytes) -> int | None:
    """Bytes before the first row; None where no row has come yet."""
    size = 0
    for number, line in enumerate(lines.splitlines(keepends=True)):
        text = line.lstrip(b"\xef\xbb\xbf \t\"'")
        if (text[:1] and text[0] in _NUMBERS) or number == _MOST_HEADER:
            return size
        size += len(line)
    return None
