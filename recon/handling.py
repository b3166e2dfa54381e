"""A trajectory as those see it who judge driving: speed and accelerations along the way, to the left and up.

Accelerations are those of the trajectory where it has them, gravity removed, turned to the horizontal by its attitude;
else the velocity's rate of change. A low-pass filter takes off what the road and the engine do.

A crash is no driving: a filter without delay would spread it over the time before, and call it the driver's braking.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import NotEnoughData
from recon.numerics.evaluation import GAP_STEPS
from recon.numerics.handling import intermediate, rate_of_change, smoothed, steps_s, to_local, weights_s
from recon.numerics.signals import median_rate
from recon.schema import TRAJECTORY, Need
from recon.tables import Array, has, matrix, time_ns

NEED: Need = TRAJECTORY.need("vel", "q", maybe=("accel", "pos", "lat", "lon"))
"""What a stage that uses `handling_of` asks of a trajectory."""
_LEAST_GAP_S = 1.0
"""A shorter step is none of a gap; a longer one is, where it is more than GAP_STEPS usual ones."""
_FASTEST_REVERSE = -0.5
"""m/s; slower backwards motion may be noise."""
_SPREAD = 0.5
"""Periods of its cut-off over which a low-pass spreads an impact to either side."""


@dataclass(frozen=True)
class Handling:
    """n rows of a trajectory.

    t_ns : ns since 1970; speed : m/s, horizontal; weight_s : s that each row stands for
    along : m/s^2, positive where it gains speed, also backwards; left, up : m/s^2; NaN in a crash; rate : Hz
    """

    t_ns: NDArray[np.int64]
    speed: Array
    along: Array
    left: Array
    up: Array
    weight_s: Array
    rate: float

    @property
    def max_gap_s(self) -> float:
        """The longest step between rows that are not parted by a gap, s."""
        return _max_gap_s(self.rate)

    @property
    def distance(self) -> Array:
        """Way since the first row, m: (n,)."""
        mean = 0.5 * (self.speed[1:] + self.speed[:-1])
        return np.append(0.0, np.cumsum(mean * steps_s(self.t_ns, self.max_gap_s)))


def handling_of(trajectory: pa.Table, cutoff_hz: float | None, crashes: Iterable[tuple[int, int]] = ()) -> Handling:
    """The rows of a trajectory whose velocity and attitude are known.

    cutoff_hz : of the low-pass filter, None for accelerations as they are
    crashes : (start, end) in ns since 1970, in which accelerations are none of driving

    Raises NotEnoughData where fewer than three rows are known.
    """
    vel, q = matrix(trajectory, "vel", gaps=True), matrix(trajectory, "q", gaps=True)
    known = np.isfinite(vel).all(axis=1) & np.isfinite(q).all(axis=1)
    if known.sum() < 3:
        raise NotEnoughData("trajectory", needed="3 rows with velocity and attitude", found=str(int(known.sum())))
    t_ns, vel, q = time_ns(trajectory)[known], vel[known], q[known]
    rate = median_rate(t_ns)
    gap_s = _max_gap_s(rate)
    if has(trajectory, "accel"):
        accel = intermediate(to_local(matrix(trajectory, "accel", gaps=True)[known], q), q)
    else:
        accel = intermediate(rate_of_change(t_ns, vel, gap_s), q)
    if cutoff_hz is not None:
        accel = smoothed(t_ns, accel, cutoff_hz, gap_s)
    spread_ns = round(1e9 * _SPREAD / cutoff_hz) if cutoff_hz is not None else 0
    for start_ns, end_ns in crashes:
        accel[(t_ns >= start_ns - spread_ns) & (t_ns <= end_ns + spread_ns)] = np.nan
    ahead = intermediate(vel, q)[:, 0]
    along = np.where(ahead < _FASTEST_REVERSE, -accel[:, 0], accel[:, 0])
    speed, weight = np.hypot(vel[:, 0], vel[:, 1]), weights_s(t_ns, gap_s)
    return Handling(t_ns, speed, along, accel[:, 1], accel[:, 2], weight, rate)


def _max_gap_s(rate_hz: float) -> float:
    return max(_LEAST_GAP_S, GAP_STEPS / rate_hz)
