"""Statistics in centred windows that move along samples: mean, standard deviation.

References
    Chan, Golub, LeVeque (1983), "Algorithms for computing the sample variance", The American Statistician 37(3):
    mean and sum of squares of two joined samples.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def moving_average(y: ArrayLike, window: int) -> Floats:
    """Centred mean whose window shrinks symmetrically at the ends.

    The first and last sample are kept, and a constant and a straight line over the sample number pass unchanged.
    A NaN touches only the windows that hold it.

    y : (n,) or (n, k)
    window : odd number of samples
    returns : shape of y
    raises : ValueError if window is not odd and positive
    """
    y = np.asarray(y, dtype=np.float64)
    half = min(_half_width(window), (len(y) - 1) // 2)
    if half < 1:
        return y.copy()
    inside = _sliding_moments(y, 2 * half + 1).mean
    return np.concatenate((_growing_means(y, half), inside, _growing_means(y[::-1], half)[::-1]))


def rolling_std(y: ArrayLike, window: int) -> Floats:
    """Standard deviation (divisor: number of samples) in a centred window, whatever the offset of the signal.

    Near the ends, where a full window does not fit, the value of the nearest full window holds. A signal shorter than
    the window has one value throughout.

    y : (n,) or (n, k)
    window : odd number of samples
    returns : shape of y, unit of y
    raises : ValueError if window is not odd and positive
    """
    y = np.asarray(y, dtype=np.float64)
    half, n = _half_width(window), len(y)
    if n == 0:
        return y.copy()
    size = min(window, n)
    squares = _sliding_moments(y, size).squares
    nearest = np.clip(np.arange(n) - half, 0, n - size)
    return np.asarray(np.sqrt(squares / size)[nearest])


def _half_width(window: int) -> int:
    if window < 1 or window % 2 == 0:
        raise ValueError(f"window must be an odd, positive number of samples, not {window}")
    return window // 2


def _growing_means(y: Floats, count: int) -> Floats:
    """Means of the first 1, 3, 5, ... samples, `count` of them; sums are of differences, so a constant is exact."""
    size = 2 * np.arange(count) + 1
    sums = np.cumsum(y[: 2 * count] - y[0], axis=0)[::2]
    return np.asarray(y[0] + (sums.T / size).T)


class _Moments(NamedTuple):
    """Mean and sum of squared deviations of `size` samples, for many windows at once."""

    mean: Floats
    squares: Floats
    size: int

    def at(self, windows: slice) -> _Moments:
        """Those of some of the windows."""
        return _Moments(self.mean[windows], self.squares[windows], self.size)

    def joined(self, other: _Moments) -> _Moments:
        """Those of the samples of both, window by window; Chan et al. 1983."""
        total = self.size + other.size
        shift = other.mean - self.mean
        share = other.size / total
        squares = self.squares + other.squares + self.size * share * shift**2
        return _Moments(self.mean + share * shift, squares, total)


def _sliding_moments(y: Floats, window: int) -> _Moments:
    """Moments of every full window, (n - window + 1, ...).

    Blocks of 1, 2, 4, ... samples are joined to `window` along its binary digits: O(n log window), and every result
    depends on the samples of its own window only, so nothing drifts as in a running sum.
    """
    many = len(y) - window + 1
    block = _Moments(y, np.zeros_like(y), 1)
    result = _Moments(np.zeros_like(y[:many]), np.zeros_like(y[:many]), 0)
    while True:
        if window & block.size:
            result = result.joined(block.at(slice(result.size, result.size + many)))
        if result.size == window:
            return result
        block = block.at(slice(None, -block.size)).joined(block.at(slice(block.size, None)))
