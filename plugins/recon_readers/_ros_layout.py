"""Numbers out of serialized ROS messages, thousands of messages at a time.

A message holds texts and sequences whose lengths stand before them, so its numbers have no fixed place. But messages
of one topic whose lengths are equal share a layout: it is found by walking the definition along the first of them, and
all of them are then read by one NumPy view. No code is generated from a definition and none is run.

References
    ROS 1 serialization: wiki.ros.org/msg, wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes.
    ROS 2: CDR of OMG DDSI-RTPS 2.5, clause 10, with CORBA 3.3, part 2, clause 9.3: numbers are aligned to their size.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from recon.extras import needs
from recon.tables import Array
from recon_readers._time_order import Mask

Serialization: TypeAlias = Literal["ros1", "cdr"]
Types: TypeAlias = Mapping[str, Sequence[tuple[str, Any]]]
"""Fields (name, description as rosbags gives it) of message types, by their ROS 2 names."""

_DEEPEST: Final = 20
"""Messages within messages; a definition that holds itself has no end."""
_CDR_HEADER: Final = 4
_NUMBERS: Final[Mapping[str, str]] = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    "uint8": "u1",
    "int8": "i1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_TIME: Final = ("sec", (1, ("int32", 0))), ("nanosec", (1, ("uint32", 0)))
_BUILT_IN: Final[Types] = {"builtin_interfaces/msg/Time": _TIME, "builtin_interfaces/msg/Duration": _TIME}


def ros_name(name: str) -> str:
    """A message type by its ROS 2 name: "sensor_msgs/Imu" -> "sensor_msgs/msg/Imu"."""
    package, _, rest = name.partition("/")
    return name if "/" in rest or not rest else f"{package}/msg/{rest}"


def definitions(name: str, text: str, language: str, reader: str) -> Types:
    """The types that a definition in a log holds, or for an empty one those that come with ROS 2.

    language : "idl" or "msg"; reader : who needs it, for the error

    Raises ValueError for a text that is no definition, PluginError where rosbags is not installed.
    """
    with needs(reader, "rosbags for this log", extra="rosbag"):
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    try:
        if not text.strip():
            parsed = get_typestore(Stores.ROS2_HUMBLE).fielddefs
        elif language == "idl":
            parsed = {key: value for part in _idl_parts(text) for key, value in get_types_from_idl(part).items()}
        else:
            parsed = get_types_from_msg(text, ros_name(name))
    except Exception as error:  # the parser raises what it likes at texts that are damaged
        raise ValueError(f"the definition of {name} cannot be read") from error
    return {**_BUILT_IN, **{key: fields for key, (_, fields) in parsed.items()}}


def _idl_parts(text: str) -> list[str]:
    """The IDL files that a recorder put into one text, each behind a line of = and its name."""
    line = "=" * 80 + "\nIDL: "
    return [part.partition("\n")[2] for part in text.split(line)[1:]] if text.startswith(line) else [text]


def parts_of(
    types: Types, name: str, known: Collection[str], path: str = "", depth: int = 0
) -> Iterator[tuple[str, str]]:
    """(path, type) of each known type in a message type: ("", name) where it is one itself, else of its fields."""
    if name in known:
        yield path, name
    elif depth < _DEEPEST:
        for field_name, (kind, what) in types.get(name, ()):
            if kind == 2:
                yield from parts_of(types, what, known, f"{path}{field_name}.", depth + 1)


@dataclass
class Layout:
    """Where in messages of one length what stands.

    numbers : by path, NumPy type and byte; lengths : of texts and sequences, byte and value, same for all messages of
    this layout
    """

    numbers: dict[str, tuple[str, int]] = field(default_factory=dict)
    lengths: dict[int, int] = field(default_factory=dict)
    order: str = "<"


def read_numbers(
    messages: Sequence[bytes], types: Types, name: str, serialization: Serialization, paths: Collection[str]
) -> tuple[dict[str, Array], Mask]:
    """The numbers at `paths` of each message, (n,) NaN where there is none; which messages are whole, (n,) bool."""
    values = {path: np.full(len(messages), np.nan) for path in paths}
    whole = np.zeros(len(messages), dtype=bool)
    sizes = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    for size in np.unique(sizes[sizes > 0]).tolist():
        rows = np.flatnonzero(sizes == size)
        joined = np.frombuffer(b"".join([messages[row] for row in rows.tolist()]), dtype=np.uint8).reshape(-1, size)
        left = np.arange(len(rows))
        while len(left):
            try:
                layout = _walk(types, name, joined[left[0]].tobytes(), serialization, paths)
            except (ValueError, LookupError):
                left = left[1:]
                continue
            alike = _same_lengths(joined[left], layout)
            alike[0] = True
            chosen = left[alike]
            _take(joined[chosen], layout, rows[chosen], values)
            whole[rows[chosen]] = True
            left = left[~alike]
    return values, whole


def _same_lengths(block: NDArray[np.uint8], layout: Layout) -> Mask:
    alike = np.ones(len(block), dtype=bool)
    for at, value in layout.lengths.items():
        alike &= np.ascontiguousarray(block[:, at : at + 4]).view(f"{layout.order}u4")[:, 0] == value
    return alike


def _take(block: NDArray[np.uint8], layout: Layout, rows: NDArray[np.intp], values: Mapping[str, Array]) -> None:
    for path, (kind, at) in layout.numbers.items():
        width = int(kind[1])
        values[path][rows] = np.ascontiguousarray(block[:, at : at + width]).view(layout.order + kind)[:, 0]


def _walk(types: Types, name: str, data: bytes, serialization: Serialization, paths: Collection[str]) -> Layout:
    """Raises ValueError where the message ends too early or is not understood, KeyError at unknown types."""
    walk = _Walk(types, data, frozenset(paths), cdr=serialization == "cdr")
    walk.message(name, "", 0)
    return walk.layout


class _Walk:
    """A walk along one message."""

    def __init__(self, types: Types, data: bytes, paths: frozenset[str], *, cdr: bool) -> None:
        self.types, self.data, self.paths, self.cdr = types, data, paths, cdr
        self.at = 0
        self.layout = Layout()
        if cdr:
            if len(data) < _CDR_HEADER or data[0] or data[1] > 1:
                raise ValueError("this is no plain CDR")
            self.at = _CDR_HEADER
            self.layout.order = "<" if data[1] else ">"

    def message(self, name: str, path: str, depth: int) -> None:
        if depth > _DEEPEST:
            raise ValueError("a message holds itself")
        for field_name, description in self.types[name]:
            self.value(description, f"{path}{field_name}", depth)

    def value(self, description: Any, path: str, depth: int) -> None:
        kind, what = description
        if kind == 1:
            self.base(what[0], path)
        elif kind == 2:
            self.message(what, f"{path}.", depth + 1)
        else:
            element, count = what
            if kind == 4:
                count = self.length()
            self.elements(element, count, path, depth)

    def base(self, name: str, path: str) -> None:
        if name == "string":
            self.skip(self.length())
        elif name in _NUMBERS:
            self.number(_NUMBERS[name], path)
        else:
            raise ValueError(f"'{name}' is not read")

    def elements(self, element: Any, count: int, path: str, depth: int) -> None:
        kind, what = element
        if count and kind == 1 and what[0] in _NUMBERS:
            self.numbers(_NUMBERS[what[0]], count, path)
            return
        for number in range(count):
            before = self.at
            self.value(element, f"{path}[{number}]", depth)
            if self.at == before:
                return  # elements without contents

    def numbers(self, kind: str, count: int, path: str) -> None:
        width = int(kind[1])
        self.align(width)
        for wanted in self.paths:
            index = wanted.removeprefix(path)[1:-1]
            if wanted == f"{path}[{index}]" and index.isdigit() and int(index) < count:
                self.layout.numbers[wanted] = (kind, self.at + int(index) * width)
        self.skip(count * width)

    def number(self, kind: str, path: str) -> None:
        width = int(kind[1])
        self.align(width)
        if path in self.paths:
            self.layout.numbers[path] = (kind, self.at)
        self.skip(width)

    def length(self) -> int:
        self.align(4)
        at = self.at
        self.skip(4)
        value = int.from_bytes(self.data[at : at + 4], "little" if self.layout.order == "<" else "big")
        self.layout.lengths[at] = value
        return value

    def align(self, width: int) -> None:
        if self.cdr:
            self.at += -(self.at - _CDR_HEADER) % width

    def skip(self, count: int) -> None:
        self.at += count
        if self.at > len(self.data):
            raise ValueError("the message is cut short")
