"""Distance, duration, top speed and stops of a drive: by its trajectory, or as far as GNSS alone tells them.

Standstills are what steps are sure of, and a slammed door ends one; a stop lasts until the vehicle moves. While it
stands it goes no way, whatever the errors of its positions sum up to.
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.budget import NORMAL_95
from recon.rows import spans
from recon.tables import Array, has, known_rows, matrix, seconds, select_rows, time_ns, vector
from recon.trajectory import Trajectory, speed_sigma

Spans: TypeAlias = list[tuple[int, int]]

_LONGEST_STEP_S: Final = 10.0
"""Between two fixes the mean of their speeds is taken for the speed, as long as they are no further apart,"""
_MOSTLY: Final = 0.9
"""and for a distance at least this share of the time must be known."""
_MOVES: Final = 0.3
"""m/s; slower is none of a vehicle that moves: about 1 km/h, which a door that is slammed does not reach."""


def summarize(
    trajectory: pa.Table | None,
    gnss: pa.Table | None,
    happened: pa.Table | None = None,
    knots: pa.Table | None = None,
) -> dict[str, float]:
    """distance m, duration s and top_speed m/s of a trajectory, or as far as GNSS alone tells them, and stops.

    Of rows that hold a position and a velocity; what nothing tells is left out. Without a standstill that no stop was
    found is told only where the vehicle was seen never to be slow: elsewhere perhaps nothing looked for one. Where the
    trajectory has sigmas, top_speed is the speed of the row that is fastest by the lower end of its interval of 95 %,
    and top_speed_sigma its sigma. Where the fuser tells it, distance_sigma is how well the last row is known from the
    first, east and north together: enough for a straight way, and what the distance of turning ones err by.

    happened, knots : the streams `events` and `knots` of the run
    """
    stood = spans(happened, "standstill")
    rows = select_rows(trajectory, known_rows(trajectory, "pos", "vel")) if trajectory is not None else None
    if rows is not None and rows.num_rows:
        known = Trajectory(rows, knots)
        speed = known.speed
        stood = _joined(stood, time_ns(rows), speed)
        found = {"distance": _way(known, stood), "duration": known.duration, **_doubt(known), **_top(rows, speed)}
    else:
        found, speed = _of_fixes(gnss) if gnss is not None and gnss.num_rows else ({}, np.empty(0))
    never_slow = happened is not None and len(speed) > 0 and bool(speed.min() > _MOVES)
    return {**found, "stops": len(stood)} if stood or never_slow else found


def _joined(stood: Spans, t_ns: NDArray[np.int64], speed: Array) -> Spans:
    """Standstills as one where rows in between show that the vehicle did not move."""
    found: Spans = []
    for start, end in stood:
        between = speed[slice(*np.searchsorted(t_ns, [found[-1][1], start]))] if found else speed[:0]
        if len(between) and between.max() < _MOVES:
            start, end = found[-1][0], max(end, found.pop()[1])
        found.append((start, end))
    return found


def _way(known: Trajectory, stood: Spans) -> float:
    """Length of the path in m, without what the positions of a vehicle that stands wander about."""
    t_ns, slow = time_ns(known.table), np.maximum(known.speed[1:], known.speed[:-1]) < _MOVES
    steps = np.linalg.norm(np.diff(matrix(known.table, "pos"), axis=0), axis=1)
    for start, end in stood:
        first, last = np.searchsorted(t_ns, [start, end + 1])
        rest = slice(first, max(last - 1, first))
        steps[rest][slow[rest]] = 0.0
    return float(steps.sum())


def _doubt(known: Trajectory) -> dict[str, float]:
    if known.knots is None:
        return {}
    first, last = time_ns(known.table)[[0, -1]].view("datetime64[ns]")
    spread = known.between(first, last).displacement_covariance[:2, :2]
    return {"distance_sigma": float(np.sqrt(np.trace(spread)))} if np.isfinite(spread).all() else {}


def _top(table: pa.Table, speed: Array) -> dict[str, float]:
    if not has(table, "vel_std"):
        return {"top_speed": float(speed.max())}
    sigma = speed_sigma(matrix(table, "vel"), matrix(table, "vel_std", gaps=True))
    if not np.isfinite(sigma).all():
        return {"top_speed": float(speed.max())}
    fastest = int((speed - NORMAL_95 * sigma).argmax())
    return {"top_speed": float(speed[fastest]), "top_speed_sigma": float(sigma[fastest])}


def _of_fixes(gnss: pa.Table) -> tuple[dict[str, float], Array]:
    """By the speed of fixes, and these; the distance only where it is known nearly all the time, without long gaps."""
    t_s = seconds(gnss)
    found = {"duration": float(t_s[-1])}
    if has(gnss, "speed"):
        speed = np.abs(vector(gnss, "speed", gaps=True))
    elif has(gnss, "vel"):
        speed = np.linalg.norm(matrix(gnss, "vel", gaps=True)[:, :2], axis=1)
    else:
        return found, np.empty(0)
    known = np.isfinite(speed)
    if not known.any():
        return found, np.empty(0)
    found["top_speed"] = float(speed[known].max())
    steps, mean = np.diff(t_s[known]), (speed[known][1:] + speed[known][:-1]) / 2.0
    near = steps <= _LONGEST_STEP_S
    if steps[near].sum() >= _MOSTLY * t_s[-1] > 0.0:
        found["distance"] = float((steps * mean)[near].sum())
    return found, speed[known]
