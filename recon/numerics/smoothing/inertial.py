"""The factor of the IMU: two neighbouring knots against the increments between them.

    e_R = log(dR^T R_i^T exp(w T) R_j)
    e_v = R_i^T exp(w T / 2) (v_j - v_i - a T) - dV
    e_p = R_i^T exp(w T / 3) (p_j - p_i - v_i T - a T^2 / 2) - dP

with the Earth's rate w, gravity less Coriolis a, and increments corrected to first order for what the biases and scale
errors have moved since they were integrated.

References
    Forster et al. (2017), IEEE T-RO 33(1), eqs. 44 and 45 (residuals), 36 and 37 (bias), supplement (Jacobians).
    Groves (2013), 2nd ed., section 5.4 (Earth-fixed local axes).
"""

from __future__ import annotations

import numpy as np

from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.epochs import gravity_and_coriolis
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.soa import Floats, mm, mmt, mtm, mtv, mv, rotation_exp, rotation_log, skew
from recon.numerics.smoothing.state import SCALES, State

HERE = slice(3, 18)
"""Rotation to accelerometer bias of the knot before."""
THERE = slice(3, 12)
"""Rotation, velocity and position of the knot behind."""

_TURN, _VEL, _POS, _BIAS_G, _BIAS_A = (slice(i, i + 3) for i in range(0, 15, 3))
_TURN_J, _VEL_J, _POS_J = (slice(i, i + 3) for i in range(15, 24, 3))
_SCALE_G, _SCALE_A = slice(24, 27), slice(27, 30)
_RESIDUAL = 30


def whitening(increments: Increments, gyro_noise: Floats, accel_noise: Floats) -> Floats:
    """Square roots of the information of the increments: (K, 9, 9), U with U^T U = C^-1.

    gyro_noise, accel_noise : (K,) rad/s/sqrt(Hz), m/s^2/sqrt(Hz)
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance(increments, gyro_noise, accel_noise))))


def covariance(increments: Increments, gyro_noise: Floats, accel_noise: Floats) -> Floats:
    """Of rotation, velocity and position increments: (K, 9, 9)."""
    by_gyro = (gyro_noise**2)[:, None, None] * increments.covariance_gyro
    return np.asarray(by_gyro + (accel_noise**2)[:, None, None] * increments.covariance_accel)


def inertial_jacobian(state: State, increments: Increments, gravity: GravityField, earth_rate_n: Floats) -> Floats:
    """Unweighted Jacobians with the negative residual as last column: (K, 9, 31)."""
    length, omega = increments.duration, earth_rate_n[:, None]
    rot_i, rot_j = state.rot_ns[..., :-1], state.rot_ns[..., 1:]
    back = rot_i.swapaxes(0, 1)
    pull = gravity_and_coriolis(state, gravity, omega)
    d_gyro, d_accel, d_scale = _moved(state, increments)
    turned = mm(
        increments.rotation,
        rotation_exp(mv(increments.rotation_gyro, d_gyro) + _scaled(increments.rotation_gyro_scale, d_scale[:3])),
    )
    e_rot = rotation_log(mtm(turned, mtm(rot_i, mm(rotation_exp(omega * length), rot_j))))
    to_j = mmt(skew(0.5 * e_rot) + np.eye(3)[:, :, None], rot_j)
    step_v = state.vel_n[:, 1:] - state.vel_n[:, :-1] - pull * length
    step_p = state.pos_n[:, 1:] - state.pos_n[:, :-1] - state.vel_n[:, :-1] * length - 0.5 * pull * length**2
    in_v = mtv(rot_i, mv(rotation_exp(omega * length / 2.0), step_v))
    in_p = mtv(rot_i, mv(rotation_exp(omega * length / 3.0), step_p))
    inc_v, inc_p = _corrected(increments, d_gyro, d_accel, d_scale)

    tall = np.zeros((len(length), 9, 31))
    rows_r, rows_v, rows_p = tall[:, 0:3], tall[:, 3:6], tall[:, 6:9]
    _put(rows_r, _TURN, -to_j)
    _put(rows_r, _TURN_J, to_j)
    _put(rows_r, _BIAS_G, -increments.rotation_gyro)
    _put(rows_r, _SCALE_G, -increments.rotation_gyro_scale)
    _put(rows_v, _TURN, mm(skew(in_v), back))
    _put(rows_v, _VEL, -back)
    _put(rows_v, _VEL_J, back)
    _put(rows_v, _BIAS_G, -increments.velocity_gyro)
    _put(rows_v, _BIAS_A, -increments.velocity_accel)
    _put(rows_v, _SCALE_G, -increments.velocity_gyro_scale)
    _put(rows_v, _SCALE_A, -increments.velocity_accel_scale)
    _put(rows_p, _TURN, mm(skew(in_p), back))
    _put(rows_p, _VEL, -back * length)
    _put(rows_p, _POS, -back)
    _put(rows_p, _POS_J, back)
    _put(rows_p, _BIAS_G, -increments.position_gyro)
    _put(rows_p, _BIAS_A, -increments.position_accel)
    _put(rows_p, _SCALE_G, -increments.position_gyro_scale)
    _put(rows_p, _SCALE_A, -increments.position_accel_scale)
    rows_r[..., _RESIDUAL], rows_v[..., _RESIDUAL] = -e_rot.T, -(in_v - inc_v).T
    rows_p[..., _RESIDUAL] = -(in_p - inc_p).T
    return tall


def add_inertial(normal: Normal, tall: Floats, white: Floats) -> None:
    """Add the factors of all intervals: tall (K, 9, 31) from `inertial_jacobian`, white (K, 9, 9)."""
    normal.add_intervals(lambda part: np.matmul(white[part], tall[part]), 9, HERE, THERE, SCALES)


def _put(rows: Floats, columns: slice, matrices: Floats) -> None:
    rows[:, :, columns] = matrices.transpose(2, 0, 1)


def _moved(state: State, increments: Increments) -> tuple[Floats, Floats, Floats]:
    """What biases (3, K) and scale errors (6,) have changed since the increments were integrated."""
    return (
        state.gyro_bias[:, :-1] - increments.gyro_bias,
        state.accel_bias[:, :-1] - increments.accel_bias,
        state.common[SCALES] - increments.scale,
    )


def _scaled(jacobian: Floats, change: Floats) -> Floats:
    return np.asarray(np.einsum("ijk,j->ik", jacobian, change))


def _corrected(inc: Increments, d_gyro: Floats, d_accel: Floats, d_scale: Floats) -> tuple[Floats, Floats]:
    vel = inc.velocity + mv(inc.velocity_gyro, d_gyro) + mv(inc.velocity_accel, d_accel)
    vel = vel + _scaled(inc.velocity_gyro_scale, d_scale[:3]) + _scaled(inc.velocity_accel_scale, d_scale[3:])
    pos = inc.position + mv(inc.position_gyro, d_gyro) + mv(inc.position_accel, d_accel)
    return vel, pos + _scaled(inc.position_gyro_scale, d_scale[:3]) + _scaled(inc.position_accel_scale, d_scale[3:])
