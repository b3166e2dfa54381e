"""Smoothing spline of positions whose error is partly slow, as that of a GNSS receiver.

The curve p(t) and the slow error m(t) minimise

    sum (z_i - p_i - m_i)^2 / w_i^2 + sum (u_i - p'_i)^2 / s_i^2 + integral p''(t)^2 / a(t)^2 dt
        + m_0^2 / c^2 + sum (m_i+1 - f_i m_i)^2 / (c^2 (1 - f_i^2)),    f_i = exp(-(t_i+1 - t_i) / tau).

The first and the third term are the smoothing spline of Reinsch (1967), piecewise cubic, its penalty here dependent on
time; the second holds measured derivatives; the last two make m a first-order Gauss-Markov process. The integral over
one piece is a quadratic form in the values and derivatives at its ends (Wahba 1978: p' is a Wiener process), so the
minimum is the solution of one symmetric system with the unknowns p_i, p'_i, m_i and a bandwidth of five.

References
    Reinsch (1967), "Smoothing by spline functions", Numerische Mathematik 10, 177-183.
    Wahba (1978), "Improper priors, spline smoothing and the problem of guarding against model errors in regression",
    J. Royal Statistical Society B 40(3), 364-372.
    Gelb (1974), "Applied Optimal Estimation", ch. 3.6 (Gauss-Markov process).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_STATES = 3
"""Value, derivative and slow error at each time."""


def smoothing_spline(
    t_s: Floats,
    z: Floats,
    rate: Floats,
    *,
    white: Floats,
    rate_sigma: Floats,
    bend: Floats,
    slow: float,
    correlation_s: float,
) -> tuple[Floats, Floats]:
    """Value and derivative of the spline at each time: (n,) and (n,).

    t_s : (n,) s, strictly increasing, n > 0
    z : (n,) measured values; white : (n,) sigma of their white error, inf where there is no value
    rate : (n,) measured derivatives, unit of z per s; rate_sigma : (n,) their sigma, inf where there is none
    bend : (n-1,) a(t) in each interval, density of the second derivative, unit of z per s^1.5
    slow : c, sigma of the slow error, above zero; correlation_s : tau
    """
    from scipy.linalg import solveh_banded  # slow import: only when used

    here, known_rate = 1.0 / white**2, 1.0 / rate_sigma**2
    middle = float(np.mean(z[here > 0.0])) if (here > 0.0).any() else 0.0
    z, rate = np.where(here > 0.0, z - middle, 0.0), np.where(known_rate > 0.0, rate, 0.0)
    diagonal, below = _blocks(np.diff(t_s), here, known_rate, bend, slow, correlation_s)
    wanted = np.column_stack((here * z, known_rate * rate, here * z)).ravel()
    found = solveh_banded(_banded(diagonal, below), wanted, lower=True, check_finite=False)
    value, derivative, _ = found.reshape(-1, _STATES).T
    return value + middle, np.asarray(derivative)


def _blocks(
    step: Floats, here: Floats, known_rate: Floats, bend: Floats, slow: float, correlation_s: float
) -> tuple[Floats, Floats]:
    """Blocks of the normal matrix: (n, 3, 3) on its diagonal, (n-1, 3, 3) below it."""
    diagonal = np.zeros((len(here), _STATES, _STATES))
    below = np.zeros((len(step), _STATES, _STATES))
    diagonal[:, 0, 0] = diagonal[:, 0, 2] = diagonal[:, 2, 0] = diagonal[:, 2, 2] = here
    diagonal[:, 1, 1] = known_rate
    diagonal[0, 2, 2] += 1.0 / slow**2
    weight = 1.0 / bend**2
    far, near, own = 12.0 * weight / step**3, 6.0 * weight / step**2, 4.0 * weight / step
    for rows, sign in ((slice(None, -1), 1.0), (slice(1, None), -1.0)):
        diagonal[rows, 0, 0] += far
        diagonal[rows, 0, 1] += sign * near
        diagonal[rows, 1, 0] += sign * near
        diagonal[rows, 1, 1] += own
    below[:, 0, 0], below[:, 0, 1], below[:, 1, 0], below[:, 1, 1] = -far, -near, near, 0.5 * own
    fade = np.exp(-step / correlation_s)
    innovation = 1.0 / (slow**2 * -np.expm1(-2.0 * step / correlation_s))
    diagonal[1:, 2, 2] += innovation
    diagonal[:-1, 2, 2] += fade**2 * innovation
    below[:, 2, 2] = -fade * innovation
    return diagonal, below


def _banded(diagonal: Floats, below: Floats) -> Floats:
    """The symmetric matrix of these blocks in the lower form of LAPACK: (6, 3 n)."""
    band = np.zeros((2 * _STATES, diagonal.shape[0] * _STATES))
    for column in range(_STATES):
        for row in range(_STATES):
            if row >= column:
                band[row - column, column::_STATES] = diagonal[:, row, column]
            band[_STATES + row - column, column : -_STATES or None : _STATES] = below[:, row, column]
    return band
