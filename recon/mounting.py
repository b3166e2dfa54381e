"""How another body is mounted: the constant part of the differences of attitude between two trajectories.

Two pipelines may find another mounting of one phone, and a reference may tell the attitude of a camera. Such a turn is
the same all the time; what is left of the attitudes without it are the errors of a drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.evaluation import Motion, Statistics, mounting_between, statistics
from recon.numerics.rotation import angle, to_euler

_LEAST_DEG: Final = 3.0
"""From which turn of a body on attitudes are said to be of another mounting."""
_LEFT: Final = 0.5
"""Share of that turn which may be left of the attitudes without it: more are errors that come and go."""


@dataclass(frozen=True)
class Mounting:
    """The mean turn of the trajectory's body against that of the reference: yaw, pitch, roll and whole angle, in deg.

    left : how far the attitudes are from that turn, in deg
    """

    yaw: float
    pitch: float
    roll: float
    angle: float
    left: Statistics

    @classmethod
    def between(cls, run: Motion, reference: Motion) -> Mounting | None:
        """Of two motions at the same times; None where no attitude is known in both."""
        turn, left = mounting_between(run, reference)
        found = statistics(np.degrees(left))
        if found is None:
            return None
        yaw, pitch, roll = (float(np.degrees(part)) for part in to_euler(turn))
        return cls(yaw, pitch, roll, float(np.degrees(angle(turn, np.array([1.0, 0.0, 0.0, 0.0])))), found)

    @property
    def note(self) -> str:
        """What is to be said where the turn explains most of the attitudes' differences; "" where it does not."""
        if self.angle < _LEAST_DEG or self.left.rmse > _LEFT * self.angle:
            return ""
        return (
            f"its body stands turned by {self.angle:.1f} deg all the time (yaw {self.yaw:.1f}, pitch {self.pitch:.1f}, "
            f"roll {self.roll:.1f}): another mounting, or one that was found otherwise; without that turn attitudes "
            f"are {self.left.rmse:.2f} deg apart (rms)"
        )
