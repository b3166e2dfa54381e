"""Random processes of unit sigma, as errors of sensors are made of them.

References: Brown and Hwang, Introduction to Random Signals and Applied Kalman Filtering, 4th ed. (2012), sec. 4.2
(Gauss-Markov process).
"""

from __future__ import annotations

import numpy as np

from recon.numerics.rotation import Floats

_HIGHEST = 0.45
"""Of the sampling rate: a band is cut here, below half the rate."""


def gauss_markov(shape: tuple[int, int], rate_hz: float, correlation_s: float, rng: np.random.Generator) -> Floats:
    """Stationary first-order Gauss-Markov processes, one per column; white for a correlation time of 0.

    m_k+1 = c m_k + sqrt(1 - c^2) n,   c = exp(-1 / (rate correlation time))
    """
    white = rng.standard_normal(shape)
    if not correlation_s:
        return white
    from scipy.signal import lfilter

    kept = np.exp(-1.0 / (rate_hz * correlation_s))
    white[1:] *= np.sqrt(1.0 - kept**2)
    return np.asarray(lfilter([1.0], [1.0, -kept], white, axis=0))


def in_band(shape: tuple[int, int], rate_hz: float, band_hz: tuple[float, float], rng: np.random.Generator) -> Floats:
    """White noise between two frequencies, one per column; where the sampling is too slow for it, plainly white.

    A sensor slower than a vibration sees it aliased to frequencies all over its own band.
    """
    white = rng.standard_normal(shape)
    low, high = band_hz[0], min(band_hz[1], _HIGHEST * rate_hz)
    if low >= high:
        return white
    from scipy.signal import butter, sosfilt, sosfreqz

    sections = butter(2, (low, high), "bandpass", fs=rate_hz, output="sos")
    _, gain = sosfreqz(sections, 8192)
    return np.asarray(sosfilt(sections, white, axis=0) / np.sqrt(np.mean(np.abs(gain) ** 2)))
