"""What is on disk after all when a command fails or is interrupted, and what a finished run is told as."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from recon.cli import _console as console
from recon.cli import _signals as signals
from recon.errors import ReconError, StorageError

if TYPE_CHECKING:
    from recon.api import Run

MOST_WARNINGS: Final = 8
_SURE_M: Final = 0.5
"""m of sigma below which a distance is told without it."""


@contextmanager
def accounted(results: Mapping[str, Path], goes_on: str = "", tell: Callable[[], None] | None = None) -> Iterator[None]:
    """An error or interruption in the block says which of these results were written before it, by looking.

    The block ends with its report to the user: after it, an interruption is too late and is ignored.

    results : by what messages call it, the place where a result appears when it is whole
    goes_on : the command that makes what is missing once the first of them is there, followed by the last words of
        what it is called
    tell : reports the first of them where it is there and something behind it failed
    """
    before = {name: _identity(path) for name, path in results.items()}
    try:
        yield
        signals.hold()
    except (ReconError, KeyboardInterrupt) as error:
        there = {name: _identity(path) for name, path in results.items()}
        made = [name for name in results if there[name] not in (None, before[name])]
        missing = [name for name in results if name not in made]
        whole = [f"{name} is complete: {results[name]}" for name in made]
        if tell is not None and made[:1] == [*results][:1] and not isinstance(error, StorageError | KeyboardInterrupt):
            tell()
        if not whole and isinstance(error, StorageError):
            whole = ["nothing of it is kept; the same command begins anew"]
        elif whole and missing and goes_on and isinstance(error, StorageError | KeyboardInterrupt):
            whole.append(f"'{goes_on} {' '.join(name.rpartition(' ')[2] for name in missing)}' makes what is missing")
        if not whole:
            raise
        if isinstance(error, KeyboardInterrupt):
            error.args = ("; ".join(filter(None, (str(error), *whole))),)
        else:
            error.hint = "\n".join([*error.hint.splitlines(), *whole])
        raise


def _identity(path: Path) -> tuple[int, int] | None:
    """Tells a file or folder from another one that took its place; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def as_data(finished: Run) -> dict[str, Any]:
    """A finished run for programs; `crash` only where a step judged crashes."""
    from recon.crash_summary import crash_summary

    crash = crash_summary(finished.recording)
    return {
        "folder": str(finished.folder),
        "pipeline": finished.manifest["pipeline"]["name"],
        "summary": finished.summary(),
        **({"crash": crash} if crash is not None else {}),
        "warnings": finished.warnings,
        "streams": list(finished.recording),
        "exports": [str(path) for path in exported(finished)],
    }


def as_text(finished: Run) -> str:
    """A finished run for people: a short table, then what they should know before they believe it."""
    from recon.crash_summary import crash_summary

    facts, crash = finished.summary(), crash_summary(finished.recording)
    rows = [
        ("distance", _distance(facts) if "distance" in facts else ""),
        ("duration", f"{facts['duration']:,.1f} s" if "duration" in facts else ""),
        ("top speed", _speed(facts["top_speed"]) if "top_speed" in facts else ""),
        ("stops", f"{facts['stops']:.0f}" if "stops" in facts else ""),
        *(_crash_rows(crash) if crash is not None else ()),
        ("warnings", str(len(finished.warnings))),
        ("streams", ", ".join(finished.recording)),
        *(("export", str(path)) for path in exported(finished)),
        ("result", str(finished.folder)),
    ]
    told = [console.table([row for row in rows if row[1]])]
    return "\n".join(told + warning_lines(finished.warnings))


def _crash_rows(crash: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """When the severest crash was, how severe, and where the force came from."""
    from recon.crash_summary import SIGN
    from recon.rounding import milliseconds

    if "after_s" not in crash:
        yield "crash", crash["note"] or "none"
        return
    at = f"{milliseconds(crash['time'])} {crash['time_scale']}, " if "time" in crash else ""
    several = f", the severest of {crash['impacts']}" if crash["impacts"] > 1 else ""
    yield "crash", f"{at}{crash['after_s']:.2f} s after the start{several}"
    for name, title in ((SIGN, "delta-V"), ("pdof", "direction of force"), ("speed_before", "speed before")):
        if name in crash:
            yield title, _number(name, crash[name])


def _number(name: str, row: Mapping[str, Any]) -> str:
    from recon.numerics.severity import clock
    from recon.rounding import with_interval

    if row["value"] is None:
        return f"not known: {row['note']}"
    text = with_interval(row, row["unit"])
    if name == "pdof":
        return f"{text}, clockwise from the front: {clock(math.radians(row['value']))} o'clock"
    return f"{text}, {row['note']}" if name == "speed_before" and row["note"] else text


def _distance(facts: Mapping[str, float]) -> str:
    """To a tenth of a metre, and how well it is known where that is less."""
    sigma = facts.get("distance_sigma", 0.0)
    doubt = f" (sigma {sigma:,.{sigma < 10.0:d}f} m)" if sigma > _SURE_M else ""
    return f"{facts['distance']:,.1f} m{doubt}"


def _speed(value: float) -> str:
    return f"{value:.2f} m/s ({value * 3.6:.1f} km/h)"


def exported(finished: Run) -> list[Path]:
    """Files that exporters left in the run's folder."""
    from recon.storage.atomic import EXPORT_MANIFEST

    below = finished.folder / "exports" if finished.folder else Path()
    made = [path for path in below.rglob("*") if path.is_file() and path.name != EXPORT_MANIFEST]
    return sorted(made) if finished.folder else []


def warning_lines(warnings: list[str]) -> list[str]:
    """A line for each warning, the same ones together, the first ones only."""
    counts = Counter(warnings)
    lines = [f"warning: {text}{f' ({count} times)' if count > 1 else ''}" for text, count in counts.items()]
    if len(lines) > MOST_WARNINGS:
        lines[MOST_WARNINGS:] = [f"... and {len(lines) - MOST_WARNINGS} more warnings, see manifest.json"]
    return lines
