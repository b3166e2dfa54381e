"""An MCAP file of many messages, written chunk by chunk from columns.

    magic, header, metadata, attachments, schemas, channels, (chunk, its message indexes)*, data end, summary, footer

A chunk holds the messages of all channels in a span of time, zstd-compressed, and no two chunks overlap, so that a
viewer that jumps to a time reads one chunk. Chunks and the data section have checksums.

References
    MCAP specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.storage.mcap import MAGIC

if TYPE_CHECKING:
    from mcap.records import ChunkIndex, McapRecord

CHUNK_MESSAGES: Final = 16384
"""About 4 MB before compression, of which a viewer holds a few at a time."""

_MESSAGE: Final = 0x05
_MESSAGE_INDEX: Final = 0x07
_FOOTER: Final = 0x02
_HEADER: Final = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""What stands before the data of a message."""
_AFTER_LENGTH: Final = _HEADER.itemsize - 9
_LEVEL: Final = 1
"""Of zstd: the higher ones make these files 3 % smaller and take three times as long."""
_WORKERS: Final = 3
"""Threads that encode; a fourth beside the one that writes waits for the interpreter's lock, and all are slower."""


Metadata: TypeAlias = Mapping[str, Mapping[str, str]]
"""Facts by the name of a record of metadata."""


@dataclass(frozen=True)
class Channel:
    """Messages of one topic.

    encoding : of the messages, "protobuf" or "json"; schema_encoding, schema_name, schema : how to understand them
    t_ns : (n,) ns since 1970, rising, not negative
    encode : rows -> their messages, as an Arrow array of bytes
    about : facts on the channel
    """

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    t_ns: NDArray[np.int64]
    encode: Callable[[slice], pa.Array]
    about: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Attachment:
    """A file within the file."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class _Chunk:
    """Messages of a span of time, ready to be written. indexes : message index of each channel, by its number."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compressed: bytes
    indexes: Mapping[int, bytes]


def write_file(
    path: Path,
    channels: Sequence[Channel],
    *,
    library: str,
    metadata: Metadata,
    attachments: Sequence[Attachment],
) -> None:
    """Write a whole file; equal channels give equal bytes. Chunks are encoded side by side and written in order."""
    from mcap.records import DataEnd, Header

    with path.open("wb") as file:
        out = _Out(file)
        out.write(MAGIC)
        out.record(Header(profile="", library=library))
        summary = _write_beginning(out, channels, metadata, attachments)
        spans = _spans([channel.t_ns for channel in channels])
        summary += [_write_chunk(out, chunk) for chunk in _ahead(lambda rows: _chunk(channels, rows), spans)]
        out.record(DataEnd(data_section_crc=out.crc))
        _write_end(out, _ordered(summary, _statistics(channels, metadata, attachments, len(spans))))


def _ahead(work: Callable[[list[slice]], _Chunk], spans: Iterable[list[slice]]) -> Iterator[_Chunk]:
    """What the work makes of each span, in their order; some are made while others are written, never all at once."""
    workers = max(1, min(_WORKERS, pa.cpu_count() - 1))
    waiting: deque[Future[_Chunk]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        for span in spans:
            waiting.append(pool.submit(work, span))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


class _Out:
    """A file that knows how far it is written, and the checksum of all that."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.position = 0
        self.crc = 0

    def write(self, data: bytes) -> int:
        """Write bytes; how many."""
        self._file.write(data)
        self.crc = zlib.crc32(data, self.crc)
        self.position += len(data)
        return len(data)

    def record(self, record: McapRecord) -> int:
        """Write a record; its length in bytes."""
        return self.write(_bytes_of(record))


def _bytes_of(*records: McapRecord) -> bytes:
    from mcap.data_stream import RecordBuilder

    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _write_beginning(
    out: _Out, channels: Sequence[Channel], metadata: Metadata, attachments: Sequence[Attachment]
) -> list[McapRecord]:
    """Write all but messages; what the summary says of it. Schema and channel number n belong to channels[n - 1]."""
    from mcap import records

    summary: list[McapRecord] = []
    for name, facts in metadata.items():
        offset = out.position
        length = out.record(records.Metadata(name=name, metadata=dict(facts)))
        summary.append(records.MetadataIndex(offset=offset, length=length, name=name))
    for item in attachments:
        offset, kind = out.position, item.media_type
        length = out.record(records.Attachment(0, 0, name=item.name, media_type=kind, data=item.data))
        summary.append(records.AttachmentIndex(offset, length, 0, 0, len(item.data), item.name, kind))
    for number, channel in enumerate(channels, start=1):
        schema = records.Schema(number, data=channel.schema, encoding=channel.schema_encoding, name=channel.schema_name)
        described = records.Channel(number, channel.topic, channel.encoding, dict(channel.about), schema_id=number)
        summary += [schema, described]
        out.write(_bytes_of(schema, described))
    return summary


def _spans(times: Sequence[NDArray[np.int64]]) -> list[list[slice]]:
    """Rows of each channel for each chunk: about CHUNK_MESSAGES together, none of a chunk after any of the next."""
    starts = np.unique(np.sort(np.concatenate([*times, np.zeros(0, np.int64)]))[::CHUNK_MESSAGES])
    cuts = [[0, *np.searchsorted(t_ns, starts[1:]).tolist(), len(t_ns)] for t_ns in times]
    return [[slice(cut[number], cut[number + 1]) for cut in cuts] for number in range(len(starts))]


def _chunk(channels: Sequence[Channel], rows: Sequence[slice]) -> _Chunk:
    from zstandard import compress

    parts: list[bytes] = []
    indexes: dict[int, bytes] = {}
    size = 0
    for number, (channel, some) in enumerate(zip(channels, rows, strict=True), start=1):
        if some.stop > some.start:
            data, starts = _records(number, channel, some)
            entries = np.column_stack((channel.t_ns[some], starts + size)).astype("<u8").tobytes()
            indexes[number] = struct.pack("<BQHI", _MESSAGE_INDEX, 6 + len(entries), number, len(entries)) + entries
            parts.append(data)
            size += len(data)
    times = [channel.t_ns[some] for channel, some in zip(channels, rows, strict=True) if some.stop > some.start]
    whole = b"".join(parts)
    start_ns, end_ns = min(int(t_ns[0]) for t_ns in times), max(int(t_ns[-1]) for t_ns in times)
    return _Chunk(start_ns, end_ns, size, zlib.crc32(whole), compress(whole, _LEVEL), indexes)


def _records(number: int, channel: Channel, rows: slice) -> tuple[bytes, NDArray[np.int64]]:
    """The message records of some rows, one after the other, and where each begins: (n,)."""
    import pyarrow.compute as pc  # slow import: only when used

    bodies = channel.encode(rows)
    head = np.empty(len(bodies), dtype=_HEADER)
    head["opcode"], head["channel"] = _MESSAGE, number
    head["length"] = np.asarray(pc.binary_length(bodies)) + _AFTER_LENGTH
    head["sequence"] = np.arange(rows.start, rows.stop)
    head["log"] = head["publish"] = channel.t_ns[rows]
    whole = pc.binary_join_element_wise(fixed_binary(head.view(np.uint8).reshape(len(head), -1)), bodies, b"")
    _, offsets, data = whole.buffers()
    starts = np.frombuffer(offsets, dtype=np.int32, count=len(whole) + 1).astype(np.int64)
    return data.to_pybytes()[: starts[-1]], starts[:-1]


def fixed_binary(rows: NDArray[np.uint8]) -> pa.Array:
    """The rows of bytes, (n, k), as an Arrow array of n values."""
    values = pa.py_buffer(np.ascontiguousarray(rows))
    return pa.FixedSizeBinaryArray.from_buffers(pa.binary(rows.shape[1]), len(rows), [None, values]).cast(pa.binary())


def _write_chunk(out: _Out, chunk: _Chunk) -> ChunkIndex:
    from mcap import records

    facts: dict[str, Any] = {
        "compression": "zstd",
        "message_start_time": chunk.start_ns,
        "message_end_time": chunk.end_ns,
        "uncompressed_size": chunk.size,
    }
    start = out.position
    length = out.record(records.Chunk(data=chunk.compressed, uncompressed_crc=chunk.crc, **facts))
    offsets, behind = {}, out.position
    for number, index in chunk.indexes.items():
        offsets[number] = out.position
        out.write(index)
    return records.ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compressed_size=len(chunk.compressed),
        message_index_length=out.position - behind,
        message_index_offsets=offsets,
        **facts,
    )


def _statistics(
    channels: Sequence[Channel], metadata: Metadata, attachments: Sequence[Attachment], chunks: int
) -> McapRecord:
    from mcap.records import Statistics

    counts = {number: len(channel.t_ns) for number, channel in enumerate(channels, start=1)}
    filled = [channel.t_ns for channel in channels if len(channel.t_ns)]
    return Statistics(
        attachment_count=len(attachments),
        channel_count=len(channels),
        channel_message_counts=counts,
        chunk_count=chunks,
        message_count=sum(counts.values()),
        message_start_time=min((int(t_ns[0]) for t_ns in filled), default=0),
        message_end_time=max((int(t_ns[-1]) for t_ns in filled), default=0),
        metadata_count=len(metadata),
        schema_count=len(channels),
    )


def _ordered(summary: Iterable[McapRecord], statistics: McapRecord) -> list[McapRecord]:
    """Records of the summary in groups of one kind, schemas before the channels that name them."""
    kinds = ("Schema", "Channel", "Statistics", "ChunkIndex", "AttachmentIndex", "MetadataIndex")
    return sorted([*summary, statistics], key=lambda record: kinds.index(type(record).__name__))


def _write_end(out: _Out, summary: Iterable[McapRecord]) -> None:
    """Write summary, summary offsets, footer and magic."""
    from mcap.records import SummaryOffset

    start, groups = out.position, []
    out.crc = 0
    for _, some in groupby(summary, key=type):
        data, begin = _bytes_of(*some), out.position
        groups.append(SummaryOffset(group_opcode=data[0], group_start=begin, group_length=out.write(data)))
    offsets_start = out.position
    out.write(_bytes_of(*groups))
    out.write(struct.pack("<BQQQ", _FOOTER, 20, start, offsets_start))
    out.write(struct.pack("<I", out.crc))
    out.write(MAGIC)
