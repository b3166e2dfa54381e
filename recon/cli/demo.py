"""`recon demo`: a simulated drive, its reconstruction by two pipelines, and how far they are from the truth."""

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
PIPELINE: Final = "best_accuracy"
SIMPLER: Final = "thesis"
"""The pipeline that the errors are shown beside."""


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

    drive, best, simple = (out / name for name in ("drive", PIPELINE, SIMPLER))
    for folder in (drive, best, simple):
        refuse_existing(folder, overwrite)
    registry = Registry.installed()

    def made(pipeline: Pipeline, source: Path | None, folder: Path) -> Run:
        with progress() as shown:
            return execute(pipeline, source, folder, [], registry=registry, overwrite=overwrite, progress=shown)

    with accounted({"the drive": drive, f"the result of '{PIPELINE}'": best, f"the result of '{SIMPLER}'": simple}):
        made(Pipeline.of("drive", SIMULATOR), None, drive)
        runs = [made(Pipeline.from_file(folder.name), drive, folder) for folder in (best, simple)]
        console.write(_as_text(drive, runs))


def _as_text(drive: Path, runs: list[Run]) -> str:
    from recon.api import evaluate
    from recon.cli.compare import errors_beside
    from recon.cli.evaluate import as_text as errors_as_text
    from recon.comparison import compare

    best = runs[0]
    further = [
        (f"recon measure {best.folder} --from 30s --to 60s", "distance and bearing"),
        (f"recon inspect {best.folder}", "what is in the result"),
        (f"recon export {best.folder} report", "a page to read and print"),
        (f"recon run {PIPELINE} LOG", "the same for a log of yours"),
    ]
    return "\n".join(
        [
            f"simulated: {drive}",
            f"reconstructed by pipeline '{PIPELINE}': {best.folder}",
            as_text(best),
            "",
            errors_as_text("against the truth", evaluate(best)),
            "",
            f"beside the pipeline '{SIMPLER}', a step for each of the thesis' methods",
            errors_beside(compare(runs)),
            "",
            "next",
            console.table(further),
        ]
    )
