"""Where the IMU is believed less than usual: while it is silent, and while something pushes the vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.smoothing.model import Impact, Noise
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.soa import Floats
from recon.numerics.smoothing.stops import Mask

_GAP_RATE: Final = 0.3
_GAP_FORCE: Final = 2.0
_GAP_FAR_S: Final = (2.0, 5.0)
"""rad/s and m/s^2, what may have happened where the IMU is silent for so long, s, without wheels and on them; less in a
shorter gap, whose ends tell: it is what a line between them misses once in a hundred gaps of 0.5 to 10 s, in cars
simulated and real. One who walks turns as much in 2 s as a car in 5 s."""
_FROZEN: Final = 1e-4
"""Of the time of an impact in which biases walk; not nought, lest they have no relation."""
_NEAR_S: Final = 0.1
"""s; knots are the samples nearest to the ends of an impact."""


@dataclass(frozen=True)
class Disturbances:
    """Of the K intervals between knots.

    gap_s : (K,) s of silence; walk_s : (K,) s in which biases walk
    gap : (K,) s, what gaps add to squared densities, per squared rate or force
    pushed, spun : (K,) m^2/s^3 and rad^2/s, what impacts add to those of accelerometer and gyro
    """

    gap_s: Floats
    walk_s: Floats
    gap: Floats
    pushed: Floats
    spun: Floats

    @classmethod
    def of(cls, samples: Samples, impacts: tuple[Impact, ...], wheels: bool = True) -> Disturbances:
        """Those of a log and of the impacts found in it. wheels : as in Model"""
        knots = samples.knot_times
        length = np.diff(knots)
        gap_s = (np.diff(samples.t_s) * samples.filled).reshape(samples.intervals, -1).sum(axis=1)
        inside, pushed, spun = _impacts(knots, impacts)
        return cls(
            gap_s=gap_s,
            walk_s=np.where(inside, _FROZEN * length, length),
            gap=(gap_s * np.minimum(gap_s / _GAP_FAR_S[wheels], 1.0)) ** 2 / length,
            pushed=pushed,
            spun=spun,
        )

    def densities(self, noise: Noise) -> tuple[Floats, Floats]:
        """Noise of gyro and accelerometer in each interval: (K,) rad/s/sqrt(Hz), (K,) m/s^2/sqrt(Hz)."""
        turned, moved = self.missed()
        return np.sqrt(noise.gyro**2 + turned), np.sqrt(noise.accel**2 + moved)

    def missed(self) -> tuple[Floats, Floats]:
        """What silences and impacts add to squared densities of gyro and accelerometer: (K,) rad^2/s, (K,) m^2/s^3."""
        return _GAP_RATE**2 * self.gap + self.spun, _GAP_FORCE**2 * self.gap + self.pushed


def _impacts(knots: Floats, impacts: tuple[Impact, ...]) -> tuple[Mask, Floats, Floats]:
    """Which intervals lie in impacts, and what they add to squared densities of accelerometer and gyro: (K,) each."""
    middle = 0.5 * (knots[1:] + knots[:-1])
    inside, pushed, spun = np.zeros(len(middle), dtype=bool), np.zeros(len(middle)), np.zeros(len(middle))
    for impact in impacts:
        here = (middle > impact.start_s) & (middle < impact.end_s)
        here &= np.diff(knots) <= impact.end_s - impact.start_s + _NEAR_S
        inside |= here
        lasting = max(float(np.diff(knots)[here].sum()), _NEAR_S)
        pushed[here] += impact.velocity**2 / lasting
        spun[here] += impact.turn**2 / lasting
    return inside, pushed, spun
