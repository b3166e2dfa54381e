"""What a stream holds: columns with type, unit, frame and quantity; matching with explanation.

A `Schema` describes one stream, a `Column` one of its columns, a `Need` what a stage asks of a stream, a `Change`
what it does to one. Columns of one vector form a *group*: "accel" stands for accel_x, accel_y, accel_z; "pos" for
pos_e, pos_n, pos_u; "q" for qw, qx, qy, qz; a single column is a group of its own.

Frames
    sensor   axes of the box as it was logged          level    sensor turned so that z points up
    vehicle  ISO 8855: x forward, y left, z up         local    East, North, Up about the anchor
Of a quaternion the frame names the body whose attitude it is; it always rotates body vectors to local.

Quantities tell apart what shares a unit: specific_force is what an accelerometer feels (a still one reads +g
upwards), acceleration is the change of velocity (gravity removed).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import pyarrow as pa

ANY: Final = "*"
QUATERNION: Final = ("qw", "qx", "qy", "qz")

_IN_FRAME: Final = "in frame"
_ALIGN: Final = "put a step that turns it before this one: 'recon plugins aligner' lists them"
_AXES: Final = (("_x", "_y", "_z"), ("_e", "_n", "_u"), ("_roll", "_pitch", "_yaw"))


@dataclass(frozen=True)
class Column:
    """One column of a stream.

    frame and quantity may be ANY in a Need, and in the plan of a reader whose files tell; `optional` columns may be
    absent, which again only the file can tell.
    """

    name: str
    unit: str = ""
    frame: str = ""
    quantity: str = ""
    type: pa.DataType = field(default_factory=pa.float64)
    optional: bool = False
    doc: str = ""


def group_of(column: str) -> str:
    """Name of the group that a column belongs to: "accel_x" -> "accel", "qw" -> "q", "speed" -> "speed"."""
    if column in QUATERNION:
        return "q"
    for suffixes in _AXES:
        for suffix in suffixes:
            if column.endswith(suffix) and len(column) > len(suffix):
                return column.removesuffix(suffix)
    return column


def spread(group: str, columns: Iterable[str]) -> tuple[str, ...]:
    """Names of the columns of a group among `columns`, in their order; empty where there are none."""
    names = tuple(columns)
    if group in names:
        return (group,)
    return tuple(name for name in names if group_of(name) == group)


@dataclass(frozen=True)
class Need:
    """What a stage asks of one stream: columns (frame and quantity may be ANY); is the stream itself `optional`?"""

    columns: tuple[Column, ...]
    optional: bool = False


@dataclass(frozen=True)
class Change:
    """What a stage does to a stream that it reads and returns under the same name.

    frames and quantities : new value by group, for example {"accel": "vehicle"}
    adds : columns that are added or take the place of one of that name; drops : groups that disappear
    """

    frames: Mapping[str, str] = field(default_factory=dict)
    quantities: Mapping[str, str] = field(default_factory=dict)
    adds: tuple[Column, ...] = ()
    drops: tuple[str, ...] = ()

    def apply(self, schema: Schema) -> Schema:
        """The schema after the change; groups that are not there are left out of account."""
        dropped = {name for group in self.drops for name in spread(group, schema.names)}
        columns = {column.name: column for column in schema.columns if column.name not in dropped}
        for column in columns.values():
            group = group_of(column.name)
            columns[column.name] = replace(
                column,
                frame=self.frames.get(group, column.frame),
                quantity=self.quantities.get(group, column.quantity),
            )
        columns.update({column.name: column for column in self.adds})
        return Schema(tuple(columns.values()))


SAME: Final = Change()


@dataclass(frozen=True)
class Schema:
    """The columns of one stream."""

    columns: tuple[Column, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns, in their order."""
        return tuple(column.name for column in self.columns)

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> Column:
        for column in self.columns:
            if column.name == name:
                return column
        raise KeyError(name)

    @property
    def uncertain(self) -> bool:
        """May the stream be absent? Only when all its columns may."""
        return all(column.optional for column in self.columns)

    def possible(self) -> Schema:
        """The same stream where only the file can tell whether it is there, and with which columns."""
        return Schema(tuple(replace(column, optional=True) for column in self.columns))

    def open_ended(self) -> Schema:
        """As `possible`, where the file also tells the frames and quantities: for readers that are self-describing."""
        return Schema(
            tuple(
                replace(column, frame=column.frame and ANY, quantity=column.quantity and ANY)
                for column in self.possible().columns
            )
        )

    def columns_of(self, *groups: str) -> tuple[Column, ...]:
        """Columns of the groups, in the order given. Raises KeyError on a group that is not here."""
        found: list[Column] = []
        for group in groups:
            names = spread(group, self.names)
            if not names:
                raise KeyError(group)
            found.extend(self[name] for name in names)
        return tuple(found)

    def only(self, *groups: str, maybe: Iterable[str] = (), frame: str | None = None) -> Schema:
        """Time and the groups named; those in `maybe` optional; vectors in another `frame` where one is given."""
        required = [replace(column, optional=False) for column in self.columns_of(*groups)]
        uncertain = [replace(column, optional=True) for column in self.columns_of(*maybe)]
        columns = required + uncertain
        if frame is not None:
            columns = [replace(column, frame=frame if column.frame else "") for column in columns]
        time = [column for column in self.columns if column.name == "time" and "time" not in groups]
        return Schema((*time, *columns))

    def need(
        self,
        *groups: str,
        maybe: Iterable[str] = (),
        frame: str = ANY,
        quantity: Mapping[str, str] | None = None,
        optional: bool = False,
    ) -> Need:
        """What a stage asks of this stream.

        groups : must be there; maybe : used where they are there
        frame : the frame in which vectors must be, ANY for whichever
        quantity : by group, for example {"accel": "specific_force"}; ANY where not named
        optional : the stage runs without the stream, its argument is None then
        """
        wanted = quantity or {}
        columns = [
            replace(
                column,
                optional=uncertain,
                frame=frame if column.frame else ANY,
                quantity=wanted.get(group_of(column.name), ANY),
            )
            for names, uncertain in ((groups, False), (tuple(maybe), True))
            for column in self.columns_of(*names)
        ]
        return Need(tuple(columns), optional)


@dataclass(frozen=True)
class Mismatch:
    """Why a stream does not serve a need.

    columns : those concerned, none where the whole stream is absent; missing : absent rather than of wrong properties
    hint : what to do, "" where that is not plain
    """

    columns: tuple[str, ...]
    text: str
    missing: bool = False
    hint: str = ""


def match(need: Need, schema: Schema, stream: str) -> list[Mismatch]:
    """What keeps `schema` from serving `need`, one entry for each group; empty where it serves."""
    found: dict[tuple[str, str], list[str]] = {}
    for wanted in need.columns:
        fault = _fault(wanted, schema)
        if fault:
            found.setdefault((group_of(wanted.name), fault), []).append(wanted.name)
    return [_explain(tuple(names), fault, schema, stream) for (_, fault), names in found.items()]


def _fault(wanted: Column, schema: Schema) -> str:
    if wanted.name not in schema:
        return "" if wanted.optional else "missing"
    here = schema[wanted.name]
    if ANY not in (wanted.frame, here.frame) and here.frame != wanted.frame:
        return f"{_IN_FRAME} '{wanted.frame}'; here it is in frame '{here.frame}'"
    if ANY not in (wanted.quantity, here.quantity) and here.quantity != wanted.quantity:
        return f"as {wanted.quantity}; here it is {here.quantity}"
    if here.unit != wanted.unit:
        return f"in {wanted.unit or 'no unit'}; here it is in {here.unit or 'no unit'}"
    if here.type != wanted.type:
        return f"as {wanted.type}; here it is {here.type}"
    return ""


def _explain(names: tuple[str, ...], fault: str, schema: Schema, stream: str) -> Mismatch:
    shown = f"{stream}.{', '.join(names)}"
    if fault == "missing":
        return Mismatch(names, f"{shown}; columns of '{stream}' here are {', '.join(schema.names)}", missing=True)
    return Mismatch(names, f"{shown} {fault}", hint=_ALIGN if fault.startswith(_IN_FRAME) else "")


def vector(group: str, suffixes: str, unit: str, frame: str, quantity: str, doc: str = "") -> tuple[Column, ...]:
    """The columns of a group; suffixes "xyz" or "enu" (one letter each)."""
    return tuple(Column(f"{group}_{s}", unit=unit, frame=frame, quantity=quantity, doc=doc) for s in suffixes)
