"""Recordings that recon keeps as one MCAP file: the file itself, or a run's folder with `streams.mcap`.

`recon.storage.mcap` describes the layout. MCAP files of other programs are not read here: the error names what they
hold. Of a file that is cut short or damaged everything whole is read, and a warning counts what is lost. For the rest
this reader does what `reader.parquet` does.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.rows import metrics, warning
from recon.schema import STREAMS
from recon.stages import Reader, Sniff
from recon.storage import salvage_recording, store_of
from recon.storage.mcap import MAGIC, is_own
from recon.tables import Streams, append


def salvaged(path: Path, params: NoParams) -> Streams:
    """The streams of a recording that recon keeps at `path`. Raises ReadFailed where nothing in it is whole."""
    recording, loss = salvage_recording(path)
    streams = dict(recording)
    if loss:
        told, kept = metrics([warning(loss)]), streams.get("metrics")
        streams["metrics"] = told if kept is None else append(told, kept)
    return streams


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
        run=salvaged,
        sniff=sniff,
        self_describing=True,
        writes={name: schema.open_ended() for name, schema in STREAMS.items()},
        references=("MCAP specification, mcap.dev/spec",),
    )
