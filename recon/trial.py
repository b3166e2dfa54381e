"""Is a drive understood better with what `recon doctor` would put right? The log is run both ways.

Whatever is wrong with axes, units or clocks, fuser.map has to take for errors of the IMU in the moving vehicle, or it
warns that its result is not to be trusted. White noise of density N and a bias that walks by K move an angle, or a
velocity, in a time T by

    sqrt(N^2 T + K^2 T^3 / 3)

Reference: Maybeck (1979), "Stochastic models, estimation, and control", vol. 1, 4.11 (integrals of white noise).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from recon import api
from recon.errors import ReconError
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.registry import Registry

SPAN_S: Final = 10.0
"""T: long enough for a bias that walks to count."""
_DISTRUST: Final = "do not trust"
_WORSE: Final = 1.1
"""Times that a number of a drive may grow before it counts as worse."""


@dataclass(frozen=True)
class Trial:
    """A drive, run. doubts : warnings not to trust it.

    turning, pushing : deg and m/s that the IMU strays in SPAN_S by what nothing explains; None where nobody tells it
    error : why it could not be run; then there are no numbers
    """

    doubts: int = 0
    turning: float | None = None
    pushing: float | None = None
    error: str = ""

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)

    def better_than(self, other: Trial) -> bool:
        """Is there less to doubt here than there or, where that is the same, no more unexplained than a tenth above?

        A drive that could be run is better than one that could not.
        """
        if self.error or other.error:
            return not self.error
        if self.doubts != other.doubts:
            return self.doubts < other.doubts
        pairs = [(self.turning, other.turning), (self.pushing, other.pushing)]
        known = [(own, its) for own, its in pairs if own is not None and its is not None]
        return all(own <= _WORSE * its for own, its in known)


def try_out(
    pipeline: Pipeline, paths: Sequence[Path], overrides: Sequence[Override] = (), *, registry: Registry
) -> Trial:
    """Run a pipeline that ends in fuser.map, and look at what it could not explain."""
    try:
        run = api.execute(pipeline, paths, None, list(overrides), registry=registry)
    except ReconError as error:
        return Trial(error=error.message)
    rows = [] if run.metrics is None else run.metrics.select(["name", "value"]).to_pylist()
    found = {row["name"]: row["value"] for row in rows}
    doubts = sum(_DISTRUST in text for text in run.warnings)
    turning, pushing = (_strays(found.get(f"{one}_noise"), found.get(f"{one}_bias_walk")) for one in ("gyro", "accel"))
    return Trial(doubts, turning, pushing)


def _strays(noise: float | None, walk: float | None) -> float | None:
    return None if noise is None or walk is None else math.sqrt(noise**2 * SPAN_S + walk**2 * SPAN_S**3 / 3.0)
