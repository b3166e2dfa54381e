"""Rotations as unit quaternions: (..., 4) arrays, scalar first (qw, qx, qy, qz), Hamilton product, active.

`q_nb` takes vectors from body to local: v_n = q_nb v_b q_nb*; a product chains frames, q_nb = q_nv (x) q_vb. Euler
angles are those of ISO 8855:2011: x forward, y left, z up; yaw about z, then pitch about the new y, then roll about
the new x (intrinsic z-y'-x''). So positive yaw turns left, positive pitch puts the nose down.
q and -q are the same rotation; functions accept both.

References
    Thesis, section 2.2 (quaternions).
    Shepperd (1978), "Quaternion from rotation matrix", J. Guidance and Control 1(3), 223-224.
    Shuster (1993), "A survey of attitude representations", J. Astronautical Sciences 41(4), 439-517.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.numerics.signals import wrap_angle

Floats = NDArray[np.float64]

# Below this, yaw and roll turn about one axis as far as rounding can tell; the distance is about half an angle in rad.
_GIMBAL = 1e-12
# Below this sine the cross product holds little but rounding and shows no axis; the least angle is then pi to as much.
_ANTIPARALLEL = 16.0 * np.finfo(np.float64).eps


def multiply(p: ArrayLike, q: ArrayLike) -> Floats:
    """Hamilton product p (x) q: first q, then p. Thesis 2.2.2.

    p, q : (..., 4), broadcast against each other
    returns : (..., 4)
    """
    pw, px, py, pz = _components(p)
    qw, qx, qy, qz = _components(q)
    product = (
        pw * qw - px * qx - py * qy - pz * qz,
        pw * qx + px * qw + py * qz - pz * qy,
        pw * qy - px * qz + py * qw + pz * qx,
        pw * qz + px * qy - py * qx + pz * qw,
    )
    return np.stack(product, axis=-1)


def conjugate(q: ArrayLike) -> Floats:
    """The inverse rotation: q_nb gives q_bn.

    q : (..., 4)
    returns : (..., 4)
    """
    return np.asarray(np.asarray(q, dtype=np.float64) * (1.0, -1.0, -1.0, -1.0))


def normalize(q: ArrayLike) -> Floats:
    """q scaled to unit length; NaN where q is zero.

    q : (..., 4)
    returns : (..., 4)
    """
    q = np.asarray(q, dtype=np.float64)
    return np.asarray(q / _norm(q))


def rotate(q: ArrayLike, v: ArrayLike) -> Floats:
    """Vectors taken by q: q_nb takes v_b to v_n. Thesis 2.2.1, without the products by zero.

    q : (..., 4) unit
    v : (..., 3), broadcast against q
    returns : (..., 3), unit of v
    """
    w, x, y, z = _components(q)
    vx, vy, vz = _components(v)
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    rotated = (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )
    return np.stack(rotated, axis=-1)


def from_rotvec(rotvec: ArrayLike) -> Floats:
    """Quaternion of a rotation vector (axis times angle). Shuster 1993.

    rotvec : (..., 3) rad
    returns : (..., 4), exact to rounding at any angle, zero included
    """
    rotvec = np.asarray(rotvec, dtype=np.float64)
    half = 0.5 * _norm(rotvec)
    return np.concatenate((np.cos(half), 0.5 * np.sinc(half / np.pi) * rotvec), axis=-1)


def to_rotvec(q: ArrayLike) -> Floats:
    """Rotation vector of the shorter way around, of length 0 to pi; the inverse of `from_rotvec`.

    q : (..., 4) unit
    returns : (..., 3) rad, exact to rounding near 0 and near pi
    """
    q = np.asarray(q, dtype=np.float64)
    scalar, vector = q[..., :1], q[..., 1:]
    sine = _norm(vector)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    turned = sine > 0.0
    scale = np.where(turned, angle / np.where(turned, sine, 1.0), 2.0)
    return np.asarray(np.copysign(scale, scalar) * vector)


def from_matrix(matrix: ArrayLike) -> Floats:
    """Quaternion of a rotation matrix, scalar part not negative. Shepperd 1978.

    All ten products 4 q_i q_j follow from the matrix; the row of the largest q_i is taken, so nothing cancels.

    matrix : (..., 3, 3), orthonormal, right-handed
    returns : (..., 4)
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrix, (-2, -1), (0, 1))
    products = (
        (1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1.0 + xx - yy - zz, yx + xy, xz + zx),
        (xz - zx, yx + xy, 1.0 - xx + yy - zz, zy + yz),
        (yx - xy, xz + zx, zy + yz, 1.0 - xx - yy + zz),
    )
    table = np.stack([np.stack(row, axis=-1) for row in products], axis=-2)
    largest = np.argmax(np.diagonal(table, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(table, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(normalize(row) * np.copysign(1.0, row[..., :1]))


def to_matrix(q: ArrayLike) -> Floats:
    """Rotation matrix: rot_nb @ v_b = rotate(q_nb, v_b).

    q : (..., 4) unit
    returns : (..., 3, 3)
    """
    w, x, y, z = _components(q)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def from_euler(yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> Floats:
    """Quaternion vehicle to local of ISO 8855 yaw, pitch, roll.

    yaw, pitch, roll : (...) rad, broadcast against each other
    returns : (..., 4)
    """
    halves = np.broadcast_arrays(*(0.5 * np.asarray(angle, dtype=np.float64) for angle in (yaw, pitch, roll)))
    (cy, cp, cr), (sy, sp, sr) = np.cos(halves), np.sin(halves)
    q = (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
    return np.stack(q, axis=-1)


def to_euler(q: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """ISO 8855 yaw, pitch, roll; the inverse of `from_euler`.

    With p = pitch / 2, the formulas of `from_euler` pair up to
        w + y = (cos p + sin p) cos((roll - yaw) / 2),   x - z = (cos p + sin p) sin((roll - yaw) / 2),
        w - y = (cos p - sin p) cos((roll + yaw) / 2),   x + z = (cos p - sin p) sin((roll + yaw) / 2),
    hence all three angles by arctan2, with no arcsin that loses half the digits near a vertical nose.
    With the nose vertical, yaw and roll turn about one axis: roll is then given as 0.

    q : (..., 4) unit
    returns : yaw (...) in (-pi, pi], pitch (...) in [-pi/2, pi/2], roll (...) in (-pi, pi], rad
    """
    w, x, y, z = _components(q)
    plus, minus = np.hypot(w + y, x - z), np.hypot(w - y, x + z)
    half_difference, half_sum = np.arctan2(x - z, w + y), np.arctan2(x + z, w - y)
    half_sum = np.where(minus < _GIMBAL, -half_difference, half_sum)
    half_difference = np.where(plus < _GIMBAL, -half_sum, half_difference)
    pitch = 2.0 * np.arctan2(plus, minus) - 0.5 * np.pi
    return wrap_angle(half_sum - half_difference), np.asarray(pitch), wrap_angle(half_sum + half_difference)


def shortest_arc(a: ArrayLike, b: ArrayLike) -> Floats:
    """The rotation by the least angle that takes direction a to direction b.

    Beyond a right angle the arc runs from a to -b, and a half turn across it follows, so that opposite directions lose
    no digits. Of exactly opposite ones one of the half turns is returned.

    a, b : (..., 3) of any length but zero, broadcast against each other
    returns : (..., 4); (1, 0, 0, 0) where the directions are equal
    """
    a, b = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    a, b = normalize(a), normalize(b)
    cosine = _dot(a, b)
    cross = np.cross(a, b)
    opposite = cosine < 0.0
    arc = normalize(np.concatenate((1.0 + np.abs(cosine), np.where(opposite, -cross, cross)), axis=-1))
    half_turn = np.concatenate((np.zeros_like(cosine), _perpendicular(b, cross)), axis=-1)
    return np.asarray(np.where(opposite, multiply(half_turn, arc), arc))


def _perpendicular(b: Floats, wanted: Floats) -> Floats:
    """Unit vectors across b, along `wanted` where that is long enough to say a direction; (..., 3) both."""
    shortest = np.argmin(np.abs(b), axis=-1)
    anyhow = np.cross(b, np.eye(3)[shortest])
    clear = _norm(wanted) > _ANTIPARALLEL
    axis = normalize(np.where(clear, wanted, anyhow))
    return normalize(axis - _dot(axis, b) * b)


def angle(p: ArrayLike, q: ArrayLike) -> Floats:
    """Angle of the rotation between p and q, exact to rounding near 0 and near pi.

    p, q : (..., 4) unit, broadcast against each other
    returns : (...) rad, 0 to pi
    """
    p, q = np.asarray(p, dtype=np.float64), np.asarray(q, dtype=np.float64)
    apart, together = _norm(p - q)[..., 0], _norm(p + q)[..., 0]
    return np.asarray(4.0 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together)))


def heading_from_yaw(yaw: ArrayLike) -> Floats:
    """Heading clockwise from north of a yaw counter-clockwise from east.

    yaw : (...) rad
    returns : (...) rad in [0, 2 pi)
    """
    heading = np.mod(0.5 * np.pi - np.asarray(yaw, dtype=np.float64), 2.0 * np.pi)
    return np.asarray(np.where(heading >= 2.0 * np.pi, 0.0, heading))  # the remainder of -1e-17 rounds up to 2 pi


def yaw_from_heading(heading: ArrayLike) -> Floats:
    """Yaw counter-clockwise from east of a heading, or course, clockwise from north.

    heading : (...) rad
    returns : (...) rad in (-pi, pi]
    """
    return wrap_angle(0.5 * np.pi - np.asarray(heading, dtype=np.float64))


def cross_matrix(v: ArrayLike) -> Floats:
    """Matrices of the vector product: cross_matrix(v) @ w = v x w.

    v : (..., 3)
    returns : (..., 3, 3), antisymmetric, unit of v
    """
    v = np.asarray(v, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., (2, 0, 1), (1, 2, 0)] = v
    matrix[..., (1, 2, 0), (2, 0, 1)] = -v
    return matrix


def _components(q: ArrayLike) -> Floats:
    """The last axis first, to unpack quaternions or vectors into rows."""
    return np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)


def _dot(a: Floats, b: Floats) -> Floats:
    """Inner product along the last axis, which is kept with length 1."""
    return np.asarray(np.einsum("...i,...i->...", a, b)[..., None])


def _norm(a: Floats) -> Floats:
    """Length along the last axis, which is kept; twice as fast as np.linalg.norm on short rows."""
    return np.asarray(np.sqrt(_dot(a, a)))
