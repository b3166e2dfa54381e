"""Turn rate from the steering wheel: the single-track model, its numbers found from a gyroscope.

    r = v (d - d_0) / (a + k v^2)              a = ratio times wheelbase, k = ratio times understeer gradient

d is the angle of the steering wheel (or of the front wheels: then the ratio is one), v the speed of the rear axle and r
the rate about the vehicle's vertical axis. With b the gyroscope's offset the model is all but linear in its numbers,

    d = d_0 + a (r / v) + k (v r) - a b (1 / v) - k b v,

the last term being that of the numbers so far, and its errors are those of the steering: play, wind, the bank of the
road. They last for seconds, so that means of a second do not count for one measurement each. Tyres that slide are no
part of the model: such times are left out.

References
    ISO 8855:2011, 12.4 (understeer gradient).
    Milliken, Milliken (1995), "Race car vehicle dynamics", section 5.3 (single-track model, steady turns).
    Priestley (1981), "Spectral analysis and time series", section 5.3.2 (variance of the mean of a correlated series).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SLOWEST: Final = 3.0
"""m/s below which the wheels are turned standing, and tyres scrub."""
STRONGEST: Final = 3.5
"""m/s^2 across, beyond which tyres are no longer linear."""
_FEWEST: Final = 60
"""Means of a second."""
_ROUNDS: Final = 6
_C2: Final = 9.0
"""c^2 of the weights 1 / (1 + e^2 / c^2), errors e in sigmas: at three sigma a row counts half."""
_KNOWN: Final = 0.05
"""Largest relative sigma of a: of a drive without bends, nothing is made."""
_LONGEST: Final = 30
"""s over which errors of the steering are looked for."""


@dataclass(frozen=True)
class SingleTrack:
    """ratio_length : m, a; understeer : s^2/m, k; offset : rad, d_0; ratio_length_sigma, offset_sigma : of these
    sigma : rad, error of the steering angle's mean of a second; lasts : s, for which it is the same; count : of means
    """

    ratio_length: float
    understeer: float
    offset: float
    ratio_length_sigma: float
    offset_sigma: float
    sigma: float
    lasts: float
    count: int

    def rate(self, speed: Floats, angle: Floats) -> tuple[Floats, Floats]:
        """Turn rate to the left and its sigma, of values that count one by one: (n,) rad/s.

        speed : (n,) m/s; angle : (n,) rad. All together they tell no more than the offset, which they share, is known.
        """
        gain = speed / (self.ratio_length + self.understeer * speed**2)
        doubt = np.hypot(self.sigma * np.sqrt(self.lasts), self.offset_sigma * np.sqrt(self.count))
        return gain * (angle - self.offset), np.abs(gain) * doubt


def grips(speed: Floats, rate: Floats) -> NDArray[np.bool_]:
    """Where the model holds: (n,) of speed m/s and turn rate rad/s."""
    return np.asarray((speed > SLOWEST) & (np.abs(speed * rate) < STRONGEST))


def single_track(speed: Floats, angle: Floats, rate: Floats) -> SingleTrack | None:
    """The numbers of the model from means of a second each; None where the drive does not tell them.

    speed : (n,) m/s; angle : (n,) rad, of the steering; rate : (n,) rad/s, of the gyroscope about the vertical axis
    """
    held = grips(speed, rate)
    if held.sum() < _FEWEST:
        return None
    v, d, r = speed[held], angle[held], rate[held]
    rows = np.column_stack([np.ones_like(v), r / v, v * r, 1.0 / v])
    size = np.sqrt((rows**2).mean(axis=0))
    if not (size > 0.0).all():
        return None
    scaled, weight, bent = rows / size, np.ones_like(v), np.zeros_like(v)
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        found, *_, rank, _singular = np.linalg.lstsq(scaled * root, (d + bent) * root[:, 0], rcond=None)
        error = d + bent - scaled @ found
        _, length, slope, share = found / size
        bent = -slope * share / length * v if length > 0.0 else np.zeros_like(v)
        sigma = float(1.4826 * np.median(np.abs(error)))
        weight = 1.0 / (1.0 + (error / max(sigma, 1e-9)) ** 2 / _C2)
    if rank < rows.shape[1]:
        return None
    lasts = _lasts(np.clip(error, -3.0 * sigma, 3.0 * sigma))
    inverse = np.linalg.inv((scaled * weight[:, None]).T @ scaled)
    spread = sigma * np.sqrt(lasts * np.diag(inverse)) / size
    offset, ratio_length, understeer = (found / size)[:3]
    if not spread[1] < _KNOWN * ratio_length:
        return None
    return SingleTrack(
        float(ratio_length), float(understeer), float(offset), float(spread[1]), float(spread[0]), sigma, lasts, len(v)
    )


def _lasts(error: Floats) -> float:
    """Integrated autocorrelation time of values a second apart, s: up to the first that is not positive."""
    centred = error - error.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return 1.0
    most = min(_LONGEST, len(error) // 4)
    rho = np.array([centred[lag:] @ centred[: len(centred) - lag] for lag in range(1, most)]) / power
    ends = np.flatnonzero(rho <= 0.0)
    return 1.0 + 2.0 * float(rho[: ends[0] if len(ends) else None].sum())
