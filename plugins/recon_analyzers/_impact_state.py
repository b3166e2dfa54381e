"""What a trajectory tells of the vehicle about an impact: how fast it went, whether it tipped."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa

from recon import has, matrix, time_ns, vector
from recon.knots import VELOCITY, Knots
from recon.numerics.rotation import conjugate, rotate

_LEANS_S: Final = (0.1, 2.0)
"""s before and after an impact between which a vehicle may have tipped."""
ROLLS_S: Final = 10.0
"""s after an impact in which a vehicle rolls over, if it does."""
_UP: Final = np.array([0.0, 0.0, 1.0])


def speed_at(trajectory: pa.Table | None, zero_ns: int, knots: pa.Table | None) -> tuple[float, float] | None:
    """Horizontal speed at a time and its sigma, m/s, NaN where unknown; None where there is no trajectory.

        sigma^2 = u_e^2 s_e^2 + u_n^2 s_n^2 + 2 r u_e u_n s_e s_n,    u along the velocity

    with the correlation r of the nearest knot: without it the sigma would be another one in each direction of travel.
    """
    if trajectory is None or not has(trajectory, "vel"):
        return None
    t_ns = time_ns(trajectory)
    if not t_ns[0] <= zero_ns <= t_ns[-1]:
        return None
    row = int(np.searchsorted(t_ns, zero_ns))
    vel = np.array([vector(trajectory.slice(row, 1), f"vel_{axis}", gaps=True)[0] for axis in "en"])
    speed = float(np.hypot(*vel))
    if not has(trajectory, "vel_std"):
        return speed, float("nan")
    std = np.array([vector(trajectory.slice(row, 1), f"vel_std_{axis}", gaps=True)[0] for axis in "en"])
    east, north = std * (vel / speed if speed > 0.0 else np.array([1.0, 0.0]))
    return speed, float(np.sqrt(max(east**2 + north**2 + 2.0 * _correlation(knots, zero_ns) * east * north, 0.0)))


def tipped(trajectory: pa.Table | None, span: tuple[int, int]) -> tuple[float, float] | None:
    """By how much the vertical of the vehicle leans otherwise than right before an impact: once it is over, and at most
    while it may roll, rad.

    None where no trajectory tells it. span : ns, of the impact
    """
    if trajectory is None or not has(trajectory, "q"):
        return None
    ends = [span[0] - round(_LEANS_S[0] * 1e9), *(span[1] + round(s * 1e9) for s in (_LEANS_S[1], ROLLS_S))]
    before, after, last = np.searchsorted(time_ns(trajectory), ends).clip(max=trajectory.num_rows - 1)
    q = matrix(trajectory.slice(before, last - before + 1), "q", gaps=True)
    up = rotate(conjugate(q), np.broadcast_to(_UP, (len(q), 3)))
    lean = np.arctan2(np.linalg.norm(np.cross(up, up[0]), axis=1), up @ up[0])
    return float(lean[after - before]), float(np.fmax.reduce(lean, initial=0.0))


def _correlation(knots: pa.Table | None, at_ns: int) -> float:
    """Of the errors of velocity to the East and to the North at the nearest knot; 0 where nothing tells it."""
    if knots is None or knots.num_rows < 2:
        return 0.0
    nearest = int(np.abs(time_ns(knots) - at_ns).argmin())
    first = min(nearest, knots.num_rows - 2)
    own = nearest - first
    (east, both, _), (_, north, _), _ = Knots.of(knots.slice(first, 2)).covariance(own, own)[VELOCITY, VELOCITY]
    found = both / np.sqrt(east * north)
    return float(found) if np.isfinite(found) else 0.0
