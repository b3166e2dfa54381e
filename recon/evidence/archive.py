"""The zip archive of a seal: written in one way only, so that whatever is not in that way is found.

Entries are stored, sorted by name, dated 1980-01-01, with one set of attributes. The bytes of an archive follow from
the names and contents of its entries: `strange_byte` writes them again and compares, so that no header, gap, comment or
second directory can hold what nobody sees.
"""

from __future__ import annotations

import hashlib
import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import IO, Final

from recon.errors import Difference, ReadFailed
from recon.storage.atomic import storage_errors

_DATE: Final = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip archive can hold."""
_UNIX: Final = 3
_ATTRIBUTES: Final = 0o100644 << 16
_ENCRYPTED: Final = 1
_CHUNK: Final = 1 << 20
_A_SEAL: Final = "name a file that 'recon seal' wrote"
_BEGIN: Final = b"PK"


@dataclass(frozen=True)
class Entry:
    """A file of an archive: name with slashes, bytes, and how to open it for reading."""

    name: str
    size: int
    open: Callable[[], IO[bytes]]

    @classmethod
    def of_text(cls, name: str, text: str) -> Entry:
        """A text that is made here."""
        data = text.encode()
        return cls(name, len(data), lambda: BytesIO(data))

    @classmethod
    def of_file(cls, name: str, path: Path) -> Entry:
        """A file on disk."""
        return cls(name, path.stat().st_size, lambda: path.open("rb"))

    def sha256(self) -> str:
        """SHA-256 of its bytes, as hexadecimal text."""
        with self.open() as source:
            return digest(source)


def digest(source: IO[bytes]) -> str:
    """SHA-256 of what is left of a stream, as hexadecimal text."""
    found = hashlib.sha256()
    while chunk := source.read(_CHUNK):
        found.update(chunk)
    return found.hexdigest()


def write(entries: Iterable[Entry], file: Path) -> None:
    """Write an archive of these entries, sorted by name."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for entry in sorted(entries, key=lambda entry: entry.name):
            info = zipfile.ZipInfo(entry.name, _DATE)
            info.create_system, info.external_attr, info.file_size = _UNIX, _ATTRIBUTES, entry.size
            with archive.open(info, "w") as target, entry.open() as source:
                shutil.copyfileobj(source, target, _CHUNK)


def unreadable(file: Path, error: OSError) -> ReadFailed:
    """What to raise where a seal cannot be opened."""
    other = "this is a folder" if file.is_dir() else f"it cannot be read: {error.strerror or error}"
    return ReadFailed(file, "there is no such file" if isinstance(error, FileNotFoundError) else other, hint=_A_SEAL)


@contextmanager
def opened(file: Path) -> Iterator[list[Entry]]:
    """The entries of an archive, in its order.

    Raises ReadFailed for what is no archive, Difference for one that is damaged or holds what a seal never does.
    """
    try:
        with file.open("rb") as raw:
            begins = raw.read(len(_BEGIN)) == _BEGIN
    except OSError as error:
        raise unreadable(file, error) from error
    try:
        archive = zipfile.ZipFile(file)
    except (zipfile.BadZipFile, RuntimeError, ValueError, OSError) as error:
        if not begins:
            raise ReadFailed(file, "this is no seal of recon: it is no zip archive", hint=_A_SEAL) from error
        raise Difference(f"{file.name} is cut short or damaged: {error}") from error
    with archive:
        _refuse_strange(archive.infolist(), file)
        yield [_entry(archive, info) for info in archive.infolist()]


def _entry(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Entry:
    return Entry(info.filename, info.file_size, lambda: archive.open(info))


def _refuse_strange(infos: Sequence[zipfile.ZipInfo], file: Path) -> None:
    """Raises Difference for names that two files share or that lead elsewhere, and for entries that are not stored."""
    seen: dict[str, str] = {}
    for info in infos:
        name = info.filename
        fault = name_fault(name)
        if not fault and name.casefold() in seen:
            fault = f"a second file of that name, beside {seen[name.casefold()]!r}"
        if not fault and (info.flag_bits & _ENCRYPTED or info.compress_type != zipfile.ZIP_STORED):
            fault = "it is compressed or encrypted, which no seal is"
        if fault:
            raise Difference(f"{file.name}, entry {name!r}: {fault}")
        seen[name.casefold()] = name
    if sum(info.file_size for info in infos) > file.stat().st_size:
        raise Difference(f"{file.name}: its entries claim more bytes than it has")


def name_fault(name: str) -> str:
    """Why no file of a seal may have that name; "" where it may."""
    if not name.isprintable() or "\\" in name:
        return "its name holds a backslash or a character that cannot be printed"
    if PurePosixPath(name).is_absolute() or any(part in ("", ".", "..") for part in name.split("/")):
        return "its name leads out of the archive"
    return ""


def strange_byte(file: Path, entries: Iterable[Entry]) -> int | None:
    """Offset of the first byte that is not as `write` leaves these entries; None where all are."""
    with TemporaryDirectory(prefix="recon-seal-") as folder:
        again = Path(folder) / "again.zip"
        with storage_errors(again):
            write(entries, again)
        with file.open("rb") as one, again.open("rb") as other:
            return _first_unlike(one, other)


def _first_unlike(one: IO[bytes], other: IO[bytes]) -> int | None:
    offset = 0
    while True:
        first, second = one.read(_CHUNK), other.read(_CHUNK)
        if first != second:
            pairs = zip(first, second, strict=False)
            return offset + next((i for i, (a, b) in enumerate(pairs) if a != b), min(len(first), len(second)))
        if not first:
            return None
        offset += len(first)
