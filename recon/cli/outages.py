"""`recon outages`: what a result loses where GNSS is gone, on a log of one's own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from recon.cli import _console as console
from recon.cli._options import (
    AsJson,
    Blocked,
    FirstPartyOnly,
    Overwrite,
    Settings,
    bad_option,
    overrides_of,
    registry_of,
)
from recon.cli._progress import progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from recon.outages import Outage, Study

_HEAD: Final = (
    *("outage", "number", "way", "horizontal", "largest", "of the way", "worst inside", "vertical"),
    *("velocity", "heading", "sigma told", "within 2 sigma"),
)
_LEGEND: Final = (
    "errors are medians at the end of an outage, but 'largest' is the largest horizontal one there, and 'worst inside' "
    "the median of the largest horizontal ones while GNSS was away; of honest sigmas, which are of east and north "
    "together, 95 to 98 % are within 2"
)
_COLORS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Of Okabe and Ito (2008), which every eye tells apart."""


def outages(
    paths: Annotated[list[Path], typer.Argument(metavar="LOG", help="A log, or several files of one drive.")],
    lengths: Annotated[str, typer.Option(metavar="S,S,...", help="Lengths of outages in s.")] = "10,30,60",
    pipeline: Annotated[
        str, typer.Option(metavar="PIPELINE", help="Name of a shipped pipeline, or a YAML file.")
    ] = "best_accuracy",
    most: Annotated[int, typer.Option(min=1, help="Outages of each length, at most: as many as find room.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Of where they begin.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the table, every number, and a plot of how errors grow.")
    ] = None,
    settings: Settings = None,
    overwrite: Overwrite = False,
    blocked: Blocked = None,
    first_party_only: FirstPartyOnly = False,
    as_json: AsJson = False,
) -> None:
    """Take GNSS away from a log for a while, here and there, and tell how far the result then is from what it was.

    Example: recon outages drive.txt --lengths 10,30,60 --out tunnels
    """
    from recon.outages import study
    from recon.pipeline import Pipeline
    from recon.storage import refuse_existing

    if out is not None:
        refuse_existing(out, overwrite=overwrite)
        _figures()  # before all the work, not after it
    chosen, overrides = Pipeline.from_file(pipeline), overrides_of(settings)
    registry = registry_of(blocked, first_party_only)
    spans = _lengths(lengths)
    with progress() as shown:
        found = study(
            paths, chosen, spans, most=most, seed=seed, overrides=overrides, registry=registry, progress=shown
        )
    data = {"paths": [str(path) for path in paths], "pipeline": chosen.name, "seed": seed, **found.as_data()}
    if out is not None:
        _keep(out, data, found, overwrite=overwrite)
    if as_json:
        console.write_json(data)
        return
    kept = [f"kept in {out}: outages.md, outages.json, outages.png"] if out is not None else []
    console.write("\n".join([_as_text(data), *kept]))


def _as_text(data: Mapping[str, Any]) -> str:
    how = f"pipeline {data['pipeline']}, against {_against(data['against'])}"
    title = f"{', '.join(data['paths'])}: outages of GNSS, {how}"
    return "\n".join(
        [title, console.table([_HEAD, *_rows(data["lengths"])]), _LEGEND, *_lost(data["lengths"]), *_doubts(data)]
    )


def _against(what: str) -> str:
    return "the log's own reference" if what == "reference" else "the result with all fixes (whose errors both share)"


def _doubts(data: Mapping[str, Any]) -> list[str]:
    """What the pipeline warned of, each text once with all that it ran over; and whose errors are not to be trusted."""
    found: dict[str, list[str]] = {}
    for over, texts in data["warnings"].items():
        for text in texts:
            found.setdefault(text, []).append(over)
    lines = [f"warning: the result with {' and '.join(over)}: {text}" for text, over in found.items()]
    doubted = dict.fromkeys(over for text, overs in found.items() if "do not trust" in text for over in overs)
    distrust = f"warning: so what is told of {' and '.join(doubted)} is not to be trusted either"
    return [*lines, distrust] if doubted else lines


def _lost(lengths: Sequence[Mapping[str, Any]]) -> list[str]:
    """Which lengths have no result, and why."""
    lost = [(one["length_s"], one["lost"]) for one in lengths if one["lost"] is not None]
    return [f"warning: there is no result with outages of {length:g} s: {why}" for length, why in lost]


def _lengths(text: str) -> list[float]:
    """Raises ConfigError."""
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if not found or not all(0.0 < length < math.inf for length in found):
        raise bad_option(f"--lengths '{text}' are no seconds", "write 10,30,60")
    return list(dict.fromkeys(found))


def _rows(lengths: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Cells of the table; errors at the end of the outage, medians unless the head says otherwise."""
    return [
        (
            f"{one['length_s']:g} s",
            str(one["count"]),
            _shown(one["way_m"], "m", 0),
            _shown(one["horizontal"]["median"], "m", 2),
            _shown(one["horizontal"]["max"], "m", 2),
            _shown(one["drift_percent"], "%", 2),
            _shown(one["worst"]["median"], "m", 2),
            _shown(one["vertical"]["median"], "m", 2),
            _shown(one["velocity"]["median"], "m/s", 3),
            _shown(one["heading"]["median"], "deg", 2),
            _shown(one["sigma"], "m", 2),
            _shown(None if one["within_2_sigma"] is None else 100.0 * one["within_2_sigma"], "%", 0),
        )
        for one in lengths
    ]


def _shown(value: float | None, unit: str, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def _keep(out: Path, data: Mapping[str, Any], found: Study, *, overwrite: bool) -> None:
    """Write the table, the numbers and the plot."""
    from recon.storage import staged_folder
    from recon.storage.json_text import to_json

    rows = _rows(data["lengths"])
    lines = ["| " + " | ".join(cells) + " |" for cells in (_HEAD, ["---"] * len(_HEAD), *rows)]
    note = f"Errors at the end of outages, medians; pipeline {data['pipeline']}, against {_against(data['against'])}."
    doubts = [f"\n{text}" for text in (*_lost(data["lengths"]), *_doubts(data))]
    with staged_folder(out, overwrite=overwrite) as folder:
        (folder / "outages.md").write_text("\n".join([*lines, "", note, *doubts, ""]), encoding="utf-8", newline="\n")
        (folder / "outages.json").write_text(to_json(data, indent=1) + "\n", encoding="utf-8", newline="\n")
        _draw(folder / "outages.png", found.outages)


def _figures() -> type[Figure]:
    """Raises PluginError where Matplotlib is not installed."""
    from recon.extras import needs

    with needs("the plot", "matplotlib", extra="figures"):
        from matplotlib.figure import Figure
    return Figure


def _draw(path: Path, found: Mapping[float, Sequence[Outage]]) -> None:
    """How the horizontal error grows in every outage."""
    figure = _figures()(figsize=(6.7, 3.6), layout="constrained")
    axes = figure.subplots()
    for color, (length, some) in zip(cycle(_COLORS), found.items(), strict=False):
        for number, one in enumerate(some):
            label = f"{length:g} s, {len(some)} outages" if number == 0 else None
            axes.plot(one.t_s, one.growth, color=color, linewidth=0.9, alpha=0.75, label=label)
            axes.plot(one.t_s[-1:], one.growth[-1:], "o", color=color, markersize=3.0)
    axes.set_xlabel("s without GNSS")
    axes.set_ylabel("horizontal error [m]")
    axes.grid(color="#e4e6e8")
    axes.legend(frameon=False)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    figure.savefig(path, dpi=160)
