"""Messages of MAVLink, versions 1 and 2, in logs of ground stations (.tlog), as columns.

    record     time of reception, 8 bytes, us since 1970, highest byte first; then a frame
    frame v1   0xFE, length, sequence, system, component, number (1 byte), payload, checksum
    frame v2   0xFD, length, two flags, sequence, system, component, number (3 bytes), payload, checksum, signature

Zeros at the end of a v2 payload are left away. A frame counts if its checksum is right; behind damaged bytes the next
frame is searched.

Reference: mavlink.io/en/guide/serialization.html; message definitions common.xml.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from recon.tables import Array
from recon_readers._columns import Grown
from recon_readers._windows import walk_through

V1, V2 = 0xFE, 0xFD
_MARK: Final = re.compile(b"[\xfd\xfe]")
_WINDOW: Final = 2**22
_LONGEST: Final = 8 + 10 + 255 + 2 + 13
EARLIEST_US, LATEST_US = 946_684_800 * 10**6, 4_102_444_800 * 10**6
"""2000 to 2100."""


@dataclass(frozen=True)
class Message:
    """A message of the definitions: number, seed of its checksum, fields in the order in which they are sent."""

    name: str
    number: int
    seed: int
    fields: np.dtype[np.void]


def _message(name: str, number: int, seed: int, fields: str) -> Message:
    """fields : "u8 time_usec, i2 xacc yacc zacc, ..." """
    parts = [part.split() for part in fields.split(",")]
    return Message(name, number, seed, np.dtype([(one, f"<{kind}") for kind, *names in parts for one in names]))


_SCALED: Final = "u4 time_boot_ms, i2 xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag temperature"
_PRESSURE: Final = "u4 time_boot_ms, f4 press_abs press_diff, i2 temperature temperature_press_diff"
MESSAGES: Final = (
    _message("HEARTBEAT", 0, 50, "u4 custom_mode, u1 type autopilot base_mode system_status mavlink_version"),
    _message("SYSTEM_TIME", 2, 137, "u8 time_unix_usec, u4 time_boot_ms"),
    _message(
        "GPS_RAW_INT",
        24,
        24,
        "u8 time_usec, i4 lat lon alt, u2 eph epv vel cog, u1 fix_type satellites_visible, i4 alt_ellipsoid, "
        "u4 h_acc v_acc vel_acc hdg_acc, u2 yaw",
    ),
    _message("SCALED_IMU", 26, 170, _SCALED),
    _message(
        "RAW_IMU",
        27,
        144,
        "u8 time_usec, i2 xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag, u1 id, i2 temperature",
    ),
    _message("SCALED_PRESSURE", 29, 115, _PRESSURE),
    _message("ATTITUDE", 30, 39, "u4 time_boot_ms, f4 roll pitch yaw rollspeed pitchspeed yawspeed"),
    _message("GLOBAL_POSITION_INT", 33, 104, "u4 time_boot_ms, i4 lat lon alt relative_alt, i2 vx vy vz, u2 hdg"),
    _message(
        "HIGHRES_IMU",
        105,
        93,
        "u8 time_usec, f4 xacc yacc zacc xgyro ygyro zgyro xmag ymag zmag abs_pressure diff_pressure pressure_alt "
        "temperature, u2 fields_updated, u1 id",
    ),
    _message("SCALED_IMU2", 116, 76, _SCALED),
    _message("SCALED_IMU3", 129, 46, _SCALED),
)


_BY_NUMBER: Final = {one.number: one for one in MESSAGES}
TIMES: Final = ("time_usec", "time_boot_ms")
"""Fields that every message has one of, but HEARTBEAT."""


class Table:
    """Fields of the messages of one name, sender and sensor: (n,) each, and (n,) us of reception since 1970."""

    def __init__(self, message: Message, fields: Collection[str]) -> None:
        names = [name for name in message.fields.names or () if name in {*TIMES, *fields}]
        self._columns = {name: Grown(message.fields[name], 1024) for name in names}
        self._received = Grown(np.int64, 1024)

    def add(self, received_us: NDArray[np.int64], rows: NDArray[np.void]) -> None:
        """More messages."""
        self._received.add(received_us)
        for name, column in self._columns.items():
            column.add(rows[name])

    def __len__(self) -> int:
        return len(self._received.all)

    def __contains__(self, name: str) -> bool:
        return name in self._columns

    @property
    def received_ns(self) -> NDArray[np.int64]:
        """(n,) ns since 1970 at which the messages were received."""
        return np.asarray(self._received.all * 1000)

    def numbers(self, name: str) -> Array:
        """A field as (n,) float64. It is given once and then no longer kept."""
        with np.errstate(invalid="ignore"):  # a damaged float may be a NaN that signals
            return np.asarray(self._columns.pop(name).all.astype(np.float64))

    def integers(self, name: str) -> NDArray[np.int64]:
        """A field of whole numbers as (n,) int64."""
        return np.asarray(self._columns[name].all.astype(np.int64))


@dataclass
class Walk:
    """What was found: messages by name, sender and sensor; frames, those of a wrong checksum, places without a frame.

    wanted : the fields that are kept of a message, by its name
    """

    wanted: Mapping[str, Collection[str]]
    found: dict[tuple[str, int, int], Table] = field(default_factory=dict)
    frames: int = 0
    wrong: int = 0
    damaged: int = 0

    def tables(self) -> tuple[dict[str, Table], int]:
        """The messages of the sender that sent most, by name, those of a second sensor as "NAME 2".

        Also how many messages others sent: a gimbal has an IMU and a clock of its own.
        """
        counts: dict[int, int] = {}
        for (_, sender, _), table in self.found.items():
            counts[sender] = counts.get(sender, 0) + len(table)
        chosen = max(counts, key=lambda sender: counts[sender], default=0)
        others = sum(len(t) for (name, sender, _), t in self.found.items() if sender != chosen and name != "HEARTBEAT")
        return {
            f"{name} {sensor + 1}" if sensor else name: table
            for (name, sender, sensor), table in sorted(self.found.items(), key=lambda each: each[0])
            if sender == chosen
        }, others

    def take(self, message: Message, sender: int, received_us: NDArray[np.int64], rows: NDArray[np.void]) -> None:
        """Keep messages, each with those of its sensor."""
        sensors = rows["id"] if "id" in (rows.dtype.names or ()) else np.zeros(len(rows), dtype=np.uint8)
        for sensor in np.unique(sensors).tolist():
            own = sensors == sensor
            key = message.name, sender, sensor
            self.found.setdefault(key, Table(message, self.wanted[message.name])).add(received_us[own], rows[own])


def walk(path: Path, wanted: Mapping[str, Collection[str]]) -> Walk:
    """All whole messages of these names, of each its times and these fields."""
    found = Walk(wanted)
    walk_through(path, _WINDOW, partial(_take, found))
    return found


def frame_at(window: bytes, at: int) -> tuple[int, int, int, int] | None:
    """(number, sender, start of the payload, its length) of the record at `at`; None where there is none.

    The sender is 256 times its system, and its component.
    """
    if at + 18 > len(window):
        return None
    received_us = int.from_bytes(window[at : at + 8], "big")
    if not EARLIEST_US < received_us < LATEST_US:
        return None
    length = window[at + 9]
    if window[at + 8] == V1:
        number, sender, start = window[at + 13], 256 * window[at + 11] + window[at + 12], at + 14
    elif window[at + 8] == V2:
        number, start = int.from_bytes(window[at + 15 : at + 18], "little"), at + 18
        sender = 256 * window[at + 13] + window[at + 14]
    else:
        return None
    return (number, sender, start, length) if end_of(window, at, start, length) <= len(window) else None


def end_of(window: bytes, at: int, start: int, length: int) -> int:
    """Where the record ends."""
    signed = window[at + 8] == V2 and window[at + 10] & 1
    return start + length + 2 + (13 if signed else 0)


def _take(found: Walk, window: bytes, *, last: bool) -> int:
    at, end = 0, len(window) if last else len(window) - _LONGEST
    places: dict[tuple[int, int, int, int], array[int]] = {}  # by number, sender, version, length
    while at < end:
        frame = frame_at(window, at)
        if frame is None:
            found.damaged += 1
            at = _next(window, at + 1)
            continue
        number, sender, start, length = frame
        found.frames += 1
        if number in _BY_NUMBER and _BY_NUMBER[number].name in found.wanted:
            places.setdefault((number, sender, window[at + 8], length), array("q")).append(at)
        at = end_of(window, at, start, length)
    for (number, sender, version, length), offsets in places.items():
        _gather(window, np.frombuffer(offsets, dtype=np.int64), found, number, sender, version, length)
    return at


def _next(window: bytes, at: int) -> int:
    """Where the next record may begin."""
    mark = _MARK.search(window, at + 8)
    return mark.start() - 8 if mark else max(len(window) - 8, at)


def _gather(
    window: bytes, at: NDArray[np.int64], found: Walk, number: int, sender: int, version: int, length: int
) -> None:
    message = _BY_NUMBER[number]
    head = 6 if version == V1 else 10
    data = np.frombuffer(window, dtype=np.uint8)
    frames = sliding_window_view(data, head + length + 2)[at + 8]
    told = frames[:, -2] + 256 * frames[:, -1].astype(np.uint16)
    right = checksum(frames[:, 1 : head + length], message.seed) == told
    found.wrong += int((~right).sum())
    size = message.fields.itemsize
    padded = np.zeros((int(right.sum()), size), dtype=np.uint8)
    taken = min(size, length)
    padded[:, :taken] = frames[right, head : head + taken]
    received = sliding_window_view(data, 8)[at[right]].view(">u8")[:, 0]
    found.take(message, sender, received.astype(np.int64), padded.view(message.fields)[:, 0])


def checksum(data: NDArray[np.uint8], seed: int) -> NDArray[np.uint16]:
    """CRC-16/MCRF4XX of each row and the seed: (n,). data : (n, k)"""
    crc = np.full(len(data), 0xFFFF, dtype=np.uint16)
    for column in [*data.T, np.full(len(data), seed, dtype=np.uint8)]:
        low = column ^ (crc & 0xFF).astype(np.uint8)
        low = low ^ (low << 4)
        wide = low.astype(np.uint16)
        crc = (crc >> 8) ^ (wide << 8) ^ (wide << 3) ^ (wide >> 4)
    return crc
