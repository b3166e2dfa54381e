"""Whether two sources agree on the speed of a drive, by statistics that outliers and a late receiver do not move.

    d = smallest over the lag of the upper quartile of |speed(t) - reference(t + lag)|,  while either one moves

They disagree strongly if d exceeds `MARGIN` and a quarter of the typical speed: noise, drift and slip stay under
that, a wrong unit, a reversed axis or positions of another drive do not.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.signals import interpolate
from recon.rows import Metric, warning
from recon.tables import Array

MARGIN: Final = 1.0
"""m/s; neither source tells slower motion well."""
STRONG: Final = 0.25
"""Share of the larger speed by which two sources may differ beyond MARGIN."""
LAGS_S: Final = np.arange(0.0, 1.21, 0.1)
"""How late receivers report their speed."""
MAX_GAP_NS: Final = 2_000_000_000
"""Speeds further apart are not joined."""
ENOUGH: Final = 20_000
"""Rows of the reference that are compared: a long one is thinned evenly."""
FEWEST: Final = 10
"""Times in motion, under which nothing is said."""
UNITS: Final = {3.6: "read in km/h where it is in m/s", 1.0 / 3.6: "read in m/s where it is in km/h"}
"""By how many times the reference is too small, what then was probably done to it."""


class Agreement(NamedTuple):
    """How a speed compares with its reference, where either one moves.

    difference : m/s, upper quartile; speed, reference : m/s, medians; ratio : of speed to reference; lag : s
    highest, reference_highest : m/s
    """

    difference: float
    speed: float
    reference: float
    ratio: float
    lag: float
    highest: float
    reference_highest: float

    @property
    def strong(self) -> bool:
        """Do the two disagree strongly?"""
        return self.difference > MARGIN + STRONG * max(self.speed, self.reference)


def agreement(t_ns: NDArray[np.int64], speed: Array, at_ns: NDArray[np.int64], reference: Array) -> Agreement | None:
    """Compare a speed with a reference that may be late; None where there is too little motion to compare.

    t_ns : (n,) ns, strictly increasing; speed : (n,) m/s, NaN where unknown
    at_ns : (m,) ns; reference : (m,) m/s, NaN where unknown
    """
    evenly = slice(None, None, max(1, len(at_ns) // ENOUGH))
    at_ns, reference = at_ns[evenly], reference[evenly]
    best: tuple[float, float, Array, Array] | None = None
    for lag in LAGS_S:
        ours = interpolate(at_ns - round(lag * 1e9), t_ns, speed, MAX_GAP_NS)
        moving = np.maximum(ours, reference) > MARGIN  # false where either one is NaN
        if np.count_nonzero(moving) < FEWEST:
            continue
        one, other = ours[moving], reference[moving]
        difference = float(np.quantile(np.abs(one - other), 0.75))
        if best is None or difference < best[0]:
            best = (difference, float(lag), one, other)
    return None if best is None else _told(*best)


def _told(difference: float, lag: float, one: Array, other: Array) -> Agreement:
    """The comparison of two speeds (n,) m/s at the best lag."""
    medians, highest = (float(np.median(one)), float(np.median(other))), (float(one.max()), float(other.max()))
    return Agreement(difference, *medians, _ratio(one, other), lag, *highest)


def _ratio(one: Array, other: Array) -> float:
    """Slope of the line through the origin, by the median; NaN where the other one does not move."""
    moving = other > MARGIN / 4.0
    return float(np.median(one[moving] / other[moving])) if moving.any() else float("nan")


def as_metrics(found: Agreement | None, name: str, reference: str) -> list[Metric]:
    """The numbers, and a warning where the two disagree strongly.

    name, reference : how the warning calls the two speeds
    """
    if found is None:
        return []
    rows = [
        Metric("speed_difference", found.difference, "m/s", method="upper quartile", note=f"{name} and {reference}"),
        Metric("speed_ratio", found.ratio, "1", method="median", note=f"{name} to {reference}"),
    ]
    if found.strong:
        text = (
            f"{name} and {reference} disagree: they differ by more than {found.difference:.1f} m/s in a quarter of the "
            f"time in motion, in which they are {found.speed:.1f} and {found.reference:.1f} m/s (medians) and reach "
            f"{found.highest:.1f} and {found.reference_highest:.1f} m/s: do not trust the result before you know why"
        )
        rows.append(warning("; ".join([text, *_likely(found.ratio, reference)])))
    return rows


def _likely(ratio: float, reference: str) -> list[str]:
    """The unit that was mistaken, where the ratio tells one."""
    return [
        f"the ratio is {ratio:.2f}: perhaps {reference} was {cause}"
        for factor, cause in UNITS.items()
        if abs(ratio / factor - 1.0) < 0.2
    ]
