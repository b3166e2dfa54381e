"""Statistics over drives, as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from .cases import Case
from .scoring import Row

ERRORS: Final[Mapping[str, tuple[str, int]]] = {
    "horizontal": ("H m", 2),
    "vertical": ("V m", 2),
    "velocity": ("vel m/s", 3),
    "tilt": ("tilt deg", 3),
    "heading": ("head deg", 3),
    "vehicle_heading": ("car: head", 3),
    "vehicle_pitch": ("pitch", 3),
    "vehicle_roll": ("roll deg", 3),
    "outage_horizontal": ("outage: H m", 2),
    "outage_velocity": ("vel m/s", 3),
    "outage_heading": ("head deg", 3),
    "outage_worst": ("worst m", 2),
}
"""Columns of the table of errors: their heads, and how many digits are shown."""
HONESTY: Final[Mapping[str, tuple[str, int]]] = {
    "nees_position": ("NEES position", 2),
    "nees_velocity": ("velocity", 2),
    "nees_attitude": ("attitude", 2),
    "nees_gyro_bias": ("gyro bias", 2),
    "nees_accel_bias": ("accel bias", 2),
    "coverage": ("in 2 sigma %", 1),
}
"""Columns of the table of honesty, means over drives."""
REJECTED: Final = {
    "outliers": "outliers found %",
    "positions": "good positions lost %",
    "velocities": "good velocities lost %",
}
"""Further columns of that table: of all such fixes of all drives, how many were rejected."""

STATISTICS: Final[Mapping[str, Callable[[np.ndarray], float]]] = {
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "median": lambda values: float(np.median(values)),
    "mean": lambda values: float(np.mean(values)),
    "max": lambda values: float(np.max(values)),
}


def statistic(name: str, rows: Sequence[Row], column: str) -> float:
    """Over the drives that have the column; NaN where none has."""
    values = np.array([row[column] for row in rows])
    values = values[np.isfinite(values)]
    return STATISTICS[name](values) if len(values) else float("nan")


def errors_table(measured: Mapping[str, Sequence[Row]], cases: Iterable[Case]) -> str:
    """For each case its statistics and what is demanded; what misses that is marked by '!'."""
    lines = _head(["drives", "over them", *(head for head, _ in ERRORS.values())])
    for case in cases:
        rows = measured[case.name]
        wanted = {name if ":" in name else f"rms:{name}": limit for name, limit in case.demand.items()}
        for name in STATISTICS:
            cells = []
            for column, (_, digits) in ERRORS.items():
                value = statistic(name, rows, column)
                missed = value > wanted.get(f"{name}:{column}", np.inf)
                cells.append(shown(value, digits) + (" !" if missed else ""))
            lines.append(line([f"{case.name} ({len(rows)})" if name == "rms" else "", name, *cells]))
        if wanted:
            limits = {key.partition(":")[2]: f"{limit:g}" for key, limit in wanted.items()}
            lines.append(line(["", "demanded", *(limits.get(column, "") for column in ERRORS)]))
    return "\n".join(lines)


def summary_table(measured: Mapping[str, Sequence[Row]]) -> str:
    """Root mean squares over the drives of each case, and the worst drive in brackets."""
    lines = _head(["drives", *(head for head, _ in ERRORS.values())])
    for name, rows in measured.items():
        both = [[shown(statistic(of, rows, c), digits) for of in ("rms", "max")] for c, (_, digits) in ERRORS.items()]
        cells = ["-" if usual == "-" else f"{usual} ({worst})" for usual, worst in both]
        lines.append(line([f"{name} ({len(rows)})", *cells]))
    return "\n".join(lines)


def honesty_table(measured: Mapping[str, Sequence[Row]]) -> str:
    """Means over the drives of each case, shares of all their fixes, the most steps of any, and warnings of all."""
    lines = _head(["drives", *(head for head, _ in HONESTY.values()), *REJECTED.values(), "most steps", "warnings"])
    for name, rows in measured.items():
        cells = [shown(statistic("mean", rows, column), digits) for column, (_, digits) in HONESTY.items()]
        cells += [shown(_share(rows, column), 2) for column in REJECTED]
        cells += [shown(statistic("max", rows, "steps"), 0), shown(sum(row["warnings"] for row in rows), 0)]
        lines.append(line([f"{name} ({len(rows)})", *cells]))
    return "\n".join(lines)


def _share(rows: Sequence[Row], column: str) -> float:
    """In %; NaN where there is no such fix."""
    total = sum(row[column] for row in rows)
    return 100.0 * sum(row[f"{column}_rejected"] for row in rows) / total if total else float("nan")


def insurance_table(measured: Mapping[str, Sequence[Row]]) -> str:
    """Root mean squares over the same drives, and their change from the first case in %."""
    columns = ("horizontal", "vertical", "velocity", "tilt", "heading")
    lines = _head(["told", *(ERRORS[column][0] for column in columns), "H, change %", "head, change %"])
    right = next(iter(measured.values()))
    for name, rows in measured.items():
        cells = [shown(statistic("rms", rows, column), ERRORS[column][1]) for column in columns]
        changes = [change(statistic("rms", rows, c), statistic("rms", right, c)) for c in ("horizontal", "heading")]
        lines.append(line([f"{name} ({len(rows)})", *cells, *changes]))
    return "\n".join(lines)


def plain_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Cells as they are."""
    return "\n".join([*_head(heads), *map(line, rows)])


def change(value: float, base: float) -> str:
    """In % of the base, with its sign."""
    return f"{100.0 * (value / base - 1.0):+.1f}"


def shown(value: float, digits: int) -> str:
    """A number, or a dash where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def line(cells: Sequence[str]) -> str:
    """A line of Markdown."""
    return "| " + " | ".join(cells) + " |"


def _head(cells: Sequence[str]) -> list[str]:
    return [line(cells), "|---" * len(cells) + "|"]
