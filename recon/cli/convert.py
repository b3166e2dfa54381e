"""`recon convert`: any log that can be read, as Parquet or MCAP."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import (
    Blocked,
    FirstPartyOnly,
    Overwrite,
    Settings,
    Start,
    Stop,
    Store,
    bad_option,
    check_store,
    overrides_of,
    registry_of,
)
from recon.cli._progress import progress
from recon.cli._results import accounted, warning_lines

if TYPE_CHECKING:
    from recon.api import Run
    from recon.registry import Registry


def convert(
    sources: Annotated[list[Path], typer.Argument(metavar="SRC", help="A log, several of one drive, or a result.")],
    target: Annotated[Path, typer.Argument(metavar="DST", help="A new folder, or one file that ends in .mcap.")],
    settings: Settings = None,
    start: Start = None,
    stop: Stop = None,
    store: Store = None,
    overwrite: Overwrite = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
) -> None:
    """Write a log as Parquet or MCAP.

    Example: recon convert drive.txt drive.mcap --from 120s --to 10min
    """
    from recon.api import execute
    from recon.check import with_span
    from recon.pipeline import Pipeline
    from recon.rounding import counted

    check_store(store)
    overrides, registry = overrides_of(settings), registry_of(blocked, first_party_only)
    as_file = target.suffix.lower() == ".mcap"
    if as_file:
        _refuse(target, store, overwrite=overwrite)
    else:
        _check_kind(target, registry)
    with accounted({"the recording": target}):
        with progress() as shown:
            made = execute(
                with_span(Pipeline.of("convert", "reader.auto"), start, stop), sources, None if as_file else target,
                overrides, registry=registry, store=store, overwrite=overwrite, progress=shown,
            )  # fmt: skip
            if as_file:
                _write_file(made, target)
        rows = ", ".join(f"{name} ({counted(table.num_rows, 'row')})" for name, table in made.recording.items())
        console.write("\n".join([f"{target}: {rows}", *warning_lines(made.warnings)]))


def _check_kind(target: Path, registry: Registry) -> None:
    """Raises ConfigError for the name of a file of another kind: a folder of that name is not what is wanted."""
    kind = target.suffix[1:].lower()
    if kind == "parquet":
        text, hint = f"{target} would be a folder, with a Parquet file for each stream", f"write {target.stem}"
    elif f"exporter.{kind}" in registry:
        text, hint = f"convert writes no {kind}", f"convert to a folder, then write 'recon export FOLDER {kind}'"
    else:
        return
    raise bad_option(text, hint)


def _refuse(target: Path, store: str | None, *, overwrite: bool) -> None:
    """Raises ConfigError where the file may not be written: to be asked before any work is done."""
    from recon.storage import refuse_existing, store_of

    if store == "parquet":
        hint = "name a folder, or leave --store away"
        raise bad_option(f"{target} is a single MCAP file", hint, f"--store {store}")
    if not (overwrite and target.is_file() and store_of(target) == "mcap"):
        refuse_existing(target, overwrite)


def _write_file(made: Run, target: Path) -> None:
    """One MCAP file. Its meta holds the manifest, but for what differs between equal runs."""
    from recon.recording import Recording
    from recon.storage import mcap, staged_file
    from recon.tables import with_meta

    manifest = {key: value for key, value in made.manifest.items() if key not in ("environment", "outputs", "store")}
    streams = {name: with_meta(table) for name, table in made.recording.items()}
    with staged_file(target) as path:
        mcap.write_file(Recording(streams, {**made.recording.meta, "manifest": manifest}), path)
