"""Messages of one topic to columns, batch by batch: no message is kept longer than until its batch is full."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from recon.tables import Array
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

    broken : how many messages were not whole
    """

    def __init__(self, paths: Collection[str], stamps: Collection[str]) -> None:
        self._paths, self._stamps = sorted(set(paths)), sorted({*stamps, _OTHER_STAMP})
        self._language: Language | None = None
        self._messages: list[bytes] = []
        self._logged: list[int] = []
        self._size = 0
        # arrays that grow in place: many small ones, freed column by column, would leave holes as large as themselves
        self._columns = {path: array("d") for path in self._paths}
        self._times = {path: array("q") for path in ("", *self._stamps)}
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
            self._columns[path].frombytes(values[path][whole].tobytes())
        for stamp in self._stamps:
            seconds, nanoseconds = (np.nan_to_num(values[f"{stamp}.{part}"][whole]) for part in self._language.stamp)
            self._times[stamp].frombytes((_whole(seconds) * NS + _whole(nanoseconds)).tobytes())
        logged = np.array(self._logged, dtype=np.uint64).astype(np.int64)
        self._times[""].frombytes(logged[whole].tobytes())
        self._messages, self._logged, self._size = [], [], 0

    def times(self, stamp: str) -> Times:
        """(n,) ns since 1970 of measurement, by the message or the one around it; "" for those of recording.

        Empty where no message has a stamp.
        """
        self._decode()
        for path in ("",) if not stamp else (stamp, _OTHER_STAMP):
            found = np.frombuffer(self._times[path], dtype=np.int64)
            if found.any():
                return found
        return np.zeros(0, dtype=np.int64)

    def numbers(self, path: str) -> Array:
        """(n,) numbers at a path, in the order of the messages."""
        self._decode()
        return np.frombuffer(self._columns[path], dtype=np.float64)


def _whole(values: Array) -> Times:
    """Seconds or nanoseconds as integers; what no clock shows becomes zero."""
    return np.where(np.abs(values) < 2.0**33, values, 0.0).astype(np.int64)
