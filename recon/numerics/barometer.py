"""Heights from the pressure of the air.

In the standard atmosphere, of 15 degC and 1013.25 hPa at sea level and a lapse of 6.5 K/km,

    h = T0 / L ((p / p0)^(-R L / g) - 1)

Weather moves this height by up to some hundred metres and lets it drift by decimetres in a minute; where the air is
warmer or colder than standard, differences of height are wrong by its share of the absolute temperature, 3 % for 10 K.

References
    ISO 2533:1975, Standard atmosphere, clause 2. Groves (2013), 2nd ed., eq. 6.17.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

_TEMPERATURE: Final = 288.15
"""K, at sea level."""
_PRESSURE: Final = 101_325.0
"""Pa, at sea level."""
_LAPSE: Final = -0.0065
"""K/m"""
_EXPONENT: Final = -287.05287 * _LAPSE / 9.80665

SCALE_SIGMA: Final = 0.04
"""Of differences of height, for air 12 K from the standard."""


def pressure_height(pressure: ArrayLike) -> Floats:
    """Height above the surface of 1013.25 hPa in the standard atmosphere.

    pressure : (n,) Pa
    returns : (n,) m
    """
    ratio = np.asarray(pressure, dtype=np.float64) / _PRESSURE
    return np.asarray(_TEMPERATURE / _LAPSE * (ratio**_EXPONENT - 1.0))


def height_pressure(height: ArrayLike) -> Floats:
    """The inverse of `pressure_height`: (n,) Pa at (n,) m."""
    ratio = 1.0 + _LAPSE / _TEMPERATURE * np.asarray(height, dtype=np.float64)
    return np.asarray(_PRESSURE * ratio ** (1.0 / _EXPONENT))
