"""Times at which sensors sample."""

from __future__ import annotations

import numpy as np


def irregular(rate_hz: float, duration_s: float = 10.0) -> np.ndarray:
    """(n,) s at a rate, but for the first each up to 0.3 periods early or late, in whole ns."""
    t_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    t_s[1:] += np.random.default_rng(5).uniform(-0.3, 0.3, len(t_s) - 1) / rate_hz
    return np.round(t_s * 1e9) * 1e-9
