"""Attitude and mounting to start from, in closed form, however the box is mounted.

The gyroscopes carry the attitude from the first knot of a segment of the log: chain R_cs, known but for one rotation
R_nc, which the bias of the gyroscopes lets drift slowly. Each interval shows one vector in both frames, the change of
velocity less that of gravity,

    v_k+1 - v_k - g T = R_nc R_cs,k dV_k,

so R_nc at every knot is the best rotation between two sets of vectors, those nearby in time (Wahba's problem): with
B = sum of w b a^T = U S V^T it is U diag(1, 1, det(U) det(V)) V^T. Gravity in these vectors gives the level, changes of
speed and turns give the heading. Frames as in the package; c is that of the chain.

References
    Markley (1988), "Attitude determination using vector observations and the singular value decomposition",
    J. Astronautical Sciences 36(3), 245-258 (solution, covariance).
    Wu, Pan (2013), "Velocity/position integration formula part I: application to in-flight coarse alignment",
    IEEE Trans. Aerospace and Electronic Systems 49(2), 1006-1023 (vectors from changes of velocity).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.soa import (
    Floats,
    matrix_to_quat,
    mm,
    mmt,
    mtv,
    mv,
    quat_to_matrix,
    rotation_exp,
    rotation_log,
    running_product,
)

NEARBY_S: Final = 60.0
"""s, standard deviation of the bell that weighs the vectors around a knot: long enough to hold turns and stops, short
enough for the drift of gyroscopes whose bias is known to 0.05 deg/s."""

_TAIL: Final = 0.01
"""Share of far vectors, which falls with the time between: where the vehicle stands for minutes, or has no fixes, the
chain carries the heading there."""

_UNKNOWN_WEIGHT: Final = 0.01
"""Of intervals without known velocity, taken as unaccelerated: enough for the level where there is nothing else."""

_DISAGREEMENT: Final = 0.5
"""m/s^2 between the lengths of the two vectors of an interval, alike in all frames: half of the weight is gone."""

_TINY: Final = float(np.finfo(np.float64).tiny)

CRUISING: Final = 3.0
"""m/s, from where the direction of the velocity is that of the vehicle to a degree or two."""

_ASTRAY: Final = 0.9
"""Share of its way that a vehicle on wheels goes ahead in any segment."""


@dataclass(frozen=True)
class Vectors:
    """One segment of k intervals: its chain, and what each interval shows.

    rot_cs : (3, 3, k+1); duration : (k,) s; known : (k,) velocity known at both ends
    felt_s, felt_c : (3, k) m/s, change of velocity less that of gravity, by the IMU, in axes of the knot before, of c
    change_n, fall_n : (3, k) m/s, change of velocity by GNSS, none where unknown; that of gravity
    """

    rot_cs: Floats
    duration: Floats
    known: NDArray[np.bool_]
    felt_s: Floats
    felt_c: Floats
    change_n: Floats
    fall_n: Floats

    def weight(self) -> Floats:
        """Of each interval, (k,) 1/s; less where the vectors differ in length, which no rotation can mend."""
        weight = np.where(self.known, 1.0, _UNKNOWN_WEIGHT) / self.duration
        surplus = (length(self.change_n - self.fall_n) - length(self.felt_c)) / self.duration
        surplus = surplus - (np.median(surplus[self.known]) if self.known.any() else 0.0)
        return np.asarray(weight / (1.0 + (surplus / _DISAGREEMENT) ** 2))

    def attitude(self, sigma_s: float) -> tuple[Floats, Floats]:
        """Rotation R_nc (3, 3, k+1), and information on its error about axes c (3, 3, k+1), of any unit.

        The level is that of all vectors, Wahba's problem (Markley 1988). The heading is found again from the horizontal
        parts alone: while the vehicle stands these vanish, and vectors further away may speak.
        """
        gained_n = self.change_n - self.fall_n
        weight = self.weight()
        left, size, right_t = np.linalg.svd(np.moveaxis(self._profile(gained_n, self.felt_c, weight, sigma_s), -1, 0))
        left[:, :, 2] *= np.linalg.det(left @ right_t)[:, None]
        rot_nc = np.moveaxis(left @ right_t, 0, -1)
        up_c = rot_nc[2]
        level_c = self.felt_c - up_c[:, :-1] * (up_c[:, :-1] * self.felt_c).sum(axis=0)
        level_n = gained_n * np.array([[1.0], [1.0], [0.0]])
        (xx, xy, _), (yx, yy, _), _ = mmt(self._profile(level_n, level_c, weight, sigma_s), rot_nc)
        heading = np.arctan2(yx - xy, xx + yy)
        turn_n = np.stack([np.zeros_like(heading), np.zeros_like(heading), heading])
        outer = up_c[:, None] * up_c
        information = size[:, 0] * (np.eye(3)[..., None] - outer) + np.hypot(yx - xy, xx + yy) * outer
        return mm(rotation_exp(turn_n), rot_nc), information

    def _profile(self, of_n: Floats, of_c: Floats, weight: Floats, sigma_s: float) -> Floats:
        """Attitude profile matrices of the vectors near each knot: (3, 3, k+1)."""
        products = of_n[:, None] * of_c * weight
        return _near_knots(products.reshape(9, -1), self.duration, sigma_s).reshape(3, 3, -1)


def align(
    increments: Increments,
    vel_n: Floats,
    known: NDArray[np.bool_],
    gravity_n: Floats,
    segments: Sequence[slice],
    sigma_s: float = NEARBY_S,
) -> Floats:
    """Attitude of the box at every knot.

    increments : of K = N - 1 intervals, for gyroscope biases known to about 0.05 deg/s (see gyro_start)
    vel_n : (3, N) m/s at the knots, axes n; known : (N,) where it was measured nearby; elsewhere it is not looked at
    gravity_n : (3,) or (3, K) m/s^2, axes n
    segments : of knots between gaps of the log, disjoint; nothing is carried over from one to another
    sigma_s : s, bell of the vectors that count at a knot

    returns : R_ns (3, 3, N), identity at knots in no segment or alone in one. The level is always meaningful; for the
        heading see `heading_sigma`.
    """
    rot_ns = np.tile(np.eye(3)[..., None], known.size)
    for segment in segments:
        vectors = vectors_of(increments, vel_n, known, gravity_n, segment)
        rot_ns[..., segment] = mm(vectors.attitude(sigma_s)[0], vectors.rot_cs)
    return rot_ns


def mounting(rot_ns: Floats, vel_n: Floats, known: NDArray[np.bool_]) -> Floats:
    """How the box is mounted, from where it moves to and where up is, both as medians over the drive.

    rot_ns : (3, 3, N); vel_n : (3, N) m/s, axes n; known : (N,) where it was measured
    returns : R_vs (3, 3), sensor to vehicle (x forward, y left, z up)

    Raises ValueError where no knot of known velocity moves.
    """
    forward = unit(np.median(directions(rot_ns, vel_n, known), axis=1))
    up = np.median(rot_ns[2], axis=1)
    up = unit(up - forward * (forward @ up))
    return np.stack([forward, np.cross(up, forward), up])


def directions(rot_ns: Floats, vel_n: Floats, known: NDArray[np.bool_]) -> Floats:
    """Where the box moves, as unit vectors of its own axes, at the knots that drive: (3, k). Raises ValueError."""
    speed = np.sqrt((vel_n * vel_n).sum(axis=0))
    fastest = float(speed[known].max(initial=0.0))
    if fastest == 0.0:
        raise ValueError("the vehicle moves at no knot with known velocity, so forward cannot be told")
    moves = known & (speed > min(CRUISING, 0.5 * fastest))
    return mtv(rot_ns[..., moves], vel_n[:, moves] / speed[moves])


def along_course(rot_ns: Floats, vel_n: Floats, known: NDArray[np.bool_], segments: Sequence[slice]) -> Floats:
    """Attitudes of a box in a vehicle on wheels; in segments that go astray turned about up until they go ahead.

    The changes of velocity in a few seconds tell no heading, and iterations that begin far from it may end in a vehicle
    that drives backwards, with a small sigma. The course tells it as soon as the rest of the drive tells what of the
    box is ahead: where it moves, as a median over the drive.

    rot_ns : (3, 3, N) of `align`; the other arguments as there
    returns : R_ns (3, 3, N)
    """
    speed = length(vel_n)
    moves = known & (speed > CRUISING)
    if len(segments) < 2 or not moves.any():
        return rot_ns
    ahead_s = np.median(mtv(rot_ns[..., moves], vel_n[:, moves] / speed[moves]), axis=1)
    ahead_n = mv(rot_ns, ahead_s[:, None])
    off = (vel_n[0] + 1j * vel_n[1]) * (ahead_n[0] - 1j * ahead_n[1])
    turned = rot_ns.copy()
    for segment in segments:
        knots = np.arange(segment.start, segment.stop)
        told = knots[moves[segment]]
        if off[told].sum().real >= _ASTRAY * np.abs(off[told]).sum():
            continue
        yaw = np.angle(off[told])[np.abs(knots[:, None] - told).argmin(axis=1)]
        up = np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw])
        turned[..., segment] = mm(rotation_exp(up), rot_ns[..., segment])
    return turned


def pseudo_velocity(increments: Increments, speed: Floats, segments: Sequence[slice]) -> Floats:
    """Velocity where only speed is known: along a course that is north at the start of each segment, and level.

    Up is where the specific force points on average, in the frame of the chain, in which turns average out; the course
    is the turn about it. Bends and changes of speed then tell `align` how the box is mounted; the absolute heading
    remains a convention.

    increments : of K = N - 1 intervals; speed : (N,) m/s, finite; segments : as of `align`
    returns : vel_n (3, N) m/s, axes n
    """
    yaw = np.zeros(speed.size)
    for segment in segments:
        inside = slice(segment.start, segment.stop - 1)
        rotation = increments.rotation[..., inside]
        rot_cs = _chain(rotation)
        force_c = mv(rot_cs[..., :-1], increments.velocity[:, inside])
        up_c = unit(_near_knots(force_c, increments.duration[inside], NEARBY_S)[:, :-1])
        turn_c = mv(rot_cs[..., :-1], rotation_log(rotation))
        yaw[segment.start + 1 : segment.stop] = np.cumsum((turn_c * up_c).sum(axis=0))
    return np.stack([-speed * np.sin(yaw), speed * np.cos(yaw), np.zeros_like(speed)])


def heading_sigma(
    increments: Increments,
    rot_ns: Floats,
    vel_n: Floats,
    known: NDArray[np.bool_],
    gravity_n: Floats,
    segments: Sequence[slice],
) -> Floats:
    """How well the motion tells the heading, where it does so best in each segment.

    The horizontal changes of velocity h that the IMU felt, turned by R_ns, are regressed on those d of the GNSS, as
    complex numbers: heading = arg(sum of h* d), its deviation sqrt(sum |h|^2 mean |d - h|^2 / 2) / |sum of h* d|. Noise
    alone gives 0.3 to 1, ordinary driving 0.01 to 0.05, with many outliers 0.1.

    rot_ns : (3, 3, N) of `align`; the other arguments as there
    returns : (len(segments),) rad, pi at most: above about 0.2 there was no motion to find the heading
    """
    sigma = np.full(len(segments), np.pi)
    for i, segment in enumerate(segments):
        vectors = vectors_of(increments, vel_n, known, gravity_n, segment)
        felt_n = mv(rot_ns[..., segment][..., :-1], vectors.felt_s) + vectors.fall_n
        h, d = (v[0] + 1j * v[1] for v in (felt_n, vectors.change_n))
        told = h.conj() * d
        rows = np.stack([told.real, told.imag, np.abs(h) ** 2, np.abs(d - h) ** 2, np.ones(h.size)]) * vectors.known
        real, imag, felt2, missed2, count = _near_knots(rows, vectors.duration, NEARBY_S)
        noise = np.sqrt(np.maximum(felt2 * missed2, 0.0) / (2.0 * np.maximum(count, _TINY)))
        sigma[i] = min(
            np.pi, float(np.min(noise / np.maximum(np.hypot(real, imag), _TINY), where=count > _TINY, initial=np.pi))
        )
    return sigma


def flip_needed(forward_velocity: Floats) -> bool:
    """Whether the vehicle came out back to front: it moves backwards for most of its way.

    What is faster than usual counts as the usual, lest a few seconds that went astray outweigh a whole drive.

    forward_velocity : (n,) m/s along its x axis, evenly spaced in time
    """
    speed = np.abs(forward_velocity)
    usual = np.median(speed[speed > CRUISING]) if speed.max(initial=0.0) > CRUISING else CRUISING
    return bool(np.clip(forward_velocity, -usual, usual).sum() < 0.0)


def vectors_of(
    increments: Increments, vel_n: Floats, known: NDArray[np.bool_], gravity_n: Floats, segment: slice
) -> Vectors:
    """What the intervals of a segment show; arguments as of `align`."""
    inside = slice(segment.start, segment.stop - 1)
    rot_cs, duration = _chain(increments.rotation[..., inside]), increments.duration[inside]
    both = known[segment][1:] & known[segment][:-1]
    felt_s = increments.velocity[:, inside]
    return Vectors(
        rot_cs=rot_cs,
        duration=duration,
        known=both,
        felt_s=felt_s,
        felt_c=mv(rot_cs[..., :-1], felt_s),
        change_n=np.where(both, np.diff(vel_n[:, segment]), 0.0),
        fall_n=np.broadcast_to(gravity_n.reshape(3, -1), increments.velocity.shape)[:, inside] * duration,
    )


def _chain(rotation: Floats) -> Floats:
    """Products of the rotations of k intervals, from the identity: (3, 3, k) to (3, 3, k+1)."""
    first = np.array([[1.0], [0.0], [0.0], [0.0]])
    q = np.concatenate([first, running_product(matrix_to_quat(rotation))], axis=1)
    return quat_to_matrix(unit(q))


def _near_knots(rows: Floats, duration: Floats, sigma_s: float) -> Floats:
    """Sums over the intervals near each knot, by a bell of the time from their middle, and a tail.

    The intervals count as of one length. By the Fourier transform, for the tail reaches everywhere.

    rows : (c, k) of k intervals; duration : (k,) s
    returns : (c, k+1)
    """
    k = duration.size
    if k == 0:
        return np.zeros((len(rows), 1))
    away = (np.arange(1 - k, k + 1) - 0.5) * float(np.mean(duration)) / sigma_s
    bell = np.exp(-0.5 * away**2) + _TAIL / (1.0 + np.abs(away))
    size = 1 << (3 * k).bit_length()
    spectrum = np.fft.rfft(rows, size) * np.fft.rfft(bell, size)
    return np.asarray(np.fft.irfft(spectrum, size)[:, k - 1 : 2 * k])


def unit(v: Floats) -> Floats:
    """Vectors of length one: (3, ...) or quaternions (4, ...)."""
    return np.asarray(v / length(v))


def length(v: Floats) -> Floats:
    """Along the first axis."""
    return np.asarray(np.sqrt((v * v).sum(axis=0)))
