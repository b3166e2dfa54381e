"""Structures of numbers in .mat files of MATLAB 5 to 7.

A file is a header of 128 bytes and elements: a tag of type and size, then that many bytes, padded to a multiple of
eight; of at most four bytes, tag and contents share eight. A matrix is an element of elements: flags, dimensions,
name, and numbers, column after column, or for a structure the names of its fields and a matrix for each.

SciPy reads these files too, but trusts the types and sizes in them: one damaged byte can end the program.

Reference: The MathWorks, MAT-File Format, chapter 1, "Level 5 MAT-File Format".
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Final

import numpy as np

from recon.tables import Array
from recon_readers._limits import LARGEST_UNPACKED

HEADER: Final = 128
"""Bytes before the first element."""
COMPRESSED: Final = 15
"""Type of an element that zlib packed."""
_MATRIX: Final = 14
_STRUCTURE: Final = 2
"""Class of a matrix that holds fields."""
_NUMERIC: Final = range(6, 16)
"""Classes of a matrix that holds numbers, from double to uint64."""
_COMPLEX: Final = 0x0800
_MOST_PARTS: Final = 10_000
"""Elements of a matrix, and bytes of its flags and its shape: far more than a log has."""
_NUMBERS: Final = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
"""Types of elements that hold numbers."""


def structures(data: bytes) -> dict[str, dict[str, Array | None]]:
    """Structures of a file by name: their fields as (rows, columns, ...), None where one holds no real numbers.

    Arrays of structures and variables of other classes are left out. Raises ValueError where the file is damaged, or
    unpacks to more than LARGEST_UNPACKED bytes.
    """
    order = byte_order(data)
    if not order:
        raise ValueError("the header does not tell the order of bytes")
    found = {}
    packed = numbers = LARGEST_UNPACKED
    for kind, body in _elements(memoryview(data)[HEADER:], order):
        if kind == COMPRESSED:
            ((kind, body),) = _elements(memoryview(_unpacked(body, packed)), order)
            packed -= len(body)
        if kind == _MATRIX:
            name, fields = _structure(body, order, numbers)
            if fields is not None:
                numbers -= _size(fields)
                found[name] = fields
    return found


def _unpacked(body: memoryview, most: int) -> bytes:
    """Of at most so many bytes. Raises ValueError."""
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(body, most + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    if len(found) > most:
        raise ValueError(f"it unpacks to more than {LARGEST_UNPACKED / 1e6:,.0f} MB")
    if not unpacker.eof:
        raise ValueError("a packed element is cut")
    return found


def byte_order(data: bytes) -> str:
    """ "<" for a file of little-endian numbers, ">" for a big-endian one, "" where the header does not tell."""
    return {b"IM": "<", b"MI": ">"}.get(data[HEADER - 2 : HEADER], "")


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and contents of each element."""
    start = 0
    while start < len(data):
        if len(data) - start < 8:
            raise ValueError("the last element is cut")
        kind, size = struct.unpack_from(f"{order}II", data, start)
        begin, step = start + 8, 8 + size + (0 if kind == COMPRESSED else -size % 8)
        if kind >> 16:  # tag and contents share eight bytes
            kind, size = kind & 0xFFFF, kind >> 16
            begin, step = start + 4, 8
        if begin + size > min(len(data), start + step):
            raise ValueError("an element is longer than what holds it")
        yield kind, data[begin : begin + size]
        start += step


def _structure(body: memoryview, order: str, most: int) -> tuple[str, dict[str, Array | None] | None]:
    """The name of a matrix, and its fields where it is a single structure; of at most so many bytes as doubles."""
    flags, shape, name, rest = _opening(body, order)
    if flags & 0xFF != _STRUCTURE or math.prod(shape) != 1:
        return name, None
    if len(rest) < 2:
        raise ValueError(f"the structure {name} has no fields")
    (width,) = _few(*rest[0], order)
    if width < 1:
        raise ValueError(f"the structure {name} has fields without names")
    text = bytes(rest[1][1])
    if (several := -(-len(text) // width)) != len(rest) - 2:
        raise ValueError(f"the structure {name} has {several:,} names for {len(rest) - 2:,} fields")
    names = [text[start : start + width].split(b"\0")[0].decode("ascii") for start in range(0, len(text), width)]
    fields: dict[str, Array | None] = {}
    for field, (_, part) in zip(names, rest[2:], strict=True):
        fields[field] = _numbers(part, order, most - _size(fields))
    return name, fields


def _size(fields: Mapping[str, Array | None]) -> int:
    return sum(values.nbytes for values in fields.values() if values is not None)


def _numbers(body: memoryview, order: str, most: int) -> Array | None:
    """The numbers of a matrix; None where it holds something else. An empty one may have no contents at all.

    most : bytes that they may take as doubles
    """
    if not len(body):
        return np.zeros((0, 0))
    flags, shape, name, rest = _opening(body, order)
    if flags & 0xFF not in _NUMERIC or flags & _COMPLEX or not rest:
        return None
    values = _array(*rest[0], order)
    if len(values) != math.prod(shape):
        raise ValueError(f"{name} holds {len(values)} numbers for the shape {shape}")
    if 8 * len(values) > most:
        raise ValueError(f"its numbers take more than {LARGEST_UNPACKED / 1e6:,.0f} MB as doubles")
    return values.reshape(shape, order="F").astype(np.float64)


def _opening(body: memoryview, order: str) -> tuple[int, tuple[int, ...], str, list[tuple[int, memoryview]]]:
    """Flags, shape and name of a matrix, and the elements behind them."""
    parts = list(islice(_elements(body, order), _MOST_PARTS + 1))
    if len(parts) > _MOST_PARTS:
        raise ValueError(f"a matrix has more than {_MOST_PARTS:,} parts")
    if len(parts) < 3:
        raise ValueError("a matrix has no name")
    flags, shape = (_few(*part, order) for part in parts[:2])
    if not flags or len(shape) < 2 or min(shape) < 0:
        raise ValueError("a matrix has no flags or no shape")
    return flags[0], tuple(shape), bytes(parts[2][1]).decode("ascii"), parts[3:]


def _few(kind: int, body: memoryview, order: str) -> list[int]:
    """The numbers of an element that holds few."""
    if len(body) > _MOST_PARTS:
        raise ValueError(f"flags, shape or width of names take {len(body):,} bytes")
    numbers: list[int] = _array(kind, body, order).astype(int).tolist()
    return numbers


def _array(kind: int, body: memoryview, order: str) -> np.ndarray:
    """The numbers of an element: (n,)."""
    if kind not in _NUMBERS:
        raise ValueError(f"type {kind} is none of numbers")
    return np.frombuffer(body, dtype=order + _NUMBERS[kind])
