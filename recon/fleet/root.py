"""The folder of all results of a batch, local or in an object store: how a result becomes whole, and what is there.

A local result is renamed to its place as a whole. An object store renames nothing: there the files are uploaded and
the manifest last, and what is replaced loses its manifest first.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex
from typing import Any, Final

from recon.errors import StorageError
from recon.fleet.lock import leased, locked
from recon.fleet.places import Place
from recon.storage.atomic import MANIFEST, MARK, refuse_existing, storage_errors

SCRATCH: Final = ".scratch"


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
    def put(self, file: Path, name: str) -> None:
        """Move a local file, made in `scratch`, to the root."""

    def manifest(self, key: str) -> dict[str, Any] | None:
        """Manifest of a result; None where there is no whole one. Raises OSError where the store cannot be reached."""
        try:
            found = json.loads(self.manifest_text(key) or b"null")
        except ValueError:
            return None
        return found if isinstance(found, dict) and MARK in found else None

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

    def _folders(self, below: str, prefix: str) -> list[str]:
        from pyarrow import fs

        start = (self.place / below).path.rstrip("/")
        infos = self.place.filesystem.get_file_info(fs.FileSelector(start, allow_not_found=True))
        return [i.base_name for i in infos if i.type == fs.FileType.Directory and i.base_name.startswith(prefix)]


class LocalRoot(Root):
    """A folder of this machine, or one that all machines share under the same path."""

    @property
    def folder(self) -> Path:
        """The root."""
        return Path(self.place.path)

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
        filesystem, final = self.place.filesystem, (self.place / key).path
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        with _upload_errors(f"{self.place}/{key}"):
            with suppress(FileNotFoundError):
                filesystem.delete_file(f"{final}/{MANIFEST}")
            filesystem.delete_dir_contents(final, missing_dir_ok=True)
            for path in sorted(files, key=lambda path: path == folder / MANIFEST):
                _upload(path, filesystem, f"{final}/{path.relative_to(folder).as_posix()}")

    def put(self, file: Path, name: str) -> None:
        """Upload."""
        with _upload_errors(f"{self.place}/{name}"):
            _upload(file, self.place.filesystem, (self.place / name).path)


def root_of(place: Place) -> Root:
    """The root at a place."""
    return LocalRoot(place) if place.is_local else StoreRoot(place)


def _upload(file: Path, filesystem: Any, path: str) -> None:
    with file.open("rb") as source, filesystem.open_output_stream(path) as target:
        shutil.copyfileobj(source, target, 1 << 20)


@contextmanager
def _upload_errors(target: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StorageError(f"{target} could not be written: {error}", "look at the store's rights and quota") from error
