"""What a barometer reports of a drive: the pressure of air that is not standard, drifts and is stirred.

    p = p0(h_b),   h_b = s h + w(t) + d(t) + n        p0 of the standard atmosphere

with the scale s of differences of height, a random walk w of the weather, steps d where a window opens, a fan runs or a
tunnel begins, and white noise n.

Reference: Groves (2013), 2nd ed., section 6.2.1.
"""

from __future__ import annotations

import numpy as np

from recon.numerics.barometer import height_pressure
from recon.numerics.rotation import Floats
from recon_simulators.drive_params import DriveParams
from recon_simulators.gnss_model import random_outages
from recon_simulators.route import Route
from recon_simulators.sensor_model import regular_times


def barometer(route: Route, rate_hz: float, params: DriveParams, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Times (n,) s and pressures (n,) Pa."""
    t_s = regular_times(0.0, route.duration_s, rate_hz)
    true = route.at(t_s).height
    scale = 1.0 + params.baro_scale * rng.standard_normal()
    walk = np.cumsum(rng.standard_normal(len(t_s))) * params.baro_walk / np.sqrt(rate_hz)
    height = scale * true + walk + params.baro_noise * rng.standard_normal(len(t_s))
    for start_s, stop_s in random_outages(params.baro_jump_rate, params.baro_jump_length, route.duration_s, rng):
        inside = (t_s >= start_s) & (t_s < stop_s)
        height[inside] += rng.choice([-1.0, 1.0]) * rng.uniform(*params.baro_jump)
    return t_s, height_pressure(height)
