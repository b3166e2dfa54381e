"""Recordings that recon keeps as Parquet, and single streams in Parquet files of other programs.

    a run's folder with streams/<stream>.parquet      a folder of <stream>.parquet      one <stream>.parquet

`recon.storage.parquet` says how they are kept, and what is asked of a file of another program: canonical name, columns,
units and frames. All streams come as they were kept, in the frames in which they were kept; rows of `events` and
`metrics` keep the name of the step that made them.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.rows import Metric, metrics
from recon.schema import STREAMS, group_of
from recon.stages import Reader, Sniff
from recon.storage import read_recording, store_of
from recon.storage.parquet import MAGIC
from recon.tables import Streams, append, replace, vector
from recon_readers._limits import LIMITS, MOST_FAULTY, SIGMAS, possible
from recon_readers._sensing import doubts


def stored(path: Path, params: NoParams) -> Streams:
    """The streams of a recording that recon keeps at `path`, in either store, or a stream of another program.

    Of another program's what no vehicle shows is left out. Raises ReadFailed, also where that is much.
    """
    streams = dict(read_recording(path))
    plain = {name: table for name, table in streams.items() if b"recon.schema" not in (table.schema.metadata or {})}
    learnt = []
    for name, table in plain.items():
        streams[name], told = _plausible(path, name, table)
        learnt += told
    learnt += doubts({name: streams[name] for name in plain})
    if learnt:
        streams["metrics"] = append(streams.get("metrics"), metrics(learnt))
    return streams


def _plausible(path: Path, name: str, table: pa.Table) -> tuple[pa.Table, list[Metric]]:
    learnt = []
    for column in [each for each in table.column_names if {each, group_of(each)} & {*LIMITS, *SIGMAS}]:
        values = vector(table, column, gaps=True)
        found, told = possible(path, name, column, values, most=MOST_FAULTY)
        learnt += told
        if found is not values:
            kind = table.schema.field(column).type
            table = replace(table, **{column: pa.array(found, from_pandas=True).cast(kind)})
    return table, learnt


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder that keeps a recording as Parquet, or a file with Parquet's magic number."""
    if path.is_dir():
        own = store_of(path) == "parquet"
        return Sniff(1.0, "folder with streams as Parquet") if own else Sniff(0.0, "a folder without streams")
    return Sniff(0.9, "magic number of Parquet") if head.startswith(MAGIC) else Sniff(0.0, "another magic number")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of Parquet files and of folders with them."""
    yield Reader(
        name="parquet",
        summary="Recordings kept by recon as Parquet; single streams in Parquet files.",
        run=stored,
        sniff=sniff,
        self_describing=True,
        writes={name: schema.open_ended() for name, schema in STREAMS.items()},
        references=("Apache Parquet format, parquet.apache.org/docs/file-format",),
    )
