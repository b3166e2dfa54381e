"""Recordings that recon keeps as one MCAP file: the file itself, or a run's folder with `streams.mcap`.

`recon.storage.mcap` describes the layout. MCAP files of other programs are not read here: the error names what they
hold. For the rest this reader does what `reader.parquet` does.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recon.hookspecs import hookimpl
from recon.schema import STREAMS
from recon.stages import Reader, Sniff
from recon.storage import store_of
from recon.storage.mcap import MAGIC, is_own
from recon_readers.parquet import stored


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder with `streams.mcap`, or an MCAP file that says it is recon's; faintly any other MCAP file."""
    if path.is_dir():
        own = store_of(path) == "mcap"
        return Sniff(1.0, "folder with streams as MCAP") if own else Sniff(0.0, "a folder without streams")
    if is_own(head):
        return Sniff(1.0, "MCAP file of profile recon")
    if head.startswith(MAGIC):
        return Sniff(0.1, "MCAP file of another program")
    return Sniff(0.0, "another magic number")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of recon's own MCAP files."""
    yield Reader(
        name="mcap",
        summary="Recordings kept by recon as MCAP.",
        run=stored,
        sniff=sniff,
        self_describing=True,
        writes={name: schema.open_ended() for name, schema in STREAMS.items()},
        references=("MCAP specification, mcap.dev/spec",),
    )
