"""The three files of a fleet as they are: what they tell of a result need not be read from the result again.

A row of jobs.parquet says which manifest it was made from, by its size and time of change, and how many rows of
events.parquet and of metrics.parquet are of the same drive; these lie there in the order of the jobs. The three are of
use only together, so each holds the token of the compaction that wrote it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.fleet.inputs import key_of
from recon.fleet.places import Stamp
from recon.fleet.root import Root
from recon.schema import by_step

NAMES: Final = ("jobs", "events", "metrics")
JOBS: Final = "jobs.parquet"

_TIME: Final = pa.timestamp("ns", tz="UTC")
_DRIVE: Final = (("vehicle", pa.string()), ("drive", pa.string()))
_JOB: Final = (
    *((name, pa.string()) for name in ("status", "code", "reason", "hint", "input")),
    *(("input_bytes", pa.int64()), ("modified", _TIME), ("started", _TIME)),
    *((name, pa.float64()) for name in ("seconds", "duration", "distance", "top_speed", "stops", "pos_std")),
    *((name, pa.int64()) for name in ("warnings", "rows", "events", "metrics")),
    *((name, pa.string()) for name in ("pipeline", "recon", "versions", "made_of")),
    *(("manifest_bytes", pa.int64()), ("manifest_modified", _TIME)),
)
SCHEMAS: Final[Mapping[str, pa.Schema]] = {
    "jobs": pa.schema([*_DRIVE, *_JOB]),
    **{
        name: pa.schema([*_DRIVE, *((column.name, column.type) for column in by_step(name).columns)])
        for name in NAMES[1:]
    },
}
OK: Final = "ok"
FAILED: Final = "failed"
TOKEN: Final = b"recon.compaction"
"""Key in the metadata of each file: the same in the three that were written together."""

_BATCH: Final = 65_536
"""Rows that are read at a time."""
_COARSE_NS: Final = 1_000_000
"""Clocks of stores that tell times by whole milliseconds or seconds."""
_TICK_NS: Final = 2_000_000_000
"""The coarsest of them."""


@dataclass(frozen=True)
class Index:
    """What jobs.parquet knows of manifests.

    rows : by key; stamps : (n, 2) bytes and time of change of the manifest, -1 where they are not relied on
    made_of : (n,) as in the manifest; counts : (n, 2) rows of events.parquet and metrics.parquet
    """

    rows: Mapping[str, int] = field(default_factory=dict)
    stamps: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))
    made_of: NDArray[np.bytes_] = field(default_factory=lambda: np.empty(0, dtype="S64"))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), dtype=np.int64))

    def row(self, key: str, stamp: Stamp) -> int | None:
        """The row of a result, None where there is none that was made from just this manifest."""
        row = self.rows.get(key)
        return row if row is not None and tuple(self.stamps[row].tolist()) == stamp else None


def read_index(root: Root) -> Index:
    """As the files tell; empty where they are not there, not whole, or not of one compaction."""
    columns = ["vehicle", "drive", "manifest_bytes", "manifest_modified", "made_of", "events", "metrics"]
    try:
        with opened(root) as files:
            schemas = {name: file.schema_arrow for name, file in files.items()}
            if schemas != SCHEMAS or len({(schema.metadata or {}).get(TOKEN) for schema in schemas.values()}) != 1:
                return Index()
            table = files["jobs"].read(columns=columns)
            totals = [files[name].metadata.num_rows for name in NAMES[1:]]
            size, modified, *counts = (_numbers(table[name]) for name in (*columns[2:4], *columns[5:]))
    except (OSError, KeyError, pa.ArrowException):
        return Index()
    if [int(count.sum()) for count in counts] != totals:
        return Index()
    names = zip(table["vehicle"].to_pylist(), table["drive"].to_pylist(), strict=True)
    return Index(
        {key_of(vehicle, drive): row for row, (vehicle, drive) in enumerate(names)},
        np.column_stack([size, modified]),
        np.array(table["made_of"].fill_null("").to_pylist(), dtype="S64"),
        np.column_stack(counts),
    )


def _numbers(column: pa.ChunkedArray) -> NDArray[np.int64]:
    return np.asarray(column.cast(pa.int64()).fill_null(-1 if pa.types.is_timestamp(column.type) else 0))


def is_settled(stamp: Stamp, now_ns: int) -> bool:
    """Will a later change of the file show? Not where it was just written, by a clock that is a coarse one."""
    return stamp[1] % _COARSE_NS != 0 or stamp[1] < now_ns - _TICK_NS


@contextmanager
def opened(root: Root) -> Iterator[Mapping[str, Any]]:
    """The three files, as pyarrow.parquet.ParquetFile. Raises OSError, pa.ArrowException."""
    from pyarrow.parquet import ParquetFile

    with ExitStack() as stack:
        files = {}
        for name in NAMES:
            source = stack.enter_context(root.place.filesystem.open_input_file((root.place / f"{name}.parquet").path))
            files[name] = stack.enter_context(ParquetFile(source))
        yield files


class Older:
    """Rows of the file `name`, from its beginning to its end. file : a ParquetFile; None where nothing is taken"""

    def __init__(self, name: str, index: Index, file: Any) -> None:
        self._counts = (
            np.ones(len(index.rows), dtype=np.int64) if name == "jobs" else index.counts[:, NAMES.index(name) - 1]
        )
        self._batches = iter(()) if file is None else file.iter_batches(_BATCH)
        self._held = SCHEMAS[name].empty_table()
        self._next = 0

    def take(self, jobs: Sequence[int]) -> tuple[pa.Table, NDArray[np.int64]]:
        """The rows of some jobs, of each so many. jobs : rising, and behind those of before"""
        if not len(jobs):
            return self._held.slice(0, 0), np.empty(0, dtype=np.int64)
        counts = self._counts[self._next : jobs[-1] + 1]
        chosen = np.zeros(len(counts), dtype=bool)
        chosen[np.array(jobs) - self._next] = True
        self._next = jobs[-1] + 1
        return self._read(int(counts.sum())).filter(pa.array(np.repeat(chosen, counts))), counts[chosen]

    def _read(self, count: int) -> pa.Table:
        while self._held.num_rows < count:
            more = pa.Table.from_batches([next(self._batches)], self._held.schema)
            self._held = pa.concat_tables([self._held, more])
        taken, self._held = self._held.slice(0, count), self._held.slice(count)
        return taken


def failed_before(root: Root) -> dict[str, dict[str, Any]]:
    """Rows of `jobs` that say why a drive failed, by key."""
    from pyarrow.parquet import read_table

    try:
        with root.place.filesystem.open_input_file((root.place / JOBS).path) as file:
            table = read_table(file, filters=[("status", "=", FAILED)])
    except (OSError, pa.ArrowException):
        return {}
    rows = _with_times_as_numbers(table).to_pylist()
    return {key_of(row["vehicle"], row["drive"]): row for row in rows}


def _with_times_as_numbers(table: pa.Table) -> pa.Table:
    """Python has no times of nanoseconds."""
    for index, column in enumerate(table.schema):
        if pa.types.is_timestamp(column.type):
            table = table.set_column(index, column.name, table[column.name].cast(pa.int64()))
    return table
