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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

import pyarrow as pa

from recon.errors import ReadFailed
from recon_readers._delimited import contents, not_text
from recon_readers._lines import COPIED, Form, Lines, read_lines
from recon_readers._text_blocks import plain

LARGEST: Final = 2**30
"""Bytes of a table; a member of a zip that claims more is refused."""
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

    def read(self, name: str) -> bytes:
        """The content of a file. Raises ReadFailed where it cannot be had."""
        if self.beside or self.path.is_dir():
            return contents(self.path.parent / name if self.beside else self.path / name)
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(_member(archive, name)) as file:
                found = file.read(LARGEST + 1)
        except _BAD_ZIP as error:
            raise ReadFailed(self.label(name), f"it cannot be unpacked: {error}", hint=COPIED) from error
        if len(found) > LARGEST:
            raise ReadFailed(self.label(name), "it unpacks to more than a gigabyte", hint="unpack it, and cut it")
        return found

    def optional(self, name: str) -> bytes | None:
        """The content of a file of this path, which may stand beside a single one; None where there is none."""
        if name in self.names:
            return self.read(name)
        there = self.beside and (self.path.parent / name).is_file()
        return contents(self.path.parent / name) if there else None


def files_of(path: Path) -> Files:
    """The files at a path, or in the one folder that is all that is in it. Raises ReadFailed for a broken zip."""
    if path.is_dir():
        inside = [each for each in path.iterdir() if not each.name.startswith(".")]
        if len(inside) == 1 and inside[0].is_dir():
            return files_of(inside[0])
        found = [*path.glob("*"), *path.glob("*/*")]
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
    """A table before its numbers are read: names of the columns, and the rows with decimal points."""

    path: Path
    names: tuple[str, ...]
    rows: bytes
    separator: bytes

    def lines(self, kinds: Mapping[str, pa.DataType]) -> Lines | None:
        """The whole rows of the columns wanted, None where there are none at all."""
        if not self.rows.strip():
            return None
        return read_lines(self.path, self.rows, 2, Form(self.names, kinds, self.separator))


def sheet_of(path: Path, raw: bytes) -> Sheet:
    """A table with a header in its first line. Raises ReadFailed for what is no text."""
    fault = not_text(raw[:65536])
    if fault:
        raise ReadFailed(path, fault[0], hint=fault[1])
    head, _, rows = plain(raw).partition(b"\n")
    names, separator = header_of(head)
    if separator != b"," and _DECIMAL_COMMA.search(rows[:65536]):
        rows = rows.replace(b",", b".")
    return Sheet(path, names, rows.replace(b'"', b""), separator)


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
