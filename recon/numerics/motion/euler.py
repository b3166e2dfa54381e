"""Angular rate and acceleration of a body from its Euler angles, and of a body that turns on a body that turns.

With yaw, pitch and roll of ISO 8855 (z-y'-x''), and dots for their rates:

    omega = (roll. - yaw. sin pitch,
             pitch. cos roll + yaw. cos pitch sin roll,
             yaw. cos pitch cos roll - pitch. sin roll)

References: Titterton and Weston, Strapdown Inertial Navigation Technology (2004), sec. 3.6 (Euler angles; it holds for
z-y-x in any right-handed frame).
"""

from __future__ import annotations

import numpy as np

from recon.numerics.rotation import Floats, conjugate, rotate


def angular_rate(pitch: Floats, roll: Floats, rates: Floats) -> Floats:
    """Angular rate in the body frame.

    pitch, roll : (n,) rad; rates : (n, 3) rad/s of yaw, pitch, roll
    returns : (n, 3) rad/s, body
    """
    (sin_p, cos_p), (sin_r, cos_r) = ((np.sin(a), np.cos(a)) for a in (pitch, roll))
    yaw_d, pitch_d, roll_d = rates.T
    return np.stack(
        (
            roll_d - yaw_d * sin_p,
            pitch_d * cos_r + yaw_d * cos_p * sin_r,
            yaw_d * cos_p * cos_r - pitch_d * sin_r,
        ),
        axis=-1,
    )


def angular_acceleration(pitch: Floats, roll: Floats, rates: Floats, accels: Floats) -> Floats:
    """Derivative of `angular_rate`.

    accels : (n, 3) rad/s^2, second derivatives of yaw, pitch, roll
    returns : (n, 3) rad/s^2, body
    """
    (sin_p, cos_p), (sin_r, cos_r) = ((np.sin(a), np.cos(a)) for a in (pitch, roll))
    yaw_d, pitch_d, roll_d = rates.T
    turning = np.stack(
        (
            -yaw_d * pitch_d * cos_p,
            -pitch_d * roll_d * sin_r + yaw_d * (roll_d * cos_p * cos_r - pitch_d * sin_p * sin_r),
            -pitch_d * roll_d * cos_r - yaw_d * (roll_d * cos_p * sin_r + pitch_d * sin_p * cos_r),
        ),
        axis=-1,
    )
    return np.asarray(angular_rate(pitch, roll, accels) + turning)


def carried_rates(
    q_cb: Floats, rate_c: Floats, accel_c: Floats, rate_b: Floats, accel_b: Floats
) -> tuple[Floats, Floats]:
    """Angular rate and acceleration of a body b that turns relative to its carrier c.

    q_cb : (n, 4) body to carrier; rate_c, accel_c : (n, 3) rad/s, rad/s^2 of the carrier, in its own frame
    rate_b, accel_b : (n, 3) of the body relative to the carrier, body
    returns : (n, 3) rad/s and (n, 3) rad/s^2 of the body, body
    """
    q_bc = conjugate(q_cb)
    carrier_b = rotate(q_bc, rate_c)
    return carrier_b + rate_b, rotate(q_bc, accel_c) + np.cross(carrier_b, rate_b) + accel_b
