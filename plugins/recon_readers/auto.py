"""Asks every reader whether a file is its own and hands it to the one that is sure.

Parameters for the readers are given under their names; those of a reader that was not chosen are left alone, and
noted.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
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
from recon.parameters import bind
from recon.problems import Where
from recon.schema import STREAMS
from recon.stages import Delegation
from recon.tables import append, conform
from recon.yaml_nodes import Node

HEAD_BYTES: Final = 65536
SURE: Final = 0.5


@dataclass(frozen=True)
class Opinion:
    """What one reader says of a file."""

    reader: Reader
    sniff: Sniff


def auto(*, path: Path, params: Delegation, registry: Registry) -> Streams:
    """Read a file or folder by the reader that knows it.

    The metrics tell which reader was chosen, why, with which parameters, and what was not used. Raises ReadFailed
    where no reader is sure, or two are equally so.
    """
    opinions, broken = _ask(path, registry)
    chosen = _choose(path, opinions, broken)
    given = params.readers.get(chosen.reader.key, {})
    bound, problems = bind(chosen.reader.params, Node.of(given, Where(chosen.reader.key)), chosen.reader.key)
    if bound is None:
        raise ConfigError(problems)
    streams = _stamped(chosen.reader, chosen.reader.run(path=path, params=bound), bound)
    unused = sorted(name for name in params.readers if name != chosen.reader.key)
    learnt = [
        Metric("reader", chosen.sniff.confidence, method=chosen.reader.key, note=chosen.sniff.reason),
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
    planned = reader.outputs({}, params)
    undeclared = sorted(set(returned) - set(planned))
    if undeclared:
        raise ContractError(reader.key, f"it returned the stream '{undeclared[0]}', which it does not declare")
    return {name: conform(table, planned[name], stream=name, step=reader.key) for name, table in returned.items()}


def _ask(path: Path, registry: Registry) -> tuple[list[Opinion], list[str]]:
    """Opinions of all readers, the surest first, and the readers that cannot be used."""
    try:
        head = b"" if path.is_dir() else _head(path)
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror or error}") from error
    opinions, broken = [], []
    for key in registry.names(Reader.role):
        try:
            reader = registry.get(key)
            if isinstance(reader, Reader) and reader.sniff is not None:
                opinions.append(Opinion(reader, reader.sniff(path, head)))
        except PluginError as error:
            broken.append(f"{key}: {error.message}")
        except Exception as error:  # a stranger's look at a stranger's file
            broken.append(f"{key}: {type(error).__name__}: {error}")
    return sorted(opinions, key=lambda opinion: -opinion.sniff.confidence), broken


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def _choose(path: Path, opinions: list[Opinion], broken: list[str]) -> Opinion:
    if not opinions or opinions[0].sniff.confidence < SURE:
        said = [f"{opinion.reader.key}: {opinion.sniff.reason}" for opinion in opinions]
        looked = "\n  ".join(said + broken) or "no reader is installed"
        raise ReadFailed(path, "no reader knows this file", hint=f"{looked}\n  name one in place of reader.auto")
    sure = [one for one in opinions if one.sniff.confidence == opinions[0].sniff.confidence]
    if len(sure) > 1:
        names = " and ".join(opinion.reader.key for opinion in sure)
        raise ReadFailed(path, f"{names} are equally sure of this file", hint="name one in place of reader.auto")
    return opinions[0]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader `auto`."""
    yield Reader(
        name="auto",
        summary="Whichever reader knows the file.",
        params=Delegation,
        run=auto,
        self_describing=True,
        writes={name: schema.possible() for name, schema in STREAMS.items()},
    )
