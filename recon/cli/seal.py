"""`recon seal`: a finished run as one file that anybody can check and run again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, registry_of
from recon.cli._results import accounted

if TYPE_CHECKING:
    from recon.evidence import Sealed


def seal(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The sealed file; by default RUN.zip in the working directory.")
    ] = None,
    inputs: Annotated[
        list[Path] | None,
        typer.Option("--input", metavar="LOG", help="The log, where it is no longer where the run read it."),
    ] = None,
    exports: Annotated[bool, typer.Option("--exports", help="Take the files of the run's exporters along.")] = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Seal a run with its log, pipeline, manifest and versions in one file, when it has come out again byte by byte.

    Example: recon seal drive-crash --exports
    """
    from recon import evidence

    registry = registry_of(blocked, first_party_only)
    target = out or Path(f"{run.resolve().name}.zip")
    with accounted({"the seal": target}):
        made = evidence.seal(run, target, inputs or (), exports=exports, registry=registry)
        if as_json:
            console.write_json({"file": str(made.file), "sha256": made.sha256, "bytes": made.size, "files": made.names})
        else:
            console.write(as_text(made))


def as_text(made: Sealed) -> str:
    """The seal for people."""
    rows = [
        ("sealed", str(made.file)),
        ("holds", f"{len(made.names)} files, {made.size:,} bytes"),
        ("replay", "same bytes"),
        ("SHA-256", made.sha256),
    ]
    note = "note the SHA-256 where others can see it: it alone shows that this is the file of today"
    return f"{console.table(rows)}\n{note}"
