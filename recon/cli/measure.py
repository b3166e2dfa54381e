"""`recon measure`: distance and bearing between two times or frames of a finished run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import AsJson

if TYPE_CHECKING:
    from recon.movement import Movement

_DIGITS: Final = {"m": 3, "deg": 4, "s": 3}
"""That are shown to people."""
_TIMES: Final = "'#12' (frame), '100s' (after the first row) or an ISO time."


def measure(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a finished run.")],
    start: Annotated[str, typer.Option("--from", metavar="A", help=f"Where it begins: {_TIMES}")],
    stop: Annotated[str, typer.Option("--to", metavar="B", help="Where it ends, likewise.")],
    as_json: AsJson = False,
) -> None:
    """Measure distance and bearing between two times or frames of a run.

    Example: recon measure drive-smartphone --from '#12' --to 100s
    """
    from recon import api
    from recon.rounding import milliseconds

    moved = api.open(run).trajectory.between(start, stop)
    data = as_data(moved)
    if as_json:
        console.write_json({"run": str(run), "from": str(moved.start), "to": str(moved.stop), **data})
    else:
        console.write(
            as_text(f"{run} from {milliseconds(str(moved.start))} to {milliseconds(str(moved.stop))} UTC", data)
        )


def as_data(moved: Movement) -> dict[str, dict[str, Any]]:
    """Value, sigma and unit of each figure; null for what is not known. A length of the path and a time have no sigma.

    distance is along the ellipsoid; bearings are those of that way, 0 to 360, clockwise from true north.
    """
    import numpy as np

    bearings = {"initial_bearing": moved.initial_bearing, "final_bearing": moved.final_bearing}
    sigma = float(np.degrees(moved.bearing_sigma))
    return {
        "distance": _figure(moved.ground_distance, moved.ground_distance_sigma, "m"),
        "path_length": _figure(moved.path_length, float("nan"), "m"),
        **{name: _figure(float(np.degrees(value)), sigma, "deg") for name, value in bearings.items()},
        "height_difference": _figure(moved.height_difference, moved.height_sigma, "m"),
        "elapsed": _figure(moved.duration, float("nan"), "s"),
    }


def _figure(value: float, sigma: float, unit: str) -> dict[str, Any]:
    return {"value": _known(value), "sigma": _known(sigma), "unit": unit}


def _known(value: float) -> float | None:
    return value if value == value else None  # only NaN differs from itself


def as_text(title: str, data: dict[str, dict[str, Any]]) -> str:
    """The figures for people: a line each."""
    rows = [("", "", "", "sigma")]
    for name, figure in data.items():
        digits = _DIGITS[figure["unit"]]
        value, sigma = (
            "" if number is None else f"{number:.{digits}f}" for number in (figure["value"], figure["sigma"])
        )
        rows.append((name.replace("_", " "), value or "not known", figure["unit"], sigma))
    widths = [max(len(row[column]) for row in rows) for column in (1, 3)]
    aligned = [(name, value.rjust(widths[0]), unit, sigma.rjust(widths[1])) for name, value, unit, sigma in rows]
    shown = aligned if any(row[3] for row in rows[1:]) else aligned[1:]
    return f"{title}\n{console.table(shown)}"
