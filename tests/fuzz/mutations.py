"""Damage to bytes as it happens to files, from a seed: cut, flipped, lost, doubled, mixed up, filled in by hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Final

CHANGES: Final = (1, 1, 1, 2, 6)
"""Mostly one: a reader stops at the first that it does not take, and what comes behind is not tried."""
LONGEST_BLOCK: Final = 400
"""Bytes; a few rows of a log, a few entries of a footer."""

_NUMBER: Final = re.compile(rb"-?\d+(?:\.\d*)?")
_NUMBERS: Final = (
    *(b"", b"0", b"-1", b"-0.0", b"1e999", b"-1e999", b"1e-320", b"1e18", b"1.5e308", b"nan", b"inf", b"-inf", b"null"),
    *(b"255", b"65536", b"2147483648", b"9223372036854775807", b"18446744073709551616", b"9" * 45, b"9" * 5000),
    *(b"0x1f", b"0o17", b"1_000", b"1,5", b"1.2.3", b"12:30", b"5 km/h", "\u0663".encode(), "5\u00a0m".encode()),
)
_LINES: Final = (
    *(b"", b" ", b"#", b"# timestamp ax ay az", b"time", b"\t" * 13, b"0 " * 14, b"\0" * 16, b"---", b"..."),
    *(b"%YAML 9", b"{", b"}", b"[" * 60, b"]", b'"', b"'", b"- use: reader.auto", b"<<: *a", b"&a [*a]", b"? !!str a"),
    *(b"\xff\xfe", b"\xef\xbb\xbf", b"\r", b"x" * 20_000, b"(" * 300, b"{" * 3000, b"- " * 300),
)


def mutate(data: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """The bytes with one to six changes; blocks may come from `others`."""
    for _ in range(rng.choice(CHANGES)):
        data = rng.choice(_CHANGES)(data, rng.choice(others), rng)
    return data


def _cut(data: bytes, other: bytes, rng: Random) -> bytes:
    return data[: rng.randint(0, len(data))]


def _flip(data: bytes, other: bytes, rng: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.randint(1, 8) if data else 0):
        changed[rng.randrange(len(changed))] ^= rng.choice((1 << rng.randrange(8), 0xFF, rng.randint(1, 0xFF)))
    return bytes(changed)


def _lose(data: bytes, other: bytes, rng: Random) -> bytes:
    start, stop = _block(data, rng)
    return data[:start] + data[stop:]


def _double(data: bytes, other: bytes, rng: Random) -> bytes:
    start, stop = _block(data, rng)
    return data[:stop] + data[start:stop] * rng.randint(1, 4) + data[stop:]


def _splice(data: bytes, other: bytes, rng: Random) -> bytes:
    """A block of another sample, or of this one, over or between what was there."""
    start, stop = _block(other, rng)
    where, until = _block(data, rng)
    return data[:where] + other[start:stop] + data[rng.choice((where, until)) :]


def _insert_bytes(data: bytes, other: bytes, rng: Random) -> bytes:
    return _inserted(data, rng.randint(0, len(data)), rng.randbytes(rng.randint(1, 30)))


def _insert_line(data: bytes, other: bytes, rng: Random) -> bytes:
    at = data.find(b"\n", rng.randint(0, len(data))) + 1
    return _inserted(data, at, rng.choice((*_LINES, *other.split(b"\n")[:50])) + b"\n")


def _replace_number(data: bytes, other: bytes, rng: Random) -> bytes:
    found = _NUMBER.search(data, rng.randint(0, len(data)))
    start, stop = found.span() if found else (len(data), len(data))
    return data[:start] + rng.choice(_NUMBERS) + data[stop:]


def _fill(data: bytes, other: bytes, rng: Random) -> bytes:
    """A block of one byte value: what is lost on a disk reads as zeros."""
    start, stop = _block(data, rng)
    return data[:start] + rng.choice((b"\0", b"\xff", b" ", b"\n", b"\t")) * (stop - start) + data[stop:]


def _inserted(data: bytes, at: int, part: bytes) -> bytes:
    return data[:at] + part + data[at:]


def _block(data: bytes, rng: Random) -> tuple[int, int]:
    start = rng.randint(0, len(data))
    return start, min(start + rng.randint(0, rng.choice((4, 40, LONGEST_BLOCK))), len(data))


_CHANGES: Final[Sequence[Callable[[bytes, bytes, Random], bytes]]] = (
    *(_cut, _flip, _lose, _double, _splice, _insert_bytes, _insert_line, _replace_number, _fill),
    *(_flip, _replace_number),  # these leave most of a file as it was, so that more of the reader sees it
)
