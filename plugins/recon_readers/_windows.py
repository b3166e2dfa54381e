"""A binary file from beginning to end, in windows, whose records need not end where a window does."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol


class Take(Protocol):
    """What reads the records of a window."""

    def __call__(self, window: bytes, *, last: bool) -> int:
        """Where the first record begins that is not whole in it. last : no window follows"""
        ...


def walk_through(path: Path, size: int, take: Take) -> None:
    """Give `take` the file, `size` bytes at a time, behind what it left of those before."""
    with path.open("rb") as file:
        left, last = b"", False
        while not last:
            data = file.read(size)
            window, last = left + data, len(data) < size
            left = window[take(window, last=last) :]
