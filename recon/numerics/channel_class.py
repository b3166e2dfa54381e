"""Channel frequency classes: the low-pass of crash tests, forward and backward, so that nothing is delayed.

    wd = 2 pi CFC 2.0775,   wa = tan(wd T / 2),   D = 1 + sqrt(2) wa + wa^2
    a0 = wa^2 / D,   a1 = 2 a0,   a2 = a0,   b1 = -2 (wa^2 - 1) / D,   b2 = (-1 + sqrt(2) wa - wa^2) / D
    y_i = a0 x_i + a1 x_i-1 + a2 x_i-2 + b1 y_i-1 + b2 y_i-2

a Butterworth low-pass of two poles by the bilinear transform, four poles in both directions: -3 dB at 1.667 CFC where
the log is much faster, at 1.75 CFC with ten samples to a period of the class.
Vehicle structure is read in CFC 60, what is integrated to velocity in CFC 180, chest in CFC 600, head in CFC 1000.

References
    SAE J211-1 (1995), appendix C; ISO 6487:2002, annex A: coefficients, mirrored ends of at least 10 ms.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

CLASSES: Final = (60, 180, 600, 1000)
LEAST_RATE: Final = 10.0
"""Samples per second by class: below, the class is not what the standards mean by it (SAE J211-1, section 9)."""
_CORNER: Final = 2.0775
"""Of one pass: its -3 dB in Hz by class."""
_MIRROR_PERIODS: Final = 1.0
"""Length of the mirrored ends in periods of the class; 10 ms at least."""


def coefficients(cfc: float, rate_hz: float) -> tuple[Floats, Floats]:
    """Of one pass: (a0, a1, a2) of the input and (b1, b2) of the output, signs as in the difference equation above.

    raises : ValueError where the class lies beyond half the sampling rate
    """
    if not _CORNER * cfc < 0.5 * rate_hz:
        raise ValueError(f"CFC {cfc:g} needs more than {2 * _CORNER * cfc:.0f} samples per second, not {rate_hz:g}")
    wa = np.tan(np.pi * _CORNER * cfc / rate_hz)
    d = 1.0 + np.sqrt(2.0) * wa + wa**2
    a0 = wa**2 / d
    return np.array([a0, 2.0 * a0, a0]), np.array([-2.0 * (wa**2 - 1.0) / d, (-1.0 + np.sqrt(2.0) * wa - wa**2) / d])


def channel_class(y: ArrayLike, cfc: float, rate_hz: float, axis: int = 0) -> Floats:
    """The signal in a channel frequency class, its ends mirrored at their points; a constant passes unchanged.

    y : (..., n, ...) regularly sampled; axis : of the samples
    returns : shape of y, unchanged where the class lies beyond half the sampling rate, as nothing is left to take away
    """
    from scipy.signal import filtfilt  # slow import: only when used

    values = np.asarray(y, dtype=np.float64)
    if not _CORNER * cfc < 0.5 * rate_hz:
        return values.copy()
    a, b = coefficients(cfc, rate_hz)
    mirrored = int(np.ceil(rate_hz * max(0.01, _MIRROR_PERIODS / cfc)))
    pad = min(mirrored, values.shape[axis] - 1)
    if pad < 1:
        return values.copy()
    return np.asarray(filtfilt(a, np.concatenate(([1.0], -b)), values, axis=axis, padtype="odd", padlen=pad))
