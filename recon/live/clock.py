"""The clock of a log that goes on: which rows have a time that follows on those before.

A row whose time is minutes ahead of those before is believed once others follow it there: then the log paused, or its
clock was set. Until then it is held back; where the rows go on as before, its time was wrong. Of a clock that was set
back nothing is taken until it has caught up, for a trajectory has every time once.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Streams, select_rows, time_ns
from recon.units import duration_text

_JUMP_NS: Final = 300_000_000_000
_AGREE_NS: Final = 2_000_000_000
"""Rows that follow for so long bear a jump out."""
_LEAST_NS: Final = np.iinfo(np.int64).min


class Clock:
    """Give it the rows of each piece by `fresh`; it gives those that may be taken.

    wrong : what was found wrong with the times, as it was found
    """

    def __init__(self) -> None:
        self._until: dict[str, int] = {}
        self._held: NDArray[np.int64] = np.zeros(0, np.int64)
        self._set_back = False
        self.wrong: list[str] = []

    @property
    def newest_ns(self) -> int | None:
        """The last time that was taken; None before the first."""
        return max(self._until.values(), default=None)

    def fresh(self, streams: Streams, overlaps: bool) -> Streams:
        """The rows that are later than those taken before, up to a jump that nothing bears out yet.

        streams : of a piece; rows that were held back must be in it again
        overlaps : does it begin with rows of earlier pieces? Then the first of each may be a value held over
        """
        at_ns = times_of(streams)
        newest, limit_ns = self.newest_ns, self._believed(at_ns)
        taken = {name: self._later(name, table, limit_ns, overlaps) for name, table in streams.items()}
        self._tell_set_back(at_ns, newest)
        return taken

    def end(self) -> None:
        """No more will come: what is held back stays out."""
        self._tell_far(self._held)

    def _believed(self, at_ns: NDArray[np.int64]) -> int:
        """The time up to which rows are taken; those behind are held back."""
        newest = self.newest_ns
        row = at_ns if newest is None else np.append(newest, at_ns[at_ns > newest])
        doubtful = [jump for jump in np.flatnonzero(np.diff(row) > _JUMP_NS) if row[-1] - row[jump + 1] < _AGREE_NS]
        limit_ns = int(row[doubtful[0]]) if doubtful else int(np.iinfo(np.int64).max)
        self._tell_far(np.setdiff1d(self._held, at_ns))
        self._held = row[row > limit_ns]
        return limit_ns

    def _later(self, name: str, table: pa.Table, limit_ns: int, overlaps: bool) -> pa.Table:
        at_ns = time_ns(table)
        fresh = (at_ns > self._until.get(name, _LEAST_NS)) & (at_ns <= limit_ns)
        if overlaps:
            fresh[:1] = False
        if fresh.any():
            self._until[name] = int(at_ns[fresh][-1])
        return select_rows(table, fresh)

    def _tell_far(self, at_ns: NDArray[np.int64]) -> None:
        """Rows that are left out: those before or behind them go on otherwise."""
        self.wrong += [f"a row of {_utc(ns)} is far ahead of those around it and is left out" for ns in at_ns.tolist()]

    def _tell_set_back(self, at_ns: NDArray[np.int64], newest: int | None) -> None:
        """A piece whose rows all lie before what was taken."""
        before = newest is not None and len(at_ns) > 0 and at_ns[-1] < newest
        if newest is not None and before and not self._set_back:
            back = duration_text((newest - int(at_ns[-1])) * 1e-9)
            self.wrong.append(f"the clock was set back by {back}: no row is taken until it has passed {_utc(newest)}")
        self._set_back = before


def times_of(streams: Streams) -> NDArray[np.int64]:
    """All times of all streams, rising: (n,) int64 ns."""
    return np.unique(np.concatenate([np.zeros(0, np.int64), *(time_ns(table) for table in streams.values())]))


def _utc(at_ns: int) -> str:
    return str(np.datetime64(at_ns, "ns").astype("datetime64[s]")).replace("T", " ")
