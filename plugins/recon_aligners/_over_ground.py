"""Speed and course over ground of a gnss stream, whichever way it tells them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from recon import Array, has, vector


def speed_of(gnss: pa.Table | None) -> Array | None:
    """Speed over ground: (n,) m/s, NaN where unknown; None where there is none."""
    if gnss is None:
        return None
    if has(gnss, "speed"):
        return vector(gnss, "speed", gaps=True)
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        return np.hypot(vector(gnss, "vel_e", gaps=True), vector(gnss, "vel_n", gaps=True))
    return None


def course_of(gnss: pa.Table) -> Array:
    """Course over ground: (n,) rad clockwise from north, NaN where unknown."""
    if has(gnss, "course"):
        return vector(gnss, "course", gaps=True)
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        return np.arctan2(vector(gnss, "vel_e", gaps=True), vector(gnss, "vel_n", gaps=True))
    return np.full(gnss.num_rows, np.nan)
