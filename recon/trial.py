"""Is a drive understood better with what `recon doctor` would put right? The log is run both ways.

Whatever is wrong with axes, units or clocks, fuser.map has to take for noise of the IMU in the moving vehicle, or it
warns that its result is not to be trusted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from recon import api
from recon.errors import ReconError
from recon.overrides import Override
from recon.pipeline import Pipeline
from recon.registry import Registry

NOISES: Final = ("gyro_noise", "accel_noise")
_DISTRUST: Final = "do not trust"
_WORSE: Final = 1.1


@dataclass(frozen=True)
class Trial:
    """A drive, run. doubts : warnings not to trust it; noise in the moving vehicle, deg/s/sqrt(Hz), m/s^2/sqrt(Hz).

    error : why it could not be run; then there are no numbers
    """

    doubts: int = 0
    gyro_noise: float | None = None
    accel_noise: float | None = None
    error: str = ""

    def as_data(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)

    def better_than(self, other: Trial) -> bool:
        """Is less unexplained here than there?"""
        if self.error or other.error:
            return not self.error
        if self.doubts != other.doubts:
            return self.doubts < other.doubts
        pairs = [(getattr(self, name), getattr(other, name)) for name in NOISES]
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
    noise = {row["name"]: row["value"] for row in rows if row["name"] in NOISES}
    return Trial(sum(_DISTRUST in text for text in run.warnings), **noise)
