"""The bias of the gyroscopes to start from, for drives that never stop: from how the alignment drifts, and from course.

Reference: Forster, Carlone, Dellaert, Scaramuzza (2017), IEEE T-RO 33(1), eq. 44 (increments for another bias).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.alignment import CRUISING, align, directions, length, unit, vectors_of
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.soa import Floats, mm, mtm, mtv, mv, rotation_exp, rotation_log

_DRIFT_BELLS_S: Final = (8.0, 20.0, 60.0)
"""s; the better the bias is known, the longer the chain may be trusted."""

_ROUNDS: Final = 3
"""With each bell: smoothing hides part of the drift, more the nearer the ends, so each round finds what was left."""

_LEVEL: Final = 0.04
"""What information on the level counts for the drift: as if gravity were the 0.2 g of a brisk drive."""

_FEW: Final = 10
"""Intervals, fewer of which are no sample."""


def gyro_bias_from_drift(
    increments: Increments,
    vel_n: Floats,
    known: NDArray[np.bool_],
    gravity_n: Floats,
    segments: Sequence[slice],
) -> Floats:
    """What to add to the gyroscope bias of the increments, for drives that never stop: arguments as of `align`.

    A residual bias b turns the chain, log(R_nc,k^T R_nc,k+1) = -R_cs,k b T: solved for b by least squares over all
    knots, the drift weighted by what is known of R_nc. Repeated with longer bells as the bias gets known; the
    increments follow by their derivatives, good to (b T)^2: beyond 1 deg/s preintegrate and repeat.

    returns : (3,) rad/s, sensor; zero where no segment has two knots
    """
    bias = np.zeros(3)
    for sigma_s in np.repeat(_DRIFT_BELLS_S, _ROUNDS):
        bias = bias + _residual_bias(_with_bias(increments, bias), vel_n, known, gravity_n, segments, float(sigma_s))
    return bias


def gyro_bias_from_course(increments: Increments, vel_n: Floats, known: NDArray[np.bool_]) -> Floats:
    """The gyroscope bias of a box that is fixed in a vehicle on wheels, to begin with: arguments as of `align`.

    On a level road such a vehicle turns about up alone, and as fast as its course: the rate that is felt beside is
    bias. Up in the box is where the specific force points, both as medians over what drives at some speed. Roads that
    are not level and noise of the velocities leave some 0.1 deg/s; where nothing but straight ways has known
    velocities, only this tells the bias about up.

    returns : (3,) rad/s, sensor, to add to the bias of the increments; zero where too little drives
    """
    speed = np.hypot(vel_n[0], vel_n[1])
    drives = known & (speed > CRUISING)
    both = drives[1:] & drives[:-1]
    if both.sum() < _FEW:
        return np.zeros(3)
    duration = increments.duration[both]
    up = unit(np.median(increments.velocity[:, both] / duration, axis=1))
    course = np.arctan2(vel_n[1], vel_n[0])
    turned = np.angle(np.exp(1j * np.diff(course)))[both]
    felt = rotation_log(increments.rotation[..., both])
    return np.asarray(np.median((felt - up[:, None] * turned) / duration, axis=1))


def steadier(
    increments: Increments,
    more: Floats,
    vel_n: Floats,
    known: NDArray[np.bool_],
    gravity_n: Floats,
    segments: Sequence[slice],
) -> Floats:
    """What to add to the gyroscope bias of the increments of a box that is fixed in a vehicle: `more`, or nothing.

    Aligned with the better bias, the box moves in the same direction of its own all the time. Other arguments as of
    `align`; more : (3,) rad/s, for example of `gyro_bias_from_drift`
    """

    def strays(made: Increments) -> float:
        rot_ns = align(made, vel_n, known, gravity_n, segments)
        moves = directions(rot_ns, vel_n, known)
        return float(np.median(length(moves - unit(np.median(moves, axis=1))[:, None])))

    return more if strays(_with_bias(increments, more)) < strays(increments) else np.zeros(3)


def _with_bias(increments: Increments, more: Floats) -> Increments:
    """The increments for a gyroscope bias greater by `more` (3,) rad/s. Forster et al. 2017, eq. 44."""
    turn = mv(increments.rotation_gyro, more[:, None])
    return replace(
        increments,
        rotation=mm(increments.rotation, rotation_exp(turn)),
        velocity=increments.velocity + mv(increments.velocity_gyro, more[:, None]),
    )


def _residual_bias(
    increments: Increments,
    vel_n: Floats,
    known: NDArray[np.bool_],
    gravity_n: Floats,
    segments: Sequence[slice],
    sigma_s: float,
) -> Floats:
    """One step of `gyro_bias_from_drift`: (3,) rad/s."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for segment in segments:
        vectors = vectors_of(increments, vel_n, known, gravity_n, segment)
        rot_nc, information_c = vectors.attitude(sigma_s)
        drift_c = rotation_log(mtm(rot_nc[..., :-1], rot_nc[..., 1:])) / vectors.duration
        rot_cs, weight_c = vectors.rot_cs[..., :-1], _evened(rot_nc, information_c)[..., :-1]
        normal += mm(mtm(rot_cs, weight_c), rot_cs).sum(axis=-1)
        right -= mtv(rot_cs, mv(weight_c, drift_c)).sum(axis=-1)
    return np.asarray(np.linalg.pinv(normal, hermitian=True) @ right)


def _evened(rot_nc: Floats, information_c: Floats) -> Floats:
    """Information (3, 3, k+1) in which that on the level counts no more than that on the heading usually does.

    Gravity tells it a hundred times as well; but where up is out by some degrees, as in a braking that no fix shows,
    what the level then drifts by would pass for a drift of the heading, and outweigh it.
    """
    up_c = rot_nc[2]
    heading = (up_c * mv(information_c, up_c)).sum(axis=0)
    return np.asarray(_LEVEL * information_c + (1.0 - _LEVEL) * heading * up_c[:, None] * up_c)
