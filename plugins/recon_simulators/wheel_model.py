"""What the wheels of a drive report: their speed, and by the single-track model each wheel's and the steering wheel's.

    v_i = |(v - y_i w, x_i w)|,    delta = i_s (atan(l w v / (v^2 + c^2)) + k v w)

with the turn rate w, the wheel at x_i ahead of the rear axle and y_i to the left, the steering ratio i_s, the wheelbase
l, the understeer k in rad/(m/s^2), and c = 0.3 m/s, below which a turn rate says little. A constant scale stands for
worn or pumped tyres; white noise, an offset and a slow wander are added where parameters ask for them. At rest a wheel
shows exactly zero.

Reference: Rajamani (2012), "Vehicle Dynamics and Control", 2.2 and 3.1.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.rotation import Floats
from recon_simulators.drive_params import DriveParams
from recon_simulators.noise import gauss_markov
from recon_simulators.route import Route
from recon_simulators.sensor_model import regular_times

WHEELS: Final = (("front_left", 1, 1), ("front_right", 1, -1), ("rear_left", 0, 1), ("rear_right", 0, -1))
"""Name; axles ahead of the rear one; side, positive to the left."""
_CRAWL: Final = 0.3
"""m/s."""
_WANDERS_S: Final = 5.0
"""s for which wind, bank and play hold the steering wheel aside."""


def wheels(
    route: Route, rate_hz: float, params: DriveParams, rng: np.random.Generator
) -> tuple[Floats, dict[str, Floats]]:
    """Times (n,) s, and by column (n,) m/s speeds, rad the angle of the steering wheel where `steering` asks for it."""
    t_s = regular_times(0.0, route.duration_s, rate_hz)
    scale = 1.0 + params.wheel_scale * rng.standard_normal()
    true = route.wheel_speed(t_s)
    noise = np.where(true == 0.0, 0.0, params.wheel_noise * rng.standard_normal(len(t_s)))
    columns = {"speed": scale * true + noise}
    if params.steering:
        columns |= _steered(route, t_s, true, scale, params, rate_hz, rng)
    return t_s, columns


def _steered(
    route: Route,
    t_s: Floats,
    speed: Floats,
    scale: float,
    params: DriveParams,
    rate_hz: float,
    rng: np.random.Generator,
) -> dict[str, Floats]:
    """Angle of the steering wheel by the single-track model, and the speeds of the four wheels: (n,) each."""
    rate = route.turn_rate(t_s)
    curvature = rate * speed / (speed**2 + _CRAWL**2)  # at a crawl, where the rate says nothing, the wheels are ahead
    front = np.arctan(params.wheelbase * curvature) + params.understeer * speed * rate
    wander = params.steering_wander * gauss_markov((len(t_s), 1), rate_hz, _WANDERS_S, rng)[:, 0]
    white, offset = (
        params.steering_noise * rng.standard_normal(len(t_s)),
        params.steering_offset * rng.standard_normal(),
    )
    columns = {"steering_angle": params.steering_ratio * front + offset + wander + white}
    for name, ahead, side in WHEELS:
        along, across = speed - side * 0.5 * params.track * rate, ahead * params.wheelbase * rate
        rolled = np.sign(along) * np.hypot(along, across)
        own = scale * (1.0 + params.tyre_scale * rng.standard_normal())
        noise = np.where(rolled == 0.0, 0.0, params.wheel_noise * rng.standard_normal(len(t_s)))
        columns[f"speed_{name}"] = own * rolled + noise
    return columns
