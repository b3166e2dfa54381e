"""One IMU from several that measure the same motion: a weighted mean, and a vote on each second.

    x = sum w_i (x_i - o_i) / sum w_i + o,    w_i = 1 / N_i^2,    o = sum w_i o_i / sum w_i

over the boxes i that are there and not voted out, with N_i the density of a box' noise, told by its quietest seconds,
and o_i its usual offset from the median of all, so that nothing jumps where a box comes or goes. In each second a box
whose distance from that median, its mean or its root mean square, is many times what is usual has lost the vote. Of two
boxes nobody can say which is wrong: the first is believed.

References
    Skog, Nilsson, Haendel, Nehorai (2016), "Inertial sensor arrays, maximum likelihood, and Cramer-Rao bound", IEEE
    Trans. Signal Processing 64(16): the mean weighted by variances, and what an array gains.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.moving_window import rolling_std
from recon.numerics.rotation import Floats
from recon.numerics.signals import median_rate, runs

_BLOCK_NS: Final = 1_000_000_000
_SHORTEST: Final = 2
"""Blocks in a row that a box must disagree in."""
_TIMES, _USUAL = 5.0, 0.75
"""So many times the distance that this share of all blocks stays below is a lost vote."""
_QUIET: Final = 0.1
"""Quantile of the blocks that shows the noise alone: those in which the vehicle hardly moves."""
_SENSORS: Final = (slice(0, 3), slice(3, 6))
_LEAST: Final = (0.02, 0.3)
"""rad/s and m/s^2; distances below are left alone, whatever is usual."""
_SILENT: Final = 1e-9
"""Density of a box without noise, so that several of them share alike."""


class Virtual(NamedTuple):
    """values (n, 6), gyro and accel; shares (k, 2) of each box in gyro and accel; out (k, n) bool, voted out."""

    values: Floats
    shares: Floats
    out: NDArray[np.bool_]


def noise_density(t_ns: NDArray[np.int64], values: Floats) -> float:
    """Density of the white noise of three sensors by their changes in the quietest seconds, unit/sqrt(Hz).

    t_ns : (n,) int64 ns;  values : (n, 3)
    returns : root of the mean over the axes; a tiny number for fewer than three rows, or no noise at all
    """
    if len(t_ns) < 3:
        return _SILENT
    rate_hz = median_rate(t_ns)
    changes = rolling_std(np.diff(np.nan_to_num(values), axis=0), 2 * round(rate_hz / 2.0) + 1)
    variance = np.quantile((changes**2).mean(axis=1), _QUIET) / 2.0
    return max(float(np.sqrt(variance / rate_hz)), _SILENT)


def combine(t_ns: NDArray[np.int64], boxes: Floats, densities: Floats) -> Virtual:
    """The virtual IMU.

    t_ns : (n,) int64 ns, n >= 1;  boxes : (k, n, 6) gyro rad/s and accel m/s^2, NaN where there is none
    densities : (k, 2) of noise, of gyro and accel
    """
    blocks = np.flatnonzero(np.diff((t_ns - t_ns[0]) // _BLOCK_NS, prepend=-1))
    there = np.asarray(np.isfinite(boxes).all(axis=2))
    shares = densities**-2.0 / (densities**-2.0).sum(axis=0)
    several = (there.sum(axis=0) > 1)[:, None]
    apart = np.where(several, boxes - _known_median(boxes), np.nan)
    offsets = _known_median(np.swapaxes(apart, 0, 1))[:, None]
    usual = boxes - offsets
    out = np.logical_and(_voted_out(usual - _known_median(usual), blocks, len(t_ns)), there)
    if len(boxes) == 2:
        out = np.stack((np.zeros_like(out[0]), out.any(axis=0) & there[0]))
    left = np.asarray(there & ~out)
    left[0] |= there[0] & ~np.any(left, axis=0)
    weights = np.repeat(shares, 3, axis=1)[:, None] * left[:, :, None]
    total = weights.sum(axis=0)
    mean = (weights * np.where(left[:, :, None], usual, 0.0)).sum(axis=0) / np.where(total > 0.0, total, np.nan)
    centre = (np.repeat(shares, 3, axis=1) * offsets[:, 0]).sum(axis=0)
    return Virtual(mean + centre, shares, out)


def _known_median(values: Floats) -> Floats:
    """Median along the first axis over what is known, zero where nothing is."""
    known = np.isfinite(values).any(axis=0)
    return np.asarray(np.where(known, np.nanmedian(np.where(known, values, 0.0), axis=0), 0.0))


def _voted_out(apart: Floats, blocks: NDArray[np.intp], rows: int) -> NDArray[np.bool_]:
    """Rows of the blocks in which a box is too far from the others: (k, n) of distances (k, n, 6)."""
    lengths = np.diff(np.append(blocks, rows))
    away = np.nan_to_num(apart)
    means = np.add.reduceat(away, blocks, axis=1) / lengths[:, None]
    squares = np.add.reduceat(away**2, blocks, axis=1) / lengths[:, None]
    lost = np.zeros(means.shape[:2], dtype=bool)
    for sensors, least in zip(_SENSORS, _LEAST, strict=True):
        for distance in (np.linalg.norm(means[..., sensors], axis=2), np.sqrt(squares[..., sensors].sum(axis=2))):
            lost |= distance > max(_TIMES * float(np.quantile(distance, _USUAL)), least)
    for box in lost:
        for start, stop in runs(box):
            box[start:stop] &= stop - start >= min(_SHORTEST, len(blocks))
    return np.asarray(np.repeat(lost, lengths, axis=1))
