"""Files and folders, local or in an object store (s3://, gs://, abfs://), behind the filesystems of pyarrow.

Credentials and regions are found as the clouds' own tools find them (environment, configuration files, roles). What
stands behind a `?` is given to pyarrow: s3://bucket/logs?region=eu-central-1&endpoint_override=http://localhost:9000
It may be secret (a SAS token of Azure, for instance), and is shown nowhere.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final, TypeAlias

from recon.errors import ReadFailed
from recon.storage.json_text import readable

Stamp: TypeAlias = tuple[int, int]
"""Bytes and time of change, ns: by these a file is known to be the same. Of a folder, their sum and the latest."""

_URI: Final = re.compile(r"([a-z][a-z0-9+.-]+://[^/?]*)([^?]*)(\?.*)?")
_WILD: Final = re.compile(r"[*?\[]")
_FLAT: Final = ("gs://", "gcs://")
"""Stores of which pyarrow lists objects only: there a folder is what names of objects have in common."""
_QUERY: Final = re.compile(r"(://[^\s?]*)\?\S*")
_CHUNK: Final = 1024
"""Paths that are asked for together."""


@dataclass(frozen=True, slots=True)
class Place:
    """A file or folder.

    path : in the filesystem, with `/` between its parts
    head, query : beginning and end of its URI; empty for a local place
    """

    path: str
    head: str = ""
    query: str = ""

    @classmethod
    def of(cls, text: str, folder: Path | None = None) -> Place:
        """From a URI or a local path; `folder` is what a local path is relative to."""
        found = _URI.fullmatch(text)
        if found is None:
            return cls(Path(folder or "", text).absolute().as_posix())
        _, base = _opened(found[1], found[3] or "")
        path = "/".join(part for part in (base.strip("/"), found[2].strip("/")) if part)
        return cls(path, found[1], found[3] or "")

    @property
    def is_local(self) -> bool:
        """Is it a path of this machine?"""
        return not self.head

    @property
    def filesystem(self) -> Any:
        """The filesystem of pyarrow. Raises OSError where the store cannot be reached."""
        return _opened(self.head, self.query)[0]

    def __str__(self) -> str:
        """The path, or the URI without its query and without a user that has a password: these may be secret."""
        if self.is_local:
            return self.path
        base = _opened(self.head, self.query)[1].strip("/")
        scheme, _, authority = self.head.partition("://")
        user, _, host = authority.rpartition("@")
        return f"{scheme}://{host if ':' in user else authority}/{self.path.removeprefix(base).strip('/')}"

    def at(self, path: str) -> Place:
        """Another path of the same filesystem."""
        return replace(self, path=path)

    def __truediv__(self, name: str) -> Place:
        """What lies below it."""
        return self.at(f"{self.path.rstrip('/')}/{name}")


@cache
def _opened(head: str, query: str) -> tuple[Any, str]:
    """Filesystem and the path in it of the root of a URI; opening one takes longer than a small file."""
    from pyarrow import fs

    return fs.FileSystem.from_uri(f"{head}{query}") if head else (fs.LocalFileSystem(), "")


def stamp(place: Place) -> Stamp | None:
    """Bytes and time of change of a file or folder; None where there is none. Raises OSError."""
    from pyarrow import fs

    (info,) = place.filesystem.get_file_info([place.path])
    if info.type == fs.FileType.Directory:
        files = files_below(place)
        return sum(part.size for part in files), max((part.mtime_ns for part in files), default=0)
    return stamp_of(info)


def stamp_of(info: Any) -> Stamp | None:
    """The stamp of a file from its FileInfo; None for a folder or nothing."""
    return None if info.size is None else (int(info.size), int(info.mtime_ns))


def below(place: Place, *, deep: bool = False) -> list[Any]:
    """FileInfo of what lies in a folder, `deep` also in its folders; none where no folder is. Raises OSError."""
    from pyarrow import fs

    flat = place.head.startswith(_FLAT)
    selector = fs.FileSelector(place.path or "/", recursive=deep or flat, allow_not_found=True)
    found: list[Any] = place.filesystem.get_file_info(selector)
    if not flat:
        return found
    start = len(place.path) + 1
    infos = {info.path: info for info in found}
    for path in list(infos):
        while "/" in path[start:]:
            path = path.rpartition("/")[0]
            infos.setdefault(path, fs.FileInfo(path, fs.FileType.Directory))
    return [info for path, info in infos.items() if deep or "/" not in path[start:]]


def files_below(place: Place) -> list[Any]:
    """FileInfo of all files of a folder and its folders. Raises OSError."""
    from pyarrow import fs

    return [info for info in below(place, deep=True) if info.type == fs.FileType.File]


def without_query(told: object) -> str:
    """A text or error without the queries of URIs in it, which may be secret."""
    return _QUERY.sub(r"\1", str(told))


def glob(pattern: Place) -> Iterator[tuple[Place, Stamp | None]]:
    """Files and folders that match a pattern with `*`, `?`, `[...]` and `**`, sorted; none that are hidden.

    A link to what is not there, a pipe and a device have no stamp: they are drives that cannot be read, not ones that
    are passed over.
    In a URI a `?` begins its query, so it is no wildcard there. Raises OSError.
    """
    *folders, last = pattern.path.split("/")
    starts = [folders.pop(0)] if folders else [""]
    for part in folders:
        starts = [found for start in starts for found in _below(pattern, start, part, folders_only=True)]
    told: set[str] = set()  # with several `**`, a path may be found more than once
    for start in sorted(set(starts)):
        chosen = sorted(set(_below(pattern, start, last, folders_only=False)) - told)
        if pattern.path.count("**") > 1:
            told.update(chosen)
        for first in range(0, len(chosen), _CHUNK):
            yield from _found(pattern, chosen[first : first + _CHUNK])


def _found(pattern: Place, paths: list[str]) -> Iterator[tuple[Place, Stamp | None]]:
    """Those paths where something is, a link counts; for `**` at the end only files."""
    from pyarrow import fs

    for info in pattern.filesystem.get_file_info(paths):
        if info.type == fs.FileType.File:
            yield pattern.at(info.path), (int(info.size), int(info.mtime_ns))
        elif info.type == fs.FileType.Directory and not pattern.path.endswith("/**"):
            yield pattern.at(info.path), stamp(pattern.at(info.path)) or (0, 0)
        elif info.type == fs.FileType.Unknown or (
            info.type == fs.FileType.NotFound and pattern.is_local and Path(info.path).is_symlink()
        ):
            yield pattern.at(info.path), None


def _below(pattern: Place, path: str, part: str, *, folders_only: bool) -> list[str]:
    """Paths that one part of a pattern leads to from a folder."""
    from pyarrow import fs

    if not _WILD.search(part):
        return [f"{path}/{part}"]
    deep = part == "**"
    try:
        if deep and pattern.is_local:
            wanted = [one for one, is_folder in _walked(path) if is_folder or not folders_only]
        else:
            infos = below(pattern.at(path), deep=deep)
            wanted = [info.path for info in infos if not folders_only or info.type == fs.FileType.Directory]
    except NotADirectoryError:
        return []
    except UnicodeDecodeError as error:
        names = (name for _, *parts in os.walk(path) for name in chain(*parts))
        wrong = next((readable(name) for name in names if readable(name) != name), "of a file")
        raise OSError(f"the name {wrong} in {path} is not UTF-8: rename it") from error
    if deep:
        shown = [one for one in wanted if "/." not in one[len(path) :]]
        return [path, *shown] if folders_only else shown
    if pattern.is_local and not folders_only:
        wanted += _dangling(path)
    named = ((one, one.rpartition("/")[2]) for one in wanted)
    return [one for one, name in named if fnmatchcase(name, part) and not name.startswith(".")]


def _walked(folder: str, within: frozenset[Path] = frozenset()) -> Iterator[tuple[str, bool]]:
    """Paths below a local folder, if there is one, and whether each is a folder.

    Links are followed, but not to a folder that they lie in: that would have no end.
    within : folders, free of links, on the way here
    """
    within |= {Path(folder or "/").resolve()}
    if not Path(folder or "/").is_dir():
        return
    with os.scandir(folder or "/") as found:
        entries = sorted((entry.name, entry.is_dir(), entry.is_symlink()) for entry in found)
    for name, is_folder, is_link in entries:
        path = f"{folder}/{name}"
        if readable(name) != name:
            raise OSError(f"the name {readable(name)} in {folder} is not UTF-8: rename it")
        if is_link and is_folder and Path(path).resolve() in within:
            continue
        yield path, is_folder
        if is_folder:
            yield from _walked(path, within)


def _dangling(folder: str) -> Iterator[str]:
    """Links in a local folder that lead to nothing, which pyarrow leaves out."""
    if not Path(folder or "/").is_dir():
        return
    with os.scandir(folder or "/") as entries:
        for entry in entries:
            if entry.is_symlink() and not Path(entry.path).exists():
                yield f"{folder}/{entry.name}"


def fetch(place: Place, folder: Path) -> Path:
    """A local path of a file or folder: itself, or a copy in `folder`. Raises ReadFailed."""
    if place.is_local:
        return Path(place.path)
    from pyarrow import fs

    target = folder / place.path.rpartition("/")[2]
    try:
        (info,) = place.filesystem.get_file_info([place.path])
        if info.type == fs.FileType.NotFound:
            raise ReadFailed(str(place), "there is no such file or folder")
        for part in below(place, deep=True) if info.type == fs.FileType.Directory else []:
            if part.type == fs.FileType.Directory:
                (target / part.path[len(place.path) + 1 :]).mkdir(parents=True, exist_ok=True)
        fs.copy_files(
            place.path,
            target.as_posix(),
            source_filesystem=place.filesystem,
            destination_filesystem=fs.LocalFileSystem(),
        )
    except OSError as error:
        raise ReadFailed(str(place), f"it cannot be fetched: {without_query(error)}") from error
    return target
