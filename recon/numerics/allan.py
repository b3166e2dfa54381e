"""Overlapping Allan deviation, and what it tells of the noise of a sensor that stands still.

    sigma^2(tau) = 1/2 mean((ybar_k+m - ybar_k)^2),   ybar_k the mean of m samples from sample k on,   tau = m / rate
                 = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3

with quantisation Q, white noise N (angle or velocity random walk), bias instability B and rate random walk K. The four
are found by non-negative least squares on sigma^2, each point weighted by how many independent ones it is worth.

References
    NIST Special Publication 1065 (Riley 2008), "Handbook of frequency stability analysis", section 5.2.4 and table 31.
    IEEE Std 952-1997 (R2008), annex C: the terms and their coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

FLICKER: Final = 2.0 * np.log(2.0) / np.pi
_LEAST_PAIRS: Final = 9.0
"""Independent means behind a point; with fewer it says little."""
_SEEN: Final = 0.1
"""Share of the variance at some tau, below which a term does not show."""


@dataclass(frozen=True)
class Noise:
    """Terms of one axis, U its unit; 0 where a term does not show.

    white : U/sqrt(Hz); instability : U; walk : U/sqrt(s); quantisation : U s
    """

    white: float
    instability: float
    walk: float
    quantisation: float

    def deviation(self, tau_s: ArrayLike) -> Floats:
        """sigma(tau) of the model, in U."""
        return np.sqrt(_terms(np.asarray(tau_s, dtype=np.float64)).T @ self._squares())

    def _squares(self) -> Floats:
        return np.array([self.quantisation, self.white, self.instability, self.walk]) ** 2


def sizes(count: int, per_decade: int = 10) -> NDArray[np.int64]:
    """Numbers of samples to average, about evenly on a logarithmic scale, as far as `count` samples tell anything."""
    most = int(count / (_LEAST_PAIRS + 1.0))
    if most < 1:
        return np.zeros(0, dtype=np.int64)
    exponents = np.arange(0.0, np.log10(most) + 1e-9, 1.0 / per_decade)
    return np.unique(np.rint(10.0**exponents).astype(np.int64))


def overlapping(y: ArrayLike, size: ArrayLike) -> Floats:
    """Overlapping Allan deviations, NIST SP 1065, eq. 10.

    y : (n, k) samples at a steady rate; size : (j,) samples that are averaged, each at most n / 2
    returns : (j, k), unit of y
    """
    y = np.asarray(y, dtype=np.float64)
    total = np.concatenate((np.zeros((1, y.shape[1])), np.cumsum(y - y.mean(axis=0), axis=0)))
    found = [np.sqrt(0.5 * (_second(total, int(m)) ** 2).mean(axis=0)) / m for m in np.asarray(size)]
    return np.array(found).reshape(-1, y.shape[1])


def _second(total: Floats, m: int) -> Floats:
    """Sums of m samples less those of the m before, everywhere."""
    return np.asarray(total[2 * m :] - 2.0 * total[m:-m] + total[: -2 * m])


def uncertainty(count: int, size: ArrayLike) -> Floats:
    """Relative sigma of the deviations of white noise, 1 / sqrt(2 (n / m - 1)). IEEE Std 952, eq. C.21."""
    return np.asarray(1.0 / np.sqrt(2.0 * np.maximum(count / np.asarray(size) - 1.0, 1.0)))


def fit(tau_s: Floats, deviation: Floats, relative: Floats) -> Noise:
    """The terms of one axis.

    tau_s : (j,) s; deviation : (j,) Allan deviations, U; relative : (j,) their relative sigmas
    """
    from scipy.optimize import nnls  # slow import: only when used

    known = deviation > 0.0
    if known.sum() < 2:
        return Noise(0.0, 0.0, 0.0, 0.0)
    terms, weight = _terms(tau_s[known]), 1.0 / relative[known]
    system = (terms / deviation[known] ** 2 * weight).T
    size = np.linalg.norm(system, axis=0)
    squares = nnls(system / size, weight)[0] / size
    share = squares[:, None] * terms / np.maximum((squares[:, None] * terms).sum(axis=0), 1e-300)
    squares = np.where(share.max(axis=1) > _SEEN, squares, 0.0)
    quantisation, white, instability, walk = np.sqrt(squares)
    return Noise(float(white), float(instability), float(walk), float(quantisation))


def _terms(tau_s: Floats) -> Floats:
    """(4, j) of Q^2, N^2, B^2, K^2."""
    return np.array([3.0 / tau_s**2, 1.0 / tau_s, np.full_like(tau_s, FLICKER), tau_s / 3.0])
