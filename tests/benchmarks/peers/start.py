"""What both peers find out before they begin: where the car stands, the gyro's bias, the first position and velocity.

A window of one second is still where the scatter of every axis is that of the sensor's own noise, and no fix near it
moves. A sample is still where every window of one second that holds it is: a car that creeps must not be called
standing, for a wrong stop costs more than many that were missed. Where fixes are missing, a cruise as smooth as rest
passes for standing; a filter's gate must refuse it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.integration import cumulative
from recon.numerics.moving_window import rolling_std
from recon.numerics.rotation import Floats, conjugate, from_rotvec, rotate
from recon.numerics.rotation_series import compose, slerp

from .drives import Drive

Flags = NDArray[np.bool_]

WINDOW_S: Final = 1.0
_SCATTER: Final = 1.25
"""Times the white noise; the scatter of 100 samples is known to 7 %, quantisation adds a little."""
_MOVES: Final = 4.0
"""Times the sigma of a fix's velocity: the speed above which a fix moves; at rest one of 3000 does."""
_FIRST_S: Final = 40.0
"""s of fixes for the first position: a burst of outliers of 18 s is then the smaller half."""
_FIRST_VELOCITY_S: Final = 5.0
"""s of fixes for the first velocity."""
ATTITUDE_SIGMA: Final = float(np.radians(1.0))
"""rad per axis: the first attitude is the truth, but a peer may not take it for exact."""


def standstill(drive: Drive) -> Flags:
    """Samples at which the car stands: (n,)."""
    rate = 1.0 / float(np.median(np.diff(drive.t_s)))
    half = max(1, round(0.5 * rate * WINDOW_S))
    gyro, accel = (rolling_std(values, 2 * half + 1).max(axis=1) for values in (drive.gyro_s, drive.accel_s))
    limit = _SCATTER * np.sqrt(rate)
    moving = (gyro > limit * drive.noise.gyro) | (accel > limit * drive.noise.accel) | _near_a_moving_fix(drive)
    count = np.concatenate([[0], np.cumsum(moving)])
    index = np.arange(len(moving))
    return np.asarray(count[np.minimum(index + half + 1, len(moving))] == count[np.maximum(index - half, 0)])


def _near_a_moving_fix(drive: Drive) -> Flags:
    """Samples within half a window of a fix that moves: (n,)."""
    speed = np.hypot(drive.fix_vel_n[:, 0], drive.fix_vel_n[:, 1])
    fast = drive.fix_t_s[speed > _MOVES * drive.noise.velocity_n[0]]
    before, behind = (np.searchsorted(fast, drive.t_s + margin) for margin in (-0.5 * WINDOW_S, 0.5 * WINDOW_S))
    return np.asarray(before < behind)


def resting_gyro_bias(drive: Drive, still: Flags) -> Floats:
    """Mean rate at rest less that of the Earth; the median of all samples where the car never rests: (3,) rad/s.

    The rate of the Earth is turned by the first attitude, which is right to some degrees of heading at every stop, so
    at most by the 15 deg/h that the Earth turns in all.
    """
    rate = drive.gyro_s[still].mean(axis=0) if still.any() else np.median(drive.gyro_s, axis=0)
    turned = rotate(conjugate(drive.start_q_ns), drive.world.earth_rate_n)
    return np.asarray(rate - turned)


@dataclass(frozen=True)
class Start:
    """pos_n, vel_n : (3,) m and m/s of the IMU at the first sample; gyro_bias : (3,) rad/s; still : (n,)."""

    pos_n: Floats
    vel_n: Floats
    gyro_bias: Floats
    still: Flags


def find_start(drive: Drive) -> Start:
    """Medians over the first fixes, each position led back to the first sample by the velocities until then."""
    since_s = drive.fix_t_s - drive.fix_t_s[0]
    first, soon = since_s <= _FIRST_S, since_s <= _FIRST_VELOCITY_S
    vel_n = np.median(drive.fix_vel_n[soon], axis=0)
    way_n = cumulative(drive.fix_t_s, drive.fix_vel_n, "trapezoid")[first]
    begin_n = np.median(drive.fix_pos_n[first] - way_n, axis=0) - vel_n * (drive.fix_t_s[0] - drive.t_s[0])
    pos_n = begin_n - rotate(drive.start_q_ns, drive.lever_s)
    still = standstill(drive)
    return Start(pos_n, vel_n, resting_gyro_bias(drive, still), still)


def turned_by_gyro(drive: Drive, gyro_bias: Floats, t_s: Floats) -> Floats:
    """Attitudes (k, 4) at t_s (k,), by the gyro alone from the first attitude on."""
    rate = drive.gyro_s - gyro_bias
    angles = 0.5 * (rate[1:] + rate[:-1]) * np.diff(drive.t_s)[:, None]
    return slerp(t_s, drive.t_s, compose(from_rotvec(angles), drive.start_q_ns))
