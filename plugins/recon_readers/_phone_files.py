"""Files that an app of a phone writes for one recording: a folder, a zip of it, or one of its tables.

Tables are delimited text with a header; separator and decimal mark are choices of the user of the app. Damaged lines
are left out and counted by `_lines`.
"""

from __future__ import annotations

import csv
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, Final

import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon_readers._limits import LARGEST_UNPACKED
from recon_readers._lines import COPIED, Form, Lines, read_lines
from recon_readers._text_blocks import HEAD_BYTES, Text, not_text, plain

_SEPARATORS: Final = (",", ";", "\t")
_WIDEST: Final = 1000
_DECIMAL_COMMA: Final = re.compile(rb"\d,\d")
_BAD_ZIP: Final = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, ValueError, OSError
)  # fmt: skip


@dataclass(frozen=True)
class Files:
    """The files of a recording by their path in its folder, or by the name of a single one.

    path : what the user named; beside : may files that were not named themselves be looked at, too?
    """

    path: Path
    names: tuple[str, ...]
    beside: bool = False

    def label(self, name: str) -> Path:
        """The file as messages call it."""
        return self.path if self.beside else self.path / name

    def text(self, name: str) -> Text:
        """The text of a file. Raises ReadFailed where it cannot be had or is none."""
        text = self._text(name)
        fault = not_text(text.head[:HEAD_BYTES])
        if fault:
            raise ReadFailed(self.label(name), fault[0], hint=fault[1])
        return text

    def _text(self, name: str) -> Text:
        if self.beside or self.path.is_dir():
            return Text.open(self._beside(name) if self.beside else self.path / name)
        try:
            return Text.open(self.path, opener=lambda: self._opened(name))
        except _BAD_ZIP as error:
            raise ReadFailed(self.label(name), f"it cannot be unpacked: {error}", hint=COPIED) from error

    def head(self, name: str) -> bytes:
        """The beginning of a file. Raises ReadFailed where it cannot be had."""
        try:
            with self._opened(name) as file:
                return plain(file.read(HEAD_BYTES))
        except _BAD_ZIP as error:
            raise ReadFailed(self.label(name), f"it cannot be read: {error}", hint=COPIED) from error

    @contextmanager
    def _opened(self, name: str) -> Iterator[IO[bytes]]:
        if self.beside or self.path.is_dir():
            with (self._beside(name) if self.beside else self.path / name).open("rb") as plain_file:
                yield plain_file
            return
        with zipfile.ZipFile(self.path) as archive:
            member = _member(archive, name)
            if member.file_size > LARGEST_UNPACKED:
                what = f"it would unpack to {member.file_size / 1e9:.1f} GB"
                raise ReadFailed(self.label(name), what, hint="unpack the zip, and name its folder")
            with archive.open(member) as packed:
                yield packed

    def _beside(self, name: str) -> Path:
        return self.path.parent / name

    def optional(self, name: str) -> bytes | None:
        """The beginning of a file of this path, which may stand beside a single one; None where there is none."""
        there = name in self.names or (self.beside and self._beside(name).is_file())
        return self.head(name) if there else None


def files_of(path: Path) -> Files:
    """The files at a path, or in the one folder that is all that is in it. Raises ReadFailed for a broken zip."""
    if path.is_dir():
        inside = [each for each in path.iterdir() if not each.name.startswith(".")]
        if len(inside) == 1 and inside[0].is_dir():
            return files_of(inside[0])
        found = [*path.glob("*"), *path.glob("meta/*")]
        return Files(path, tuple(sorted(f.relative_to(path).as_posix() for f in found if f.is_file())))
    if not is_zip(path):
        return Files(path, (path.name,), beside=True)
    try:
        with zipfile.ZipFile(path) as archive:
            names = [info.filename for info in archive.infolist() if not info.is_dir()]
    except _BAD_ZIP as error:
        raise ReadFailed(path, f"it is no whole zip: {error}", hint=COPIED) from error
    return Files(path, tuple(sorted({_inside(names, name) for name in names})))


def is_zip(path: Path) -> bool:
    """Does the file begin as zips do?"""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"


def _inside(names: list[str], name: str) -> str:
    """The name without the folder that holds all files of a zip."""
    top = {PurePosixPath(each).parts[0] for each in names if each}
    parts = PurePosixPath(name).parts
    return "/".join(parts[1:]) if len(top) == 1 and all("/" in each for each in names) else name


def _member(archive: zipfile.ZipFile, name: str) -> zipfile.ZipInfo:
    names = [info.filename for info in archive.infolist() if not info.is_dir()]
    for info in archive.infolist():
        if not info.is_dir() and _inside(names, info.filename) == name:
            return info
    raise ValueError(f"there is no {name} in it")


@dataclass(frozen=True)
class Sheet:
    """A table before its numbers are read: names of the columns, and how its rows are made."""

    path: Path
    text: Text
    names: tuple[str, ...]
    separator: bytes
    comma: bool
    start: int

    def lines(
        self, kinds: Mapping[str, pa.DataType], made: Callable[[pa.Table], Mapping[Any, NDArray[Any]]]
    ) -> Lines | None:
        """What is made of the whole rows of the columns wanted, None where there are no rows at all."""
        if self.start >= self.text.size or not self.text.tail[max(self.start - self.text.tail_at, 0) :].strip():
            return None
        form = Form(self.names, kinds, self.separator, quotes=True, comma=self.comma)
        return read_lines(self.path, self.text, form, made, start=self.start, first_line=2)


def sheet_of(files: Files, name: str) -> Sheet:
    """A table with a header in its first line. Raises ReadFailed for what is no text."""
    text = files.text(name)
    head, _, rows = text.head[:HEAD_BYTES].partition(b"\n")
    names, separator = header_of(head)
    comma = separator != b"," and _DECIMAL_COMMA.search(rows) is not None
    return Sheet(files.label(name), text, names, separator, comma, len(head) + 1)


def header_of(line: bytes) -> tuple[tuple[str, ...], bytes]:
    """The names in a header, each once, and what parts them."""
    text = line.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace").replace("\0", "").strip()
    found: list[str] = []
    mark = max(_SEPARATORS, key=lambda separator: len(_fields(text, separator)))
    for index, name in enumerate(_fields(text, mark)[:_WIDEST]):
        name = name.strip().strip('"')
        found.append(f"{name}#{index}" if name in found else name)
    return tuple(found), mark.encode()


def _fields(text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator), [])
    except csv.Error:
        return [text]
