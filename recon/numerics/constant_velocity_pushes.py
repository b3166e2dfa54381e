"""What measured accelerations do to position and velocity between any two times: their integrals, worked out once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Pushes(NamedTuple):
    """Integrals of the acceleration since the first sample, at some times: once (n, k) m/s and twice (n, k) m."""

    once: Floats
    twice: Floats

    def between(self, other: Pushes, h: Floats) -> tuple[Floats, Floats]:
        """dp (n, k) m and dv (n, k) m/s over the h s (n,) until the other times."""
        return other.twice - self.twice - h[:, None] * self.once, other.once - self.once


def pushes(t_s: Floats, acc: Floats, held: NDArray[np.bool_], at_s: Floats) -> tuple[Pushes, Pushes]:
    """Integrals of the line through the accelerations, at the samples and at other times inside.

    t_s : (n,) s, strictly increasing; acc : (n, k) m/s^2; held : (n-1,) steps over which it is taken as 0
    at_s : (m,) s
    """
    step = np.diff(t_s)[:, None]
    start, slope = acc[:-1].copy(), np.diff(acc, axis=0) / step
    start[held], slope[held] = 0.0, 0.0
    once, twice = np.zeros_like(acc), np.zeros_like(acc)
    np.cumsum(step * (start + step * slope / 2.0), axis=0, out=once[1:])
    np.cumsum(step * (once[:-1] + step * (start / 2.0 + step * slope / 6.0)), axis=0, out=twice[1:])
    row = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 2)
    u, start, slope = (at_s - t_s[row])[:, None], start[row], slope[row]
    there = Pushes(
        once[row] + u * (start + u * slope / 2.0),
        twice[row] + u * (once[row] + u * (start / 2.0 + u * slope / 6.0)),
    )
    return Pushes(once, twice), there
