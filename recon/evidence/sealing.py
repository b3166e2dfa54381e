"""A finished run to a sealed file; it is run again from that file before it counts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from recon import api
from recon import manifest as manifests
from recon.errors import ConfigError, DataError, Difference
from recon.evidence import archive, contents
from recon.evidence import exports as exported
from recon.evidence.archive import Entry
from recon.evidence.replay import sources_of
from recon.evidence.sameness import SAME_BYTES
from recon.evidence.verification import verify
from recon.problems import Problem
from recon.registry import Registry
from recon.storage import staged_file
from recon.storage.json_text import to_json

_AGAIN: Final = "run the pipeline again, then seal that result"


@dataclass(frozen=True)
class Sealed:
    """A sealed file: its SHA-256, size in bytes, and the names of what it holds."""

    file: Path
    sha256: str
    size: int
    names: tuple[str, ...]


def seal(
    run: str | Path,
    file: str | Path,
    inputs: Sequence[Path] = (),
    *,
    exports: bool = False,
    registry: Registry | None = None,
) -> Sealed:
    """Seal a finished run into a new file.

    run : its folder; inputs : the log, where it is no longer where the run read it
    exports : take the files of the run's exporters along

    Raises ConfigError where the file is there already; DataError where the log or a result is not the one that the
    manifest tells of; Difference where the run does not come out again, byte by byte.
    """
    finished, target = api.open(run), Path(file)
    if target.exists():
        text = f"{target} is there already, and a seal is never replaced"
        raise ConfigError([Problem(None, "output-exists", text, "choose another name")])
    registry = registry or Registry.installed()
    entries = list(_entries(finished, inputs, registry, exports=exports))
    entries += [contents.sums(entries)]
    for entry in entries:
        fault = archive.name_fault(entry.name)
        if fault:
            raise DataError(f"{entry.name!r} cannot be sealed: {fault}", "rename it, and run the pipeline again")
    with staged_file(target) as partial:
        archive.write(entries, partial)
        _refuse_unrepeatable(partial, target, registry)
    with target.open("rb") as source:
        return Sealed(target, archive.digest(source), target.stat().st_size, tuple(sorted(e.name for e in entries)))


def _refuse_unrepeatable(partial: Path, target: Path, registry: Registry) -> None:
    """Raises Difference where what would be sealed does not come out again."""
    try:
        found = verify(partial, registry=registry)
    except Difference as error:
        error.message = error.message.replace(partial.name, target.name)
        error.message = f"the run is not sealed, since it does not come out again: {error.message}"
        error.hint = "run the pipeline again, and its exports, then seal that result"
        raise
    if found.agreement != SAME_BYTES:
        text = "the run is not sealed: run again, it gives the same numbers, but not the same bytes"
        raise Difference(text, f"packages have changed since; {_AGAIN}")


def _entries(finished: api.Run, inputs: Sequence[Path], registry: Registry, *, exports: bool) -> Iterator[Entry]:
    """All files of the seal but the list of hashes."""
    manifest, folder = finished.manifest, finished.folder
    assert folder is not None
    yield contents.readme()
    yield from _sources(manifest, inputs)
    yield Entry.of_text(contents.MANIFEST, to_json(contents.anonymous(manifest), indent=1) + "\n")
    yield Entry.of_text(contents.PIPELINE, manifest["pipeline"]["text"])
    yield from _results(manifest, folder)
    extra = list(_exports(folder)) if exports else []
    yield from extra
    sources, packages = exported.sources_of(exported.told_by(extra), registry)
    versions = contents.versions_of([*sources_of(manifest, registry), *sources], packages)
    yield Entry.of_text(contents.VERSIONS, to_json(versions, indent=1) + "\n")


def _sources(manifest: Mapping[str, Any], inputs: Sequence[Path]) -> Iterator[Entry]:
    """The log, file by file. Raises DataError where it is not the one that was read."""
    told = manifest["inputs"]
    paths = [Path(path) for path in inputs or manifest["environment"].get("inputs", ())]
    if not told and manifest["plan"] and not manifest["plan"][0]["use"].startswith("simulator."):
        raise DataError("this run was made from tables in memory: there is no log to seal", "run it from a file")
    if len(paths) != len(told):
        raise DataError(f"the run read {len(told)} inputs, and {len(paths)} are named", "name each, in their order")
    for number, (entry, path) in enumerate(zip(told, paths, strict=True), 1):
        if not path.exists():
            raise DataError(f"the log {path} is no longer there", "name it with --input")
        if manifests.describe_input(path) | {"name": entry["name"]} != entry or not entry["name"]:
            raise DataError(f"{path} is not what the run read as {entry['name']!r}: its bytes are others", _AGAIN)
        for name, part in _files(entry, path):
            yield Entry.of_file(f"{contents.INPUTS}/{number}/{name}", part)


def _files(entry: Mapping[str, Any], path: Path) -> Iterator[tuple[str, Path]]:
    """Name below the input's number, and place, of each file of an input."""
    if "files" not in entry:
        yield entry["name"], path
    for part in entry.get("files", ()):
        yield f"{entry['name']}/{part['name']}", path / part["name"]


def _results(manifest: Mapping[str, Any], folder: Path) -> Iterator[Entry]:
    for output in manifest["outputs"]:
        path = folder / output["file"]
        if not path.is_file() or manifests.digest(path) != output["sha256"]:
            raise DataError(f"{path} is not the file that the run left there", _AGAIN)
        yield Entry.of_file(f"{contents.RESULTS}/{output['file']}", path)


def _exports(folder: Path) -> Iterator[Entry]:
    below = folder / contents.EXPORTS
    for path in sorted(below.rglob("*")):
        if path.is_file():
            yield Entry.of_file(f"{contents.EXPORTS}/{path.relative_to(below).as_posix()}", path)
