"""How far a motion is from a reference: association in time, alignment, absolute and relative errors.

With poses T = (attitude, position) of the motion and S of the reference at the same times,
    absolute error   S_i^-1 T_i                            its translation has the length of pos - pos_ref
    relative error   (S_i^-1 S_j)^-1 (T_i^-1 T_j)          what the motion errs by over the segment from i to j
so the relative error does not see an error that was there before the segment. Nothing is aligned unless asked for.

References
    Markley, Cheng, Crassidis, Oshman (2007), "Averaging quaternions", Journal of Guidance 30(4), 1193-1197.
    Sturm et al. (2012), "A benchmark for the evaluation of RGB-D SLAM systems", IROS, eq. 1 to 4.
    Geiger, Lenz, Urtasun (2012), "Are we ready for autonomous driving? The KITTI vision benchmark suite", CVPR:
    errors over segments of the path.
    Umeyama (1991), "Least-squares estimation of transformation parameters between two point patterns", IEEE PAMI
    13(4), 376-380: the rotation, without scale.
    Zhang, Scaramuzza (2018), "A tutorial on quantitative trajectory evaluation", IROS: alignment by yaw alone.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor
from recon.numerics.rotation import Floats, angle, conjugate, from_euler, from_matrix, multiply, rotate, to_euler
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate, wrap_angle

Alignment: TypeAlias = Literal["none", "yaw", "se3", "start"]

GAP_STEPS: Final = 2.5
"""Median steps beyond which nothing is interpolated: one lost row is bridged, two are a gap."""
SEGMENT_TOLERANCE: Final = 0.1
"""Share of its length by which a segment between two rows may be longer or shorter."""
_NO_DIRECTION: Final = 1e-12
"""Spread of positions across over along, squared; rounding of coordinates makes some 1e-30 of it."""


@dataclass(frozen=True)
class Motion:
    """What a trajectory says at n times, NaN where it says nothing.

    t_ns : (n,) int64 ns, strictly increasing
    pos_n : (n, 3) m; vel_n : (n, 3) m/s, local; q_nv : (n, 4)
    pos_std : (n, 3) m and vel_std : (n, 3) m/s, along the local axes; att_std : (n, 3) rad, of roll, pitch, yaw
    """

    t_ns: NDArray[np.int64]
    pos_n: Floats
    vel_n: Floats
    q_nv: Floats
    pos_std: Floats
    vel_std: Floats
    att_std: Floats

    def __len__(self) -> int:
        return len(self.t_ns)

    @cached_property
    def step_ns(self) -> float:
        """Median time between rows, infinite for fewer than two."""
        return float(np.median(np.diff(self.t_ns))) if len(self) > 1 else float("inf")

    def rows(self, choice: NDArray[Any]) -> Motion:
        """The rows where a (n,) bool is true, or those that an integer array names."""
        if choice.dtype == bool and choice.all():
            return self
        return Motion(*(getattr(self, field.name)[choice] for field in fields(self)))

    def at(self, t_ns: NDArray[np.int64]) -> Motion:
        """At other times: lines between rows, attitudes spherically; NaN outside and in gaps, see GAP_STEPS.

        t_ns : (m,) int64 ns
        """
        if np.array_equal(t_ns, self.t_ns):
            return self
        longest = GAP_STEPS * self.step_ns
        known = np.isfinite(self.q_nv).all(axis=1).any()
        q_nv = slerp(t_ns, self.t_ns, self.q_nv, longest) if known else np.full((len(t_ns), 4), np.nan)
        pos_n, vel_n, pos_std, vel_std, att_std = (
            interpolate(t_ns, self.t_ns, values, longest)
            for values in (self.pos_n, self.vel_n, self.pos_std, self.vel_std, self.att_std)
        )
        return Motion(t_ns, pos_n, vel_n, q_nv, pos_std, vel_std, att_std)

    def moved(self, turn: Floats, shift: Floats) -> Motion:
        """The motion turned about the origin, then shifted; its sigmas stay, which speak of the axes before.

        turn : (4,); shift : (3,) m
        """
        pos_n, vel_n = rotate(turn, self.pos_n) + shift, rotate(turn, self.vel_n)
        return Motion(self.t_ns, pos_n, vel_n, multiply(turn, self.q_nv), self.pos_std, self.vel_std, self.att_std)


def associate(run: Motion, reference: Motion) -> tuple[Motion, Motion]:
    """Both at the times of the one whose rows are further apart: the other one's can be interpolated with less error.

    A line between rows dt apart errs by up to |acceleration| dt^2 / 8: 4 mm at 10 Hz and 3 m/s^2, 0.4 m at 1 Hz.
    Rows where the position of either is not known in east and north are left out.
    """
    t_ns = reference.t_ns if reference.step_ns > run.step_ns else run.t_ns
    pair = run.at(t_ns), reference.at(t_ns)
    matched = np.asarray(np.isfinite(pair[0].pos_n[:, :2] + pair[1].pos_n[:, :2]).all(axis=1))
    return pair[0].rows(matched), pair[1].rows(matched)


def mounting_between(run: Motion, reference: Motion) -> tuple[Floats, Floats]:
    """The constant turn between two bodies on one vehicle, and how far each attitude is from it.

    The mean rotation from the axes of the run's body to those of the reference's, which maximises the sum of squared
    cosines of half the angles to all of them (Markley et al. 2007, eq. 12).

    run, reference : at the same times
    returns : (4,), NaN where no attitude is known in both; (n,) rad, NaN where one is not known
    """
    between = multiply(conjugate(reference.q_nv), run.q_nv)
    known = between[np.isfinite(between).all(axis=1)]
    if not len(known):
        return np.full(4, np.nan), np.full(len(between), np.nan)
    turn = np.asarray(np.linalg.eigh(known.T @ known)[1][:, -1])
    return turn, angle(between, np.broadcast_to(turn, between.shape))


def turn_between(from_anchor: Anchor, to_anchor: Anchor) -> Floats:
    """The rotation that takes East-North-Up about one anchor to that about the other: (4,)."""
    east_n, north_n = (
        from_euler(np.radians(anchor.lon) + np.pi / 2.0, 0.0, np.pi / 2.0 - np.radians(anchor.lat))
        for anchor in (from_anchor, to_anchor)
    )
    return multiply(conjugate(north_n), east_n)


def aligned(run: Motion, reference: Motion, how: Alignment) -> Motion:
    """The run moved onto the reference, both at the same times.

    how : "none" not at all; "yaw" about the vertical and along all axes, "se3" about and along all axes, both with the
        least squared distance of the positions; "start" so that the first poses agree
    raises : ValueError where the rows do not say how to turn it
    """
    if how == "none" or not len(run):
        return run
    if how == "start":
        return _onto_first(run, reference)
    known = np.isfinite(run.pos_n + reference.pos_n).all(axis=1)
    if not known.any():
        raise ValueError("no row has positions along all three axes")
    ours, theirs = run.pos_n[known].mean(axis=0), reference.pos_n[known].mean(axis=0)
    spread = (reference.pos_n[known] - theirs).T @ (run.pos_n[known] - ours)
    turn = _yaw_turn(spread) if how == "yaw" else _full_turn(spread)
    return run.moved(turn, theirs - rotate(turn, ours))


def _onto_first(run: Motion, reference: Motion) -> Motion:
    known = np.isfinite(run.q_nv + reference.q_nv).all(axis=1) & np.isfinite(run.pos_n + reference.pos_n).all(axis=1)
    if not known.any():
        raise ValueError("no row has a whole pose of both")
    first = int(known.argmax())
    turn = multiply(reference.q_nv[first], conjugate(run.q_nv[first]))
    return run.moved(turn, reference.pos_n[first] - rotate(turn, run.pos_n[first]))


def _yaw_turn(spread: Floats) -> Floats:
    """Zhang, Scaramuzza 2018, eq. 19 and 20. spread : (3, 3) m^2, sum of reference times run."""
    sine, cosine = spread[1, 0] - spread[0, 1], spread[0, 0] + spread[1, 1]
    if np.hypot(sine, cosine) == 0.0:
        raise ValueError("the positions say no direction: the vehicle stands")
    return from_euler(np.arctan2(sine, cosine), 0.0, 0.0)


def _full_turn(spread: Floats) -> Floats:
    """Umeyama 1991, eq. 40 and 43. spread : (3, 3) m^2, sum of reference times run."""
    left, sizes, right = np.linalg.svd(spread)
    if sizes[1] <= _NO_DIRECTION * sizes[0]:
        raise ValueError("the positions lie on a line, so that a turn about it is not known")
    mirror = np.sign(np.linalg.det(left) * np.linalg.det(right))
    return from_matrix(left @ np.diag([1.0, 1.0, mirror]) @ right)


@dataclass(frozen=True)
class Errors:
    """A motion minus the reference at n times, NaN where either says nothing.

    pos_n : (n, 3) m; vel_n : (n, 3) m/s, local; att : (n, 3) rad in (-pi, pi], differences of roll, pitch, yaw
    angle : (n,) rad, the whole rotation between the two
    """

    pos_n: Floats
    vel_n: Floats
    att: Floats
    angle: Floats


def errors(run: Motion, reference: Motion) -> Errors:
    """Absolute errors of a motion, both at the same times."""
    euler = [np.column_stack(to_euler(motion.q_nv)[::-1]) for motion in (run, reference)]
    return Errors(
        run.pos_n - reference.pos_n,
        run.vel_n - reference.vel_n,
        wrap_angle(euler[0] - euler[1]),
        angle(run.q_nv, reference.q_nv),
    )


def segments(along: Floats, length: float) -> NDArray[np.intp]:
    """From every row to the row closest to a length further on, where that lies within SEGMENT_TOLERANCE.

    These are the pairs that evo forms with `--all_pairs --pairs_from_reference`; segments overlap.

    along : (n,) not decreasing, such as time in s or path in m; length : in its unit, positive
    returns : (k, 2) rows i, j with i < j
    """
    if len(along) < 2:
        return np.empty((0, 2), dtype=np.intp)
    start = np.arange(len(along) - 1)
    wanted = along[start] + length
    after = np.clip(np.searchsorted(along, wanted), start + 1, len(along) - 1)
    before = np.maximum(np.searchsorted(along, along[after - 1]), start + 1)  # of equal ones the first
    sooner = np.abs(along[before] - wanted) <= np.abs(along[after] - wanted)
    end = np.where(sooner, before, after)
    right = np.abs(along[end] - along[start] - length) <= SEGMENT_TOLERANCE * length
    return np.column_stack([start[right], end[right]])


def path(pos_n: Floats) -> Floats:
    """Length of the way up to each row: (n,) m. pos_n : (n, 3) m."""
    steps = np.linalg.norm(np.diff(pos_n, axis=0), axis=1)
    return np.concatenate([np.zeros(min(len(pos_n), 1)), np.cumsum(steps)])


def relative_errors(run: Motion, reference: Motion, pairs: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Errors over segments, both motions at the same times. Sturm et al. 2012, eq. 1.

    pairs : (k, 2) first and last row of each
    returns : translation (k,) m, rotation (k,) rad
    """
    moves, turns = zip(*(_relative(motion, pairs) for motion in (run, reference)), strict=True)
    return np.asarray(np.linalg.norm(moves[0] - moves[1], axis=1)), angle(*turns)


def _relative(motion: Motion, pairs: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """From the first to the last pose, seen from the first: (k, 3) m, (k, 4)."""
    back = conjugate(motion.q_nv[pairs[:, 0]])
    move = motion.pos_n[pairs[:, 1]] - motion.pos_n[pairs[:, 0]]
    return rotate(back, move), multiply(back, motion.q_nv[pairs[:, 1]])


@dataclass(frozen=True)
class Statistics:
    """Of the sizes of errors: root mean square, mean, median, 95th percentile and maximum of `count` of them."""

    rmse: float
    mean: float
    median: float
    p95: float
    max: float
    count: int


def statistics(sizes: Floats) -> Statistics | None:
    """Statistics of (n,) errors without regard to sign; NaN is left out, None where nothing is left."""
    known = np.abs(sizes[~np.isnan(sizes)])
    if not len(known):
        return None
    median, p95 = np.percentile(known, [50.0, 95.0])
    rmse = float(np.sqrt(np.mean(known**2)))
    return Statistics(rmse, float(known.mean()), float(median), float(p95), float(known.max()), len(known))
