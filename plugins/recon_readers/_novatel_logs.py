"""Logs of NovAtel receivers in any bytes: ASCII and binary, with long and with short headers.

    #BESTPOSA,port,sequence,idle,time status,week,seconds,...;field,field,...*crc     ASCII; % for short headers
    AA 44 12, header length, id, ..., length, ..., time status, week, ms, payload, crc   binary
    AA 44 13, length, id, week, ms, payload, crc                                         binary, short header

The checksum is a CRC-32 without inversions. A log counts where it is right, wherever it stands: between others, in
packets of a capture.

Reference: NovAtel, OEM7 Commands and Logs Reference Manual, "Messages" and "32-Bit CRC".
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS
from recon.tables import Array

Raw: TypeAlias = Any
"""bytes, or a file in memory (mmap)."""

LONGEST: Final = 4096
_ASCII: Final = re.compile(rb"([#%])([A-Z0-9]{3,24}A),([^;*#%\r\n]{1,200});([^*#%\r\n]{1,2000})\*([0-9a-fA-F]{8})")
_SYNC: Final = re.compile(rb"\xaa\x44[\x12\x13]")
_UNKNOWN_TIME: Final = 20
_WORDS: Final = {
    "SOL_COMPUTED": 0.0,
    "INSUFFICIENT_OBS": 1.0,
    "INS_INACTIVE": 0.0,
    "INS_ALIGNING": 1.0,
    "INS_HIGH_VARIANCE": 2.0,
    "INS_SOLUTION_GOOD": 3.0,
    "INS_SOLUTION_FREE": 6.0,
    "INS_ALIGNMENT_COMPLETE": 7.0,
    "DETERMINING_ORIENTATION": 8.0,
}
"""Words of ASCII logs by their numbers in binary ones; others count as no solution."""


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a log are: struct of the binary payload, indices of the fields in ASCII."""

    binary: struct.Struct
    fields: tuple[int, ...]


_POS: Final = Layout(struct.Struct("<I4xdddf4xfff12xB"), (0, 2, 3, 4, 5, 7, 8, 9, 13))
_VEL: Final = Layout(struct.Struct("<I4xf4xddd"), (0, 2, 4, 5, 6))
_PVA: Final = Layout(struct.Struct("<4x8xdddddddddI"), (2, 3, 4, 5, 6, 7, 8, 9, 10, 11))
_PVAX: Final = Layout(struct.Struct("<I4xdddfdddddd"), (0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11))
_IMU: Final = Layout(struct.Struct("<4x8xdddddd"), (2, 3, 4, 5, 6, 7))
LOGS: Final[Mapping[str, tuple[int, Layout]]] = {
    "BESTPOS": (42, _POS),
    "BESTGNSSPOS": (1429, _POS),
    "BESTVEL": (99, _VEL),
    "BESTGNSSVEL": (1430, _VEL),
    "INSPVA": (507, _PVA),
    "INSPVAS": (508, _PVA),
    "INSPVAX": (1465, _PVAX),
    "CORRIMUDATA": (812, _IMU),
    "CORRIMUDATAS": (813, _IMU),
}
_BY_ID: Final = {number: name for name, (number, _) in LOGS.items()}


@dataclass
class Found:
    """Logs of a file: times in GPS ns since 1970 and numbers, by name; counts of all by name or id; damaged ones."""

    times: dict[str, array[int]] = field(default_factory=dict)
    numbers: dict[str, array[float]] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    damaged: int = 0

    def add(self, name: str, gps_ns: int, values: tuple[float, ...]) -> None:
        """One more log that is read."""
        self.times.setdefault(name, array("q")).append(gps_ns)
        self.numbers.setdefault(name, array("d")).extend(values)

    def rows(self, *names: str) -> tuple[NDArray[np.int64], Array]:
        """Times (n,) and numbers (n, k) of the first of several logs that is there; (0,) and (0, k) for none."""
        for name in names:
            if name in self.times:
                width = len(LOGS[name][1].fields)
                return np.array(self.times[name], dtype=np.int64), np.array(self.numbers[name]).reshape(-1, width)
        return np.zeros(0, dtype=np.int64), np.zeros((0, len(LOGS[names[0]][1].fields)))


def read_logs(path: Path) -> Found:
    """All logs of a file whose checksum is right."""
    with path.open("rb") as file:
        if not path.stat().st_size:
            return Found()
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
            return find_logs(raw)


def find_logs(raw: Raw) -> Found:
    """All logs in some bytes whose checksum is right."""
    found = Found()
    end = 0
    for match in _SYNC.finditer(raw):
        if match.start() >= end:
            end = max(end, _binary(raw, match.start(), found))
    for match in _ASCII.finditer(raw):
        _ascii(match, found)
    return found


def _crc(data: bytes) -> int:
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _binary(raw: Raw, start: int, found: Found) -> int:
    """Take the log that begins at a place; where it ends, the place itself where there is none."""
    head = bytes(raw[start : start + 28])
    if len(head) < 12:
        found.damaged += 1
        return start
    short = head[2] == 0x13
    if not short and len(head) < 28:
        found.damaged += 1
        return start
    size, length = (12, head[3]) if short else (head[3], int.from_bytes(head[8:10], "little"))
    end = start + size + length
    whole = bytes(raw[start : end + 4]) if length <= LONGEST else b""
    if size < 12 or len(whole) != size + length + 4 or _crc(whole[:-4]) != int.from_bytes(whole[-4:], "little"):
        found.damaged += 1
        return start
    number = int.from_bytes(head[4:6], "little")
    week, milliseconds = struct.unpack_from("<HI", head, 6 if short else 14)
    timed = week > 0 and (short or head[13] > _UNKNOWN_TIME)
    _keep(_BY_ID.get(number, f"id {number}"), GPS_EPOCH_NS + week * WEEK_NS + milliseconds * 1_000_000, timed, found,
          lambda layout: layout.binary.unpack_from(whole, size) if length >= layout.binary.size else None)  # fmt: skip
    return end + 4


def _ascii(match: re.Match[bytes], found: Found) -> None:
    """Take a log in ASCII."""
    if _crc(match[0][1:-9]) != int(match[5], 16):
        found.damaged += 1
        return
    head = match[3].split(b",")
    week, seconds = (head[4], head[5]) if match[1] == b"#" and len(head) > 5 else (head[0], head[-1])
    gps_ns = _gps_ns(week, seconds)
    timed = gps_ns is not None and b"UNKNOWN" not in head
    values = match[4].split(b",")
    _keep(match[2].decode()[:-1], gps_ns or 0, timed, found, lambda layout: _numbers(values, layout))


def _keep(
    name: str, gps_ns: int, timed: bool, found: Found, numbers: Callable[[Layout], tuple[float, ...] | None]
) -> None:
    found.counts[name] += 1
    if name in LOGS and timed:
        values = numbers(LOGS[name][1])
        if values is not None:
            found.add(name, gps_ns, values)


def _gps_ns(week: bytes, seconds: bytes) -> int | None:
    """GPS time of texts, through whole numbers alone; None where they are none."""
    whole, _, part = seconds.partition(b".")
    if not (week.isdigit() and whole.isdigit() and len(week) < 6 and len(whole) < 7 and (part.isdigit() or not part)):
        return None
    return GPS_EPOCH_NS + int(week) * WEEK_NS + int(whole) * NS + int(part[:9].ljust(9, b"0"))


def _numbers(values: list[bytes], layout: Layout) -> tuple[float, ...] | None:
    if len(values) <= max(layout.fields):
        return None
    return tuple(_number(values[index].strip()) for index in layout.fields)


def _number(text: bytes) -> float:
    try:
        return float(text)
    except ValueError:
        return _WORDS.get(text.decode("ascii", "replace"), 99.0)
