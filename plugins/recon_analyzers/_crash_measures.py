"""The numbers of a crash, of many variants of its pulse at once; recon.numerics.severity has formulas and standards."""

from __future__ import annotations

from typing import Final

import numpy as np

from recon import Array
from recon.numerics import severity
from recon.numerics.budget import NORMAL_95, Doubt, Pulse, Uncertain, fineness, refined
from recon.numerics.channel_class import channel_class
from recon.numerics.geodesy import STANDARD_GRAVITY

OLDEST_DELTA_V_S: Final = 0.3
"""s after time zero in which the largest delta-V is looked for."""


def measures(accel: Array, yaw_rate: Array, *, pulse: Pulse, ahead: float) -> dict[str, Array]:
    """Every number of many variants of a pulse, in the units that the field uses: (b,) each.

    accel : (b, n, 3) m/s^2, vehicle; yaw_rate : (b, n) rad/s; pulse : has the sampling and time zero
    ahead : m, see recon.numerics.severity.head_flight
    """
    times, g = fineness(pulse.step_s), STANDARD_GRAVITY
    step_s, lead = pulse.step_s / times, pulse.lead * times
    accel, yaw_rate = refined(accel, times), refined(yaw_rate, times)
    after, turn = accel[:, lead:], yaw_rate[:, lead:]
    gained = _gained(after, step_s)
    size = np.hypot(gained[..., 0], gained[..., 1])
    at = size.argmax(axis=1)
    structure = channel_class(accel, 60, 1.0 / step_s, axis=1)[:, lead : lead + gained.shape[1]] / g
    head = severity.head_flight(after, turn, step_s, ahead)
    occupant = severity.occupant_flight(after, step_s)
    mean = severity.window_mean(after[..., :2], step_s, severity.RIDEDOWN_S) / g
    resultant = np.hypot(mean[..., 0], mean[..., 1])[..., None]
    return {
        "delta_v_long_max": _signed_extreme(gained[..., 0]),
        "delta_v_lat_max": _signed_extreme(gained[..., 1]),
        "delta_v_resultant_max": size.max(axis=1),
        "time_of_max": at * step_s,
        "accel_peak_cfc60": _signed_extreme(structure[..., 0]),
        "accel_peak_cfc60_magnitude": np.linalg.norm(structure, axis=-1).max(axis=1),
        "pdof": np.degrees(severity.pdof(gained[np.arange(len(at)), at])),
        "asi_1998": severity.asi(accel, step_s, "1998")[:, lead:].max(axis=1),
        "asi_2010": severity.asi(accel, step_s, "2010")[:, lead:].max(axis=1),
        "thiv": 3.6 * np.linalg.norm(head.velocity, axis=-1),
        "phd": severity.largest_after(resultant, head.time_s, step_s)[:, 0],
        "oiv_long": 3.6 * occupant.velocity[:, 0],
        "oiv_lat": 3.6 * occupant.velocity[:, 1],
        "ridedown": severity.largest_after(mean, occupant.time_s, step_s).max(axis=1),
    }


def time_of_max(pulse: Pulse, doubt: Doubt) -> Uncertain:
    """When the horizontal delta-V is largest, s after time zero.

    The interval has every time whose delta-V may be the largest, for where it hardly changes errors decide; it does not
    reach behind the time that is looked at.
    """
    times = fineness(pulse.step_s)
    gained = _gained(refined(pulse.accel[None], times)[:, pulse.lead * times :], pulse.step_s / times)[0]
    size, t_s = np.hypot(*gained.T), np.arange(len(gained)) * pulse.step_s / times
    at = int(size.argmax())
    apart = np.abs(t_s - t_s[at])
    noise = float(doubt.noise[:2].max()) * np.sqrt(pulse.step_s * apart)
    scale = float(np.sqrt(np.diag(doubt.axes)[:3].max()))
    error = 3.6 * np.hypot(float(doubt.bias[:2].max()) * apart, noise) + scale * (size[at] - size)
    likely = t_s[size + NORMAL_95 * error >= size[at]]
    low, high = float(likely[0]) - NORMAL_95 * doubt.time, float(likely[-1]) + NORMAL_95 * doubt.time
    sigma = (high - low) / (2.0 * NORMAL_95)
    low, high = max(low, 0.0), min(high, max(OLDEST_DELTA_V_S, float(t_s[at])))
    return Uncertain(float(t_s[at]), sigma, low, high, {"a flat delta-V": sigma, "timing": doubt.time}, False)


def _gained(after: Array, step_s: float) -> Array:
    """Horizontal delta-V over the time in which its maximum is looked for: (b, m, 2) km/h."""
    within = slice(0, round(OLDEST_DELTA_V_S / step_s) + 1)
    return np.asarray(3.6 * severity.integral(after[:, within, :2], step_s))


def _signed_extreme(y: Array) -> Array:
    """The value of the largest size, with its sign: (b, n) to (b,)."""
    return np.asarray(np.take_along_axis(y, np.abs(y).argmax(axis=1)[:, None], axis=1)[:, 0])
