"""What a vehicle can show, by which readers know a wrong unit, a turned sign or a damaged file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

MOST_FAULTY: Final = 0.01
"""Share of rows from which on a fault of the log is no longer a slip."""
USUAL_SIZE: Final = (0.5, 2.0)
"""Median specific force of a vehicle in units of gravity."""
FASTEST_TURN: Final = 20.0
"""rad/s; no vehicle turns as fast for a hundredth of a drive."""
LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "lat": (-90.0, 90.0),
    "lon": (-180.0, 360.0),
    "height": (-1000.0, 100_000.0),
    "speed": (-500.0, 500.0),
    "course": (-2.0 * np.pi, 4.0 * np.pi),
    "vel": (-500.0, 500.0),
    "accel": (-1e6, 1e6),
    "gyro": (-1e4, 1e4),
    "mag": (-1.0, 1.0),
    "pressure": (0.0, 1e6),
    "temperature": (0.0, 1000.0),
    "fix": (0.0, 255.0),
    "satellites": (0.0, 255.0),
}
"""Least and largest value in the unit of the stream; others mean a wrong unit or a damaged file."""
