"""Messages of u-blox receivers (UBX) in any bytes, by class and number, columnar.

    B5 62, class, number, length (2 bytes), payload, checksum A, B

The checksum is that of Fletcher with 8 bits over class to payload: A = sum b_i, B = sum (n - i) b_i. With running sums
P_k = sum_{i<k} b_i and Q_k = sum_{i<=k} P_i, all modulo 256, that of bytes s to e is

    A = P_e - P_s,    B = Q_e - Q_s - (e - s) P_s,

so all candidates of a block are checked at once, and a message counts wherever it stands: among sentences of NMEA,
behind a message that was cut off, inside one whose length is damaged.

Reference: u-blox, F9 HPG 1.32 interface description, 3.2 and 3.4; u-blox M8 receiver description, 32.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

BLOCK: Final = 1 << 23
HEAD: Final = 6
LONGEST: Final = 8192
"""Bytes of a payload; receivers write no longer ones."""

Bytes: TypeAlias = NDArray[np.uint8]
Places: TypeAlias = NDArray[np.int64]
Kind: TypeAlias = tuple[int, int]
"""Class and number of a message."""

_DATE: Final = [("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"), ("min", "u1"), ("sec", "u1")]
_LLH: Final = [("lon", "<i4"), ("lat", "<i4"), ("height", "<i4"), ("msl", "<i4"), ("h_acc", "<u4"), ("v_acc", "<u4")]
_VEL: Final = [("vel_n", "<i4"), ("vel_e", "<i4"), ("vel_d", "<i4")]
LAYOUTS: Final[dict[str, tuple[Kind, np.dtype[np.void]]]] = {
    "NAV-PVT": (
        (0x01, 0x07),
        np.dtype(
            [("tow", "<u4"), *_DATE, ("valid", "u1"), ("t_acc", "<u4"), ("nano", "<i4"), ("fix", "u1"),
             ("flags", "u1"), ("flags2", "u1"), ("sats", "u1"), *_LLH, *_VEL, ("speed", "<i4"), ("course", "<i4"),
             ("s_acc", "<u4"), ("c_acc", "<u4")]
        ),
    ),
    "NAV-PVAT": (
        (0x01, 0x17),
        np.dtype(
            [("tow", "<u4"), ("version", "u1"), ("valid", "u1"), *_DATE, ("", "u1", 3), ("t_acc", "<u4"),
             ("nano", "<i4"), ("fix", "u1"), ("flags", "u1"), ("flags2", "u1"), ("sats", "u1"), *_LLH, *_VEL,
             ("speed", "<i4"), ("s_acc", "<u4"), ("roll", "<i4"), ("pitch", "<i4"), ("heading", "<i4"),
             ("course", "<i4")]
        ),
    ),
    "HNR-PVT": (
        (0x28, 0x00),
        np.dtype(
            [("tow", "<u4"), *_DATE, ("valid", "u1"), ("nano", "<i4"), ("fix", "u1"), ("flags", "u1"), ("", "u1", 2),
             *_LLH[:4], ("speed", "<i4"), ("speed3", "<i4"), ("course", "<i4"), ("heading", "<i4"), *_LLH[4:],
             ("s_acc", "<u4"), ("c_acc", "<u4")]
        ),
    ),
    "NAV-POSLLH": ((0x01, 0x02), np.dtype([("tow", "<u4"), *_LLH])),
    "NAV-HPPOSLLH": (
        (0x01, 0x14),
        np.dtype(
            [("version", "u1"), ("", "u1", 2), ("flags", "u1"), ("tow", "<u4"), *_LLH[:4], ("lon_hp", "i1"),
             ("lat_hp", "i1"), ("height_hp", "i1"), ("msl_hp", "i1"), *_LLH[4:]]
        ),
    ),
    "NAV-VELNED": (
        (0x01, 0x12),
        np.dtype([("tow", "<u4"), *_VEL, ("speed3", "<u4"), ("speed", "<u4"), ("course", "<i4"), ("s_acc", "<u4")]),
    ),
    "NAV-SOL": (
        (0x01, 0x06),
        np.dtype([("tow", "<u4"), ("ftow", "<i4"), ("week", "<i2"), ("fix", "u1"), ("flags", "u1"), ("", "u1", 35),
                  ("sats", "u1")]),
    ),
    "NAV-STATUS": ((0x01, 0x03), np.dtype([("tow", "<u4"), ("fix", "u1"), ("flags", "u1")])),
    "NAV-TIMEGPS": (
        (0x01, 0x20),
        np.dtype([("tow", "<u4"), ("ftow", "<i4"), ("week", "<i2"), ("leap", "i1"), ("valid", "u1")]),
    ),
}  # fmt: skip
"""Class and number, and the beginning of the payload, which later versions of a message only extend."""
ESF_MEAS: Final = (0x10, 0x02)
ESF_RAW: Final = (0x10, 0x03)


class Messages:
    """The payloads of a file by kind, in their order, with the place of each; and what else was seen."""

    def __init__(self) -> None:
        self.counts: Counter[Kind] = Counter()
        self.damaged = 0
        self._payloads: dict[Kind, list[tuple[Places, Bytes]]] = {}

    def add(self, kind: Kind, places: Places, payloads: Bytes) -> None:
        """Keep payloads of one kind: (m, k) bytes."""
        self._payloads.setdefault(kind, []).append((places, payloads))

    def rows(self, name: str) -> tuple[Places, NDArray[np.void]]:
        """Take out places (n,) and fields (n,) of the messages of a name in LAYOUTS, of length zero for none."""
        kind, layout = LAYOUTS[name]
        parts = [(places, np.ascontiguousarray(p).view(layout)[:, 0]) for places, p in self._payloads.pop(kind, [])]
        if not parts:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=layout)
        return np.concatenate([places for places, _ in parts]), np.concatenate([rows for _, rows in parts])

    def raw(self, kind: Kind) -> list[tuple[Places, Bytes]]:
        """Places (m,) and payloads (m, k) of a kind; its messages may differ in length k."""
        return self._payloads.get(kind, [])


def read_messages(path: Path) -> Messages:
    """All messages of a file whose checksum is right. Those that are not read are only counted."""
    found = Messages()
    rest, offset = b"", 0
    with path.open("rb") as file:
        while True:
            more = file.read(BLOCK)
            block = rest + more
            used = _take(block, offset, found, last=not more)
            rest, offset = block[used:], offset + used
            if not more:
                return found


def count_messages(head: bytes) -> Counter[Kind]:
    """Kinds of the messages with right checksums in some bytes."""
    found = Messages()
    _take(head, 0, found, last=True)
    return found.counts


def _take(block: bytes, offset: int, found: Messages, *, last: bool) -> int:
    """Take the messages of a block; how many of its bytes are done with."""
    data = np.frombuffer(block, dtype=np.uint8)
    starts = np.flatnonzero((data[:-1] == 0xB5) & (data[1:] == 0x62)) if len(data) > 1 else np.zeros(0, np.int64)
    done = len(block)
    if not last:
        open_ended = max(len(block) - LONGEST - HEAD - 2, 0)
        waiting = starts[starts >= open_ended]
        done = int(waiting[0]) if len(waiting) else len(block) - 1
        starts = starts[starts < done]
    starts = starts[starts + HEAD + 2 <= len(data)]
    lengths = data[starts + 4].astype(np.int64) | (data[starts + 5].astype(np.int64) << 8)
    whole = (lengths <= LONGEST) & (starts + HEAD + 2 + lengths <= len(data))
    right = np.zeros(len(starts), dtype=bool)
    right[whole] = _right(data, starts[whole] + 2, starts[whole] + HEAD + lengths[whole])
    kept = _outermost(starts, lengths, right)
    found.damaged += int((~right & ~_inside(starts, starts[kept], lengths[kept])).sum())
    _sort(data, starts[kept], lengths[kept], offset, found)
    return done


def _right(data: Bytes, begins: Places, ends: Places) -> NDArray[np.bool_]:
    """Do the two bytes behind `ends` hold the checksum of the bytes from `begins` on? (n,) bool"""
    one = np.concatenate([np.zeros(1, np.uint8), np.cumsum(data, dtype=np.uint8)])
    two = np.cumsum(one, dtype=np.uint8)
    a = one[ends] - one[begins]
    b = two[ends] - two[begins] - (ends - begins).astype(np.uint8) * one[begins]
    return np.asarray((a == data[ends]) & (b == data[ends + 1]))


def _outermost(starts: Places, lengths: Places, right: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Indices of the messages that do not lie inside one before them."""
    rows = np.flatnonzero(right)
    ends = starts[rows] + HEAD + 2 + lengths[rows]
    if not len(rows) or (starts[rows][1:] >= ends[:-1]).all():
        return rows
    kept, end = [], 0
    for row, start, stop in zip(rows.tolist(), starts[rows].tolist(), ends.tolist(), strict=True):
        if start >= end:
            kept.append(row)
            end = stop
    return np.array(kept, dtype=np.intp)


def _inside(points: Places, starts: Places, lengths: Places) -> NDArray[np.bool_]:
    """Does each point lie in one of the messages? (n,) bool"""
    if not len(starts):
        return np.zeros(len(points), dtype=bool)
    before = np.searchsorted(starts, points, side="right") - 1
    return np.asarray((before >= 0) & (points < (starts + lengths + HEAD + 2)[before]))


def _sort(data: Bytes, starts: Places, lengths: Places, offset: int, found: Messages) -> None:
    """Count the messages and keep the payloads of those that are read."""
    kinds = (data[starts + 2].astype(np.int64) << 8) | data[starts + 3]
    for code, count in zip(*(part.tolist() for part in np.unique(kinds, return_counts=True)), strict=True):
        found.counts[(code >> 8, code & 0xFF)] += count
    for kind, layout in LAYOUTS.values():
        rows = (kinds == (kind[0] << 8 | kind[1])) & (lengths >= layout.itemsize)
        if rows.any():
            found.add(kind, offset + starts[rows], _bytes_at(data, starts[rows] + HEAD, layout.itemsize))
    for kind in (ESF_MEAS, ESF_RAW):
        own = kinds == (kind[0] << 8 | kind[1])
        for length in np.unique(lengths[own]).tolist():
            rows = own & (lengths == length)
            found.add(kind, offset + starts[rows], _bytes_at(data, starts[rows] + HEAD, length))


def _bytes_at(data: Bytes, places: Places, count: int) -> Bytes:
    """So many bytes from each place on: (n, count)."""
    return sliding_window_view(data, count)[places] if count else np.zeros((len(places), 0), dtype=np.uint8)
