"""A sealed file, checked: every byte as it was, every number as it comes out again."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, Final

from recon import api
from recon.errors import ConfigError, Difference, PluginError, ReadFailed, ReconError, StorageError
from recon.evidence import archive, contents, replay
from recon.evidence import exports as exported
from recon.evidence.archive import Entry
from recon.evidence.sameness import SAME_BYTES, SAME_NUMBERS
from recon.problems import Problem
from recon.registry import Registry
from recon.storage.atomic import storage_errors

_WHOLE: Final = "every byte of the file is as it was sealed"
_ALIKE: Final = "code, packages and arithmetic are those of the seal, so it was changed after it was run"
_SLIGHTLY: Final = f"{_ALIKE}, or another build of the numerical libraries rounds otherwise here"
_SINGLE: Final = (contents.README, contents.SUMS, contents.MANIFEST, contents.PIPELINE, contents.VERSIONS)
_FOLDERS: Final = (contents.INPUTS, contents.RESULTS, contents.EXPORTS)
_SHA256: Final = re.compile(r"[0-9a-fA-F]{64}")


@dataclass(frozen=True)
class Verified:
    """What was found: the file's SHA-256, how many files it holds, its inputs, how its results came out again.

    agreement : SAME_BYTES or SAME_NUMBERS, that is within 1e-9
    arithmetic : what computed it again; notes : versions that are others here
    exports : of files for people, by their folder, SAME_BYTES where they were made again, else why that is not known
    """

    file: str
    sha256: str
    files: int
    inputs: tuple[str, ...]
    agreement: str
    arithmetic: str
    exports: Mapping[str, str]
    notes: tuple[str, ...]

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


def verify(file: str | Path, *, sha256: str | None = None, registry: Registry | None = None) -> Verified:
    """Check a sealed file and run it again.

    sha256 : of the file, as it was noted when it was sealed

    Raises Difference with the first difference, ReadFailed for what is no seal, PluginNotFound where a stage is not
    installed here, StorageError where the temporary folder has no room for it.
    """
    path, registry = Path(file), registry or Registry.installed()
    whole = _digest(path)
    if sha256 is not None:
        _refuse_other(path, whole, sha256)
    with archive.opened(path) as entries, TemporaryDirectory(prefix="recon-verify-") as scratch:
        check_bytes(path, entries)
        sealed, inputs = _unpacked(path, entries, Path(scratch))
        before = _json_of(path, entries, contents.VERSIONS)
        sources, packages = exported.sources_of(exported.told_by(entries), registry)
        here = contents.versions_of([*replay.sources_of(sealed.manifest, registry), *sources], packages)
        if contents.same_recon(before, here):
            _refuse_other_page(entries)
        versions = contents.changed_versions(before, here)
        same, again, notes = _replayed(sealed, inputs, Path(scratch) / "again", registry, versions)
        return Verified(
            file=path.name,
            sha256=whole,
            files=len(entries),
            inputs=tuple(entry["name"] for entry in sealed.manifest["inputs"]),
            agreement=SAME_BYTES if same else SAME_NUMBERS,
            arithmetic=str(replay.arithmetic_of(again.manifest)),
            exports=exported.made_again(sealed, entries, Path(scratch) / "exports", registry, notes),
            notes=notes,
        )


@contextmanager
def unsealed(file: Path) -> Iterator[tuple[api.Run, list[Path]]]:
    """The run in a sealed file and its inputs, in files that are gone behind the block; nothing is run again.

    Raises as `verify`.
    """
    with archive.opened(file) as entries, TemporaryDirectory(prefix="recon-unseal-") as scratch:
        check_bytes(file, entries)
        yield _unpacked(file, entries, Path(scratch))


def _digest(path: Path) -> str:
    try:
        with path.open("rb") as source:
            return archive.digest(source)
    except OSError as error:
        raise archive.unreadable(path, error) from error


def _refuse_other(path: Path, found: str, noted: str) -> None:
    if not _SHA256.fullmatch(noted.strip()):
        problem = Problem(None, "bad-option", f"'{noted}' is no SHA-256", "it has 64 digits and letters a to f")
        raise ConfigError([problem])
    if found != noted.strip().lower():
        raise Difference(f"{path.name} is not the file that was noted: its SHA-256 is {found}")


def check_bytes(path: Path, entries: Sequence[Entry]) -> None:
    """Raises Difference at the first file, or byte between them, that is not as it was sealed."""
    names = [entry.name for entry in entries]
    missing = [name for name in _SINGLE if name not in names]
    if missing:
        raise Difference(f"{path.name} holds no {missing[0]}: it is no whole seal of recon")
    strange = [n for n in names if n not in _SINGLE and n.partition("/")[0] not in _FOLDERS]
    if strange:
        raise Difference(f"{path.name}, entry {strange[0]!r}: a seal has no such file")
    listed = _sums_of(path, entries)
    for entry in entries:
        if entry.name == contents.SUMS:
            continue
        if entry.name not in listed:
            raise Difference(f"{entry.name} was added: {contents.SUMS} does not list it")
        if _bytes_of(entry, archive.digest) != listed[entry.name]:
            raise Difference(f"{entry.name} was changed: its SHA-256 is not the one in {contents.SUMS}")
    gone = sorted(set(listed) - set(names))
    if gone:
        raise Difference(f"{gone[0]} is missing: {contents.SUMS} lists it")
    offset = archive.strange_byte(path, entries)
    if offset is not None:
        text = f"{path.name}: byte {offset} is not as recon writes it, though all files in it are as listed"
        raise Difference(text, "it was packed anew, or something was hidden in the archive")


def _bytes_of(entry: Entry, use: Callable[[IO[bytes]], Any]) -> Any:
    """What a function makes of an entry's bytes. Raises Difference where the archive's own checksum is not theirs."""
    try:
        with entry.open() as source:
            return use(source)
    except MemoryError:  # says nothing of the file
        raise
    except Exception as error:  # whatever zipfile raises for a header that is damaged: BadZipFile, EOFError, struct
        raise Difference(f"{entry.name} was changed, or its header in the archive: {error}") from error


def _sums_of(path: Path, entries: Sequence[Entry]) -> dict[str, str]:
    """Hash by name, as SHA256SUMS lists them."""
    text = _bytes_of(next(entry for entry in entries if entry.name == contents.SUMS), lambda source: source.read())
    found = {}
    for line in text.decode(errors="replace").splitlines():
        digest, _, name = line.partition("  ")
        found[name] = digest
    lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(found.items()))
    if lines.encode() != text:
        raise Difference(f"{path.name}: {contents.SUMS} was changed: it is not in the form that recon writes")
    return found


def _json_of(path: Path, entries: Sequence[Entry], name: str) -> Mapping[str, Any]:
    data = _bytes_of(next(entry for entry in entries if entry.name == name), lambda source: source.read())
    try:
        found = json.loads(data)
        number = found[contents.MARK]
    except (ValueError, RecursionError, TypeError, KeyError) as error:
        raise Difference(f"{path.name}: {name} is not what recon writes") from error
    if not isinstance(number, int) or number > contents.NUMBER:
        raise ReadFailed(path, f"it was sealed by a newer recon ({found.get('recon')})", hint="update recon")
    return dict(found)


def _unpacked(path: Path, entries: Sequence[Entry], scratch: Path) -> tuple[api.Run, list[Path]]:
    """The sealed run and its inputs in files. Raises Difference where manifest and contents contradict each other."""
    run = scratch / "sealed"
    for entry in entries:
        top, _, rest = entry.name.partition("/")
        if top == contents.INPUTS:
            _unpack(entry, scratch / contents.INPUTS, rest)
        elif top in (contents.RESULTS, contents.MANIFEST):
            _unpack(entry, run, rest or top)
    try:
        sealed = api.open(run)
    except ReconError as error:
        message = error.message.replace(str(run), path.name)
        raise Difference(f"{path.name}: its manifest or its results are no run of recon: {message}") from error
    manifest, digests = sealed.manifest, {entry.name: entry.sha256() for entry in entries}
    told = dict(_told(manifest))
    kept = {name: d for name, d in digests.items() if name.partition("/")[0] in (contents.INPUTS, contents.RESULTS)}
    for name in sorted({*told, *kept}):
        if told.get(name) != kept.get(name):
            raise Difference(f"{name} is not the file that manifest.json tells of")
    text = next(entry for entry in entries if entry.name == contents.PIPELINE)
    if _bytes_of(text, lambda source: source.read()) != manifest["pipeline"].get("text", "").encode():
        raise Difference("pipeline.yaml is not the pipeline that manifest.json tells of")
    return sealed, [scratch / contents.INPUTS / str(n) / e["name"] for n, e in enumerate(manifest["inputs"], 1)]


def _refuse_other_page(entries: Sequence[Entry]) -> None:
    """Raises Difference where the page that says how to check the seal is not recon's."""
    page = next(entry for entry in entries if entry.name == contents.README)
    if page.sha256() != contents.readme().sha256():
        raise Difference(f"{contents.README} is not the page that recon writes")


def _told(manifest: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name in the archive and hash of each input and output, as the manifest tells them."""
    found = []
    for number, entry in enumerate(manifest["inputs"], 1):
        base = f"{contents.INPUTS}/{number}/{entry.get('name')}"
        parts = entry.get("files", ())
        found += [(f"{base}/{part.get('name')}", str(part.get("sha256"))) for part in parts]
        if "files" not in entry:
            found.append((base, str(entry.get("sha256"))))
    outputs = [(f"{contents.RESULTS}/{out.get('file')}", str(out.get("sha256"))) for out in manifest["outputs"]]
    return found + outputs


def _unpack(entry: Entry, folder: Path, name: str) -> None:
    """Write an entry below a folder. Raises Difference for a name that leads out of it."""
    target = (folder / name).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise Difference(f"{entry.name}: its name leads out of the archive")
    with storage_errors(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        with entry.open() as source, target.open("wb") as file:
            shutil.copyfileobj(source, file)


def _replayed(
    sealed: api.Run, inputs: Sequence[Path], folder: Path, registry: Registry, versions: Sequence[str]
) -> tuple[bool, api.Run, tuple[str, ...]]:
    """Does the run give the same bytes again? That run, and what is another one here: `versions` and more.

    Raises Difference where it does not even give the same numbers.
    """
    notes = list(versions)
    try:
        again = replay.run_again(sealed.manifest, inputs, folder, registry)
        notes += _other_arithmetic(sealed.manifest, again.manifest)
        return replay.compare(sealed, again), again, tuple(notes)
    except Difference as error:
        alike = _SLIGHTLY if replay.only_rounded(error.streams) else _ALIKE
        error.hint = f"{_WHOLE}; {_since(notes) or alike}"
        raise
    except (PluginError, StorageError):
        raise
    except ReconError as error:
        if isinstance(error.__cause__, MemoryError):
            raise
        text = f"run again, it ends with an error: {error.message}"
        raise Difference(text, f"{_WHOLE}; {_since(notes) or _ALIKE}") from error


def _other_arithmetic(sealed: Mapping[str, Any], again: Mapping[str, Any]) -> list[str]:
    """A sentence where this processor, or the libraries here, cannot compute as the manifest of a run tells."""
    told, here = replay.arithmetic_of(sealed), replay.arithmetic_of(again)
    if told in (None, here):
        return []
    return [f"it was computed by {told}, which cannot be had here, and again by {here}, which rounds otherwise"]


def _since(notes: Sequence[str]) -> str:
    return f"perhaps since {'; '.join(notes)}" if notes else ""
