"""Where Gauss and Newton begin: velocity and position of the fixes at the knots; attitude, mounting in closed form."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing import alignment, gyro_start
from recon.numerics.smoothing.earth import gravity_n
from recon.numerics.smoothing.measurements import Fixes
from recon.numerics.smoothing.model import Drive
from recon.numerics.smoothing.preintegration import Increments
from recon.numerics.smoothing.samples import LONG_GAP_S
from recon.numerics.smoothing.soa import Floats, mm, mmt, rotation_exp
from recon.numerics.smoothing.state import COMMON_SIZE, State
from recon.numerics.smoothing.stops import MOVING

if TYPE_CHECKING:
    from recon.numerics.smoothing.smoother import Smoother

_GAP_S: Final = 3.0
"""s without a fix, beyond which the velocity between is not known beforehand."""
_DIFFERENCE_S: Final = 3.9
"""s between positions whose difference is a velocity: noise of metres then is one of decimetres per second."""
_FOLLOWED_S: Final = 120.0
"""s behind the last fix over which an IMU alone tells the way better than standing still does."""
_VECTORS: Final = ("vel_n", "pos_n", "gyro_bias", "accel_bias", "drift_n")
_NO_HEADING: Final = 0.2
"""rad; doubt of the first heading that noise alone exceeds, and no drive."""
_SHORT_GAP_S: Final = 3.0
"""s of silence in which a vehicle turns so evenly that a heading carried through is better than what the accelerations
of a few seconds tell: those of a slow start may have it drive backwards."""
_JUMP: Final = 0.5
"""rad between knots that the IMU did not turn."""
_MOVES_MUCH: Final = 0.2


def fix_motion(fixes: Fixes) -> tuple[Floats, Floats, Floats]:
    """Times s, horizontal speeds m/s and courses rad of the fixes that tell a speed: (k,) each, NaN for no course.

    Where none does, those of differences of positions. Of one that only says that it is small, the sigma is its speed.
    """
    seen = np.isfinite(fixes.vel_sigma[:2]).any(axis=0)
    if not seen.any():
        t_s, vel_n = _differences(fixes.t_s, fixes.pos_n)
        return t_s, np.hypot(vel_n[0], vel_n[1]), np.arctan2(vel_n[0], vel_n[1])
    vel_n = np.einsum("jim,jm->im", fixes.vel_rows[..., seen], fixes.vel[:, seen])
    small = fixes.small_only[seen]
    speed = np.where(small, fixes.vel_sigma[0, seen], np.hypot(vel_n[0], vel_n[1]))
    course = np.where(fixes.speed_only[seen] | small, np.nan, np.arctan2(vel_n[0], vel_n[1]))
    return fixes.t_s[seen], speed, course


def start_state(smoother: Smoother) -> State:
    """Closed form: gyro bias at stops, attitude from GNSS accelerations against specific force, then the mounting.

    Between gaps of the IMU that may tell no heading, which then is that of the course, or carried over from nearby.
    Where only speed is known, the course is that of the turns since the start, which faces north by convention.
    Raises ValueError where nothing moves, so that no direction is forward and no heading is told.
    """
    drive, knots = smoother.drive, smoother.drive.samples.knot_times
    stands = int(smoother.still.sum()) > 5
    bias = np.median(smoother.blocks.gyro[:, smoother.still], axis=1) if stands else np.zeros(3)
    state = _resting(len(knots), bias)
    increments = smoother.increments(state)
    segments = segments_of(smoother.disturbed.gap_s)
    vel_n, known = knot_velocities(drive, knots, increments, segments)
    pull_n = gravity_n(np.zeros((3, 1)), drive.anchor)[:, 0]
    if not stands:
        state = _resting(len(knots), _driven_bias(smoother, increments, (vel_n, known, pull_n, segments)))
        increments = smoother.increments(state)
    rot_ns = alignment.align(increments, vel_n, known, pull_n, segments)
    if smoother.model.first_attitude is None and not _moves_much(smoother):
        unsure = alignment.heading_sigma(increments, rot_ns, vel_n, known, pull_n, segments)
        if unsure.min(initial=np.pi) > _NO_HEADING:
            raise ValueError("speed and course do not change by more than the noise of GNSS")
    if smoother.model.wheels:
        rot_ns = alignment.along_course(rot_ns, vel_n, known, segments)
    if len(segments) > 1:
        by_course, by_force = _told(smoother, increments, rot_ns, (vel_n, known, pull_n, segments))
        rot_ns, told = _carried(increments, rot_ns, by_course, segments, _SHORT_GAP_S)
        rot_ns, _ = _carried(increments, rot_ns, told | by_force, segments, LONG_GAP_S)
    rot_vs = alignment.mounting(rot_ns, vel_n, known) if smoother.model.mounting is None else smoother.model.mounting
    pos_n = knot_positions(drive, knots, vel_n)
    if smoother.model.wheels and len(drive.wheel_t_s) > 1:
        forward_n = np.einsum("ijn,j->in", rot_ns, rot_vs[0])
        vel_n, pos_n = dead_reckoned(drive, knots, (vel_n, pos_n), known, forward_n)
    smoother.datum = smoother.datum.moved(rot_vs, rot_ns[..., :1], pos_n[:, 0])
    state = replace(state, rot_ns=rot_ns, vel_n=vel_n, pos_n=pos_n, rot_vs=rot_vs)
    seen = int(np.flatnonzero(known)[-1]) + 1 if known.any() else len(known)
    if smoother.model.wheels or knots[-1] - knots[seen - 1] > _FOLLOWED_S:
        return state
    return continued(smoother, _until(state, seen))


def continued(smoother: Smoother, state: State) -> State:
    """A state of the first knots, followed to the last one by what the IMU says.

    state : of at least one knot
    """
    count, known = smoother.drive.samples.intervals + 1, state.knots
    more = ((0, 0), (0, count - known))
    state = replace(
        state,
        rot_ns=np.pad(state.rot_ns, ((0, 0), *more), mode="edge"),
        **{name: np.pad(getattr(state, name), more, mode="edge") for name in _VECTORS},
    )
    made, omega = smoother.increments(state), smoother.earth_rate_n
    for k in range(known - 1, count - 1):
        length, rot, vel, pos = made.duration[k], state.rot_ns[..., k], state.vel_n[:, k], state.pos_n[:, k]
        pull = gravity_n(pos[:, None], smoother.drive.anchor)[:, 0] - 2.0 * np.cross(omega, vel)
        turn = rotation_exp(-(omega * length)[:, None])[..., 0]
        state.rot_ns[..., k + 1] = turn @ rot @ made.rotation[..., k]
        state.vel_n[:, k + 1] = vel + pull * length + rot @ made.velocity[:, k]
        state.pos_n[:, k + 1] = pos + vel * length + 0.5 * pull * length**2 + rot @ made.position[:, k]
    return state


def _told(
    smoother: Smoother,
    increments: Increments,
    rot_ns: Floats,
    seen: tuple[Floats, NDArray[np.bool_], Floats, list[slice]],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Knots whose heading is told by the course in their segment, and by its accelerations: (N,) each.

    seen : as `align` takes
    """
    vel_n, known, _, segments = seen
    moves = known & (np.hypot(vel_n[0], vel_n[1]) > alignment.CRUISING) & smoother.model.wheels
    jumps = np.abs(_yaw(mm(rot_ns[..., :-1], increments.rotation), rot_ns[..., 1:])) > _JUMP
    by_course, by_force = moves.copy(), np.zeros(len(known), dtype=bool)
    for segment, sigma in zip(segments, alignment.heading_sigma(increments, rot_ns, *seen), strict=True):
        steady = not jumps[segment.start : segment.stop - 1].any()
        by_course[segment] |= steady and moves[segment].any()
        by_force[segment] = steady and sigma < _NO_HEADING
    return by_course, by_force


def _carried(
    increments: Increments, rot_ns: Floats, told: NDArray[np.bool_], segments: list[slice], longest_s: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Attitudes, (3, 3, N), whose headings, where nothing tells them, are those of the knots before or behind, turned
    as the IMU turned: through gaps so short that their ends say how it did. Between two gaps the level is carried, too.

    told : (N,); longest_s : s, of a gap; other arguments as of `alignment.align`
    returns : beside them (N,) where heading is told or carried
    """
    out, done, count = rot_ns.copy(), told.copy(), len(told)
    level = np.zeros(count, dtype=bool)
    for segment in segments:
        level[segment] = True
    for step, knots in ((1, range(1, count)), (-1, range(count - 2, -1, -1))):
        for to in knots:
            k = min(to, to - step)
            if done[to] or not done[to - step] or increments.duration[k] > longest_s:
                continue
            turn = increments.rotation[..., k] if step == 1 else increments.rotation[..., k].T
            rot = out[..., to - step] @ turn
            if level[to]:
                yaw = float(_yaw(rot[..., None], out[..., to, None])[0])
                rot = rotation_exp(np.array([[0.0], [0.0], [yaw]]))[..., 0] @ out[..., to]
            out[..., to], done[to] = rot, True
    return out, done


def _yaw(of: Floats, other: Floats) -> Floats:
    """Turn about up that brings other attitudes nearest to those: (n,) rad of (3, 3, n) both."""
    turn = mmt(of, other)
    return np.asarray(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


def _until(state: State, knots: int) -> State:
    """The first knots of a state."""
    return replace(
        state, rot_ns=state.rot_ns[..., :knots], **{name: getattr(state, name)[:, :knots] for name in _VECTORS}
    )


def _moves_much(smoother: Smoother) -> bool:
    """Is it fast for a fair part of the time, so that its course is its heading even where that never changes?"""
    return bool((smoother.motion[1] > MOVING).mean() > _MOVES_MUCH) if len(smoother.motion[1]) else False


def _driven_bias(
    smoother: Smoother, increments: Increments, seen: tuple[Floats, NDArray[np.bool_], Floats, list[slice]]
) -> Floats:
    """Bias of the gyroscopes, (3,) rad/s, of a drive without a stop. increments : with none; seen : as `align` takes"""
    if not smoother.model.wheels:
        return gyro_start.gyro_bias_from_drift(increments, *seen)
    bias = gyro_start.gyro_bias_from_course(increments, *seen[:2])
    increments = smoother.increments(_resting(len(smoother.drive.samples.knot_times), bias))
    return bias + gyro_start.steadier(increments, gyro_start.gyro_bias_from_drift(increments, *seen), *seen)


def _resting(knots: int, gyro_bias: Floats) -> State:
    """Nothing known but the bias of the gyro (3,) rad/s."""
    same = np.repeat(np.eye(3)[..., None], knots, axis=2)
    bias, none = np.repeat(gyro_bias[:, None], knots, axis=1), np.zeros((3, knots))
    return State(same, none, none, bias, none, none, np.eye(3), np.zeros(COMMON_SIZE))


def segments_of(gap_s: Floats, longest: float = 10.0) -> list[slice]:
    """Slices of knots between intervals that are mostly gap."""
    cut = np.flatnonzero(gap_s > longest * 0.1) + 1
    edges = [0, *cut.tolist(), len(gap_s) + 1]
    return [slice(a, b) for a, b in pairwise(edges) if b - a > 1]


def knot_velocities(
    drive: Drive, knots: Floats, increments: Increments, segments: list[slice]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Velocity at the knots, (3, N) m/s, and where it is known: of fixes, else of their positions, else of speed."""
    fixes = drive.fixes
    vector = np.isfinite(fixes.vel_sigma[:2]).all(axis=0) & ~fixes.speed_only
    speed = np.isfinite(fixes.vel_sigma[0]) & fixes.speed_only
    placed = np.isfinite(fixes.pos_sigma[:2]).all(axis=0)
    if vector.sum() > 1:
        t_s, vel_n = fixes.t_s[vector], np.einsum("jim,jm->im", fixes.vel_rows[..., vector], fixes.vel[:, vector])
    elif placed.sum() > 2:
        t_s, vel_n = _differences(fixes.t_s[placed], fixes.pos_n[:, placed])
    else:
        t_s = fixes.t_s[speed]
        known = _near(knots, t_s)
        along = np.interp(knots, t_s, fixes.vel[0, speed])
        return alignment.pseudo_velocity(increments, along, segments), known
    return np.stack([np.interp(knots, t_s, axis) for axis in vel_n]), _near(knots, t_s)


def dead_reckoned(
    drive: Drive, knots: Floats, motion: tuple[Floats, Floats], known: NDArray[np.bool_], forward_n: Floats
) -> tuple[Floats, Floats]:
    """The motion where no fix tells it, by the speed of the wheels along the vehicle: velocity and position (3, N).

    Where fixes come again, the way is bent to meet them; where none do, their last is where it begins. A start that
    stands still there is hundreds of metres off, and the wheels' speeds would look like outliers.

    motion : velocity m/s and position m at the knots, (3, N) each; known : (N,) velocities; forward_n : (3, N)
    """
    vel_n, pos_n = motion
    speed = np.interp(knots, drive.wheel_t_s, drive.wheel_speed, left=np.nan, right=np.nan)
    rolls = ~known & np.isfinite(speed)
    vel_n = np.where(rolls, forward_n * np.nan_to_num(speed), vel_n)
    way = np.zeros_like(vel_n)
    way[:, 1:] = np.cumsum(0.5 * (vel_n[:, 1:] + vel_n[:, :-1]) * np.diff(knots), axis=1)
    placed = _near(knots, drive.fixes.t_s[np.isfinite(drive.fixes.pos_sigma[:2]).all(axis=0)])
    if not placed.any():
        return vel_n, knot_positions(drive, knots, vel_n)
    bent = [axis - np.interp(knots, knots[placed], axis[placed]) for axis in way]
    return vel_n, np.where(placed, pos_n, pos_n + bent)


def _differences(t_s: Floats, pos_n: Floats) -> tuple[Floats, Floats]:
    """Velocities of positions at least DIFFERENCE_S apart: times (k,) s, (3, k) m/s."""
    ahead = np.searchsorted(t_s, t_s + _DIFFERENCE_S)
    first = np.flatnonzero(ahead < len(t_s))
    last = ahead[first]
    return 0.5 * (t_s[first] + t_s[last]), (pos_n[:, last] - pos_n[:, first]) / (t_s[last] - t_s[first])


def _near(knots: Floats, t_s: Floats) -> NDArray[np.bool_]:
    """Knots with a fix not much further away than usual."""
    if len(t_s) < 2:
        return np.zeros(len(knots), dtype=bool)
    usual = float(np.median(np.diff(t_s)))
    gap = np.append(np.diff(t_s), 0.0)[np.clip(np.searchsorted(t_s, knots) - 1, 0, len(t_s) - 1)]
    inside = (knots >= t_s[0] - usual) & (knots <= t_s[-1] + usual)
    return np.asarray((gap <= max(_GAP_S, 2.5 * usual)) & inside)


def knot_positions(drive: Drive, knots: Floats, vel_n: Floats) -> Floats:
    """Positions at the knots, (3, N) m: of the fixes, else the path of the velocities from zero."""
    out = np.zeros_like(vel_n)
    out[:, 1:] = np.cumsum(0.5 * (vel_n[:, 1:] + vel_n[:, :-1]) * np.diff(knots), axis=1)
    for axis in range(3):
        seen = np.isfinite(drive.fixes.pos_sigma[axis])
        if seen.any():
            out[axis] = np.interp(knots, drive.fixes.t_s[seen], drive.fixes.pos_n[axis, seen])
    return out
