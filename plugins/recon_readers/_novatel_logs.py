"""Logs of NovAtel receivers in any bytes: ASCII and binary, with long and with short headers.

    #BESTPOSA,port,sequence,idle,time status,week,seconds,...;field,field,...*crc     ASCII; % for short headers
    AA 44 12, header length, id, ..., length, ..., time status, week, ms, payload, crc   binary
    AA 44 13, length, id, week, ms, payload, crc                                         binary, short header

The checksum is a CRC-32 without inversions. A log counts where it is right, wherever it stands: between others, in
packets of a capture.

Reference: NovAtel, OEM7 Commands and Logs Reference Manual, "Messages" and "32-Bit CRC".
"""

from __future__ import annotations

import re
import struct
import zlib
from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS
from recon_readers._columns import Columns, Grown

LONGEST: Final = 4096
"""Bytes of a binary payload."""
_LONGEST_WHOLE: Final = 2 * LONGEST
"""Bytes of a log with header and checksum, of either kind."""
BLOCK: Final = 1 << 22
_AT_ONCE: Final = 1 << 14
_ASCII: Final = re.compile(rb"([#%])([A-Z0-9]{3,24}A),([^;*#%\r\n]{1,200});([^*#%\r\n]{1,2000})\*([0-9a-fA-F]{8})")
_SYNC: Final = re.compile(rb"\xaa\x44[\x12\x13]")
_UNKNOWN_TIME: Final = 20
_LAST_WEEK: Final = 10_000
"""Far beyond 2100; receivers that know no week may write 65535."""
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
    """Where the numbers of a log are: struct of the binary payload, indices of the fields in ASCII; and their names."""

    binary: struct.Struct
    fields: tuple[int, ...]
    names: tuple[str, ...]


_PLACE: Final = ("lat", "lon", "height")
_SIGMAS: Final = ("pos_std_n", "pos_std_e", "pos_std_u")
_MOTION: Final = ("vel_n", "vel_e", "vel_u", "roll", "pitch", "azimuth")
_POS: Final = Layout(
    struct.Struct("<I4xdddf4xfff13xB"),
    (0, 2, 3, 4, 5, 7, 8, 9, 14),
    ("status", *_PLACE, "undulation", *_SIGMAS, "satellites"),
)
_VEL: Final = Layout(
    struct.Struct("<I4xf4xddd"), (0, 2, 4, 5, 6), ("status", "latency", "speed", "course", "vertical_speed")
)
_PVA: Final = Layout(struct.Struct("<4x8xdddddddddI"), (2, 3, 4, 5, 6, 7, 8, 9, 10, 11), (*_PLACE, *_MOTION, "status"))
_PVAX: Final = Layout(
    struct.Struct("<I4xdddfdddddd"),
    (0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11),
    ("status", *_PLACE, "undulation", *_MOTION),
)
_INCREMENTS: Final = ("pitch_rate", "roll_rate", "yaw_rate", "lateral", "longitudinal", "vertical")
_IMU: Final = Layout(struct.Struct("<4xddddddd"), (1, 2, 3, 4, 5, 6, 7), ("seconds", *_INCREMENTS))
_COUNTED: Final = Layout(struct.Struct("<Idddddd"), (0, 1, 2, 3, 4, 5, 6), ("samples", *_INCREMENTS))
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
    "IMURATECORRIMUS": (1362, _IMU),
    "CORRIMUS": (2264, _COUNTED),
}
RAW: Final[Mapping[str, int]] = {"RAWIMU": 268, "RAWIMUS": 325, "RAWIMUX": 1461, "RAWIMUSX": 1462}
"""Logs in counts of each IMU, which are named and not read."""
_BY_ID: Final = {number: name for name, number in RAW.items()} | {number: name for name, (number, _) in LOGS.items()}


class _Rows:
    """Logs of one kind, a row each, which are made into columns some thousands at a time."""

    def __init__(self, layout: Layout) -> None:
        self._names = layout.names
        self._times = array("q")
        self._numbers = array("d")
        self._columns = {"time": Grown(np.int64, _AT_ONCE), **{n: Grown(np.float64, _AT_ONCE) for n in layout.names}}

    def add(self, gps_ns: int, values: tuple[float, ...]) -> None:
        """One more log."""
        self._times.append(gps_ns)
        self._numbers.extend(values)
        if len(self._times) >= _AT_ONCE:
            self._flush()

    def columns(self) -> Columns:
        """All of them: `time` in GPS ns since 1970, and the numbers by name."""
        self._flush()
        return Columns(self._columns)

    def _flush(self) -> None:
        numbers = np.array(self._numbers).reshape(-1, len(self._names))
        self._columns["time"].add(np.array(self._times, dtype=np.int64))
        for name, values in zip(self._names, numbers.T, strict=True):
            self._columns[name].add(values)
        self._times, self._numbers = array("q"), array("d")


@dataclass
class Found:
    """Logs of a file: those that are read, by name; counts of all by name or id; damaged ones."""

    logs: dict[str, _Rows] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    damaged: int = 0

    def add(self, name: str, gps_ns: int, values: tuple[float, ...]) -> None:
        """One more log that is read."""
        if name not in self.logs:
            self.logs[name] = _Rows(LOGS[name][1])
        self.logs[name].add(gps_ns, values)

    def columns(self, *names: str) -> Columns:
        """The columns of the first of several logs that is there, `time` in GPS ns among them; none where none is."""
        return next((self.logs.pop(name).columns() for name in names if name in self.logs), Columns({}))


def read_logs(path: Path) -> Found:
    """All logs of a file whose checksum is right."""
    found = Found()
    rest, end = b"", 0
    with path.open("rb") as file:
        while piece := file.read(BLOCK):
            block = rest + piece
            stop = max(len(block) - _LONGEST_WHOLE, 0)
            end = max(_take(block, end, stop, found) - stop, 0)
            rest = block[stop:]
    _take(rest, end, len(rest), found)
    return found


def find_logs(raw: bytes) -> Found:
    """All logs in some bytes whose checksum is right."""
    found = Found()
    _take(raw, 0, len(raw), found)
    return found


def _take(raw: bytes, end: int, stop: int, found: Found) -> int:
    """Take the logs that begin before an offset; where the last binary one ends.

    end : where the last binary one before ended
    """
    for match in _SYNC.finditer(raw, end, min(stop + 2, len(raw))):
        if match.start() >= end:
            end = max(end, _binary(raw, match.start(), found))
    for match in _ASCII.finditer(raw):
        if match.start() < stop:
            _ascii(match, found)
    return end


def _crc(data: bytes) -> int:
    return zlib.crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF


def _binary(raw: bytes, start: int, found: Found) -> int:
    """Take the log that begins at a place; where it ends, the place itself where there is none."""
    head = raw[start : start + 28]
    if len(head) < 12:
        found.damaged += 1
        return start
    short = head[2] == 0x13
    if not short and len(head) < 28:
        found.damaged += 1
        return start
    size, length = (12, head[3]) if short else (head[3], int.from_bytes(head[8:10], "little"))
    end = start + size + length
    whole = raw[start : end + 4] if length <= LONGEST else b""
    if size < 12 or len(whole) != size + length + 4 or _crc(whole[:-4]) != int.from_bytes(whole[-4:], "little"):
        found.damaged += 1
        return start
    number = int.from_bytes(head[4:6], "little")
    week, milliseconds = struct.unpack_from("<HI", head, 6 if short else 14)
    timed = 0 < week < _LAST_WEEK and (short or head[13] > _UNKNOWN_TIME)
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
    timed = gps_ns is not None and b"UNKNOWN" not in head and 0 < int(week) < _LAST_WEEK
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
