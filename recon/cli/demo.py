"""`recon demo`: a simulated drive, its reconstruction, and how far the two are apart."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from recon.cli import _console as console
from recon.cli._options import Overwrite
from recon.cli._progress import progress
from recon.cli._results import accounted, as_text

if TYPE_CHECKING:
    from recon.api import Run

SIMULATOR: Final = "simulator.drive"
PIPELINE: Final = "thesis"


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the two results go.")] = Path("recon-demo"),
    overwrite: Overwrite = False,
) -> None:
    """Simulate a drive, reconstruct it, compare with the truth.

    Example: recon demo --out my-demo
    """
    from recon.api import execute
    from recon.pipeline import Pipeline
    from recon.registry import Registry
    from recon.storage import refuse_existing

    drive, thesis = out / "drive", out / PIPELINE
    for folder in (drive, thesis):
        refuse_existing(folder, overwrite)
    registry = Registry.installed()
    with accounted({"the drive": drive, "the reconstruction": thesis}):
        with progress() as shown:
            made = Pipeline.of("drive", SIMULATOR)
            execute(made, None, drive, [], registry=registry, overwrite=overwrite, progress=shown)
        with progress() as shown:
            found = Pipeline.from_file(PIPELINE)
            run = execute(found, drive, thesis, [], registry=registry, overwrite=overwrite, progress=shown)
        console.write(_as_text(run, drive, thesis))


def _as_text(run: Run, drive: Path, thesis: Path) -> str:
    from recon.api import evaluate
    from recon.cli.evaluate import as_text as errors_as_text

    further = [
        (f"recon measure {thesis} --from 30s --to 60s", "distance and bearing"),
        (f"recon inspect {thesis}", "what is in the result"),
        (f"recon export {thesis} csv", "tables for a spreadsheet"),
        (f"recon run {PIPELINE} LOG", "the same for a log of yours"),
    ]
    return "\n".join(
        [
            f"simulated: {drive}",
            f"reconstructed by pipeline '{PIPELINE}': {thesis}",
            as_text(run),
            "",
            errors_as_text("against the truth", evaluate(run)),
            "",
            "next",
            console.table(further),
        ]
    )
