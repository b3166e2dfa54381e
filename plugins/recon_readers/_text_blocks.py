"""Texts that may be larger than memory, looked at in blocks that end at line ends, as often as needed.

What is needed to find out how a text is made is kept: its beginning, its end, and counts. Offsets are those in the text
as it is read, with line ends \\n and without a byte order mark.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, TypeAlias

from recon.errors import ReadFailed

BLOCK: Final = 1 << 22
"""Bytes that are taken in at a time."""
KEPT: Final = 1 << 20
"""Bytes of beginning and end that are kept."""
HEAD_BYTES: Final = 65536
"""Of the beginning, by which text is told from what is none."""
_BOM: Final = codecs.BOM_UTF8
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x1f]")

Opener: TypeAlias = Callable[[], AbstractContextManager[IO[bytes]]]
"""Opens a file from its beginning."""


@dataclass(frozen=True)
class Text:
    """A text that was looked through once.

    pieces : reads it from the beginning; head, tail : its first and last megabyte; size : bytes
    lines, quotes : how many line ends and quotation marks it holds
    """

    path: Path
    pieces: Callable[[], Iterator[bytes]]
    head: bytes
    tail: bytes
    size: int
    lines: int
    quotes: int

    @classmethod
    def of(cls, path: Path, text: bytes) -> Text:
        """A text that is in memory, with line ends \\n."""
        return cls._seen(path, lambda: iter((text,)))

    @classmethod
    def open(cls, path: Path, encoding: str | None = None, opener: Opener | None = None) -> Text:
        """A file. encoding : of a codec, None for bytes that are taken as they are; opener : of what is inside
        another, whose errors are left as they are.

        Raises ReadFailed for what is no regular file or cannot be read, UnicodeError where it is not of the encoding,
        LookupError where there is no such encoding.
        """
        b"".decode(encoding or "ascii")
        if opener is not None:
            return cls._seen(path, lambda: _pieces(opener, encoding))
        check_regular(path)
        try:
            return cls._seen(path, lambda: _pieces(lambda: path.open("rb"), encoding))
        except UnicodeError:
            raise
        except (OSError, ValueError) as error:
            raise unreadable(path, error) from error

    def lines_like(self, pattern: re.Pattern[bytes]) -> Text:
        """The text of those of its lines of which a pattern takes all, line end and all."""
        return self._seen(self.path, lambda: (b"".join(pattern.findall(block)) for block in self.blocks()))

    @classmethod
    def _seen(cls, path: Path, pieces: Callable[[], Iterator[bytes]]) -> Text:
        head, tail = b"", b""
        size = lines = quotes = 0
        for piece in pieces():
            head += piece[: max(KEPT - len(head), 0)]
            tail = piece[-KEPT:] if len(piece) >= KEPT else (tail + piece)[-KEPT:]
            size += len(piece)
            lines += piece.count(b"\n")
            quotes += piece.count(b'"')
        return cls(path, pieces, head, tail, size, lines, quotes)

    @property
    def tail_at(self) -> int:
        """Offset of the tail."""
        return self.size - len(self.tail)

    def line_at(self, offset: int) -> int:
        """Number of the line, 1-based, in which an offset of the tail or behind the head's first row lies."""
        if offset <= len(self.head):
            return 1 + self.head.count(b"\n", 0, offset)
        return 1 + self.lines - self.tail.count(b"\n", max(offset - self.tail_at, 0))

    def blocks(self, start: int = 0, end: int | None = None, *, quoted: bool = False) -> Iterator[bytes]:
        """The text from one offset to another in blocks that end at line ends; quoted : none of them within quotes."""
        rest = b""
        for piece in self._between(start, self.size if end is None else end):
            block = rest + piece if rest else piece
            cut = _cut(block, quoted)
            rest = block[cut:]
            if cut:
                yield block[:cut] if rest else block
        if rest:
            yield rest

    def _between(self, start: int, end: int) -> Iterator[bytes]:
        offset = 0
        for piece in self.pieces():
            first, last = max(start - offset, 0), min(end - offset, len(piece))
            if first < last:
                yield piece if (first, last) == (0, len(piece)) else piece[first:last]
            offset += len(piece)
            if offset >= end:
                return

    def line_of_last(self, mark: bytes) -> int:
        """Number of the line, 1-based, that holds the last of these marks; 0 where there is none."""
        found, first = 0, 1
        for block in self.blocks():
            at = block.rfind(mark)
            found = first + block.count(b"\n", 0, at) if at >= 0 else found
            first += block.count(b"\n")
        return found

    def whole(self) -> bytes:
        """All of it."""
        return b"".join(self.pieces())


def _cut(block: bytes, quoted: bool) -> int:
    """Offset behind the last line end of a block; quoted : the last one with whole quotes before it. 0 for none."""
    cut = block.rfind(b"\n") + 1
    if not quoted:
        return cut
    odd = block.count(b'"', 0, cut) % 2
    while cut and odd:
        before = block.rfind(b"\n", 0, cut - 1) + 1
        odd = (odd + block.count(b'"', before, cut)) % 2
        cut = before
    return cut


def plain(text: bytes) -> bytes:
    """The text with line ends \\n and without a byte order mark."""
    return _unix(text.removeprefix(_BOM))


def _unix(text: bytes) -> bytes:
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text


def _pieces(opener: Opener, encoding: str | None) -> Iterator[bytes]:
    """A file in UTF-8, or as it is, with line ends \\n and without a byte order mark."""
    decoder = None if encoding is None else codecs.getincrementaldecoder(encoding)()
    same = encoding is not None and codecs.lookup(encoding).name == "utf-8"
    with opener() as file:
        held, begun = b"", False
        while True:
            raw = file.read(BLOCK)
            decoded = decoder.decode(raw, final=not raw) if decoder is not None else ""
            piece = held + (raw if decoder is None or same else decoded.encode())
            held = b"\r" if raw and piece.endswith(b"\r") else b""
            piece = piece.removesuffix(held)
            plain_piece = _unix(piece if begun else piece.removeprefix(_BOM))
            begun = begun or bool(piece)
            if plain_piece:
                yield plain_piece
            if not raw:
                return


def check_regular(path: Path) -> None:
    """Raises ReadFailed for what is no regular file."""
    try:
        if path.is_dir():
            raise ReadFailed(path, "this is a folder, not a file", hint="name the files inside it")
        if path.exists() and not path.is_file():
            raise ReadFailed(path, "this is not a regular file", hint="copy the log into a file first")
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: Exception) -> ReadFailed:
    """The error that the system does not give a file."""
    reason = getattr(error, "strerror", None) or str(error)
    return ReadFailed(path, f"it cannot be read: {reason}", hint="check the name and the permissions")


def load(path: Path) -> Text:
    """The whole file with line ends \\n and without a byte order mark.

    Raises ReadFailed for what is no regular file, cannot be read, is empty, or is not one-byte text.
    """
    text = Text.open(path)
    fault = not_text(text.head[:HEAD_BYTES])
    if fault:
        what, hint = fault
        raise ReadFailed(path, what, hint=hint)
    return text


def contents(path: Path) -> bytes:
    """The whole file as it is. Raises ReadFailed for what is no regular file or cannot be read."""
    check_regular(path)
    try:
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from error


def not_text(head: bytes) -> tuple[str, str] | None:
    """Why the beginning of a file is not that of one-byte text, and what to do; None where it is."""
    if not head.strip():
        what = "it holds nothing but blanks" if head else "the file is empty"
        return what, "check that the log was copied completely"
    few, many = sorted((head[0::2].count(0), head[1::2].count(0)))
    if head[:2] in (b"\xff\xfe", b"\xfe\xff") or (len(head) > 3 and many > 0.4 * len(head) / 2 and few < many / 4):
        return "this is UTF-16 text", "save it as ASCII or UTF-8"
    if _CONTROL.search(head.rstrip(b"\0")) or not head.rstrip(b"\0"):
        return "this is not a text file", "unpack it if it is an archive"
    return None
