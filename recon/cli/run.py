"""`recon run`: a pipeline over a log."""

from __future__ import annotations

import re
from collections.abc import Sequence
from os.path import realpath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from recon.cli import _console as console
from recon.cli._options import (
    AsJson,
    Blocked,
    FirstPartyOnly,
    Inputs,
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
from recon.cli._results import accounted, as_data, as_text

if TYPE_CHECKING:
    from recon.pipeline import Pipeline

_Out: TypeAlias = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for the result; by default named after INPUT and PIPELINE.")
]
_Exports: TypeAlias = Annotated[
    list[str] | None, typer.Option("--export", metavar="NAME", help="Export when the run is done.")
]


def run(
    pipeline: Annotated[str, typer.Argument(metavar="PIPELINE", help="Name of a shipped pipeline, or a YAML file.")],
    inputs: Inputs = None,
    out: _Out = None,
    settings: Settings = None,
    start: Start = None,
    stop: Stop = None,
    exports: _Exports = None,
    store: Store = None,
    overwrite: Overwrite = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Run a pipeline over a log.

    Example: recon run thesis drive.txt --export csv --set filter.moving_average.window="20 ms"
    """
    from recon import api, memory
    from recon.check import with_span
    from recon.pipeline import Pipeline

    memory.keep_freed()
    check_store(store)
    overrides, registry = overrides_of(settings), registry_of(blocked, first_party_only)
    found = Pipeline.from_file(pipeline)
    _check_inputs(found, inputs or ())
    folder = out or default_folder(found.name, inputs or ())
    names = list(dict.fromkeys(exports or ()))

    def tell(finished: api.Run) -> None:
        if as_json:
            console.write_json(as_data(finished))
        else:
            console.write(as_text(finished))

    results, goes_on = {"the run": folder, **_places(folder, names)}, f"recon export {folder}"
    with accounted(results, goes_on, tell=lambda: tell(api.open(folder))):
        with progress() as shown:
            finished = api.execute(
                with_span(found, start, stop), inputs or None, folder, overrides, registry=registry, exports=names,
                store=store, overwrite=overwrite, progress=shown,
            )  # fmt: skip
        tell(finished)


def _places(folder: Path, exports: Sequence[str]) -> dict[str, Path]:
    """Where each export appears, by what messages call it."""
    return {f"export {name}": folder / "exports" / name.removeprefix("exporter.") for name in exports}


def _check_inputs(pipeline: Pipeline, inputs: Sequence[Path]) -> None:
    """Raises ConfigError where a log is needed: asked first, since the result's place is named after it."""
    from recon.stages import role_of

    if not inputs and role_of(pipeline.steps[0].use) == "reader":
        text = f"pipeline '{pipeline.name}' reads a log, and none is given"
        raise bad_option(text, "name it behind the pipeline")


def default_folder(pipeline: str, inputs: Sequence[Path]) -> Path:
    """Where a result goes that was given no place: `<stem of the first input>-<pipeline>` in the working directory."""
    stems = [Path(realpath(path)).stem for path in inputs[:1]]
    return Path(re.sub(r"[^\w.-]+", "_", "-".join([*stems, pipeline])))
