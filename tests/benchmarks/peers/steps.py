"""The IMU between given times: short steps of constant rate and specific force, none of which crosses such a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recon.numerics.rotation import Floats
from recon.numerics.signals import interpolate

from .drives import Drive


@dataclass(frozen=True)
class Steps:
    """n steps in k intervals.

    dt_s : (n,) s; rate_s, force_s : (n, 3) rad/s and m/s^2, mean over the step, sensor
    first : (k + 1,) the steps of interval i are first[i] to first[i + 1]
    edge_rate_s : (k + 1, 3) rad/s, at the given times
    """

    dt_s: Floats
    rate_s: Floats
    force_s: Floats
    first: NDArray[np.intp]
    edge_rate_s: Floats


def steps_between(drive: Drive, edges_s: Floats) -> Steps:
    """Steps between the edges (k + 1,) s, rising, inside drive.t_s; samples are joined by straight lines."""
    inside = drive.t_s[(drive.t_s > edges_s[0]) & (drive.t_s < edges_s[-1])]
    t_s = np.union1d(inside, edges_s)
    gyro_s, accel_s = (interpolate(t_s, drive.t_s, values) for values in (drive.gyro_s, drive.accel_s))
    first = np.searchsorted(t_s, edges_s)
    rate_s, force_s = (0.5 * (values[1:] + values[:-1]) for values in (gyro_s, accel_s))
    return Steps(np.diff(t_s), rate_s, force_s, first, gyro_s[first])


def with_none_longer(edges_s: Floats, longest_s: float) -> Floats:
    """The same rising times, and equal parts where two are farther apart than longest_s."""
    parts = np.maximum(1, np.ceil(np.diff(edges_s) / longest_s - 1e-9)).astype(int)
    spread = np.concatenate([np.arange(count) / count for count in parts])
    filled = np.repeat(edges_s[:-1], parts) + spread * np.repeat(np.diff(edges_s), parts)
    return np.append(filled, edges_s[-1])
