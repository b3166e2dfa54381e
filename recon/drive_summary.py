"""Distance, duration, top speed and stops of a drive: by its trajectory, or as far as GNSS alone tells them."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from recon.rows import spans
from recon.tables import has, known_rows, matrix, seconds, select_rows, vector
from recon.trajectory import Trajectory

_LONGEST_STEP_S: Final = 10.0
"""Between two fixes the mean of their speeds is taken for the speed, as long as they are no further apart,"""
_MOSTLY: Final = 0.9
"""and for a distance at least this share of the time must be known."""


def summarize(trajectory: pa.Table | None, gnss: pa.Table | None, happened: pa.Table | None = None) -> dict[str, float]:
    """distance m, duration s and top_speed m/s of a trajectory, or as far as GNSS alone tells them, and stops.

    Of rows that hold a position and a velocity; what nothing tells is left out: that no stop was found tells
    nothing where nothing could look for one, as in accelerations alone.

    happened : the events of the run
    """
    found = _moved(trajectory, gnss)
    stops = len(spans(happened, "standstill"))
    return {**found, "stops": stops} if stops or (found and happened is not None) else found


def _moved(trajectory: pa.Table | None, gnss: pa.Table | None) -> dict[str, float]:
    if trajectory is not None:
        found = Trajectory(select_rows(trajectory, known_rows(trajectory, "pos", "vel")))
        if len(found):
            return {"distance": found.path_length, "duration": found.duration, "top_speed": float(found.speed.max())}
    return {} if gnss is None or not gnss.num_rows else _of_fixes(gnss)


def _of_fixes(gnss: pa.Table) -> dict[str, float]:
    """By the speed of fixes; the distance only where it is known nearly all the time, without long gaps."""
    t_s = seconds(gnss)
    found = {"duration": float(t_s[-1])}
    if has(gnss, "speed"):
        speed = np.abs(vector(gnss, "speed", gaps=True))
    elif has(gnss, "vel"):
        speed = np.linalg.norm(matrix(gnss, "vel", gaps=True)[:, :2], axis=1)
    else:
        return found
    known = np.isfinite(speed)
    if not known.any():
        return found
    found["top_speed"] = float(speed[known].max())
    steps, mean = np.diff(t_s[known]), (speed[known][1:] + speed[known][:-1]) / 2.0
    near = steps <= _LONGEST_STEP_S
    if steps[near].sum() >= _MOSTLY * t_s[-1] > 0.0:
        found["distance"] = float((steps * mean)[near].sum())
    return found
