"""The folder of all results of a batch, local or in an object store: how a result becomes whole, and what is there.

A local result is renamed to its place as a whole. An object store renames nothing: there the files are uploaded and
the manifest last, and what is replaced loses its manifest first.
A result that is no more what the batch would make, and that could not be made anew, is moved to ROOT/_superseded, where
no reader of the dataset looks.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any, Final

from recon.errors import StorageError
from recon.fleet.lock import leased, locked
from recon.fleet.places import Place, Stamp, below, files_below, stamp, without_query
from recon.storage.atomic import MANIFEST, MARK, refuse_existing, storage_errors

SCRATCH: Final = ".scratch"
SUPERSEDED: Final = "_superseded"
"""Spark and pyarrow pass over names that begin so."""


@dataclass(frozen=True)
class Root(ABC):
    """Where results are."""

    place: Place

    @abstractmethod
    def prepared(self) -> AbstractContextManager[None]:
        """The root is there and belongs to this batch until the block ends; what a dead one left half-made is gone."""

    @abstractmethod
    def scratch(self) -> AbstractContextManager[Path]:
        """A new, empty local folder, taken away when the block ends."""

    @abstractmethod
    def commit(self, folder: Path, key: str) -> None:
        """Make a whole local result the result `key`, in place of an older one. Raises StorageError, ConfigError."""

    @abstractmethod
    def set_aside(self, key: str) -> bool:
        """Move the result `key` to SUPERSEDED, in place of an older one there. Was there any? Raises StorageError."""

    @abstractmethod
    def put(self, file: Path, name: str) -> None:
        """Move a local file, made in `scratch`, to the root."""

    def manifest(self, key: str) -> dict[str, Any] | None:
        """Manifest of a result; None where there is no whole one. Raises OSError where the store cannot be reached."""
        try:
            found = json.loads(self.manifest_text(key) or b"null")
        except ValueError:
            return None
        return found if isinstance(found, dict) and MARK in found else None

    def stamp(self, key: str) -> Stamp | None:
        """Size and time of change of a manifest; None where there is none. Raises OSError."""
        return stamp(self.place / key / MANIFEST)

    def manifest_text(self, key: str) -> bytes | None:
        """As `manifest`, not taken apart."""
        path = (self.place / key / MANIFEST).path
        try:
            with self.place.filesystem.open_input_stream(path) as file:
                return bytes(file.read())
        except (FileNotFoundError, NotADirectoryError):
            return None

    def keys(self) -> list[str]:
        """Names of the folders that may hold results, sorted."""
        return sorted(
            f"{vehicle}/{drive}"
            for vehicle in self._folders("", "vehicle=")
            for drive in self._folders(vehicle, "drive=")
        )

    def _folders(self, folder: str, prefix: str) -> list[str]:
        from pyarrow import fs

        infos = below(self.place / folder if folder else self.place)
        return [i.base_name for i in infos if i.type == fs.FileType.Directory and i.base_name.startswith(prefix)]


class LocalRoot(Root):
    """A folder of this machine, or one that all machines share under the same path."""

    @property
    def folder(self) -> Path:
        """The root."""
        return Path(self.place.path)

    def stamp(self, key: str) -> Stamp | None:
        """As for every root; a hundred thousand times."""
        try:
            found = os.stat(f"{self.place.path}/{key}/{MANIFEST}")  # noqa: PTH116 - a Path takes longer than the disk
        except (FileNotFoundError, NotADirectoryError):
            return None
        return found.st_size, found.st_mtime_ns

    def manifest_text(self, key: str) -> bytes | None:
        """As for every root."""
        try:
            return (self.folder / key / MANIFEST).read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """As for every root. Raises StorageError, ConfigError where another batch holds the lock."""
        with storage_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        with locked(self.folder):
            shutil.rmtree(self.folder / SCRATCH, ignore_errors=True)
            try:
                yield
            finally:
                shutil.rmtree(self.folder / SCRATCH, ignore_errors=True)

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """A folder on the same file system as the results."""
        folder = self.folder / SCRATCH / token_hex(8)
        with storage_errors(folder):
            folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def commit(self, folder: Path, key: str) -> None:
        """Rename; what is replaced goes to the scratch folder first, since Windows replaces no folder."""
        final = self.folder / key
        refuse_existing(final, overwrite=True)
        with storage_errors(final):
            final.parent.mkdir(exist_ok=True)
            if final.exists():
                final.rename(folder.with_name(f"{folder.name}.replaced"))
            folder.rename(final)

    def set_aside(self, key: str) -> bool:
        """Rename."""
        final, aside = self.folder / key, self.folder / SUPERSEDED / key
        with storage_errors(aside):
            if not final.exists():
                return False
            shutil.rmtree(aside, ignore_errors=True)
            aside.parent.mkdir(parents=True, exist_ok=True)
            final.rename(aside)
        return True

    def put(self, file: Path, name: str) -> None:
        """Rename."""
        with storage_errors(self.folder / name):
            file.replace(self.folder / name)


class StoreRoot(Root):
    """A prefix in an object store."""

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """As for every root; half-made results need no cleaning, since they count only by their manifests."""
        with ExitStack() as stack:
            with _upload_errors(str(self.place)):
                stack.enter_context(leased(self.place))
            yield

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """A temporary folder of this machine."""
        with tempfile.TemporaryDirectory(prefix="recon-", ignore_cleanup_errors=True) as folder:
            yield Path(folder)

    def commit(self, folder: Path, key: str) -> None:
        """Upload, the manifest last."""
        final = self.place / key
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        with _upload_errors(str(final)):
            _clear(final)
            for path in sorted(files, key=lambda path: path == folder / MANIFEST):
                _upload(path, final / path.relative_to(folder).as_posix())

    def set_aside(self, key: str) -> bool:
        """Copy, then delete."""
        final, aside = self.place / key, self.place / SUPERSEDED / key
        with _upload_errors(str(aside)):
            _clear(aside)
            files = [info.path for info in files_below(final)]
            for path in files:
                self.place.filesystem.copy_file(path, f"{aside.path}{path.removeprefix(final.path)}")
            _clear(final)
        return bool(files)

    def put(self, file: Path, name: str) -> None:
        """Upload."""
        with _upload_errors(f"{self.place}/{name}"):
            _upload(file, self.place / name)


def root_of(place: Place) -> Root:
    """The root at a place."""
    return LocalRoot(place) if place.is_local else StoreRoot(place)


def _clear(folder: Place) -> None:
    """Delete what is in a folder of a store, the manifest first: without it the rest is no result."""
    manifest = f"{folder.path}/{MANIFEST}"
    for path in sorted((info.path for info in files_below(folder)), key=lambda path: path != manifest):
        folder.filesystem.delete_file(path)


def _upload(file: Path, place: Place) -> None:
    with file.open("rb") as source, place.filesystem.open_output_stream(place.path) as target:
        shutil.copyfileobj(source, target, 1 << 20)


@contextmanager
def _upload_errors(target: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        text = f"{target} could not be written: {without_query(error)}"
        raise StorageError(text, "look at the store's rights and quota") from error
