"""How severe an impact was, in the terms of crash tests, from the acceleration of the vehicle during it.

Everything is taken in the axes of the vehicle (ISO 8855: x forward, y left, z up), time counts from time zero, samples
are regular. All functions take one pulse (n, 3), or many at once (..., n, 3), as the propagation of errors needs it.

    delta-V        integral of the acceleration in the vehicle's own axes, as event data recorders have it
    PDOF           atan2(dv_y, -dv_x), clockwise from the front: 0 head-on, 90 deg from the right
    ASI            max of sqrt((ax / 12 g)^2 + (ay / 9 g)^2 + (az / 10 g)^2), EN 1317-1
                   1998: components averaged over 50 ms;  2010: four-pole phaseless Butterworth of 13 Hz
    THIV           velocity at which a free point hits a box, 0.6 m ahead and behind, 0.3 m to either side, that yaws
                   with the vehicle;  PHD: highest 10 ms mean of the resultant after that, EN 1317-1
    OIV, ridedown  the same without yaw (flail space): velocity when 0.6 m ahead or 0.3 m aside are travelled, and the
                   highest 10 ms mean of one axis after that

References
    49 CFR 563.5, 563.7 (delta-V, its maximum); EN 1317-1:1998 and 2010, clauses 6 to 8; MASH (AASHTO 2016), appendix F;
    Michie (1981), "Collision risk assessment based on occupant flail-space model", TRR 796.
"""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import STANDARD_GRAVITY

Floats = NDArray[np.float64]
Edition = Literal["1998", "2010"]

FLAIL_AHEAD: Final = 0.6
FLAIL_ASIDE: Final = 0.3
"""m to the walls of the box in which head and occupant are free."""
RIDEDOWN_S: Final = 0.01
LEAST_DELTA_V_RATE: Final = 75.0
"""Hz of samples that tell the delta-V of pulses of 70 to 150 ms: at 50 Hz their sum is 2.5 % off, at 75 Hz 0.4 %."""
_ASI_LIMITS: Final = STANDARD_GRAVITY * np.array([12.0, 9.0, 10.0])
_ASI_MEAN_S: Final = 0.05
_ASI_HZ: Final = 13.0


def integral(y: Floats, step_s: float) -> Floats:
    """Trapezoidal integral over time from the first sample on: (..., n, k), unit of y times s."""
    area = np.zeros_like(y)
    np.cumsum(0.5 * step_s * (y[..., 1:, :] + y[..., :-1, :]), axis=-2, out=area[..., 1:, :])
    return area


def window_mean(y: Floats, step_s: float, window_s: float) -> Floats:
    """Centred mean over a window of time, shorter at the ends: (..., n, k).

    The window has a whole number of steps; the two samples at its ends count by half, as the trapezoid has it.
    """
    area = integral(y, step_s)
    steps = max(round(window_s / step_s), 1)
    n = y.shape[-2]
    first = np.clip(np.arange(n) - steps // 2, 0, max(n - 1 - steps, 0))
    last = np.minimum(first + steps, n - 1)
    if n < 2:
        return y.copy()
    return np.asarray((area[..., last, :] - area[..., first, :]) / ((last - first) * step_s)[:, None])


def pdof(delta_v: Floats) -> Floats:
    """Principal direction of force from the change of velocity: (..., 2 or 3) to (...) rad in (-pi, pi]."""
    return np.asarray(np.arctan2(delta_v[..., 1], -delta_v[..., 0]))


def clock(angle: float) -> int:
    """Direction of force as on the face of a clock, 12 head-on; angle in rad."""
    return round(float(np.degrees(angle)) / 30.0) % 12 or 12


def asi(accel: Floats, step_s: float, edition: Edition) -> Floats:
    """Acceleration severity index over time: (..., n, 3) m/s^2 to (..., n)."""
    smooth = window_mean(accel, step_s, _ASI_MEAN_S) if edition == "1998" else _low_pass(accel, step_s)
    return np.asarray(np.sqrt(((smooth / _ASI_LIMITS) ** 2).sum(axis=-1)))


def _low_pass(accel: Floats, step_s: float) -> Floats:
    """Two poles of 13 Hz forward and two backward; unchanged where sampling is too slow to tell."""
    from scipy.signal import butter, filtfilt  # slow import: only when used

    rate = 1.0 / step_s
    if rate <= 2.0 * _ASI_HZ:
        return accel
    b, a = butter(2, _ASI_HZ, fs=rate)
    pad = min(round(0.5 * rate), accel.shape[-2] - 1)
    return np.asarray(filtfilt(b, a, accel, axis=-2, padlen=pad))


class Flight(NamedTuple):
    """The end of a free flight inside the vehicle: (...) each, NaN where no wall is reached.

    time_s : after time zero;  velocity : (..., 2) m/s relative to the vehicle, its axes
    """

    time_s: Floats
    velocity: Floats


def head_flight(accel: Floats, yaw_rate: Floats, step_s: float, ahead: float = 0.0) -> Flight:
    """The theoretical head of EN 1317-1, free from time zero on.

    accel : (..., n, 2 or 3) m/s^2; yaw_rate : (..., n) rad/s; the first sample is that of time zero
    ahead : m, how far the head starts ahead of the point whose acceleration is given
    """
    yaw = integral(yaw_rate[..., None], step_s)[..., 0]
    cos, sin = np.cos(yaw), np.sin(yaw)
    ax, ay = accel[..., 0], accel[..., 1]
    ground = np.stack([ax * cos - ay * sin, ax * sin + ay * cos], axis=-1)
    gained = integral(ground, step_s)
    gone = integral(gained, step_s)
    dx, dy, ux, uy = ahead - gone[..., 0], -gone[..., 1], -gained[..., 0], -gained[..., 1]
    place = np.stack([dx * cos + dy * sin, -dx * sin + dy * cos], axis=-1)
    velocity = np.stack(
        [ux * cos + uy * sin + place[..., 1] * yaw_rate, -ux * sin + uy * cos - place[..., 0] * yaw_rate], axis=-1
    )
    return _landing(place - [ahead, 0.0], velocity, step_s)


def occupant_flight(accel: Floats, step_s: float) -> Flight:
    """The occupant of the flail-space model: as the head, but the vehicle does not yaw."""
    velocity = -integral(accel[..., :2], step_s)
    return _landing(integral(velocity, step_s), velocity, step_s)


def _landing(place: Floats, velocity: Floats, step_s: float) -> Flight:
    """When a wall is reached, and how fast, linearly between two samples.

    place, velocity : (..., n, 2) m, m/s
    """
    depth = np.maximum(np.abs(place[..., 0]) / FLAIL_AHEAD, np.abs(place[..., 1]) / FLAIL_ASIDE)
    beyond = depth >= 1.0
    last = np.maximum(beyond.argmax(axis=-1), 1)[..., None]
    before, after = (np.take_along_axis(depth, i, axis=-1)[..., 0] for i in (last - 1, last))
    share = np.clip((1.0 - before) / np.maximum(after - before, 1e-12), 0.0, 1.0)
    ends = [np.take_along_axis(velocity, i[..., None], axis=-2)[..., 0, :] for i in (last - 1, last)]
    landed = np.asarray(beyond.any(axis=-1))
    time_s = np.where(landed, (last[..., 0] - 1 + share) * step_s, np.nan)
    at = ends[0] + share[..., None] * (ends[1] - ends[0])
    return Flight(time_s, np.where(landed[..., None], at, np.nan))


def largest_after(y: Floats, time_s: Floats, step_s: float) -> Floats:
    """Largest size of each of k signals (..., n, k) from a time (...) on: (..., k), NaN where the time is.

    The signals are linear between samples, lest what falls steeply be told for up to a step later.
    """
    at = time_s / step_s
    known = at <= y.shape[-2] - 1
    at = np.where(known, at, 0.0)
    late = np.arange(y.shape[-2]) >= at[..., None]
    first = np.clip(np.floor(at).astype(np.intp), 0, max(y.shape[-2] - 2, 0))[..., None]
    last = np.minimum(first + 1, y.shape[-2] - 1)
    before, after = (np.take_along_axis(y, i[..., None], axis=-2)[..., 0, :] for i in (first, last))
    begin = np.abs(before + (at[..., None] - first) * (after - before))
    peak = np.maximum(np.where(late[..., None], np.abs(y), 0.0).max(axis=-2), begin)
    return np.asarray(np.where(known[..., None], peak, np.nan))
