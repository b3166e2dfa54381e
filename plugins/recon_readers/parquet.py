"""Recordings that recon keeps as Parquet, and single streams in Parquet files of other programs.

    a run's folder with streams/<stream>.parquet      a folder of <stream>.parquet      one <stream>.parquet

`recon.storage.parquet` says how they are kept, and what is asked of a file of another program: canonical name, columns,
units and frames. All streams come as they were kept, in the frames in which they were kept; rows of `events` and
`metrics` keep the name of the step that made them.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.schema import STREAMS
from recon.stages import Reader, Sniff
from recon.storage import read_recording, store_of
from recon.storage.parquet import MAGIC
from recon.tables import Streams


def stored(path: Path, params: NoParams) -> Streams:
    """The streams of a recording that recon keeps at `path`, in either store. Raises ReadFailed."""
    return dict(read_recording(path))


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
