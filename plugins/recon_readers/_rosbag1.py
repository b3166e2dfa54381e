"""Records of ROS 1 bags, from the first to the last: what lies behind a damaged place, or was never indexed, is found.

    file    "#ROSBAG V2.0\\n", then records; the index at its end is not needed
    record  length and header, length and data; a header is fields name=value with their lengths
    op      2 message, 3 bag header, 4 and 6 index, 5 chunk of records, perhaps compressed, 7 connection

Messages of topics that are not read are passed over, and so are not loaded where a chunk is not compressed.

Reference: wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import bz2
import io
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from recon.errors import ReadFailed
from recon.extras import needs
from recon.rows import Metric, warning
from recon_readers._collector import Language
from recon_readers._mcap_channels import ros_language, unread
from recon_readers._topics import Channel, Intake

MAGIC: Final = b"#ROSBAG V"
_VERSION: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"
_LONGEST_HEADER: Final = 2**20
_LARGEST_CHUNK: Final = 2**28
"""Bytes; recorders begin a new one after 768 kB."""
_NS: Final = 1_000_000_000
_WINDOW: Final = 2**20
_NEXT_CHUNK: Final = re.compile(
    rb"[\x28\x29]\0\0\0(?=[\x04\x09\x0f\x10]\0\0\0)(?=[\s\S]{0,36}op=\x05)(?=[\s\S]{0,30}compression=)"
)
"""The header of a chunk: op, size and compression, in whatever order."""


class _Broken(Exception):
    """The bytes here are no record."""


class Bag:
    """One bag as it is taken in.

    taken : messages so far, those of topics that are not read among them; damaged : places that were no records
    """

    def __init__(self, path: Path, intake: Intake) -> None:
        self.path, self.intake = path, intake
        self.channels: dict[int, Channel | None] = {}
        self.taken = self.damaged = 0

    def take_in(self) -> None:
        """Take in all whole messages. Raises ReadFailed for a bag of another version."""
        size = self.path.stat().st_size
        with self.path.open("rb", buffering=_WINDOW) as file:
            if file.read(len(_VERSION)) != _VERSION:
                raise ReadFailed(self.path, "it is no bag of version 2.0", hint="run 'rosbag fix' on an older bag")
            at = len(_VERSION)
            while at < size:
                at, whole = self._records(file, at, size)
                if not whole:
                    self.damaged += 1
                    at = _next_chunk(file, at + 1, size)
        if self.damaged:
            text = f"{self.path.name} is cut short or damaged: {self.taken} whole messages are used"
            self.intake.learnt += [
                Metric("damaged_places", float(self.damaged), note=self.path.name),
                warning(f"{text}, how many are lost is not known"),
            ]

    def _records(self, file: BinaryIO, at: int, end: int) -> tuple[int, bool]:
        """Take in records from `at` to `end`: where it ended, and whether all were whole."""
        file.seek(at)
        while at < end:
            try:
                head, fields = _header(file, end - at)
                length = _number(file.read(4))
                body = at + head + 4
                if body + length > end and fields.get(b"op") != _CHUNK:
                    raise _Broken
                self._record(file, fields, body, min(length, end - body))
                if body + length > end:
                    raise _Broken
            except _Broken:
                return at, False
            at = body + length
            file.seek(at)
        return at, True

    def _record(self, file: BinaryIO, fields: dict[bytes, bytes], at: int, length: int) -> None:
        op = fields.get(b"op")
        if op == _MESSAGE:
            self.taken += 1
            channel = self.channels.get(_number(fields.get(b"conn", b"")))
            if channel is not None and channel.topic.collector is None:
                channel.topic.count += 1
            elif channel is not None:
                seconds, nanoseconds = _numbers(fields.get(b"time", b""))
                channel.add(file.read(length), seconds * _NS + nanoseconds)
        elif op == _CHUNK:
            self._chunk(file, fields.get(b"compression", b""), at, length)
        elif op == _CONNECTION:
            number = _number(fields.get(b"conn", b""))
            if number not in self.channels:
                self.channels[number] = self._channel(fields, file.read(length))

    def _chunk(self, file: BinaryIO, compression: bytes, at: int, length: int) -> None:
        inside: BinaryIO = file
        if compression != b"none":
            data = _decompressed(compression, file.read(length))
            inside, at, length = io.BytesIO(data), 0, len(data)
        _, whole = self._records(inside, at, at + length)
        self.damaged += not whole

    def _channel(self, fields: dict[bytes, bytes], data: bytes) -> Channel | None:
        about = _fields(data)
        topic, name, text = (
            part.decode("utf-8", "replace")
            for part in (fields.get(b"topic", b""), about.get(b"type", b""), about.get(b"message_definition", b""))
        )
        try:
            parts, language = ros_language(name, text, "ros1msg", "ros1", self.intake)
        except ValueError as error:
            self.intake.learnt.append(warning(f"{topic} is not read: {error}"))
            parts, language = [], Language(unread, ("", ""))
        return self.intake.channel(topic, name, parts, language)


def _header(file: BinaryIO, left: int) -> tuple[int, dict[bytes, bytes]]:
    """Bytes and fields of the header that begins here. Raises _Broken."""
    length = _number(file.read(4))
    if length > min(left, _LONGEST_HEADER):
        raise _Broken
    return 4 + length, _fields(file.read(length))


def _fields(data: bytes) -> dict[bytes, bytes]:
    """Raises _Broken."""
    fields = {}
    at = 0
    while at < len(data):
        length = _number(data[at : at + 4])
        name, equals, value = data[at + 4 : at + 4 + length].partition(b"=")
        at += 4 + length
        if not equals or at > len(data):
            raise _Broken
        fields[name] = value
    return fields


def _number(data: bytes) -> int:
    if len(data) != 4:
        raise _Broken
    return int.from_bytes(data, "little")


def _numbers(data: bytes) -> tuple[int, int]:
    if len(data) != 8:
        raise _Broken
    first, second = struct.unpack("<II", data)
    return first, second


def _decompressed(compression: bytes, data: bytes) -> bytes:
    """What can be decompressed of a chunk, at most _LARGEST_CHUNK. Raises _Broken, PluginError."""
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(data, _LARGEST_CHUNK)
        if compression == b"lz4":
            return _lz4()(data)
    except (OSError, RuntimeError, ValueError, EOFError) as error:
        raise _Broken from error
    raise _Broken


def _lz4() -> Callable[[bytes], bytes]:
    with needs("reader.rosbag", "lz4 for this bag", extra="rosbag"):
        from lz4.frame import LZ4FrameDecompressor
    return lambda data: bytes(LZ4FrameDecompressor().decompress(data, max_length=_LARGEST_CHUNK))


def _next_chunk(file: BinaryIO, at: int, size: int) -> int:
    """Where the next chunk begins, the end of the file where none does."""
    while at < size:
        file.seek(at)
        window = file.read(_WINDOW)
        found = _NEXT_CHUNK.search(window)
        if found:
            return at + found.start()
        if len(window) < _WINDOW:
            return size
        at += len(window) - 64
    return size
