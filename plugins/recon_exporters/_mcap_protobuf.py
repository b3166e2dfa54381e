"""Protocol buffers of many messages at once: every field of a kind has the same number of bytes in all of them.

Doubles take eight bytes anyway. Integers that vary take five, the shorter ones padded with groups of zero bits, which
every decoder takes ("varints" of the encoding guide); texts are the same in all messages. So n messages are an array
(n, width) that is filled column by column.

A message is written as a list of parts, in the order of the wire: bytes that are the same in all messages, or (n, k)
bytes that are not.

References
    Protocol Buffers, "Encoding" (protobuf.dev/programming-guides/encoding); google/protobuf/descriptor.proto.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Part: TypeAlias = bytes | NDArray[np.uint8]

_VARINT, _EIGHT_BYTES, _SIZED = 0, 1, 2
_PADDED: Final = 5
_NS: Final = 1_000_000_000


def varint(value: int) -> bytes:
    """A number that is not negative, seven bits a byte."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _tag(number: int, wire: int) -> bytes:
    return varint(number << 3 | wire)


def sized(number: int, data: bytes | str) -> list[Part]:
    """A field of text or bytes."""
    raw = data.encode() if isinstance(data, str) else data
    return [_tag(number, _SIZED) + varint(len(raw)) + raw]


def whole(number: int, value: int) -> list[Part]:
    """A field of a whole number, an enumeration or a switch."""
    return [_tag(number, _VARINT) + varint(value)]


def choice(number: int, values: NDArray[np.bool_], value: int) -> list[Part]:
    """A field of an enumeration that is `value` (below 128) where `values` (n,) are true, and 0 elsewhere."""
    return [_tag(number, _VARINT), np.where(values, value, 0).astype(np.uint8)[:, None]]


def doubles(first: int, columns: Iterable[Any]) -> list[Part]:
    """Fields of doubles, numbered from `first`: (n,) each, or one number for all messages."""
    parts: list[Part] = []
    for number, column in enumerate(columns, start=first):
        parts += [_tag(number, _EIGHT_BYTES), _raw(column)]
    return parts


def packed(number: int, columns: Sequence[Any]) -> list[Part]:
    """A repeated field of k doubles: (n,) each, or one number for all messages."""
    return [_tag(number, _SIZED) + varint(8 * len(columns)), *map(_raw, columns)]


def _raw(column: Any) -> Part:
    values = np.ascontiguousarray(column, dtype="<f8")
    return values.view(np.uint8).reshape(-1, 8) if values.ndim else values.tobytes()


def message(number: int, parts: Iterable[Part]) -> list[Part]:
    """A field that is a message of its own."""
    inner = list(parts)
    return [_tag(number, _SIZED) + varint(sum(map(_width, inner))), *inner]


def timestamp(number: int, t_ns: NDArray[np.int64]) -> list[Part]:
    """A google.protobuf.Timestamp: (n,) ns since 1970, not negative."""
    seconds, nanos = _padded(t_ns // _NS), _padded(t_ns % _NS)
    return message(number, [_tag(1, _VARINT), seconds, _tag(2, _VARINT), nanos])


def _padded(values: NDArray[np.int64]) -> NDArray[np.uint8]:
    groups = values[:, None] >> 7 * np.arange(_PADDED) & 0x7F
    groups[:, :-1] |= 0x80
    return groups.astype(np.uint8)


def _width(part: Part) -> int:
    return len(part) if isinstance(part, bytes) else int(part.shape[1])


def rows_of(parts: Sequence[Part], count: int) -> NDArray[np.uint8]:
    """The parts side by side: (count, width)."""
    out = np.empty((count, sum(map(_width, parts))), dtype=np.uint8)
    at = 0
    for part in parts:
        out[:, at : at + _width(part)] = np.frombuffer(part, np.uint8) if isinstance(part, bytes) else part
        at += _width(part)
    return out


# --- descriptors ----------------------------------------------------------------------------------------------------

_FIELD: Final = re.compile(r"(repeated )?([\w.]+) (\w+) = (\d+);")
_VALUE: Final = re.compile(r"(\w+) = (\d+);")
_SCALARS: Final = {"double": 1, "int64": 3, "int32": 5, "fixed32": 7, "bool": 8, "string": 9, "bytes": 12}
_MESSAGE_TYPE, _ENUM_TYPE = 11, 14


def descriptor_set(name: str, definitions: Mapping[str, str]) -> bytes:
    """A FileDescriptorSet of a message and all that it is made of, one file for each.

    definitions : by full name, fields as a .proto file writes them; of an enumeration, named Message.Enum, its values
    """
    ordered: dict[str, None] = {}
    _collect(name, definitions, ordered)
    return b"".join(joined(sized(1, _file(each, definitions))) for each in ordered)


def _collect(name: str, definitions: Mapping[str, str], ordered: dict[str, None]) -> None:
    """Names of the messages that one needs, before it, and itself."""
    for used in _messages_in(name, definitions):
        _collect(used, definitions, ordered)
    ordered[name] = None


def _messages_in(name: str, definitions: Mapping[str, str]) -> list[str]:
    kinds = [kind for _, kind, _, _ in _FIELD.findall(definitions[name])]
    return [kind for kind in dict.fromkeys(kinds) if kind in definitions and not _is_enum(kind, definitions)]


def _is_enum(kind: str, definitions: Mapping[str, str]) -> bool:
    return kind.rpartition(".")[0] in definitions


def _path(name: str) -> str:
    package, _, title = name.rpartition(".")
    title = title.lower() if package.startswith("google") else title
    return f"{package.replace('.', '/')}/{title}.proto"


def _file(name: str, definitions: Mapping[str, str]) -> bytes:
    """A FileDescriptorProto."""
    package, _, title = name.rpartition(".")
    parts = [*sized(1, _path(name)), *sized(2, package)]
    for used in _messages_in(name, definitions):
        parts += sized(3, _path(used))
    described = [*sized(1, title)]
    for repeated, kind, field, number in _FIELD.findall(definitions[name]):
        described += sized(2, _field(field, int(number), kind, definitions, repeated=bool(repeated)))
    for inner in definitions:
        if inner.startswith(f"{name}."):
            described += sized(4, _enum(inner.removeprefix(f"{name}."), definitions[inner]))
    return joined([*parts, *sized(4, joined(described)), *sized(12, "proto3")])


def _enum(title: str, values: str) -> bytes:
    """An EnumDescriptorProto."""
    parts = sized(1, title)
    for value, number in _VALUE.findall(values):
        parts += sized(2, joined([*sized(1, value), *whole(2, int(number))]))
    return joined(parts)


def _field(name: str, number: int, kind: str, definitions: Mapping[str, str], *, repeated: bool) -> bytes:
    """A FieldDescriptorProto."""
    parts = [*sized(1, name), *whole(3, number), *whole(4, 3 if repeated else 1)]
    if kind in _SCALARS:
        return joined([*parts, *whole(5, _SCALARS[kind])])
    type_number = _ENUM_TYPE if _is_enum(kind, definitions) else _MESSAGE_TYPE
    return joined([*parts, *whole(5, type_number), *sized(6, f".{kind}")])


def joined(parts: Iterable[Part]) -> bytes:
    """The parts of one message, one after the other."""
    return b"".join(part if isinstance(part, bytes) else part.tobytes() for part in parts)
