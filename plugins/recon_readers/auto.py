"""Asks every reader whether a file is its own and hands it to the one that is sure.

Parameters for the readers are given under their names; those of a reader that was not chosen are left alone, and
noted. Where no reader is sure of a file, the one that was given parameters for it is taken.
"""

from __future__ import annotations

import codecs
import json
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from recon import (
    ConfigError,
    ContractError,
    Metric,
    Params,
    PluginError,
    Reader,
    ReadFailed,
    Registry,
    Sniff,
    Streams,
    hookimpl,
    metrics,
)
from recon.errors import NothingUsable, UnknownFormat
from recon.parameters import bind
from recon.problems import Where
from recon.schema import STREAMS, unnumbered
from recon.stages import Delegation, Wanted
from recon.tables import append, conform
from recon.yaml_nodes import Node

HEAD_BYTES: Final = 65536
SURE: Final = 0.5
"""Confidence from which a reader is taken."""
LOOKED_AT: Final = 20
"""Files of a folder that is no log, for a message that names those that are."""
_CHECK: Final = "check that it is the right file; 'recon plugins' lists the readers that are installed"
_PACKED: Final = "unpack it, and name the log in it"
_PICKLE: Final = "recon never unpickles, for a pickle may run anything: save its arrays as CSV or Parquet"
_UTF16: Final = "save it as UTF-8; as it is, reader.csv alone reads it: 'recon inspect' proposes a mapping"
_IMAGE: Final = "name the log; a folder of images may stand behind it: recon run PIPELINE LOG IMAGES"
_NO_LOGS: Final = {
    b"PK\x03\x04": ("a zip archive", _PACKED),
    b"PK\x05\x06": ("an empty zip archive", "pack the log again"),
    b"\x1f\x8b": ("packed by gzip", _PACKED),
    b"BZh": ("packed by bzip2", _PACKED),
    b"\xfd7zXZ": ("packed by xz", _PACKED),
    b"7z\xbc\xaf": ("a 7z archive", _PACKED),
    b"\x28\xb5\x2f\xfd": ("packed by zstd", _PACKED),
    b"Rar!": ("a RAR archive", _PACKED),
    b"\xff\xfe": ("UTF-16 text", _UTF16),
    b"\xfe\xff": ("UTF-16 text", _UTF16),
    b"\x89PNG": ("a PNG image", _IMAGE),
    b"\xff\xd8\xff": ("a JPEG image", _IMAGE),
    b"\x93NUMPY": ("an array of NumPy", "name the folder of the data set that it is of"),
    b"\x80\x03": ("a pickle of Python", _PICKLE),
    b"\x80\x04": ("a pickle of Python", _PICKLE),
    b"%PDF": ("a PDF document", "name the log itself"),
    b"\xd0\xcf\x11\xe0": ("a document of Excel or Word", "save its table as CSV"),
}
"""By their first bytes: what people have beside their logs, and what to do."""


@dataclass(frozen=True)
class Opinion:
    """What one reader says of a file."""

    reader: Reader
    sniff: Sniff


def auto(*, path: Path, params: Delegation, registry: Registry, wanted: Wanted) -> Streams:
    """Read a file or folder by the reader that knows it.

    The metrics tell which reader was chosen, why, with which parameters, and what was not used. Raises ReadFailed
    where two readers are equally sure, UnknownFormat where none is sure and parameters do not name one, NothingUsable
    where the file holds nothing of use: then it tells what the other readers say of it.
    """
    opinions, broken = _ask(path, registry)
    chosen = _choose(path, opinions, broken, params.readers, registry)
    given = params.readers.get(chosen.reader.key, {})
    bound, problems = bind(chosen.reader.params, Node.of(given, Where(chosen.reader.key)), chosen.reader.key)
    if bound is None:
        raise ConfigError(problems)
    extra = {"wanted": wanted} if chosen.reader.selective else {}
    try:
        returned = chosen.reader.run(path=path, params=bound, **extra)
    except NothingUsable as error:
        others = [one for one in opinions if one is not chosen]
        raise NothingUsable(error.path, error.what, hint="\n  ".join([error.hint, *_said(others), *broken])) from error
    streams = _stamped(chosen.reader, returned, bound)
    unused = sorted(name for name in params.readers if name != chosen.reader.key)
    learnt = [
        Metric("reader", chosen.sniff.confidence, method=chosen.reader.key, note=chosen.sniff.reason),
        Metric("reader_distribution", method=chosen.reader.key, note=str(registry.source(chosen.reader.key))),
        Metric("reader_parameters", method=chosen.reader.key, note=json.dumps(bound.as_si(), sort_keys=True)),
        *(Metric("reader_not_used", note=f"{name} was given parameters and was not chosen") for name in unused),
    ]
    own = metrics(learnt)
    streams["metrics"] = append(own, streams["metrics"]) if "metrics" in streams else own
    return streams


def _stamped(reader: Reader, returned: Streams, params: Params) -> Streams:
    """What a reader returned, with the units, frames and quantities that it declares."""
    if reader.self_describing:
        return dict(returned)
    declared = reader.outputs({}, params)
    homes = {name: name if name in declared else unnumbered(name) for name in returned}
    undeclared = sorted(name for name, home in homes.items() if home not in declared)
    if undeclared:
        raise ContractError(reader.key, f"it returned the stream '{undeclared[0]}', which it does not declare")
    return {
        name: conform(table, declared[homes[name]], stream=name, step=reader.key) for name, table in returned.items()
    }


def _ask(path: Path, registry: Registry) -> tuple[list[Opinion], list[str]]:
    """Opinions of all readers, the surest first, and the readers that cannot be used."""
    head = b"" if path.is_dir() else _head(path)
    opinions, broken = [], []
    for key in registry.names(Reader.role):
        try:
            reader = registry.get(key)
            if isinstance(reader, Reader) and reader.sniff is not None:
                opinions.append(Opinion(reader, reader.sniff(path, head)))
        except PluginError as error:
            broken.append(f"{key}: {error.message}")
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a stranger's look at a stranger's file
            broken.append(f"{key}: {type(error).__name__}: {error}")
    return sorted(opinions, key=lambda opinion: -opinion.sniff.confidence), broken


def _head(path: Path) -> bytes:
    """The first bytes of a file. Raises ReadFailed where there are none to be had."""
    try:
        if not path.is_file():
            raise ReadFailed(path, "this is not a regular file", hint="copy the log into a file first")
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    if not head:
        raise ReadFailed(path, "the file is empty", hint="check that the log was copied completely")
    return head.removeprefix(codecs.BOM_UTF8) or head


def _choose(
    path: Path, opinions: list[Opinion], broken: list[str], given: Collection[str], registry: Registry
) -> Opinion:
    """The reader that is sure; where none is, the only one that was given parameters and does not rule the file out."""
    if not opinions or opinions[0].sniff.confidence < SURE:
        meant = [one for one in opinions if one.reader.key in given and one.sniff.confidence > 0]
        if len(meant) == 1:
            return replace(meant[0], sniff=replace(meant[0].sniff, reason="it was given parameters"))
        raise _unknown(path, opinions, broken, registry)
    sure = [one for one in opinions if one.sniff.confidence == opinions[0].sniff.confidence]
    if len(sure) > 1:
        names = " and ".join(opinion.reader.key for opinion in sure)
        hint = f"leave one out with '--no-plugin {sure[-1].reader.key}', or name one in a pipeline of your own"
        raise ReadFailed(path, f"{names} are equally sure of this file", hint=hint)
    return opinions[0]


def _unknown(path: Path, opinions: list[Opinion], broken: list[str], registry: Registry) -> ReadFailed:
    """The error where no reader is sure: what those say that have an idea of it, else what it is, or what all say."""
    if path.is_dir():
        return _folder(path, registry)
    head = _head(path)
    kind, advice = _kind(head)
    lines = _said([one for one in opinions if one.sniff.confidence > 0] or ([] if kind else opinions))
    what = f"no reader knows this file{', which is ' * bool(kind)}{kind}"
    return UnknownFormat(path, what, hint="\n  ".join([*lines, *broken, advice]))


def _kind(head: bytes) -> tuple[str, str]:
    """What a file is that is no log, "" where that is not known, and what to do."""
    from recon.evidence import is_seal  # slow import: only when used

    if is_seal(head):
        return "a sealed run", "'recon inspect' says what it holds; unpack it, and name the log in its folder inputs"
    return next((told for mark, told in _NO_LOGS.items() if head.startswith(mark)), ("", _CHECK))


def _folder(path: Path, registry: Registry) -> ReadFailed:
    """The error for a folder that is no reader's own: it names the logs in it."""
    inside = sorted(path.iterdir())
    what = "this is a folder" if inside else "this folder is empty"
    known = []
    for file in [one for one in inside if one.is_file() and one.stat().st_size][:LOOKED_AT]:
        opinions, _ = _ask(file, registry)
        if opinions and opinions[0].sniff.confidence >= SURE:
            known.append(f"{file.name} ({opinions[0].reader.key})")
    listed = f"the logs in it: {', '.join(known)}" if known else "or the folder of a result of recon"
    return ReadFailed(path, what, hint=f"name the log files in it, several only if they are of one drive; {listed}")


def _said(opinions: Iterable[Opinion]) -> list[str]:
    """What readers say of a file, equal reasons once."""
    said: dict[str, list[str]] = {}
    for opinion in opinions:
        said.setdefault(opinion.sniff.reason, []).append(opinion.reader.key)
    return [f"{', '.join(readers)}: {reason}" for reason, readers in said.items()]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader `auto`."""
    yield Reader(
        name="auto",
        summary="Whichever reader knows the file.",
        params=Delegation,
        run=auto,
        self_describing=True,
        selective=True,
        writes={name: schema.possible() for name, schema in STREAMS.items()},
    )
