"""The result of a live run: `NAME.mcap`, always whole, and beside it `NAME.part.mcap`, which grows.

Every message of the growing file is a chunk of its own and is handed to the operating system at once, so that a process
that is killed loses nothing that was written. At the end, and when a later run goes on, its rows join the whole file.
`NAME.state` is what a later run needs to go on; it is replaced as a whole.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.recording import Recording
from recon.storage.atomic import staged_file, storage_errors
from recon.storage.mcap import Appending, salvage_file, write_file
from recon.tables import Streams, select_rows, time_ns


class GrowingResult:
    """Streams that are appended to. path : of the MCAP file; one that is there is gone on with."""

    def __init__(self, path: Path) -> None:
        self.path, self._part = path, path.with_suffix(".part.mcap")
        self._join()
        before = _streams_of(path)
        self._until = {name: int(time_ns(table)[-1]) for name, table in before.items() if table.num_rows}
        with storage_errors(self._part):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = Appending(self._part)

    @property
    def begun(self) -> bool:
        """Has it rows?"""
        return bool(self._until)

    def append(self, streams: Streams) -> None:
        """Add the rows that are later than those that are there. Raises StorageError."""
        with storage_errors(self._part):
            for name, table in streams.items():
                fresh = _after(table, self._until.get(name))
                if fresh.num_rows:
                    self._file.append(name, fresh)
                    self._until[name] = int(time_ns(fresh)[-1])

    def close(self) -> None:
        """Make the file whole. Raises StorageError."""
        with storage_errors(self._part):
            self._file.finish()
            self._file.close()
        self._join()

    def _join(self) -> None:
        """Rows of the growing file come behind those of the whole one."""
        new = _streams_of(self._part)
        if new:
            joined = dict(_streams_of(self.path))
            for name, table in new.items():
                old = joined.get(name)
                until = int(time_ns(old)[-1]) if old is not None and old.num_rows else None
                fresh = _after(table, until)
                joined[name] = fresh if old is None else pa.concat_tables([old, fresh.cast(old.schema)])
            with staged_file(self.path) as scratch:
                write_file(Recording(joined), scratch)
        self._part.unlink(missing_ok=True)


def _streams_of(path: Path) -> Streams:
    """All that is whole in a file; nothing where there is none, or where nothing was written yet."""
    if not path.exists():
        return {}
    try:
        return dict(salvage_file(path)[0])
    except ReadFailed:
        if path.suffixes[-2:] == [".part", ".mcap"]:
            return {}  # killed before its first row
        raise


def _after(table: pa.Table, until_ns: int | None) -> pa.Table:
    return table if until_ns is None else select_rows(table, np.asarray(time_ns(table) > until_ns))
