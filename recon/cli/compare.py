"""`recon compare`: finished runs side by side, and laid over each other."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Overwrite, registry_of
from recon.cli._results import accounted
from recon.problems import shortened

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pyarrow as pa

    from recon.api import Run
    from recon.comparison import Comparison, Distance, Row
    from recon.evaluation import Evaluation
    from recon.numerics.evaluation import Statistics
    from recon.registry import Registry

LONGEST: Final = 60
"""Characters of a value that people are shown."""


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Folders of finished runs.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A result with all trajectories laid over each other.")
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(metavar="REF", help="What they err against: a run, or any log with a reference; else their own."),
    ] = None,
    exports: Annotated[
        list[str] | None,
        typer.Option(
            "--export",
            metavar="NAME",
            help="Exporters of that result in place of plots: rerun, map, ...",
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Show results that are the same, or that one run alone has, too.")
    ] = False,
    overwrite: Overwrite = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Compare finished runs: how they were made, what they found, how far their trajectories are apart.

    Example: recon compare drive-thesis drive-best_accuracy --out both --export plots
    """
    from recon import api, comparison

    _refuse(runs, exports, out)
    registry = registry_of(blocked, first_party_only)
    finished = [api.open(run) for run in runs]
    found = comparison.compare(finished, _reference(reference, registry))
    if not as_json:
        console.write(as_text(found, everything=everything))
    if out is not None:
        with accounted({"the overlay": out}):
            named = _drawn() if exports is None else exports
            overlay = _overlay(finished, out, named, overwrite=overwrite, registry=registry)
        if not as_json:
            console.write("\n" + _laid_over(overlay, drawn=bool(named)))
    if as_json:
        console.write_json({**found.as_data(), "overlay": None if out is None else str(out)})


def _refuse(runs: Sequence[Path], exports: Sequence[str] | None, out: Path | None) -> None:
    """Raises ConfigError where there is nothing to compare, or nowhere to export to."""
    from recon.errors import ConfigError
    from recon.problems import Problem, Where

    if exports and out is None:
        raise ConfigError([Problem(Where("--export"), "no-folder", "an export needs a folder", "add --out DIR")])
    if len(runs) < 2:
        raise ConfigError([Problem(None, "one-run", "a comparison needs two runs", "name another one")])


def _overlay(runs: Sequence[Run], out: Path, exports: Sequence[str], *, overwrite: bool, registry: Registry) -> Run:
    """A result with all trajectories, and what the exporters make of it."""
    from recon import api, comparison
    from recon.pipeline import Pipeline

    together = comparison.overlay(runs)
    return api.execute(
        Pipeline("compare", ()), together, out, [], registry=registry, exports=exports, overwrite=overwrite
    )


def _reference(path: Path | None, registry: Registry) -> pa.Table | None:
    """What runs are to be compared with. Raises ReadFailed, DataError."""
    if path is None:
        return None
    from recon import api, evaluation

    return evaluation.reference_in(api.read(path, registry=registry))[1]


def _drawn() -> list[str]:
    """What is exported of the overlay where nothing is named: its plots, if what draws them is installed."""
    return ["plots"] if find_spec("matplotlib") else []


def _laid_over(overlay: Run, *, drawn: bool) -> str:
    """Where the overlay is, for people."""
    from recon.cli._results import exported

    files = [("export", str(path)) for path in exported(overlay)]
    none = [] if drawn else [("plots", 'none: they need matplotlib, pip install "recon-dynamics[report]"')]
    return "laid over each other\n" + console.table([*files, *none, ("result", str(overlay.folder))])


def as_text(found: Comparison, *, everything: bool = False) -> str:
    """The comparison for people: a line each, values below each other."""
    shown = [row for row in found.results if everything or (row.differs and row.everywhere)]
    parts = [
        _section("made differently", found.runs, found.settings),
        _section("found" if everything else "found differently", found.runs, shown),
        _distances(found),
        errors_beside(found),
    ]
    return "\n\n".join(part for part in parts if part)


def _section(title: str, runs: Sequence[str], rows: Sequence[Row]) -> str:
    if not rows:
        return f"{title}: nothing"
    named = [(f"{row.name} [{row.unit}]" if row.unit else row.name, *map(_cell, row.values)) for row in rows]
    return console.table([(title, *runs), *named])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else shortened(str(value), LONGEST)


_GROUPS: Final = {"position": "m", "velocity": "m/s", "attitude": "deg"}


def _distances(found: Comparison) -> str:
    head = (f"distance from {found.runs[0]}", "rms", "95 %", "largest")
    rows: list[tuple[str, ...]] = [head]
    for distance in found.distances:
        for name, figure in _figures(distance.found) if distance.found else ():
            cells = (f"{value:.3f}" for value in (figure.rmse, figure.p95, figure.max))
            rows.append((f"{distance.run}: {name}", *cells))
    return "\n".join([console.table(rows), *_notes(found.distances)])


def errors_beside(found: Comparison) -> str:
    """Errors of all runs beside each other, and what is to be said of them; "" without a reference."""
    if not found.errors:
        return ""
    known = [dict(_figures(error.found)) if error.found else {} for error in found.errors]
    names = dict.fromkeys(name for figures in known for name in figures)
    rows = [("rms error against the reference", *(error.run for error in found.errors))]
    rows += [(name, *(f"{figures[name].rmse:.3f}" if name in figures else "-" for figures in known)) for name in names]
    return "\n".join([console.table(rows), *_notes(found.errors)])


def _notes(distances: Sequence[Distance]) -> list[str]:
    """What is to be said of each, a line each."""
    said = [(one.run, one.found.notes if one.found else (one.reason,)) for one in distances]
    return [f"  {run}: {note}" for run, notes in said for note in notes]


def _figures(found: Evaluation) -> Iterator[tuple[str, Statistics]]:
    """Every figure that is known, by its name and unit."""
    for group, unit in _GROUPS.items():
        for name, figure in getattr(found, group).items():
            if figure is not None:
                yield f"{group}, {name} [{unit}]", figure
