"""Recordings on disk: as Parquet files or as one MCAP file, the same numbers in both.

A folder holds one or the other:
    DIR/streams/<stream>.parquet       store="parquet", see recon.storage.parquet
    DIR/streams.mcap                   store="mcap", see recon.storage.mcap

Written and read with
    write_recording(recording, Path("drive1"), store="mcap")
    read_recording(Path("drive1"))
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pyarrow as pa

from recon.errors import ConfigError, ContractError, ReadFailed, StorageError
from recon.problems import Problem, one_of
from recon.recording import Recording
from recon.schema import APPENDED, SCHEMA_NUMBER, STREAM_NAME, STREAMS, TIME_TYPE, by_step, unnumbered
from recon.storage import mcap, parquet
from recon.storage.atomic import refuse_existing, staged_file, staged_folder
from recon.tables import build, conform, schema_of, with_meta

__all__ = [
    "STORES",
    "read_recording",
    "refuse_existing",
    "salvage_recording",
    "staged_file",
    "staged_folder",
    "store_of",
    "write_recording",
]

STORES: Final = ("parquet", "mcap")

_FOLDER: Final = "streams"
_FILE: Final = "streams.mcap"
_AGAIN: Final = "copy or make it again"


def write_recording(recording: Recording, folder: Path, store: str = "parquet") -> list[Path]:
    """Write all streams and the meta into a folder; the paths of the files, sorted.

    Every stream is stamped with the schema's number; of its schema metadata only recon's own are kept. Equal
    recordings give equal bytes. What is being written has a temporary name until it is complete.
    Raises ConfigError for an unknown store or where a recording is there already, StorageError where it cannot be
    written.
    """
    if store not in STORES:
        raise ConfigError([Problem(None, "unknown-store", f"there is no store '{store}'", f"use {one_of(STORES)}")])
    for name in recording:
        if not STREAM_NAME.fullmatch(name):
            raise StorageError(f"no stream can be kept as '{name}'", "use lower-case letters, digits and _")
    for place in (folder / _FOLDER, folder / _FILE):
        refuse_existing(place)
    stamped = Recording({name: with_meta(table) for name, table in recording.items()}, recording.meta)
    if store == "parquet":
        with staged_folder(folder / _FOLDER) as partial_folder:
            parquet.write_folder(stamped, partial_folder)
        return sorted((folder / _FOLDER).iterdir())
    with staged_file(folder / _FILE) as partial_file:
        mcap.write_file(stamped, partial_file)
    return [folder / _FILE]


def read_recording(path: Path) -> Recording:
    """The recording in a run's folder, a folder of Parquet files, a Parquet file or an MCAP file of recon.

    Raises ReadFailed where there is none, it is damaged, or a newer recon wrote it.
    """
    store = _store_at(path)
    if store == "mcap":
        return _checked(mcap.read_file(_mcap_at(path)), path)
    if path.is_dir():
        return _checked(parquet.read_folder(path / _FOLDER if (path / _FOLDER).is_dir() else path), path)
    return _checked(Recording({path.stem: parquet.read_file(path)}), path)


def salvage_recording(path: Path) -> tuple[Recording, str]:
    """As `read_recording`, but of an MCAP file that is cut short or damaged all that is whole, and what is lost.

    returns : the recording; what is lost as a sentence, "" where nothing is
    """
    if _store_at(path) != "mcap":
        return read_recording(path), ""
    recording, loss = mcap.salvage_file(_mcap_at(path))
    return _checked(recording, path), loss


def _store_at(path: Path) -> str:
    """How a recording is kept there. Raises ReadFailed where none is."""
    if not path.exists():
        raise ReadFailed(path, "there is no such file or folder")
    store = store_of(path)
    if not store:
        raise ReadFailed(path, "it is no result of recon, Parquet file or MCAP file")
    return store


def _mcap_at(path: Path) -> Path:
    return path / _FILE if path.is_dir() else path


def _checked(recording: Recording, path: Path) -> Recording:
    """The recording, where all of it can be one. Raises ReadFailed."""
    for name, table in recording.items():
        _refuse_newer(table, name, path)
        _refuse_damaged(table, name, path)
    if not _is_meta(recording.meta):
        raise ReadFailed(path, "what it says of its sources is damaged", hint=_AGAIN)
    return recording


def _is_meta(meta: object) -> bool:
    """Is it the meta of a recording, as far as others rely on it: an object, whose `sources` are names?"""
    sources = meta.get("sources", []) if isinstance(meta, Mapping) else None
    return isinstance(sources, list) and all(isinstance(name, str) for name in sources)


def store_of(path: Path) -> str:
    """How a file or folder keeps a recording: one of STORES, "" where it holds none as far as can be seen."""
    if path.is_dir():
        if (path / _FOLDER).is_dir() or (any(path.glob("*.parquet")) and not (path / _FILE).exists()):
            return "parquet"
        return "mcap" if (path / _FILE).is_file() else ""
    try:
        with path.open("rb") as file:
            head = file.read(len(mcap.MAGIC))
    except OSError as error:
        raise ReadFailed(path, "the file cannot be read") from error
    if head == mcap.MAGIC:
        return "mcap"
    return "parquet" if head.startswith(parquet.MAGIC) else ""


def _refuse_newer(table: pa.Table, name: str, path: Path) -> None:
    number = (table.schema.metadata or {}).get(b"recon.schema", b"1").decode(errors="replace")
    if not number.isdecimal() or int(number) > SCHEMA_NUMBER:
        text = f"stream '{name}' has the schema number {number}; this recon reads up to {SCHEMA_NUMBER}"
        raise ReadFailed(path, text, hint="install a newer recon")


def _refuse_damaged(table: pa.Table, name: str, path: Path) -> None:
    """Raises ReadFailed where a table cannot be a stream: checksums do not cover all that files say of columns."""
    step = "reading"
    try:
        _refuse_other_times(table, name, path)
        if name in APPENDED:
            build(by_step(name), **{column: table[column] for column in table.column_names})
        conform(table, schema_of(table), stream=name, step=step)
    except ContractError as error:
        raise ReadFailed(path, error.message.removeprefix(f"step {step}: "), hint=_AGAIN) from error
    except (pa.ArrowException, ValueError, TypeError, LookupError, RecursionError) as error:
        raise ReadFailed(path, f"what it says of stream '{name}' is damaged", hint=_AGAIN) from error


def _refuse_other_times(table: pa.Table, name: str, path: Path) -> None:
    kind = table.schema.field("time").type if "time" in table.column_names else None
    if (kind is None and "time" in STREAMS.get(unnumbered(name), ())) or kind not in (None, TIME_TYPE):
        what = "has no times" if kind is None else f"has times of type {kind}, where recon writes {TIME_TYPE}"
        raise ReadFailed(path, f"stream '{name}' {what}", hint=_AGAIN)
