"""Results that are whole or not there: written beside their place under another name, then renamed.

    with staged_folder(Path("drive1-thesis")) as folder:
        ...                                            # write into folder
    # here drive1-thesis is complete; after an error or Ctrl-C it is as it was before

The temporary name is `.<name>.partial-<random>`, in the folder of the result: a rename is atomic only within one file
system. While an old result is replaced it waits as `.<name>.replaced-<random>` for the two renames. A process that is
killed leaves such a name behind; nothing of recon ever reads one, and nothing deletes one either, since it may belong
to a run that is still alive: a person may.
"""

from __future__ import annotations

import errno
import json
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from recon.errors import ConfigError, StorageError
from recon.problems import Problem, shortened

MANIFEST: Final = "manifest.json"
EXPORT_MANIFEST: Final = "export.json"
MARK: Final = "recon_manifest"
"""Key of the manifest's JSON object by which a folder is known as a result of recon."""

_LEFT_OVER: Final = re.compile(r"\..*\.(partial|replaced)-[0-9a-f]{8}")
"""Temporary names that a killed process leaves behind."""

_NO_SYNC_OF_FOLDERS: Final = (errno.EINVAL, errno.EBADF, errno.EACCES, errno.ENOSYS, errno.EOPNOTSUPP)
"""What file systems say that cannot do it, as those of networks."""
_FULL: Final = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))
_FORBIDDEN: Final = (errno.EACCES, errno.EPERM, errno.EROFS)


def refuse_existing(final: Path, overwrite: bool = False) -> None:
    """Make sure that a result may be put at `final`: to be asked before any work is done.

    overwrite : an empty folder, and one that holds nothing but files which a manifest of recon in it lists, may be
        replaced
    Raises ConfigError where something is there that may not, or where no folder can be.
    """
    if not _is_there(final):
        return
    if not overwrite:
        hint = "choose another place, or add --overwrite"
        raise ConfigError([Problem(None, "output-exists", f"{final} is there already", hint)])
    if Path.cwd().is_relative_to(os.path.realpath(final)):
        hint = "choose another place"
        raise ConfigError([Problem(None, "output-foreign", f"{final} is the folder that you are in", hint)])
    strange = final if not final.is_dir() else foreign_file(final)
    if strange is not None:
        text = f"{final} is no result of recon" if strange == final else f"{strange} was not written by recon"
        hint = "nothing is replaced: move it away, or choose another place"
        raise ConfigError([Problem(None, "output-foreign", text, hint)])


def _is_there(final: Path) -> bool:
    """Is anything at that place? Raises ConfigError where nothing can be."""
    try:
        os.lstat(final)
    except FileNotFoundError:
        return False
    except (OSError, ValueError) as error:
        told = isinstance(error, OSError) and error.errno
        reason = os.strerror(told).lower() if told else "its name holds a NUL"
        text = f"there cannot be a folder {shortened(str(final), 120)}: {reason}"
        raise ConfigError([Problem(None, "output-impossible", text, "choose another place")]) from error
    return True


def foreign_file(folder: Path) -> Path | None:
    """A file below the folder that none of recon's manifests in it lists; None where there is none."""
    known: set[Path] = set()
    for manifest in (folder / MANIFEST, *folder.rglob(EXPORT_MANIFEST)):
        known |= {manifest.parent / name for name in _listed(manifest)}
    others = (path for path in sorted(folder.rglob("*")) if not _is_folder(path) and path not in known)
    return next((path for path in others if not any(map(_LEFT_OVER.fullmatch, path.relative_to(folder).parts))), None)


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _listed(manifest: Path) -> list[str]:
    """Names of the files that a manifest lists, relative to its folder; empty where it is none of recon's."""
    try:
        content = json.loads(manifest.read_text(encoding="utf-8"))
        if MARK not in content:
            return []
        return [manifest.name, *(str(output["file"]) for output in content["outputs"])]
    except (OSError, ValueError, KeyError, TypeError):
        return []


@contextmanager
def staged_folder(final: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A new, empty folder that takes the place of `final` when the block ends without an error.

    On any error, KeyboardInterrupt included, the new folder is removed and what was at `final` stays. What may be
    replaced, `refuse_existing` says.
    Raises ConfigError as `refuse_existing`, StorageError for an OSError in the block.
    """
    refuse_existing(final, overwrite)
    place = Path(os.path.realpath(final))
    partial = _beside(place, "partial")
    missing = [folder for folder in place.parents if not folder.exists()]
    try:
        with storage_errors(final):
            partial.mkdir(parents=True)
            yield partial
            _sync_all(partial)
            refuse_existing(final, overwrite)
            _swap(partial, place)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        for folder in missing:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, StorageError):
            error.message = error.message.replace(str(partial), str(final))
        raise


@contextmanager
def staged_file(final: Path) -> Iterator[Path]:
    """A path to write to; the file takes the place of `final`, old or new, when the block ends without an error.

    On any error, KeyboardInterrupt included, it is removed and an old file stays.
    Raises StorageError for an OSError in the block.
    """
    place = Path(os.path.realpath(final))
    partial = _beside(place, "partial")
    with storage_errors(final):
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            _sync(partial)
            partial.replace(place)
        except BaseException:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            raise


@contextmanager
def storage_errors(target: Path) -> Iterator[None]:
    """Turn an OSError of the block, pyarrow's included, into a StorageError that names the target and the reason."""
    try:
        yield
    except OSError as error:
        reason = os.strerror(error.errno).lower() if error.errno else str(error)
        reason += f" ({error.filename})" if error.filename else ""
        raise StorageError(f"{target} could not be written: {reason}", _advice(error, target)) from error


def _advice(error: OSError, target: Path) -> str:
    if error.errno in _FULL:
        return f"make room ({_free_space(target)}) or choose a place on another disk"
    if error.errno in _FORBIDDEN:
        return "choose a place where you may write"
    if error.errno == errno.EFBIG:
        return "a file grew beyond what the disk or the limits of this process allow: choose a place on another disk"
    return ""


def _free_space(target: Path) -> str:
    existing = next((folder for folder in (target, *target.absolute().parents) if folder.exists()), Path())
    try:
        return f"{shutil.disk_usage(existing).free / 1e6:.0f} MB are free there"
    except OSError:
        return "how much is free there is not known"


def _beside(place: Path, what: str) -> Path:
    return place.with_name(f".{place.name[:100]}.{what}-{secrets.token_hex(4)}")


def _sync_all(folder: Path) -> None:
    """A folder and all below it, at once: a disk writes many together in the time of one."""
    with ThreadPoolExecutor() as pool:
        list(pool.map(_sync, [folder, *folder.rglob("*")]))


def _sync(path: Path) -> None:
    """Have the disk hold a file's bytes, or a folder's names, before a rename makes them count.

    A full disk may show only here. Whoever may read a file may have it written out, but on Windows, which asks for the
    right to write: a file that an exporter made read-only is left to the system there, and so is every folder.
    """
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    try:
        opened = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    except PermissionError:
        if sys.platform == "win32":
            return
        raise
    try:
        os.fsync(opened)
    except OSError as error:
        if path.is_file() or error.errno not in _NO_SYNC_OF_FOLDERS:
            raise
    finally:
        os.close(opened)


def _swap(partial: Path, place: Path) -> None:
    """Rename the new folder to its place. What was there is moved aside first: Windows replaces no folder."""
    if not place.exists():
        partial.rename(place)
        return
    aside = _beside(place, "replaced")
    try:
        place.rename(aside)
        partial.rename(place)
    except BaseException:
        if aside.exists() and not place.exists():
            aside.rename(place)
        raise
    shutil.rmtree(aside, ignore_errors=True)
