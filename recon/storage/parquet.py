"""Streams as Parquet: one file for each, and `recording.json` with what concerns them together.

    streams/imu.parquet  streams/trajectory.parquet  ...  streams/recording.json

Doubles are byte-stream-split and times stored as differences, both without a dictionary, then all is compressed with
zstd and every page has a checksum. The Arrow schema with units, frames and the stream's own facts is kept in the file.
`recording.json` holds `streams`, the names in their order, and `meta`, the recording's meta.
A Parquet file of another program is taken as a stream if its name and its columns are canonical (recon.schema); it is
then understood to be in canonical units and frames.

References
    Apache Parquet format, "Encodings": BYTE_STREAM_SPLIT (9), DELTA_BINARY_PACKED (5); "Checksumming".
"""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recon.errors import ReadFailed
from recon.problems import did_you_mean
from recon.recording import Recording
from recon.schema import STREAM_NAME, STREAMS, Schema
from recon.storage.json_text import to_json
from recon.tables import build

MAGIC: Final = b"PAR1"
ABOUT: Final = "recording.json"

_PANDAS_INDEX: Final = re.compile(r"__index_level_\d+__")
"""Columns that pandas writes for row numbers."""
_LEVEL: Final = -1
"""Of zstd. Most bytes of a double are noise that no level makes smaller: by 1, the default, it takes a fifth longer."""


def write_folder(recording: Recording, folder: Path) -> None:
    """Write every stream, several at a time, and `recording.json` into an existing folder."""
    with ThreadPoolExecutor(pa.cpu_count()) as pool:  # Arrow encodes and compresses without Python's lock
        list(pool.map(lambda name: write_file(recording[name], folder / f"{name}.parquet"), recording))
    about = {"streams": list(recording), "meta": dict(recording.meta)}
    text = to_json(about, indent=2, sort_keys=True)
    (folder / ABOUT).write_text(text + "\n", encoding="utf-8", newline="\n")


def write_file(table: pa.Table, path: Path) -> None:
    """Write one stream. Equal tables give equal bytes, however they are cut into chunks."""
    from pyarrow.parquet import write_table

    encodings = {field.name: encoding for field in table.schema if (encoding := _encoding(field.type))}
    with pa.OSFile(os.fsencode(path), "wb") as file:
        write_table(
            table.combine_chunks(),
            file,
            compression="zstd",
            compression_level=_LEVEL,
            use_dictionary=[name for name in table.column_names if name not in encodings],
            column_encoding=encodings,
            write_page_checksum=True,
        )


def _encoding(kind: pa.DataType) -> str:
    if pa.types.is_floating(kind):
        return "BYTE_STREAM_SPLIT"
    return "DELTA_BINARY_PACKED" if pa.types.is_timestamp(kind) else ""


def read_folder(folder: Path) -> Recording:
    """Every stream of a folder, in the order of its `recording.json`; other Parquet files after those, by name.

    Raises ReadFailed where a stream that is listed is missing, or a file is no whole stream.
    """
    about = _about(folder / ABOUT)
    listed = about["streams"]
    others = sorted(path.stem for path in folder.glob("*.parquet") if path.stem not in listed)
    streams = {name: read_file(folder / f"{name}.parquet") for name in [*listed, *others]}
    return Recording(streams, about["meta"])


def _about(path: Path) -> Mapping[str, Any]:
    """`streams` and `meta` of `recording.json`, empty where there is no such file."""
    about: dict[str, Any] = {"streams": [], "meta": {}}
    if not path.exists():
        return about
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ReadFailed(path, "it is damaged or cannot be read") from error
    if not isinstance(content, dict):
        raise ReadFailed(path, "it is not what recon writes: an object is expected")
    about |= content
    names = about["streams"]
    if not isinstance(names, list) or not all(isinstance(n, str) and STREAM_NAME.fullmatch(n) for n in names):
        raise ReadFailed(path, "it is damaged: 'streams' is no list of streams")
    return about


def read_file(path: Path) -> pa.Table:
    """One stream. Raises ReadFailed."""
    from pyarrow.parquet import ParquetFile

    try:
        source = pa.OSFile(os.fsencode(path), "rb")
    except OSError as error:
        raise ReadFailed(path, "there is no such file, or it may not be read") from error
    with source:
        try:
            with ParquetFile(source, page_checksum_verification=True) as file:
                table = file.read()
            table.validate(full=True)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise ReadFailed(path, "the Parquet file is cut short or damaged", hint="copy or make it again") from error
    return table if b"recon.schema" in (table.schema.metadata or {}) else _adopted(table, path)


def _adopted(table: pa.Table, path: Path) -> pa.Table:
    """A plain table as the stream that its file is named after."""
    name = re.sub(r"_\d+$", "", path.stem)
    if name not in STREAMS:
        hint = did_you_mean(name, STREAMS) or f"streams are {', '.join(STREAMS)}"
        raise ReadFailed(path, f"it was not written by recon, and '{path.stem}' is the name of no stream", hint=hint)
    table = table.drop_columns([column for column in table.column_names if _PANDAS_INDEX.fullmatch(column)])
    schema = STREAMS[name]
    missing = [c.name for c in schema.columns if not c.optional and c.name not in table.column_names]
    unknown = [column for column in table.column_names if column not in schema]
    doubled = [column for column, count in Counter(table.column_names).items() if count > 1]
    if missing or unknown or doubled:
        faults = [f"it lacks {missing}"] * bool(missing) + [f"it has {unknown}, which are unknown"] * bool(unknown)
        faults += [f"it has {doubled} more than once"] * bool(doubled)
        hint = f"columns of '{name}' are {', '.join(schema.names)}"
        raise ReadFailed(path, f"it was not written by recon, and as '{name}' {' and '.join(faults)}", hint=hint)
    return build(schema, **{column: _cast(table[column], column, schema, path) for column in table.column_names})


def _cast(values: pa.ChunkedArray, name: str, schema: Schema, path: Path) -> pa.ChunkedArray:
    """Numbers that are none become null, as recon writes what is not known."""
    kind = schema[name].type
    what = f"column {name} is {values.type}, which cannot be taken as {kind}"
    if pa.types.is_timestamp(kind) and pa.types.is_integer(values.type):
        raise ReadFailed(path, what, hint="whole numbers do not tell what they count: write them as timestamps")
    try:
        found = values.cast(kind)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise ReadFailed(path, what, hint="write it as that") from error
    if pa.types.is_floating(kind):
        return pa.chunked_array([pa.array(found.to_numpy(), type=kind, from_pandas=True)])
    return found
