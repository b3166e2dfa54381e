"""Are sigmas honest? Normalised errors against what their chi-square distribution allows.

With z = error / sigma of k components, NEES per degree of freedom = mean of z^2, which is 1 for honest sigmas, more for
sigmas that are too small. Of nu independent z, nu * mean(z^2) is chi-square distributed with nu degrees of freedom.
Errors at neighbouring times are not independent: of n Gaussian z with the autocorrelation rho_k the squares carry
    n_eff = n / (1 + 2 sum rho_k^2)
independent ones, since the squares have the autocorrelation rho_k^2; with n in place of n_eff nearly every honest
filter would be refused. The sum ends where rho first is no longer positive: behind that it is mostly noise.

Where n_eff is small it is itself uncertain: at n_eff = 20 of 200 the limits of 99.9 % refuse 0.5 % of honest errors, at
n_eff = 2 they refuse 3 %.

Sigmas are those of single components, so components count as independent; where they are not, the limits are too tight.

References
    Bar-Shalom, Li, Kirubarajan (2001), "Estimation with applications to tracking and navigation", section 5.4.
    Bartlett (1946), "On the theoretical specification and sampling properties of autocorrelated time-series", Suppl.
    J. Royal Statistical Society 8(1), 27-41: variance of a mean square.
    Geyer (1992), "Practical Markov chain Monte Carlo", Statistical Science 7(4), section 3.3: where the sum ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HONEST: Final = 0.999
"""Probability with which honest sigmas lie between the limits."""


@dataclass(frozen=True)
class Consistency:
    """How normalised errors are distributed.

    nees : mean of z^2 per degree of freedom
    coverage : shares of the z within 1, 2 and 3 sigma; 68.3 %, 95.4 %, 99.7 % where they are Gaussian and honest
    count : number of z; degrees : how many independent ones they are worth
    limits : between which nees of honest sigmas lies with a probability of HONEST; of twenty honest components one is
        outside the limits of 95 %
    """

    nees: float
    coverage: tuple[float, float, float]
    count: int
    degrees: float
    limits: tuple[float, float]

    @property
    def honest(self) -> bool:
        """Does nees lie between the limits?"""
        return self.limits[0] <= self.nees <= self.limits[1]

    @property
    def verdict(self) -> str:
        """honest, too small or too large: the sigmas."""
        return "honest" if self.honest else "too small" if self.nees > 1.0 else "too large"


def consistency(error: Floats, sigma: Floats, *, white: bool = False) -> Consistency | None:
    """Judge sigmas by the errors that were made; None where no error has a sigma.

    error, sigma : (n, k), each column one component in the order of time; where either is NaN, or a sigma is not
        positive, there is nothing to judge
    white : the errors should be independent in time, as residuals should: a mean that is not zero is then a fault, and
        not correlation that excuses one
    """
    used = np.isfinite(error) & np.isfinite(sigma) & (sigma > 0.0)
    columns = [e[u] / s[u] for e, s, u in zip(error.T, sigma.T, used.T, strict=True) if u.any()]
    if not columns:
        return None
    z = np.concatenate(columns)
    shares = np.array([len(column) for column in columns]) / len(z)
    worth = np.array([effective_samples(column - column.mean() if white else column) for column in columns])
    degrees = float(1.0 / np.sum(shares**2 / worth))  # what gives the mean of all squares its variance, 2 / degrees
    within = [float(np.mean(np.abs(z) <= bound)) for bound in (1.0, 2.0, 3.0)]
    return Consistency(
        float(np.mean(z**2)),
        (within[0], within[1], within[2]),
        len(z),
        degrees,
        chi_square_limits(degrees, HONEST),
    )


def effective_samples(z: Floats) -> float:
    """How many independent samples the squares of z are worth: between 1 and n.

    z : (n,) of a mean that is zero by what it is; its autocorrelation is taken about zero
    """
    n = len(z)
    spectrum = np.fft.rfft(z, 2 * n)
    products = np.fft.irfft(spectrum * spectrum.conj(), 2 * n)[:n]
    if products[0] <= 0.0:
        return float(n)
    rho = products / products[0]
    ends = np.flatnonzero(rho <= 0.0)
    positive = rho[1 : ends[0]] if len(ends) else rho[1:]
    return float(max(n / (1.0 + 2.0 * np.sum(positive**2)), 1.0))


def chi_square_limits(degrees: float, share: float) -> tuple[float, float]:
    """Limits of a chi-square variable over its degrees of freedom that hold this share of it, tails alike."""
    from scipy.special import gammaincinv  # slow import: only when used

    tail = (1.0 - share) / 2.0
    low, high = gammaincinv(degrees / 2.0, [tail, 1.0 - tail]) * 2.0 / degrees
    return float(low), float(high)
