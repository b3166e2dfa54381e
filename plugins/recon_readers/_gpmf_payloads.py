"""Payloads of GoPro's metadata (GPMF): where they are in an MP4, and the measurements in them.

    key (4 letters), type (1), size of a sample (1), count of samples (2), samples, padded to 4 bytes; big-endian

Type 0 is a nest of such entries: DEVC (a device) holds STRM (streams), a stream holds what describes its data before
the data: SCAL (divisors), ORIN (axes), STMP (us of its first sample), GPSU (UTC), GPSF (fix). In an MP4 the payloads,
of about one second each, are the samples of a track of format `gpmd`, whose tables tell their places and durations.

References: GoPro, gpmf-parser, README (format); ISO/IEC 14496-12 (boxes stts, stsz, stsc, stco, co64).
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.tables import Array

NS: Final = 1_000_000_000
WANTED: Final = ("ACCL", "GYRO", "GPS5", "GPS9")
LARGEST: Final = 1 << 26
"""Bytes of a box of tables, and of a payload."""
_TYPES: Final = {
    "b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "j": ">i8", "J": ">u8", "f": ">f4", "d": ">f8"
}  # fmt: skip
_DEPTH: Final = 4
_DEVICE: Final = re.compile(rb"DEVC\0(.)(..)DVID....(.{4})", re.DOTALL)


@dataclass(frozen=True)
class Place:
    """Where a payload is: offset and size in bytes; start and duration in ns, None where only the data tell."""

    offset: int
    size: int
    start_ns: int | None
    duration_ns: int | None


@dataclass(frozen=True)
class Data:
    """Measurements of one stream in one payload: (n, k) scaled; what describes them, by key."""

    values: Array
    about: Mapping[str, bytes]

    def text(self, key: str) -> str:
        """A description as text, "" where it is not there."""
        return self.about.get(key, b"").decode("latin-1").strip("\0 ")

    def whole(self, key: str) -> int | None:
        """A description as a whole number, None where it is not there."""
        raw = self.about.get(key, b"")
        return int.from_bytes(raw, "big") if 0 < len(raw) <= 8 else None


def is_mp4(head: bytes) -> bool:
    """Do the bytes begin as an MP4?"""
    return head[4:8] in (b"ftyp", b"mdat", b"moov", b"free", b"wide", b"skip")


def payloads(path: Path, head: bytes) -> list[Place]:
    """Where the payloads of a file are, in their order.

    Of an MP4 that was not closed, or whose index is damaged, they are searched for. Raises ReadFailed where there are
    none.
    """
    if not is_mp4(head):
        return _scattered(path)
    try:
        with path.open("rb") as file:
            return _in_mp4(path, file, path.stat().st_size)
    except ReadFailed:
        found = _scattered(path)
        if not found:
            raise
        return found


def measurements(raw: bytes) -> dict[str, Data]:
    """The data of a payload by key, of the first device that has them. What is cut off is left out."""
    found: dict[str, Data] = {}
    for key, kind, _, _, device in _entries(raw):
        if key != "DEVC" or kind != 0:
            continue
        for inner, nest, _, _, body in _entries(device):
            if inner == "STRM" and nest == 0:
                _take_stream(body, found)
    return found


def _take_stream(body: bytes, found: dict[str, Data]) -> None:
    about: dict[str, bytes] = {}
    kinds: dict[str, str] = {}
    for key, kind, size, count, raw in _entries(body):
        if key in WANTED:
            values = _values(chr(kind), size, count, raw, about, kinds)
            if values is not None and key not in found:
                found[key] = Data(values, about)
        else:
            about[key], kinds[key] = raw, chr(kind)


def _entries(raw: bytes) -> Iterator[tuple[str, int, int, int, bytes]]:
    """Key, type, size, count and bytes of each whole entry."""
    at = 0
    while at + 8 <= len(raw):
        key, kind, size = raw[at : at + 4], raw[at + 4], raw[at + 5]
        count = int.from_bytes(raw[at + 6 : at + 8], "big")
        end = at + 8 + size * count
        if end > len(raw) or not key.isalnum():
            return
        yield key.decode("ascii", "replace"), kind, size, count, raw[at + 8 : end]
        at = end + (-size * count) % 4


def _values(
    kind: str, size: int, count: int, raw: bytes, about: Mapping[str, bytes], kinds: Mapping[str, str]
) -> Array | None:
    """Samples divided by their scale: (n, k); None where they cannot be decoded."""
    letters = about.get("TYPE", b"").decode("ascii", "replace").strip("\0") if kind == "?" else ""
    if kind in _TYPES and size:
        code = np.dtype(_TYPES[kind])
        if size % code.itemsize:
            return None
        values = np.frombuffer(raw, code).reshape(count, size // code.itemsize).astype(np.float64)
    elif letters and all(letter in _TYPES for letter in letters):
        layout = np.dtype([(str(index), _TYPES[letter]) for index, letter in enumerate(letters)])
        if layout.itemsize != size:
            return None
        rows = np.frombuffer(raw, layout)
        values = np.column_stack([rows[str(index)].astype(np.float64) for index in range(len(letters))])
    else:
        return None
    scale = _scale(about.get("SCAL", b""), kinds.get("SCAL", ""))
    if len(scale) not in (1, values.shape[1]) or not (np.abs(scale) > 0).all():
        return None
    return np.asarray(values / scale)


def _scale(raw: bytes, kind: str) -> Array:
    """The divisors, one where there are none."""
    code = np.dtype(_TYPES.get(kind, "u1"))
    whole = raw[: len(raw) // code.itemsize * code.itemsize]
    return np.frombuffer(whole, code).astype(np.float64) if kind in _TYPES and whole else np.ones(1)


# --- places ---------------------------------------------------------------------------------------------------------


def _scattered(path: Path) -> list[Place]:
    """Devices wherever they are; those of different ids that follow each other make one payload."""
    found: list[Place] = []
    if not path.stat().st_size:
        return found
    start, end = 0, -1
    seen: set[bytes] = set()
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        for match in _DEVICE.finditer(raw):
            if match.start() < end:
                continue
            if match.start() != end or match[3] in seen:
                found += [Place(start, end - start, None, None)] * (end > start)
                start, seen = match.start(), set()
            seen.add(match[3])
            length = match[1][0] * int.from_bytes(match[2], "big")
            end = min(match.start() + 8 + length + -length % 4, len(raw))
    return [*found, *([Place(start, end - start, None, None)] * (end > start))]


def _in_mp4(path: Path, file: BinaryIO, size: int) -> list[Place]:
    """By the tables of the track `gpmd`. Raises ReadFailed."""
    where = next((span for name, *span in _boxes(file, 0, size) if name == b"moov"), None)
    if where is None:
        hint = "the recording was not closed: let the camera repair it, or copy the card again"
        raise ReadFailed(path, "this MP4 has no index (moov)", hint=hint)
    for name, start, end in _boxes(file, *where):
        if name == b"trak":
            boxes = _tree(file, start, end)
            if b"gpmd" in boxes.get(b"stsd", b""):
                return _sorted_places(path, boxes, size)
    hint = "it is a video without measurements: was it cut or converted? Take the camera's original file"
    raise ReadFailed(path, "this MP4 has no track of GoPro's measurements (gpmd)", hint=hint)


def _boxes(file: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte of the contents and the byte behind them of each box."""
    while start + 8 <= end:
        file.seek(start)
        head = file.read(16)
        length, skip = int.from_bytes(head[:4], "big"), 8
        if length == 1:
            length, skip = int.from_bytes(head[8:16], "big"), 16
        length = end - start if length == 0 else length
        if length < skip or start + length > end:
            return
        yield head[4:8], start + skip, start + length
        start += length


def _tree(file: BinaryIO, start: int, end: int, depth: int = 0) -> dict[bytes, bytes]:
    """Contents of the boxes of a track by name."""
    found: dict[bytes, bytes] = {}
    for name, first, last in _boxes(file, start, end):
        if name in (b"mdia", b"minf", b"stbl") and depth < _DEPTH:
            found |= _tree(file, first, last, depth + 1)
        elif last - first <= LARGEST:
            file.seek(first)
            found[name] = file.read(last - first)
    return found


def _numbers(raw: bytes, at: int, code: str = ">u4") -> NDArray[np.int64]:
    """Whole numbers from a place on, as far as there are."""
    size = np.dtype(code).itemsize
    part = raw[at:]
    return np.frombuffer(part[: len(part) // size * size], code).astype(np.int64)


def _sorted_places(path: Path, boxes: Mapping[bytes, bytes], size: int) -> list[Place]:
    """Offsets and times of the samples of a track, from its tables. Raises ReadFailed where they are damaged."""
    header, table = boxes.get(b"mdhd", b""), _numbers(boxes.get(b"stsz", b""), 4)
    scale = int.from_bytes(header[20:24] if header[:1] == b"\x01" else header[12:16], "big")
    chunks = _numbers(boxes[b"stco"], 8) if b"stco" in boxes else _numbers(boxes.get(b"co64", b""), 8, ">i8")
    if len(table) < 2 or not scale or not len(chunks):
        raise ReadFailed(path, "the tables of its track gpmd are damaged", hint="copy the file again")
    sizes = table[2 : 2 + table[1]] if table[0] == 0 else np.full(min(int(table[1]), len(chunks) * 64), table[0])
    offsets = _offsets(_numbers(boxes.get(b"stsc", b""), 8), chunks, sizes)
    steps = _steps(_numbers(boxes.get(b"stts", b""), 8), len(sizes)) * NS // scale
    starts = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(steps)[:-1]])
    rows = zip(offsets.tolist(), sizes.tolist(), starts.tolist(), steps.tolist(), strict=False)
    return [Place(*row) for row in rows if row[0] >= 0 and 0 < row[1] <= LARGEST and row[0] + row[1] <= size]


def _offsets(runs: NDArray[np.int64], chunks: NDArray[np.int64], sizes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Offset of each sample: chunks hold as many as the runs (first chunk, samples, description) say."""
    first, each = runs[0 : len(runs) // 3 * 3 : 3] - 1, runs[1 : len(runs) // 3 * 3 : 3]
    if not len(first):
        first, each = np.zeros(1, dtype=np.int64), np.ones(1, dtype=np.int64)
    run = np.maximum(np.searchsorted(first, np.arange(len(chunks)), side="right") - 1, 0)
    counts = np.clip(each[run], 0, len(sizes))
    if counts.sum() > 10 * len(sizes) + 1000:
        return np.zeros(0, dtype=np.int64)
    chunk = np.repeat(np.arange(len(chunks)), counts)[: len(sizes)]
    ends = np.cumsum(sizes[: len(chunk)])
    begins = ends - sizes[: len(chunk)]
    heads = np.flatnonzero(np.diff(chunk, prepend=-1))
    inside = begins - np.repeat(begins[heads], np.diff(np.append(heads, len(chunk))))
    return np.asarray(chunks[chunk] + inside)


def _steps(runs: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Duration of each sample from runs (count, duration), the last going on."""
    runs = runs[: len(runs) // 2 * 2].reshape(-1, 2)
    if not len(runs):
        return np.zeros(count, dtype=np.int64)
    steps = np.repeat(runs[:, 1], np.clip(runs[:, 0], 0, count))[:count]
    return np.asarray(np.append(steps, np.full(count - len(steps), runs[-1, 1])))
