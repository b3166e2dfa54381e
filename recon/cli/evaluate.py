"""`recon evaluate`: errors of a finished run against a reference, and whether its sigmas are honest."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson, Blocked, FirstPartyOnly, Settings, overrides_of, registry_of
from recon.cli._results import warning_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from recon.evaluation import Evaluation
    from recon.numerics.evaluation import Statistics

_FIGURES: Final = ("rmse", "mean", "median", "p95", "max")
_HEAD: Final = ("rms", "mean", "median", "95 %", "largest")


class Align(StrEnum):
    """How a trajectory is moved before it is compared."""

    none = "none"
    yaw = "yaw"
    se3 = "se3"
    start = "start"


def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")],
    reference: Annotated[
        Path | None,
        typer.Option(metavar="REF", help="Another run, or any log that holds a reference; by default the run's own."),
    ] = None,
    align: Annotated[
        Align,
        typer.Option(
            help="Move the trajectory onto the reference first: yaw, turned about the vertical; se3, about all axes; "
            "start, by its first pose."
        ),
    ] = Align.none,
    settings: Settings = None,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Compare a run with a reference.

    Example: recon evaluate drive-thesis --reference rtk.csv
    """
    from recon import api, evaluation
    from recon.pipeline import Pipeline

    overrides, registry = overrides_of(settings), registry_of(blocked, first_party_only)
    finished, given = api.open(run), None
    if reference is not None:
        given = api.execute(Pipeline.of("evaluate", "reader.auto"), reference, None, overrides, registry=registry)
    found = api.evaluate(finished, given, align=align.value)
    stream = "reference" if given is None else evaluation.reference_in(given.recording)[0]
    source = f"stream '{stream}' of {run if reference is None else reference}"
    warnings = [*found.notes, *(given.warnings if given else [])]
    if as_json:
        data = found.as_data()
        console.write_json({"run": str(run), "against": source, **data, "notes": warnings})
    else:
        console.write("\n".join([as_text(f"{run} against the {source}", found), *warning_lines(warnings)]))


def as_text(title: str, found: Evaluation) -> str:
    """The figures for people: a line each, numbers below each other."""
    share = 100.0 * found.rows / found.compared
    rows = [
        ("matched", f"{found.rows} of {found.compared} rows of the {found.clock} ({share:.1f} %)"),
        ("", f"over {found.span_s:.1f} s of {found.of_s:.1f} s of the trajectory"),
        ("aligned", f"by '{found.align}': the errors are what is left" if found.align != "none" else "not at all"),
    ]
    parts = [
        f"{title}\n{console.table(rows)}",
        _section("errors", _HEAD, _absolute(found)),
        _section("errors over segments", (*_HEAD, "of the way"), _segments(found)),
        _section("errors in outages", _HEAD, _outages(found)),
        _section(
            "sigmas",
            ("NEES", "of honest ones, 99.9 %", "sigmas are", "< 1 sigma", "< 2 sigma", "< 3 sigma"),
            _sigmas(found),
        ),
    ]
    return "\n\n".join(part for part in parts if part)


def _section(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table under its head, numbers to the right; "" without a row."""
    found = [(title, *head), *rows]
    if len(found) == 1:
        return ""
    widths = [max(len(row[column]) for row in found) for column in range(1, len(found[0]))]
    return console.table(
        [(row[0], *(cell.rjust(width) for cell, width in zip(row[1:], widths, strict=True))) for row in found]
    )


def _absolute(found: Evaluation) -> Iterable[Sequence[str]]:
    groups = (
        ("position", "m", found.position),
        ("velocity", "m/s", found.velocity),
        ("attitude", "deg", found.attitude),
    )
    for group, unit, figures in groups:
        for name, figure in figures.items():
            if figure is not None:
                yield (f"{group}, {name} [{unit}]", *_cells(figure))


def _segments(found: Evaluation) -> Iterable[Sequence[str]]:
    for part in found.relative:
        share = "" if part.percent is None else f"{part.percent:.2f} %"
        yield (f"{part.length:g} {part.unit}, translation [m]", *_cells(part.translation), share)
        yield (f"{part.length:g} {part.unit}, rotation [deg]", *_cells(part.rotation), "")


def _outages(found: Evaluation) -> Iterable[Sequence[str]]:
    for number, outage in enumerate(found.outages, start=1):
        lasts = f"{number}, {(outage.end_ns - outage.start_ns) * 1e-9:.1f} s"
        figures = (("horizontal [m]", outage.horizontal), ("velocity [m/s]", outage.velocity))
        for name, figure in (*figures, ("heading [deg]", outage.heading)):
            yield (f"{lasts}, {name}", *(_cells(figure) if figure else ("no reference", "", "", "", "")))


def _sigmas(found: Evaluation) -> Iterable[Sequence[str]]:
    for name, figure in found.consistency.items():
        if figure is not None:
            low, high = figure.limits
            shares = (f"{100.0 * share:.1f} %" for share in figure.coverage)
            yield (name, f"{figure.nees:.2f}", f"{low:.2f} to {high:.2f}", figure.verdict, *shares)


def _cells(figure: Statistics) -> Sequence[str]:
    return [f"{getattr(figure, name):.3f}" for name in _FIGURES]
