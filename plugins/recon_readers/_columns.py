"""Columns of numbers that come block by block, held in little memory and given back one by one."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, MutableMapping
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

_MORE_ROOM: Final = 1.02
"""By how much the later blocks of a text may hold more rows than its first, before memory is taken anew."""


class Grown:
    """Numbers that grow, in memory of their own that is given back as soon as they are dropped.

    Room for more rows than come takes nothing: systems give memory where it is written.
    """

    def __init__(self, kind: DTypeLike, room: int) -> None:
        self._values = np.empty(room, dtype=kind)
        self._count = 0

    def add(self, values: NDArray[Any]) -> None:
        """More rows: (k,)."""
        end = self._count + len(values)
        if end > len(self._values):
            larger = np.empty(end + end // 2, dtype=self._values.dtype)
            larger[: self._count] = self.all
            self._values = larger
        self._values[self._count : end] = values
        self._count = end

    @property
    def all(self) -> NDArray[Any]:
        """All rows: (n,)."""
        return self._values[: self._count]


class Runs:
    """Numbers that a logger repeats over many rows: each is kept once, with the row in which it begins."""

    def __init__(self, kind: DTypeLike, room: int) -> None:
        self._values = Grown(kind, room)
        self._begins = Grown(np.int64, room)
        self._count = 0

    def add(self, values: NDArray[Any]) -> None:
        """More rows: (k,)."""
        bits = np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")  # NaN is not equal to itself
        begins = np.flatnonzero(np.append(len(bits) > 0, bits[1:] != bits[:-1])[: len(bits)])
        self._values.add(values[begins])
        self._begins.add(begins + self._count)
        self._count += len(values)

    @property
    def all(self) -> NDArray[Any]:
        """All rows: (n,), a new array."""
        return np.repeat(self._values.all, np.diff(self._begins.all, append=self._count))


class Columns(MutableMapping[Any, NDArray[Any]]):
    """Columns by key, (n,) each. What is deleted, or popped and dropped, gives its memory back."""

    def __init__(self, columns: Mapping[Any, NDArray[Any] | Grown | Runs]) -> None:
        self._columns = dict(columns)

    @classmethod
    def of(cls, blocks: Iterable[tuple[float, Mapping[Any, NDArray[Any]]]], repeated: Collection[Any] = ()) -> Columns:
        """Columns that come in blocks, each with the part of the whole that has come with it.

        Of doubles a block may lack some: they are NaN there.

        repeated : keys of the columns of which many rows are as the one before
        """
        made: dict[Any, Grown | Runs] = {}
        before = 0
        for share, block in blocks:
            rows = len(next(iter(block.values()), ()))
            room = before + rows if share >= 1.0 else int(_MORE_ROOM * (before + rows) / max(share, 1e-6)) + 1024
            for key, values in block.items():
                if key not in made:
                    made[key] = Runs(values.dtype, 1024) if key in repeated else Grown(values.dtype, room)
                    if before:
                        made[key].add(np.full(before, np.nan))
                made[key].add(values)
            for key in made.keys() - block.keys():
                made[key].add(np.full(rows, np.nan))
            before += rows
        return cls(made)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        found = self._columns[key]
        return found if isinstance(found, np.ndarray) else found.all

    def __setitem__(self, key: Any, values: NDArray[Any]) -> None:
        self._columns[key] = values

    def __delitem__(self, key: Any) -> None:
        del self._columns[key]

    def __iter__(self) -> Iterator[Any]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __contains__(self, key: object) -> bool:
        return key in self._columns


def kept(values: NDArray[Any], rows: NDArray[np.bool_]) -> NDArray[Any]:
    """The values in some rows: those themselves where it is all. values : (n,); rows : (n,) bool"""
    return values if rows.all() else values[rows]


def at_rows(values: NDArray[np.float64], rows: NDArray[np.integer[Any]], count: int) -> NDArray[np.float64]:
    """A column of `count` rows with the values in some, NaN in the others; the values themselves where it is all.

    values : (k,) or (k, m); rows : (k,) numbers of rows, each once and rising
    """
    if len(values) == count:
        return values
    found = np.full((count, *values.shape[1:]), np.nan)
    found[rows] = values
    return found
