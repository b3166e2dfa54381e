"""The usual recipe: attitude from an AHRS filter, then a Kalman filter of position and velocity.

The Madgwick filter of the package `ahrs` turns gyroscope and accelerometer into attitude, from the true first one, with
the mean rate of the first rest taken off. Accelerations turned by it, gravity off, drive a linear Kalman filter that
positions and velocities of GNSS correct, forward in time:

    p' = v,   v' = R_ns f_s + g + white noise

Biases are no states, and the filter believes that gravity is where the accelerometer points on average. The lever of
the antenna is taken off by the attitude. Noise that stands for what the attitude does not know is one number.

References
    Madgwick (2010), "An efficient orientation filter for inertial and inertial/magnetic sensor arrays".
    ahrs 0.4 (Garcia), ahrs.filters.madgwick.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recon.numerics.integration import cumulative
from recon.numerics.rotation import Floats, rotate

from .drives import Drive, Estimate

GAIN = 0.033
"""Of the Madgwick filter for gyroscope and accelerometer, its author's."""
UNKNOWN_ACCEL = 0.5
"""m/s^2/sqrt(Hz), density of what an attitude that is off by a degree or two makes of gravity."""
REST_S = 8.0


def solve(drive: Drive) -> Estimate:
    """Position, velocity and attitude at the samples between the first and the last fix."""
    q_ns = _attitude(drive)
    accel_n = rotate(q_ns, drive.accel_s) + drive.world.gravity_at(np.zeros(3))
    at = np.searchsorted(drive.t_s, drive.fix_t_s).clip(0, len(drive.t_s) - 1)
    pos_n, vel_n, std_n = _filter(drive, accel_n, drive.fix_pos_n - rotate(q_ns[at], drive.lever_s))
    use = drive.t_s >= drive.fix_t_s[0]
    return Estimate(drive.t_s[use], pos_n[use], vel_n[use], q_ns[use], std_n[use])


def _attitude(drive: Drive) -> Floats:
    from ahrs.filters import Madgwick

    rest = drive.t_s < drive.t_s[0] + REST_S
    gyro_s = drive.gyro_s - drive.gyro_s[rest].mean(axis=0)
    period_s = float(np.median(np.diff(drive.t_s)))
    found = Madgwick(gyr=gyro_s, acc=drive.accel_s, Dt=period_s, gain=GAIN, q0=drive.start_q_ns)
    return np.asarray(found.Q)


def _filter(drive: Drive, accel_n: Floats, fix_pos_n: Floats) -> tuple[Floats, Floats, Floats]:
    """Positions, velocities and sigmas of positions at the samples, (n, 3) each: between fixes double integration."""
    t_s = drive.t_s
    gained = cumulative(t_s, accel_n, "trapezoid")
    moved = cumulative(t_s, gained, "trapezoid")
    pos_n, vel_n, std_n = (np.empty_like(accel_n) for _ in range(3))
    pos, vel = fix_pos_n[0].copy(), drive.fix_vel_n[0].copy()
    noise = drive.noise
    pos_var, vel_var = noise.drift_n**2 + noise.white_n**2, noise.velocity_n**2
    covariance = np.zeros((3, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = pos_var, vel_var
    edges = np.append(np.searchsorted(t_s, drive.fix_t_s), len(t_s))
    for k, (first, stop) in enumerate(pairwise(edges)):
        if k:
            pos, vel, covariance = _corrected(pos, vel, covariance, fix_pos_n[k], drive.fix_vel_n[k], pos_var, vel_var)
        first, last = min(first, len(t_s) - 1), min(stop, len(t_s) - 1)
        rows = slice(first, last + 1)
        since = (t_s[rows] - t_s[first])[:, None]
        vel_n[rows] = vel + gained[rows] - gained[first]
        pos_n[rows] = pos + vel * since + moved[rows] - moved[first] - gained[first] * since
        std_n[rows] = np.sqrt(_position_variance(covariance, since))
        pos, vel = pos_n[last].copy(), vel_n[last].copy()
        covariance = _predicted(covariance, float(t_s[last] - t_s[first]))
    return pos_n, vel_n, std_n


def _position_variance(covariance: Floats, since: Floats) -> Floats:
    """Of a double integrator a while later, for each axis: (m, 3); covariance (3, 2, 2), since (m, 1) s."""
    start, both, speed = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    return np.asarray(start + 2.0 * since * both + since**2 * speed + UNKNOWN_ACCEL**2 * since**3 / 3.0)


def _predicted(covariance: Floats, dt: float) -> Floats:
    """One step of a double integrator of white noise, for each axis (3, 2, 2)."""
    step = np.array([[1.0, dt], [0.0, 1.0]])
    noise = UNKNOWN_ACCEL**2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return np.asarray(step @ covariance @ step.T + noise)


def _corrected(
    pos: Floats, vel: Floats, covariance: Floats, fix_pos: Floats, fix_vel: Floats, pos_var: Floats, vel_var: Floats
) -> tuple[Floats, Floats, Floats]:
    """By position and velocity of a fix."""
    measured = covariance.copy()
    measured[:, 0, 0] += pos_var
    measured[:, 1, 1] += vel_var
    gain = covariance @ np.linalg.inv(measured)
    change = (gain @ np.stack([fix_pos - pos, fix_vel - vel], axis=1)[..., None])[..., 0]
    return pos + change[:, 0], vel + change[:, 1], covariance - gain @ covariance
