"""Messages of one topic to columns, batch by batch: no message is kept longer than until its batch is full."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from recon.tables import Array
from recon_readers._columns import Grown, Runs
from recon_readers._time_order import Mask, Times

NS: Final = 1_000_000_000
BATCH_MESSAGES: Final = 8192
BATCH_BYTES: Final = 4 * 2**20
_OTHER_STAMP: Final = "header.stamp"
"""Of a message around the one that is read, for one whose own stamp was never set."""


@dataclass(frozen=True)
class Language:
    """How messages of a channel are written.

    read : (messages, paths) -> numbers by path, (n,) NaN where there is none, and which messages are whole, (n,) bool
    stamp : what seconds and nanoseconds of a time are called
    """

    read: Callable[[Sequence[bytes], Collection[str]], tuple[dict[str, Array], Mask]]
    stamp: tuple[str, str]


Numbers: TypeAlias = dict[str, Array]


class Collector:
    """The numbers at some paths of the messages of a topic, and their times.

    paths : each as often as its numbers will be asked for; they are not kept longer
    broken : how many messages were not whole
    """

    def __init__(self, paths: Iterable[str], stamps: Collection[str]) -> None:
        self._users = Counter(paths)
        self._paths, self._stamps = sorted(self._users), sorted({*stamps, _OTHER_STAMP})
        self._language: Language | None = None
        self._messages: list[bytes] = []
        self._logged: list[int] = []
        self._size = 0
        self._columns: dict[str, Grown | Runs] = {}
        self._times = {path: Grown(np.int64, BATCH_MESSAGES) for path in ("", *self._stamps)}
        self.broken = 0

    def add(self, language: Language, message: bytes, logged_ns: int) -> None:
        """One more message, and the time in ns at which it was recorded."""
        if language is not self._language:
            self._decode()
            self._language = language
        self._messages.append(message)
        self._logged.append(logged_ns)
        self._size += len(message)
        if len(self._messages) >= BATCH_MESSAGES or self._size >= BATCH_BYTES:
            self._decode()

    def _decode(self) -> None:
        if self._language is None or not self._messages:
            return
        names = [f"{stamp}.{part}" for stamp in self._stamps for part in self._language.stamp]
        values, whole = self._language.read(self._messages, [*self._paths, *names])
        self.broken += int((~whole).sum())
        for path in self._paths:
            numbers = values[path][whole]
            if path not in self._columns:
                constant = len(numbers) > 1 and bool((numbers == numbers[0]).all())
                self._columns[path] = (Runs if constant else Grown)(np.float64, BATCH_MESSAGES)
            self._columns[path].add(numbers)
        for stamp in self._stamps:
            seconds, nanoseconds = (np.nan_to_num(values[f"{stamp}.{part}"][whole]) for part in self._language.stamp)
            self._times[stamp].add(_whole(seconds) * NS + _whole(nanoseconds))
        logged = np.array(self._logged, dtype=np.uint64).astype(np.int64)
        self._times[""].add(logged[whole])
        self._messages, self._logged, self._size = [], [], 0

    def times(self, stamp: str) -> Times:
        """(n,) ns since 1970 of measurement, by the message or the one around it; "" for those of recording.

        Empty where no message has a stamp.
        """
        self._decode()
        for path in ("",) if not stamp else (stamp, _OTHER_STAMP):
            found: Times = self._times[path].all
            if found.any():
                return found
        return np.zeros(0, dtype=np.int64)

    def numbers(self, path: str) -> Array:
        """(n,) numbers at a path, in the order of the messages."""
        self._decode()
        if path not in self._columns:
            return np.zeros(0)
        self._users[path] -= 1
        return self._columns[path].all.copy() if self._users[path] else self._columns.pop(path).all


def _whole(values: Array) -> Times:
    """Seconds or nanoseconds as integers; what no clock shows becomes zero."""
    return np.where(np.abs(values) < 2.0**33, values, 0.0).astype(np.int64)
