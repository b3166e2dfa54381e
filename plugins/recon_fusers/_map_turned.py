"""fuser.map where the box turned in its mount: found in a solution without wheels, turned back, and solved again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import Array, Event, Metric, matrix, seconds, warning
from recon.errors import DataError
from recon.numerics.smoothing import Estimate, Noise
from recon.numerics.smoothing.noise import on_wheels
from recon.numerics.smoothing.state import ROTATION
from recon.numerics.turned_box import Attitudes, Turn, attitudes, refined, sizes, turned_back, turns_of, when_read
from recon.tables import replace as with_values
from recon.tables import select_rows
from recon_fusers._map_doubts import contradiction

_USUAL: Final = (0.03, 0.2, np.radians(3.5), 0.1)
"""m/s sideways and upwards, mean of a second, rad of a road's bank, and share of the fixes that are put aside: what
hardly any drive exceeds.
"""
_BETTER: Final = 0.6
"""Share of the squares of the first three, which is left at most where the box did turn; fixes in multipath are put
aside for less, where every turn too many takes some of them in.
"""
_UPSET: Final = 5.0
"""Times the usual bank of a road, beyond which leaning into bends explains nothing."""
_JUMP: Final = 10.0
"""Growth of the walks of biases, which stay in the axes of a box and so jump in those of the vehicle."""
_MOVING: Final = 1.0
"""m/s from which on the course is that of the vehicle."""
_MOST: Final = 8
"""Turns; a box with more of them is loose."""

Solved = tuple[Estimate, list[Metric]]
"""A solution, and what was learnt of the aids in it."""
Solve = Callable[[pa.Table, bool, Noise], Solved]
"""The drive with this imu, on wheels or not, from this noise on. Raises DataError."""


@dataclass(frozen=True)
class Mounted:
    """What the box would have measured in its first mounting, without the rows in which it turned, and the solution."""

    imu: pa.Table
    found: Estimate
    learnt: list[Metric]
    turns: list[Turn]


def mounted(imu: pa.Table, solve: Solve, expected: Noise, wheels: bool, may_turn: bool) -> Mounted:
    """The drive, with the box turned back where the wheels show that it turned. Raises DataError.

    What leans into bends is left as it is. expected : noise before any was estimated, if it is
    """
    alone = Mounted(imu, *solve(imu, wheels, expected), [])
    misfit = _misfit(alone.found, expected)
    leans = alone.found.smoother.model.lean != 0.0 and misfit[2] < _UPSET
    if not (wheels and may_turn) or leans or misfit.max() < 1.0:
        return alone
    try:
        best = _turned_back_best(alone, solve, expected)
    except DataError:
        return alone
    if best is None or not best.found.solved.converged:
        return alone
    return best if _size(best, expected) < _BETTER * _size(alone, expected) else alone


def _turned_back_best(alone: Mounted, solve: Solve, expected: Noise) -> Mounted | None:
    """With the turns that are found, as they are or refined; None where there are none that can be turned back."""
    imu = alone.imu
    turns, biases = _turns(imu, expected, solve)
    if not 0 < len(turns) <= _MOST or _in_impact(turns, alone.found):
        return None
    free, _ = solve(_turned_back(imu, turns, biases), False, expected)
    found = []
    for some in (turns, refined(turns, _attitudes(free))):
        back = _turned_back(imu, some, biases)
        found.append(Mounted(back, *solve(back, True, expected), some))
    return min(found, key=lambda one: _size(one, expected))


def turned(turns: list[Turn]) -> list[Metric]:
    """A warning for each."""
    return [
        warning(
            f"between {turn.start_s:.1f} and {turn.end_s:.1f} s after the start the box turned in its mount by "
            f"{size:.1f} deg: from then on its samples are turned back, and mount_* are those of before"
        )
        for turn, size in zip(turns, np.degrees(sizes(turns)), strict=True)
    ]


def turnings(turns: list[Turn], start_ns: int) -> list[Event]:
    """An event for each. start_ns : time zero of the turns."""
    return [
        Event(
            start_ns + round(turn.start_s * 1e9), start_ns + round(turn.end_s * 1e9), "box_turned", float(size), "deg"
        )
        for turn, size in zip(turns, np.degrees(sizes(turns)), strict=True)
    ]


def _misfit(found: Estimate, expected: Noise) -> Array:
    """Motion across the track of the wheels, bank of the road and fixes put aside, in what is usual at most: (4,).

    As it was learnt, or more where the whole drive shows more than the twenty minutes that tell it.
    """
    learnt, told = ([n.sideways, n.upwards, n.bank] for n in (found.solved.noise, expected))
    shown = np.maximum(on_wheels(found.smoother, found.solved), np.where(np.equal(learnt, told), 0.0, learnt))
    return np.array([*shown, found.solved.rejected]) / _USUAL


def _size(one: Mounted, expected: Noise) -> float:
    """Of what the wheels contradict: a sum of squares."""
    return float((_misfit(one.found, expected)[:3] ** 2).sum())


def _attitudes(free: Estimate) -> Attitudes:
    state, smoother = free.solved.state, free.smoother
    rate_s, heading = smoother.knot_rate - state.gyro_bias, ROTATION.start + 2
    sigma = np.sqrt(free.covariance[:, heading, heading])
    return attitudes(smoother.drive.samples.knot_times, state.rot_ns, state.vel_n, rate_s, sigma)


def _turns(imu: pa.Table, expected: Noise, solve: Solve) -> tuple[list[Turn], tuple[Array, Array]]:
    """The turns, and the biases of accelerometer and gyroscope, (3,) each, that stay in the axes of the box.

    Found with biases that may jump, and where these are several also without, which tells too many of large turns.
    """
    jumping = replace(expected, gyro_walk=_JUMP * expected.gyro_walk, accel_walk=_JUMP * expected.accel_walk)
    free, _ = solve(imu, False, jumping)
    found = _turns_in(free, imu)
    if contradiction(free.solved.noise, jumping)[0]:  # which needs no mounting: something else does not fit
        return [], found[1]
    if len(found[0]) < 2:
        return found
    return min(found, _turns_in(solve(imu, False, expected)[0], imu), key=lambda one: len(one[0]) or np.inf)


def _turns_in(free: Estimate, imu: pa.Table) -> tuple[list[Turn], tuple[Array, Array]]:
    state, knots, t_s = free.solved.state, free.smoother.drive.samples.knot_times, seconds(imu)
    biases = np.median(state.accel_bias, axis=1), np.median(state.gyro_bias, axis=1)
    up_s = np.stack([np.interp(t_s, knots, axis) for axis in state.rot_ns[2]], axis=1)
    moves = np.hypot(*state.vel_n[:2]) > _MOVING
    course = np.unwrap(np.arctan2(state.vel_n[1, moves], state.vel_n[0, moves]))
    turned = np.interp(t_s, knots[moves], course) if moves.any() else np.zeros(len(t_s))
    return when_read(turns_of(_attitudes(free)), t_s, matrix(imu, "gyro") - biases[1], turned, up_s), biases


def _turned_back(imu: pa.Table, turns: list[Turn], biases: tuple[Array, Array]) -> pa.Table:
    t_s = seconds(imu)
    back = {
        name: turned_back(turns, t_s, matrix(imu, name), bias)
        for name, bias in zip(("accel", "gyro"), biases, strict=True)
    }
    return select_rows(with_values(imu, **back), _steady(turns, t_s))


def _steady(turns: list[Turn], t_s: Array) -> NDArray[np.bool_]:
    """Rows in which the box does not turn."""
    steady = np.ones(len(t_s), dtype=bool)
    for turn in turns:
        steady &= (t_s <= turn.start_s) | (t_s >= turn.end_s)
    return steady


def _in_impact(turns: list[Turn], alone: Estimate) -> bool:
    """Did the box turn in an impact, whose samples are needed?"""
    impacts = alone.smoother.drive.impacts
    return any(turn.start_s <= one.end_s and one.start_s <= turn.end_s for turn in turns for one in impacts)
