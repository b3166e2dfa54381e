"""Channels of MCAP files of other programs, and how their messages are written.

    message encoding   schema encoding           of
    ros1               ros1msg                   ROS 1
    cdr                ros2msg, ros2idl          ROS 2
    protobuf           protobuf                  Foxglove
    json               jsonschema                Foxglove

Reference: MCAP specification, appendix "Well-known encodings" (mcap.dev/spec/registry).
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from recon.extras import needs
from recon.rows import Metric, warning
from recon.storage.mcap import Clipped, whole_records
from recon.tables import Array
from recon_readers import _topics
from recon_readers._collector import Language
from recon_readers._message_kinds import KINDS, may_hold
from recon_readers._ros_layout import Serialization, definitions, parts_of, read_numbers, ros_name
from recon_readers._time_order import Mask
from recon_readers._topics import Intake

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

_SERIALIZATIONS: Final[Mapping[str, Serialization]] = {"ros1": "ros1", "cdr": "cdr"}
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
"""How what zstd packed begins; a message of ROS 2 begins with a zero."""
_LARGEST_BATCH: Final = 2**28
"""Bytes that messages may unpack to at a time."""
_DATUM: Final = "height_datum"
_DATUMS: Final = ("mean_sea_level", "ellipsoid")
"""A fact that exporter.mcap writes into the metadata of a channel, and what it may say."""


def take_in(path: Path, intake: Intake) -> None:
    """Take all whole messages of an MCAP file in. What is damaged becomes a warning that counts what was read."""
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Schema] = {}
    channels: dict[int, _topics.Channel] = {}
    damaged, taken = 0, 0
    with Clipped(path.open("rb", buffering=0)) as file:
        for record in whole_records(file, path.stat().st_size):
            if isinstance(record, Message):
                channel = channels.get(record.channel_id)
                taken += 1
                if channel is not None:
                    channel.add(record.data, record.log_time)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.id not in channels:
                channels[record.id] = _channel(record, schemas.get(record.schema_id), intake)
            elif isinstance(record, Exception):
                damaged += 1
    if damaged:
        text = f"{path.name} is cut short or damaged: {taken} whole messages are used, how many are lost is not known"
        intake.learnt += [Metric("damaged_places", float(damaged), note=path.name), warning(text)]


def _channel(channel: Channel, schema: Schema | None, intake: Intake) -> _topics.Channel:
    """The channel; one whose messages cannot be read gives no numbers, and a warning that says why."""
    name = schema.name if schema is not None else ""
    facts = {_DATUM: channel.metadata[_DATUM]} if channel.metadata.get(_DATUM) in _DATUMS else {}
    try:
        parts, language = _language(channel.message_encoding, schema, channel.topic, intake)
    except ValueError as error:
        intake.learnt.append(warning(f"{channel.topic} is not read: {error}"))
        parts, language = [], Language(unread, ("", ""))
    return intake.channel(channel.topic, name or channel.message_encoding, parts, language, **facts)


def _language(
    encoding: str, schema: Schema | None, topic: str, intake: Intake
) -> tuple[list[tuple[str, str]], Language]:
    """The known types in a channel's messages, and how these are read. Raises ValueError, PluginError."""
    if schema is None:
        return [], Language(unread, ("", ""))
    if encoding in _SERIALIZATIONS:
        return ros_language(schema.name, schema.data.decode("utf-8", "replace"), schema.encoding, encoding, intake)
    parts = [("", schema.name)] if schema.name in KINDS else []
    if encoding == "protobuf" and intake.uses(topic, parts):
        return parts, Language(_from_protobuf(schema, intake.reader), ("seconds", "nanos"))
    if encoding == "json":
        return parts, Language(_from_json, ("sec", "nsec"))
    return parts, Language(unread, ("", ""))


def ros_language(
    name: str, text: str, language: str, serialization: str, intake: Intake
) -> tuple[list[tuple[str, str]], Language]:
    """The known types in messages of a ROS type, and how these are read. Raises ValueError, PluginError."""
    if not may_hold(name, text):
        return [], Language(unread, ("", ""))
    types = definitions(name, text, "idl" if "idl" in language else "msg", intake.reader)
    form = _SERIALIZATIONS[serialization]

    def read(messages: Sequence[bytes], paths: Collection[str]) -> tuple[dict[str, Array], Mask]:
        plain = _unpacked(messages) if form == "cdr" else messages
        return read_numbers(plain, types, ros_name(name), form, paths)

    return list(parts_of(types, ros_name(name), KINDS)), Language(read, ("sec", "nanosec"))


def _unpacked(messages: Sequence[bytes]) -> Sequence[bytes]:
    """Messages of ROS 2, each packed with zstd by itself where rosbag2 was told to; empty where one is damaged."""
    if not any(message.startswith(_ZSTD) for message in messages):
        return messages
    left = _LARGEST_BATCH
    found = []
    for message in messages:
        plain = message
        if message.startswith(_ZSTD):
            try:
                with pa.CompressedInputStream(pa.BufferReader(message), "zstd") as stream:
                    plain = stream.read(left)
            except (pa.ArrowException, OSError):
                plain = b""
        left -= len(plain)
        found.append(plain)
    return found


def unread(messages: Sequence[bytes], paths: Collection[str]) -> tuple[dict[str, Array], Mask]:
    """`Language.read` of messages that nobody understands: (n,) NaN by path, none of them whole."""
    return {path: np.full(len(messages), np.nan) for path in paths}, np.zeros(len(messages), dtype=bool)


def _one_by_one(
    parse: Callable[[bytes], Any], step: Callable[[Any, str], Any], messages: Sequence[bytes], paths: Collection[str]
) -> tuple[dict[str, Array], Mask]:
    """As `Language.read`, of messages that a library reads one at a time; they are kept as numbers, not as objects.

    parse : a message as an object; step : the member of an object that has this name
    """
    routes = {path: _route(path) for path in paths}
    values = {path: array("d") for path in paths}
    whole = np.zeros(len(messages), dtype=bool)
    for row, message in enumerate(messages):
        try:
            parsed = parse(message)
        except Exception:  # whatever a library raises at damaged bytes
            parsed = None
        whole[row] = parsed is not None
        for path, route in routes.items():
            values[path].append(_follow(parsed, route, step))
    return {path: np.frombuffer(column, dtype=np.float64).copy() for path, column in values.items()}, whole


def _route(path: str) -> list[str | int]:
    """ "pose.covariance[4]" -> ["pose", "covariance", 4]."""
    parts = path.replace("[", ".[").split(".")
    return [int(part[1:-1]) if part.startswith("[") else part for part in parts]


def _follow(value: Any, route: Sequence[str | int], step: Callable[[Any, str], Any]) -> float:
    try:
        for part in route:
            value = value[part] if isinstance(part, int) else step(value, part)
        return float(value)
    except (LookupError, AttributeError, TypeError, ValueError, OverflowError):
        return float("nan")


def _from_json(messages: Sequence[bytes], paths: Collection[str]) -> tuple[dict[str, Array], Mask]:
    return _one_by_one(json.loads, lambda value, name: value[name], messages, paths)


def _from_protobuf(schema: Schema, reader: str) -> Callable[..., tuple[dict[str, Array], Mask]]:
    """Raises ValueError for a descriptor that cannot be read, PluginError where the decoder is not installed."""
    with needs(reader, "mcap-protobuf-support for this log", extra="mcap"):
        from mcap_protobuf.decoder import DecoderFactory
    try:
        parse = DecoderFactory().decoder_for("protobuf", schema)
    except Exception as error:
        raise ValueError(f"the definition of {schema.name} cannot be read") from error
    if parse is None:
        raise ValueError(f"the definition of {schema.name} cannot be read")

    def read(messages: Sequence[bytes], paths: Collection[str]) -> tuple[dict[str, Array], Mask]:
        return _one_by_one(parse, getattr, messages, paths)

    return read
