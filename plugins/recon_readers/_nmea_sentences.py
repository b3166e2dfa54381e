"""Sentences of NMEA 0183 in any bytes, by type, columnar.

A sentence is `$TTSSS,field,...*hh`: talker, type, fields, and the exclusive or of the bytes between $ and *. It counts
where that checksum is right, wherever it stands: behind a time stamp of the logger, before more commas, among binary
messages. All bytes are looked at in blocks, so that memory does not grow with the file.

Reference: NMEA 0183, version 4.11.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Array
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import clocks, days, digits, short_dates

BLOCK: Final = 1 << 21
LONGEST_EPOCH: Final = 1 << 16
"""Bytes that the sentences of one time take, and all between them."""
LONGEST: Final = 256
"""Bytes of a sentence; the standard has 82, receivers write more."""
TYPES: Final[Mapping[str, int]] = {"RMC": 9, "GGA": 14, "GST": 8, "VTG": 9, "ZDA": 4, "GNS": 12, "GLL": 6, "GSA": 2}
"""Sentences that are read, and how many of their fields."""
KNOT: Final = 1852.0 / 3600.0
_SENTENCE: Final = re.compile(
    rb"[$!]([A-Z]{2}(?:" + "|".join(TYPES).encode() + rb"),[ \"#%-)+-~]{0,240})\*([0-9A-Fa-f]{2})"
)
_ANY: Final = re.compile(rb"[$!][A-Z][A-Z0-9]{3,7},[^$!\r\n]*")
_NUMBER: Final = r"^[+-]?(?:[0-9]{1,18}\.?[0-9]{0,18}|\.[0-9]{1,18})$"


@dataclass
class Counts:
    """What was seen: sentences used by type, those of other types, and those whose checksum is wrong or missing."""

    used: dict[str, int] = field(default_factory=lambda: dict.fromkeys(TYPES, 0))
    others: int = 0
    bad: int = 0


@dataclass(frozen=True)
class Sentences:
    """The sentences of one type in a block: place of each in it, (n,), and values by name, NaN where a field is blank.

    clock_ns : (n,) ns since midnight, -1 where the sentence has no time; day : (n,) days since 1970, -1 without date
    """

    place: NDArray[np.int64]
    clock_ns: Times
    day: Times
    values: Mapping[str, Array]


def read_sentences(path: Path, counts: Counts) -> Iterator[tuple[float, dict[str, Sentences]]]:
    """The sentences of a file by type, in blocks that end between two times, with the part of the file so far."""
    size, done = max(path.stat().st_size, 1), 0
    for block in _blocks(path):
        done += len(block)
        found = _of_block(block, counts)
        if found:
            yield done / size, found


def count_sentences(head: bytes) -> tuple[int, int]:
    """How many sentences of a type that is read have a right checksum, and how many there are of all types."""
    found = list(_SENTENCE.finditer(head))
    right = int(_right(head, found).sum()) if found else 0
    return right, sum(1 for _ in _ANY.finditer(head))


def _blocks(path: Path) -> Iterator[bytes]:
    """The file in blocks that end before the first sentence of another time, or at least between sentences."""
    with path.open("rb") as file:
        rest = b""
        while read := file.read(BLOCK):
            block = rest + read
            cut = _last_time(block) or _last_begin(block)
            yield block[:cut]
            rest = block[cut:]
        yield rest


def _last_time(block: bytes) -> int:
    """Offset at which the sentences of the last time begin, which may go on behind the block; 0 where none is seen."""
    start = max(len(block) - LONGEST_EPOCH, 0)
    found = _of_block(block[start:], Counts())
    if not found:
        return 0
    clock_ns = np.concatenate([part.clock_ns for part in found.values()])
    places = np.concatenate([part.place for part in found.values()])[clock_ns >= 0]
    order = np.argsort(places, kind="stable")
    changes = np.flatnonzero(np.diff(clock_ns[clock_ns >= 0][order]))
    return start + int(places[order][changes[-1] + 1]) if len(changes) else 0


def _last_begin(block: bytes) -> int:
    cut = max(block.rfind(b"$"), block.rfind(b"!"))
    return cut if len(block) - cut < LONGEST and cut > 0 else len(block)


def _of_block(block: bytes, counts: Counts) -> dict[str, Sentences]:
    found = list(_SENTENCE.finditer(block))
    right = _right(block, found)
    by_type: dict[str, tuple[list[int], list[bytes]]] = {}
    for match, good in zip(found, right.tolist(), strict=True):
        if good:
            places, texts = by_type.setdefault(match[1][2:5].decode(), ([], []))
            places.append(match.start())
            texts.append(match[1][6:])
    used = 0
    for name, (places, _) in by_type.items():
        counts.used[name] += len(places)
        used += len(places)
    others, wrong = _others(block)
    counts.others += others
    counts.bad += wrong + len(found) - used
    return {name: _columns(name, np.array(places), texts) for name, (places, texts) in by_type.items()}


def _others(block: bytes) -> tuple[int, int]:
    """Sentences of other types, and sentences of a type that is read that have no checksum."""
    kinds = [match[0][3:6] for match in _ANY.finditer(block)]
    own = sum(kind.decode("ascii") in TYPES for kind in kinds)
    return len(kinds) - own, own - sum(1 for _ in _SENTENCE.finditer(block))


def _right(block: bytes, found: list[re.Match[bytes]]) -> Mask:
    """Is the checksum the exclusive or of what it covers? (n,) bool"""
    if not found:
        return np.zeros(0, dtype=bool)
    spans = np.array([match.span(1) for match in found])
    told = np.array([int(match[2], 16) for match in found], dtype=np.uint8)
    data = np.frombuffer(block, dtype=np.uint8)
    return np.asarray(np.bitwise_xor.reduceat(data, spans.ravel())[::2] == told)


def _columns(name: str, places: NDArray[np.int64], texts: list[bytes]) -> Sentences:
    """Values of sentences of one type."""
    from pyarrow import compute

    width = TYPES[name]
    padded = pa.array([text + b"," * width for text in texts], pa.binary()).cast(pa.string())
    split = compute.split_pattern(padded, ",")
    fields = [compute.utf8_trim_whitespace(compute.list_element(split, index)) for index in range(width)]
    clock_ns, day = _clock(name, fields)
    return Sentences(places, clock_ns, day, _READ[name](fields))


def _clock(name: str, fields: list[Any]) -> tuple[Times, Times]:
    none = np.full(len(fields[0]), -1, dtype=np.int64)
    if name in ("VTG", "GSA"):
        return none, none
    clock_ns, good = clocks(fields[4 if name == "GLL" else 0])
    day = none
    if name == "RMC":
        day = short_dates(fields[8])
    elif name == "ZDA":
        date, known = days(*(digits(fields[index]) for index in (3, 2, 1)))
        day = np.where(known, date, -1)
    return np.where(good, clock_ns, -1), day


def _number(texts: Any) -> Array:
    """Numbers, NaN where a text is none: (n,)."""
    from pyarrow import compute

    known = compute.if_else(compute.match_substring_regex(texts, _NUMBER), texts, None)
    return np.asarray(known.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)


def _degrees(texts: Any, sides: Any, negative: str) -> Array:
    """Degrees of (d)ddmm.mmm and its hemisphere, NaN where either is missing."""
    from pyarrow import compute

    value = _number(texts)
    whole_degrees = np.floor(value / 100.0)
    degrees = whole_degrees + (value - 100.0 * whole_degrees) / 60.0
    signed = np.where(np.asarray(compute.equal(sides, negative)), -degrees, degrees)
    return np.where(np.asarray(compute.not_equal(sides, "")), signed, np.nan)


def _place(fields: list[Any]) -> dict[str, Array]:
    return {"lat": _degrees(fields[0], fields[1], "S"), "lon": _degrees(fields[2], fields[3], "W")}


def _where(valid: Mask, values: dict[str, Array]) -> dict[str, Array]:
    return {name: np.where(valid, array, np.nan) for name, array in values.items()}


def _is(texts: Any, *words: str) -> Mask:
    from pyarrow import compute

    return np.asarray(compute.is_in(texts, value_set=pa.array(words, pa.string())))


def _rmc(fields: list[Any]) -> dict[str, Array]:
    speed, course = _number(fields[6]) * KNOT, np.radians(_number(fields[7]))
    return _where(_is(fields[1], "A", "D"), {**_place(fields[2:6]), "speed": speed, "course": course})


def _gga(fields: list[Any]) -> dict[str, Array]:
    quality = _number(fields[5])
    found = {"height": _number(fields[8]), "separation": _number(fields[10]), "satellites": _number(fields[6])}
    return {**_where(quality > 0, {**_place(fields[1:5]), **found}), "quality": quality}


def _gns(fields: list[Any]) -> dict[str, Array]:
    found = {"height": _number(fields[8]), "separation": _number(fields[9]), "satellites": _number(fields[6])}
    fixed = ~_is(fields[5], "", "N", "NN", "NNN", "NNNN", "NNNNN", "NNNNNN")
    quality = np.where(_is(fields[5], ""), np.nan, fixed)  # of the sentence of one system beside that of all of them
    return {**_where(fixed, {**_place(fields[1:5]), **found}), "quality": quality}


def _gll(fields: list[Any]) -> dict[str, Array]:
    return _where(_is(fields[5], "A", ""), _place(fields[0:4]))


def _vtg(fields: list[Any]) -> dict[str, Array]:
    knots, km_h = _number(fields[4]) * KNOT, _number(fields[6]) / 3.6
    found = {"speed": np.where(np.isfinite(knots), knots, km_h), "course": np.radians(_number(fields[0]))}
    return _where(~_is(fields[8], "N"), found)  # without a fix, receivers tell zeros


def _gst(fields: list[Any]) -> dict[str, Array]:
    return {"pos_std_n": _number(fields[5]), "pos_std_e": _number(fields[6]), "pos_std_u": _number(fields[7])}


def _gsa(fields: list[Any]) -> dict[str, Array]:
    mode = _number(fields[1])
    return {"fix": np.where(np.isin(mode, (1.0, 2.0, 3.0)), np.where(mode == 1.0, 0.0, mode), np.nan)}


_READ: Final[Mapping[str, Any]] = {
    "RMC": _rmc, "GGA": _gga, "GST": _gst, "VTG": _vtg, "ZDA": lambda fields: {}, "GNS": _gns, "GLL": _gll, "GSA": _gsa,
}  # fmt: skip
