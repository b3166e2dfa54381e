"""DataFlash logs of ArduPilot (.bin): messages of one kind as columns.

    message    0xA3 0x95, number of its kind, fields
    FMT        kind 128: number, length, name, types and names of the fields of another kind

A file is walked window by window; of kinds that are not wanted only the place is looked at. Behind damaged bytes the
next message of a known kind is searched.

Reference: ArduPilot, libraries/AP_Logger/LogStructure.h.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.tables import Array
from recon_readers._windows import walk_through

HEAD: Final = b"\xa3\x95"
FMT: Final = 128
_FMT_LENGTH: Final = 89
_WINDOW: Final = 2**24
_LONGEST: Final = 255
_TYPES: Final[Mapping[str, tuple[str, float]]] = {
    "a": ("32i2", 1.0),
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "M": ("u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
    "g": ("<f2", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "c": ("<i2", 100.0),
    "C": ("<u2", 100.0),
    "e": ("<i4", 100.0),
    "E": ("<u4", 100.0),
    "L": ("<i4", 1e7),
}
"""NumPy type, and by what the number is divided."""


@dataclass
class Kind:
    """A kind of message: NumPy type of its fields, the divisor of each that is a number, and the rows so far."""

    name: str
    length: int
    fields: np.dtype[np.void] | None
    divisors: Mapping[str, float] = field(default_factory=dict)
    parts: list[NDArray[np.void]] = field(default_factory=list)


@dataclass
class Table:
    """The messages of one kind, in the order in which they stand in the file: (n,) rows of raw fields."""

    rows: NDArray[np.void]
    divisors: Mapping[str, float]

    def __contains__(self, name: str) -> bool:
        return name in self.divisors

    def numbers(self, name: str) -> Array:
        """A field as (n,) float64, NaN where it is not there."""
        if name not in self.divisors:
            return np.full(len(self.rows), np.nan)
        with np.errstate(invalid="ignore"):  # a damaged float may be a NaN that signals
            return np.asarray(self.rows[name].astype(np.float64) / self.divisors[name])

    def integers(self, name: str) -> NDArray[np.int64]:
        """A field of whole numbers as (n,) int64."""
        with np.errstate(invalid="ignore"):  # a log may declare it as a float, which may be none
            return np.asarray(self.rows[name].astype(np.int64))

    def only(self, choice: NDArray[np.bool_]) -> Table:
        """Some of the rows."""
        return self if choice.all() else Table(self.rows[choice], self.divisors)


@dataclass
class Walk:
    """What was found in a file: all kinds by number, messages by kind's name, places that were no message.

    declared_anew : messages that `tables` left out, whose kind has other fields elsewhere in the file
    """

    wanted: frozenset[str]
    kinds: dict[int, Kind] = field(default_factory=lambda: {FMT: Kind("FMT", _FMT_LENGTH, None)})
    counts: dict[str, int] = field(default_factory=dict)
    finished: dict[str, list[Table]] = field(default_factory=dict)
    damaged: int = 0
    declared_anew: int = 0

    def tables(self) -> dict[str, Table]:
        """The messages by name. Of a kind that was declared anew the declaration with most messages counts."""
        for kind in self.kinds.values():
            self._close(kind)
        found = {name: max(tables, key=lambda table: len(table.rows)) for name, tables in self.finished.items()}
        of_all = sum(len(table.rows) for tables in self.finished.values() for table in tables)
        self.declared_anew = of_all - sum(len(table.rows) for table in found.values())
        return found

    def declare(self, body: bytes) -> None:
        """Take in a FMT message. One that makes no sense is passed over."""
        number, length = body[0], body[1]
        name, types, columns = (part.split(b"\0")[0].decode("ascii", "replace") for part in _split(body))
        names = columns.split(",") if columns else []
        known = all(code in _TYPES for code in types) and len(set(names)) == len(names) == len(types)
        fields = np.dtype([(name, _TYPES[code][0]) for name, code in zip(names, types, strict=True)]) if known else None
        if number == FMT or length < 3 or (fields is not None and fields.itemsize != length - 3):
            return
        numeric = zip(names, types, strict=True) if known else ()
        divisors = {name: _TYPES[code][1] for name, code in numeric if code not in "anNZ"}
        before = self.kinds.get(number)
        if before is not None and (before.name, before.fields, before.divisors) == (name, fields, divisors):
            return
        if before is not None:
            self._close(before)
        self.kinds[number] = Kind(name, length, fields if name in self.wanted else None, divisors)

    def _close(self, kind: Kind) -> None:
        if kind.parts:
            self.finished.setdefault(kind.name, []).append(Table(np.concatenate(kind.parts), kind.divisors))
            kind.parts = []


def _split(body: bytes) -> tuple[bytes, bytes, bytes]:
    return body[2:6], body[6:22], body[22:86]


def walk(path: Path, names: Collection[str]) -> Walk:
    """All messages of the kinds named."""
    found = Walk(frozenset(names))
    walk_through(path, _WINDOW, partial(_take, found))
    return found


def _take(found: Walk, window: bytes, *, last: bool) -> int:
    """Take in the messages of a window: where the first begins that is not whole in it.

    last : no window follows
    """
    at, end = 0, len(window) if last else len(window) - _LONGEST
    places: dict[int, array[int]] = {}
    while at + 3 <= end:
        number = window[at + 2]
        kind = found.kinds.get(number) if window.startswith(HEAD, at) else None
        if kind is None or at + kind.length > len(window):
            found.damaged += 1
            at = _next(window, at + 1, found)
            continue
        if number == FMT:
            _gather(window, places, found)
            found.declare(window[at + 3 : at + _FMT_LENGTH])
            places = {}
        elif kind.fields is not None:
            places.setdefault(number, array("q")).append(at)
        at += kind.length
    _gather(window, places, found)
    return at


def _next(window: bytes, at: int, found: Walk) -> int:
    """Where the next message of a known kind begins; the end of the window, less what may belong to one, else."""
    while (at := window.find(HEAD, at)) >= 0:
        if at + 3 > len(window) or window[at + 2] in found.kinds:
            return at
        at += 1
    return len(window) - window.endswith(HEAD[:1])


def _gather(window: bytes, places: Mapping[int, array[int]], found: Walk) -> None:
    data = np.frombuffer(window, dtype=np.uint8)
    for number, offsets in places.items():
        kind = found.kinds[number]
        assert kind.fields is not None
        starts = np.frombuffer(offsets, dtype=np.int64) + 3
        block = data[starts[:, None] + np.arange(kind.fields.itemsize)]
        kind.parts.append(np.ascontiguousarray(block).view(kind.fields)[:, 0])
