"""Streams in one MCAP file, bit for bit the tables that were written.

Layout (header profile "recon"):
    metadata record "recon.recording"  {"meta": the recording's meta as JSON, "rows": rows of each stream as JSON}
    one channel for each stream        topic: the stream's name; message encoding "arrow-ipc-stream"
    its schema record                  encoding "arrow-ipc-schema": the Arrow schema as an encapsulated IPC message
    its messages                       up to BATCH_ROWS rows each: an Arrow IPC stream (schema, one record batch, end)

A message is complete in itself: `pyarrow.ipc.open_stream(message.data).read_all()` gives its rows. The log time is that
of the first row in ns since 1970, 0 where it has none or lies before 1970; the sequence number counts the messages of a
channel. Every stream has at least one message, an empty one where it has no rows.
Each message is a chunk of its own, compressed with zstd. Chunks and the data section as a whole have checksums, which
are verified in reading. Of a file that is cut short or damaged the chunks that are whole can be salvaged, and the rest
be counted.
Channels of other encodings are for viewers and are passed over.

References
    MCAP specification, version 0 (mcap.dev/spec).
    Apache Arrow columnar format 1.5, "IPC Streaming Format".
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np
import pyarrow as pa

from recon import __version__
from recon.errors import ReadFailed
from recon.recording import Recording
from recon.storage.json_text import to_json

if TYPE_CHECKING:
    from mcap.records import McapRecord

MAGIC: Final = b"\x89MCAP0\r\n"
PROFILE: Final = "recon"
MESSAGE_ENCODING: Final = "arrow-ipc-stream"
SCHEMA_ENCODING: Final = "arrow-ipc-schema"
RECORDING: Final = "recon.recording"
BATCH_ROWS: Final = 16_384

_DAMAGED: Final = "the MCAP file is cut short or damaged"
_AGAIN: Final = "copy or make it again"
_HEADER_START: Final = MAGIC + b"\x01"
_PROFILE_AT: Final = len(_HEADER_START) + 8


def is_own(head: bytes) -> bool:
    """Do a file's first bytes say that it is an MCAP file of recon? The header record is the first of every file."""
    profile = len(PROFILE).to_bytes(4, "little") + PROFILE.encode()
    return head.startswith(_HEADER_START) and head[_PROFILE_AT:].startswith(profile)


def write_file(recording: Recording, path: Path) -> None:
    """Write all streams. Equal recordings give equal bytes, however their tables are cut into chunks."""
    rows = to_json({name: table.num_rows for name, table in recording.items()})
    file = Appending(path, {"meta": to_json(dict(recording.meta), sort_keys=True), "rows": rows})
    try:
        for name, table in recording.items():
            file.append(name, table)
        file.finish()
    finally:
        file.close()


class Appending:
    """A file that grows. What was appended is with the operating system, and whole, even if `finish` is never reached.

    about : the metadata record; by default that of a recording whose rows are not known yet
    """

    def __init__(self, path: Path, about: Mapping[str, str] | None = None) -> None:
        from mcap.writer import Writer

        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=0, enable_data_crcs=True)
        self._writer.start(profile=PROFILE, library=f"recon {__version__}")
        self._writer.add_metadata(RECORDING, dict(about or {"meta": "{}"}))
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def append(self, name: str, table: pa.Table) -> None:
        """Rows of a stream, behind those that are there, with the same columns."""
        table = _canonical(table)
        if name not in self._channels:
            schema = self._writer.register_schema(name, SCHEMA_ENCODING, table.schema.serialize().to_pybytes())
            self._channels[name] = self._writer.register_channel(name, MESSAGE_ENCODING, schema)
        for start in range(0, max(table.num_rows, 1), BATCH_ROWS):
            rows = table.slice(start, BATCH_ROWS)
            log_time, number = _log_time(rows), self._counts.get(name, 0)
            sink = pa.BufferOutputStream()
            with pa.ipc.new_stream(sink, table.schema) as stream:
                stream.write_table(rows)
            self._writer.add_message(
                self._channels[name], log_time, sink.getvalue().to_pybytes(), publish_time=log_time, sequence=number
            )
            self._counts[name] = number + 1
        self._file.flush()

    def finish(self) -> None:
        """Write the summary at the end."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Close the file, finished or not."""
        self._file.close()


def _log_time(rows: pa.Table) -> int:
    first = rows["time"][0].value if "time" in rows.column_names and rows.num_rows else None
    return max(first or 0, 0)


def _canonical(table: pa.Table) -> pa.Table:
    """The table in one chunk, with zeros behind its nulls: what stands there is otherwise left to chance."""
    table = table.combine_chunks()
    every_row = pa.array(np.arange(table.num_rows))
    arrays = [values.take(every_row) if values.null_count else values for values in table.columns]
    return pa.Table.from_arrays(arrays, schema=table.schema)


def read_file(path: Path) -> Recording:
    """All streams and the meta. Raises ReadFailed for a damaged file, and for one of another program."""
    recording, loss = salvage_file(path)
    if loss:
        raise ReadFailed(path, _DAMAGED, hint="copy or make it again, or take what reader.mcap salvages")
    return recording


def salvage_file(path: Path) -> tuple[Recording, str]:
    """All that is whole in a file, and what is lost, as a sentence: "" where nothing is.

    Raises ReadFailed where no stream has anything whole, and for a file of another program.
    """
    try:
        with Clipped(path.open("rb", buffering=0)) as file:
            head = file.read(_PROFILE_AT + 4 + len(PROFILE))
            if head.startswith(_HEADER_START) and not is_own(head):
                raise ReadFailed(path, f"the MCAP file was not written by recon; {_contents(file)}")
            file.seek(0)
            return _read(file, path)
    except OSError as error:
        raise ReadFailed(path, "there is no such file, or it may not be read") from error


class Clipped(io.BufferedReader):
    """A file whose reads ask for no more than is left of it: mcap asks for as much as damaged bytes tell."""

    def __init__(self, raw: io.FileIO) -> None:
        super().__init__(raw)
        self._size = os.fstat(raw.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """As much as is asked for, or left."""
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


def whole_records(file: BinaryIO, size: int) -> Iterator[McapRecord | Exception]:
    """Every record of an MCAP file that is whole, those in chunks included, and errors in the place of what is not.

    A chunk whose checksum is wrong is one error, and is passed over; after any other the file cannot be followed.
    size : of the file in bytes, which no record exceeds
    """
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    records = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=size).records
    try:
        for record in records:
            if not isinstance(record, Chunk):
                yield record
                continue
            try:
                inside = breakup_chunk(record, validate_crc=True)
            except Exception as error:  # as below
                yield error
            else:
                yield from inside
    except Exception as error:  # damaged bytes make mcap, zstandard and struct raise errors of many kinds
        yield error


def _read(file: BinaryIO, path: Path) -> tuple[Recording, str]:
    """The recording of what is whole, and what is lost. Channels are told in their first chunk and again at the end."""
    from mcap.records import Channel, Message, Metadata

    names: dict[int, str] = {}
    parts: dict[int, list[bytes]] = {}
    about: tuple[Any, dict[str, int] | None] | None = {}, None
    damaged = False
    for record in whole_records(file, path.stat().st_size):
        if isinstance(record, Message):
            parts.setdefault(record.channel_id, []).append(record.data)
        elif isinstance(record, Channel) and record.message_encoding == MESSAGE_ENCODING:
            names[record.id] = record.topic
        elif isinstance(record, Metadata) and record.name == RECORDING:
            about = _about(record.metadata)
        damaged |= isinstance(record, Exception) or about is None
    try:
        streams = {name: _stream(parts[number]) for number, name in names.items() if number in parts}
    except (pa.ArrowException, ValueError, LookupError, TypeError, RecursionError) as error:
        raise ReadFailed(path, _DAMAGED, hint=_AGAIN) from error  # with checksums that are right
    if damaged and not streams:
        raise ReadFailed(path, f"{_DAMAGED}, and nothing in it is whole", hint=_AGAIN)
    meta, expected = about or ({}, None)
    recording = Recording(streams, meta)
    return recording, f"{_DAMAGED}: {_loss(recording, expected)}" if damaged else ""


def _about(facts: Mapping[str, str]) -> tuple[Any, dict[str, int] | None] | None:
    """The meta, and rows by stream, None where they were not told; None where what the record says is damaged."""
    try:
        meta, rows = json.loads(facts["meta"]), json.loads(facts.get("rows", "null"))
    except (ValueError, LookupError, RecursionError):
        return None
    sound = rows is None or (isinstance(rows, dict) and all(type(count) is int for count in rows.values()))
    return (meta, rows) if sound else None


def _loss(recording: Recording, expected: Mapping[str, int] | None) -> str:
    here = {name: table.num_rows for name, table in recording.items()}
    if expected is None:
        salvaged = ", ".join(f"{rows:,} rows of {name}" for name, rows in here.items())
        return f"{salvaged} are salvaged, how many are lost is not known"
    lost = {name: rows - here.get(name, 0) for name, rows in expected.items() if rows > here.get(name, 0)}
    shown = ", ".join(f"{rows:,} of {expected[name]:,} rows of {name}" for name, rows in lost.items())
    return f"{shown} are lost" if lost else "every row is salvaged"


def _stream(messages: list[bytes]) -> pa.Table:
    """The rows of messages. Arrow believes what damaged bytes tell of its buffers until it is asked to look."""
    table = pa.concat_tables(pa.ipc.open_stream(data).read_all() for data in messages).combine_chunks()
    table.validate(full=True)
    return table


def _contents(file: BinaryIO) -> str:
    """What an MCAP file of another program holds, as a phrase."""
    from mcap.reader import SeekingReader

    try:
        file.seek(0)
        summary = SeekingReader(file).get_summary()
    except Exception:  # the same errors of many kinds; the file is refused anyway
        summary = None
    if summary is None or not summary.channels:
        return "its summary names no channels"
    topics = sorted(f"{channel.topic} ({channel.message_encoding})" for channel in summary.channels.values())
    more = f" and {len(topics) - 10} more" if len(topics) > 10 else ""
    return f"it holds {', '.join(topics[:10])}{more}"
