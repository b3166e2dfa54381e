"""What a vehicle can show, by which readers know a wrong unit, a turned sign or a damaged file.

What lies beyond is left out and counted where single values are damaged, refused where it is many or where a format
keeps whole arrays. Of what is packed, the bytes that it may unpack to: a file of a few kB can ask for all memory.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from recon.errors import ReadFailed
from recon.rounding import occasions
from recon.rows import Metric, warning
from recon.schema import group_of
from recon.tables import Array

LARGEST_UNPACKED: Final = 2**30
"""Bytes that a file, or a member of a zip, may unpack to."""
MOST_FAULTY: Final = 0.01
"""Share of rows from which on a fault of the log is no longer a slip."""
USUAL_SIZE: Final = (0.5, 2.0)
"""Median specific force of a vehicle in units of gravity."""
FASTEST_TURN: Final = 20.0
"""rad/s; no vehicle turns as fast for a hundredth of a drive."""
LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "lat": (-90.0, 90.0),
    "lon": (-180.0, 360.0),
    "height": (-1000.0, 100_000.0),
    "speed": (-500.0, 500.0),
    "course": (-2.0 * np.pi, 4.0 * np.pi),
    "vel": (-500.0, 500.0),
    "accel": (-1e6, 1e6),
    "gyro": (-1e4, 1e4),
    "mag": (-1.0, 1.0),
    "pos": (-1e7, 1e7),
    "acc": (-1e6, 1e6),
    "pressure": (0.0, 1e6),
    "temperature": (0.0, 1000.0),
    "fix": (0.0, 255.0),
    "satellites": (0.0, 255.0),
}
"""Least and largest value in the unit of the stream; others mean a wrong unit or a damaged file."""
_FARTHEST: Final = 1e12
"""Largest number of columns that have no limits of their own."""
SIGMAS: Final = ("pos_std", "vel_std", "att_std")
_LARGEST_SIGMA: Final = 1e6
"""In the unit of the column; a larger one says that nothing is known, as does zero."""


def limits_of(column: str) -> tuple[float, float]:
    """Least and largest value of a column, by its own name or that of its group."""
    return LIMITS.get(column, LIMITS.get(group_of(column), (-_FARTHEST, _FARTHEST)))


def possible(
    path: Path, stream: str, column: str, values: Array, *, most: float, line: Callable[[int], int] | None = None
) -> tuple[Array, list[Metric]]:
    """The values (n,) with NaN in place of those that no vehicle shows, and how many these were; NaN stays.

    A sigma that is not above zero, or that is huge, says that it is not known.

    most : share of the values from which on they are no slips; line : of a row, in text

    Raises ReadFailed where more than `most` of them are impossible: then they are of another unit or format.
    """
    if group_of(column) in SIGMAS:
        with np.errstate(invalid="ignore"):
            unknown = ~((values > 0.0) & (values < _LARGEST_SIGMA))
        return (np.where(unknown, np.nan, values) if unknown.any() else values), []
    low, high = limits_of(column)
    if not len(values) or not (np.nanmin(values, initial=high) < low or np.nanmax(values, initial=low) > high):
        return values, []
    outside = (values < low) | (values > high)
    row, count = int(outside.argmax()), int(outside.sum())
    where = f"line {line(row)}" if line is not None else f"row {row}"
    what = f"{stream}.{column} is {values[row]:.6g} in {where}, outside {low:g} to {high:g}, which no vehicle shows"
    if count > most * np.count_nonzero(np.isfinite(values) | outside):
        at = line(row) if line is not None else None
        raise ReadFailed(path, what, line=at, hint="the file is damaged, or of another unit or format")
    left_out = Metric("values_left_out", float(count), method=stream, note=what)
    text = f"left out of {path.name}: {what} ({occasions(count)})"
    return np.where(outside, np.nan, values), [left_out, warning(text)]


def refuse_impossible(path: Path, **groups: Array) -> None:
    """Raises ReadFailed at a value that no vehicle shows. `groups` : in the units of the streams, NaN where none is."""
    for name, values in groups.items():
        refuse_beyond(path, name, values, *LIMITS[name])


def refuse_beyond(path: Path, name: str, values: Array, low: float, high: float) -> None:
    """Raises ReadFailed at the first row with a value below `low` or above `high`; NaN passes."""
    wrong = (values < low) | (values > high)
    if wrong.any():
        row = int(np.flatnonzero(wrong.reshape(len(wrong), -1).any(axis=1))[0])
        what = f"{name} is {values[wrong][0]:g} in row {row}, which no vehicle shows"
        raise ReadFailed(path, what, hint="the file is damaged or in other units: copy it again")
