"""What a vehicle's handling is told by: accelerations along and across the road, how smooth, how often beyond a limit.

Axes are those of the intermediate system of ISO 8855: X horizontal along the heading, Y horizontal to the left, Z up.

References
    ISO 8855:2011, 2.11 (axis systems).
    Commission Regulation (EU) 2017/1151, annex IIIA, appendix 7a (relative positive acceleration, v a+).
    Garwood (1936), "Fiducial limits for the Poisson distribution", Biometrika 28 (rates of rare events).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.rotation import Floats, rotate, to_euler
from recon.numerics.signals import differentiate, interval_mean, runs

MEANS: Final = 4
HALF_POWER: Final = 0.22751
"""Frequency times width at which that many running means pass half of the power: sinc^4 = 1/sqrt(2)."""
GAINING: Final = 0.1
"""m/s^2 above which a vehicle counts as accelerating."""


def intermediate(accel_n: Floats, q: Floats) -> Floats:
    """Vectors along the heading, to the left and up: (n, 3).

    accel_n : (n, 3), local; q : (n, 4) vehicle to local, scalar first
    """
    yaw = to_euler(q)[0]
    east, north = np.cos(yaw), np.sin(yaw)
    ahead = accel_n[:, 0] * east + accel_n[:, 1] * north
    left = accel_n[:, 1] * east - accel_n[:, 0] * north
    return np.column_stack([ahead, left, accel_n[:, 2]])


def to_local(vectors: Floats, q: Floats) -> Floats:
    """Vectors (n, 3) of the vehicle in local axes: (n, 3)."""
    return np.asarray(rotate(q, vectors))


def smoothed(t_ns: NDArray[np.int64], values: Floats, cutoff_hz: float, max_gap_s: float) -> Floats:
    """Running means one after the other, which together pass half of the power at the cut-off: as `values`.

    Nothing is delayed, and no edge overshoots, as it does behind a Butterworth filter. Of what is five times as fast as
    the cut-off 1/5300 is left. That holds where samples are dense: lines between them take more, so that 0.62 of the
    amplitude for 0.71 pass with ten samples to a period of the cut-off, and 0.42 with five.

    t_ns : (n,) ns, strictly increasing; values : (n,) or (n, k)
    """
    width = HALF_POWER / cutoff_hz
    for _ in range(MEANS):
        values = interval_mean(t_ns, t_ns, values, width, max_gap_s)
    return values


def of_neighbours(t_ns: NDArray[np.int64], values: Floats, cutoff_hz: float, max_gap_s: float) -> Floats:
    """As `smoothed` of (n,) values, where few samples make a period of the cut-off: without lines between samples.

    Each counts by the cubic B-spline that four running means are together, and by the time that it stands for. Half of
    the power passes at the cut-off from five samples to its period on; fewer take less off, and two and a half nothing.
    """
    width_s = HALF_POWER / cutoff_hz
    known = np.isfinite(values)
    weight, value = weights_s(t_ns, max_gap_s) * known, np.nan_to_num(values)
    total, whole = _spline(np.zeros(len(t_ns))) * weight * value, _spline(np.zeros(len(t_ns))) * weight
    for away in range(1, len(t_ns)):
        share = _spline(np.asarray((t_ns[away:] - t_ns[:-away]) * 1e-9 / width_s))
        if not share.any():
            break
        for here, there in ((slice(away, None), slice(None, -away)), (slice(None, -away), slice(away, None))):
            total[here] += share * weight[there] * value[there]
            whole[here] += share * weight[there]
    return np.asarray(np.where(known & (whole > 0.0), total / np.where(whole > 0.0, whole, 1.0), np.nan))


def _spline(apart: Floats) -> Floats:
    """The cubic B-spline of width one at times not below nought."""
    far = np.clip(2.0 - apart, 0.0, None) ** 3 / 6.0
    return np.asarray(np.where(apart < 1.0, 2.0 / 3.0 - apart**2 + apart**3 / 2.0, far))


def rate_of_change(t_ns: NDArray[np.int64], values: Floats, max_gap_s: float) -> Floats:
    """Derivative by time, NaN on both sides of gaps: as `values`."""
    found = np.full_like(values, np.nan)
    for start, stop in pieces(t_ns, max_gap_s):
        if stop - start > 2:
            found[start:stop] = differentiate((t_ns[start:stop] - t_ns[start]) * 1e-9, values[start:stop])
    return found


def pieces(t_ns: NDArray[np.int64], max_gap_s: float) -> NDArray[np.intp]:
    """Rows between which no gap lies: (m, 2) first row and the one behind the last."""
    cuts = np.flatnonzero(np.diff(t_ns) > max_gap_s * 1e9) + 1
    edges = np.concatenate([[0], cuts, [len(t_ns)]]).astype(np.intp)
    return np.column_stack([edges[:-1], edges[1:]]) if len(t_ns) else np.zeros((0, 2), dtype=np.intp)


def steps_s(t_ns: NDArray[np.int64], max_gap_s: float) -> Floats:
    """From each row to the next, s, nought across gaps: (n - 1,)."""
    steps = np.diff(t_ns) * 1e-9
    return np.asarray(np.where(steps > max_gap_s, 0.0, steps))


def weights_s(t_ns: NDArray[np.int64], max_gap_s: float) -> Floats:
    """The time that each row stands for, s: half of the steps to its neighbours, none across gaps. (n,)"""
    steps = steps_s(t_ns, max_gap_s)
    return np.asarray(0.5 * (np.append(0.0, steps) + np.append(steps, 0.0)))


def spells(
    t_ns: NDArray[np.int64], beyond: NDArray[np.bool_], merge_s: float, min_s: float, max_gap_s: float
) -> NDArray[np.intp]:
    """First and last row of each stretch beyond a limit: (m, 2).

    merge_s : stretches that follow each other so soon are one; min_s : one that is beyond the limit for less time, the
        pauses in it left out, does not count; none spans a gap
    """
    found: list[tuple[int, int]] = []
    for start, stop in pieces(t_ns, max_gap_s):
        rows = runs(beyond[start:stop]) + start - [0, 1]
        pauses = (t_ns[rows[1:, 0]] - t_ns[rows[:-1, 1]]) * 1e-9
        joined = np.split(rows, np.flatnonzero(pauses > merge_s) + 1) if len(rows) else []
        long = (one for one in joined if int(np.diff(t_ns[one]).sum()) * 1e-9 >= min_s)
        found += [(int(one[0, 0]), int(one[-1, 1])) for one in long]
    return np.array(found, dtype=np.intp).reshape(-1, 2)


def each_second(t_ns: NDArray[np.int64], speed: Floats, known: NDArray[np.bool_], max_gap_s: float) -> Floats:
    """Speed and acceleration along the way at whole seconds since the first row, and since each gap: (2, k) m/s, m/s^2.

    a_i = (v_i+1 - v_i-1) / 2 s, as (EU) 2017/1151, annex IIIA, appendix 7a has it; none for the second at either end,
    beyond which it takes the vehicle to stand.

    t_ns : (n,); speed : (n,) m/s; known : (n,) seconds within one of a row that is not are left out
    """
    found = [np.empty((2, 0))]
    for start, stop in pieces(t_ns, max_gap_s):
        own_s, rows = (t_ns[start:stop] - t_ns[start]) * 1e-9, slice(start, stop)
        seconds = np.arange(np.floor(own_s[-1]) + 1.0)
        v = np.interp(seconds, own_s, speed[rows])
        unknown = np.interp(seconds, own_s, np.cumsum(~known[rows]))
        sure = unknown[2:] == unknown[:-2]
        found.append(np.stack([v[1:-1], 0.5 * (v[2:] - v[:-2])])[:, sure])
    return np.concatenate(found, axis=1)


def relative_positive_acceleration(speed: Floats, accel: Floats) -> float:
    """Sum of v a over that of v, where a > 0.1 m/s^2: m/s^2, high where a driver accelerates often and hard.

    speed, accel : (k,) m/s and m/s^2, of `each_second`
    """
    way, gains = float(speed.sum()), accel > GAINING
    return float((speed * accel)[gains].sum()) / way if way > 0.0 else float("nan")


def percentile_of_gains(speed: Floats, accel: Floats) -> float:
    """The 95th percentile of v a where a > 0.1 m/s^2, of which the j-th of M in order is the j / M-th: m^2/s^3.

    speed, accel : as for `relative_positive_acceleration`; NaN where it nowhere gains speed
    """
    gained = np.sort((speed * accel)[accel > GAINING])
    ranks = np.arange(1, len(gained) + 1) / max(len(gained), 1)
    return float(np.interp(0.95, ranks, gained)) if len(gained) else float("nan")


def weighted_quantile(values: Floats, weight: Floats, share: float) -> float:
    """The value that a share of the weight does not exceed; NaN without any."""
    known = np.isfinite(values) & (weight > 0.0)
    if not known.any():
        return float("nan")
    order = np.argsort(values[known], kind="stable")
    total = np.cumsum(weight[known][order])
    return float(values[known][order][min(int(np.searchsorted(total, share * total[-1])), len(order) - 1)])


def poisson_limits(count: int) -> tuple[float, float]:
    """Limits of 95 % of the mean of a count."""
    from scipy.special import gammaincinv  # slow import: only when used

    low = float(gammaincinv(count, 0.025)) if count else 0.0
    return low, float(gammaincinv(count + 1, 0.975))
