"""How far a peer's estimate is from the truth, as numbers and as a table.

Attitude errors are rotations about the axes n that take the estimate to the truth: heading is their part about Up, tilt
that about East and North, so roll and pitch of the sensor however it is mounted. An outage is a gap between fixes of
more than OUTAGE_S.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.rotation import Floats, conjugate, multiply, to_rotvec
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate

from .drives import Drive, Estimate, Solve

OUTAGE_S: Final = 5.0


@dataclass(frozen=True)
class Errors:
    """Root mean squares over time; NaN where there is no sample.

    horizontal, vertical : m; velocity : m/s, of the vector; tilt : rad, per axis; heading : rad
    """

    horizontal: float
    vertical: float
    velocity: float
    tilt: float
    heading: float


@dataclass(frozen=True)
class Score:
    """Errors of a whole drive and inside its outages, the largest horizontal one there in m, and the wall time in s."""

    drive: Errors
    outages: Errors
    worst: float
    wall_s: float


def run(solve: Solve, drive: Drive, truth: Estimate) -> Score:
    """Solve a drive and score the result."""
    begin = time.perf_counter()
    estimate = solve(drive)
    return score(estimate, truth, in_outage(estimate.t_s, drive.fix_t_s), time.perf_counter() - begin)


def in_outage(t_s: Floats, fix_t_s: Floats) -> NDArray[np.bool_]:
    """Times (k,) that lie between two fixes more than OUTAGE_S apart: (k,)."""
    index = np.searchsorted(fix_t_s, t_s)
    gap = np.concatenate([[0.0], np.diff(fix_t_s), [0.0]])
    return np.asarray(gap[index] > OUTAGE_S)


def score(estimate: Estimate, truth: Estimate, outage: NDArray[np.bool_], wall_s: float) -> Score:
    """Errors at the times of the estimate, all of which the truth must span; outage : (k,) of them."""
    pos_n = estimate.pos_n - interpolate(estimate.t_s, truth.t_s, truth.pos_n)
    vel_n = estimate.vel_n - interpolate(estimate.t_s, truth.t_s, truth.vel_n)
    turn_n = to_rotvec(multiply(slerp(estimate.t_s, truth.t_s, truth.q_ns), conjugate(estimate.q_ns)))
    horizontal = np.hypot(pos_n[:, 0], pos_n[:, 1])
    return Score(
        _errors(pos_n, vel_n, turn_n),
        _errors(pos_n[outage], vel_n[outage], turn_n[outage]),
        float(horizontal[outage].max()) if outage.any() else float("nan"),
        wall_s,
    )


def _errors(pos_n: Floats, vel_n: Floats, turn_n: Floats) -> Errors:
    if len(pos_n) == 0:
        return Errors(*[float("nan")] * 5)
    squares = [(values**2).mean(axis=0) for values in (pos_n, vel_n, turn_n)]
    position, velocity, turn = squares
    return Errors(
        *(float(np.sqrt(x)) for x in (position[:2].sum(), position[2], velocity.sum(), turn[:2].mean(), turn[2]))
    )


def together(scores: Sequence[Score]) -> Score:
    """Several drives as one: root mean squares of the errors, mean of the largest errors and of the wall times."""
    return Score(
        _root_mean_square([score.drive for score in scores]),
        _root_mean_square([score.outages for score in scores]),
        float(np.mean([score.worst for score in scores])),
        float(np.mean([score.wall_s for score in scores])),
    )


def _root_mean_square(errors: Sequence[Errors]) -> Errors:
    return Errors(*np.sqrt(np.mean([np.square(astuple(one)) for one in errors], axis=0)).tolist())


def table(scores: Mapping[str, Sequence[Score]]) -> str:
    """A line of Markdown for each peer over its drives: m, m/s, deg, s; "o" inside outages, worst as `together`."""
    heads = ["peer", "drives", "H", "V", "vel", "tilt", "head", "Ho", "Vo", "velo", "tilto", "heado", "worst", "wall"]
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    for name, of in scores.items():
        one = together(of)
        numbers = [f"{x:.{digits}f}" for errors in (one.drive, one.outages) for x, digits in _shown(errors)]
        lines.append("| " + " | ".join([name, str(len(of)), *numbers, f"{one.worst:.2f}", f"{one.wall_s:.2f}"]) + " |")
    return "\n".join(lines)


def _shown(errors: Errors) -> list[tuple[float, int]]:
    """Values as shown, and how many digits of them."""
    tilt, heading = np.degrees([errors.tilt, errors.heading])
    return [(errors.horizontal, 2), (errors.vertical, 2), (errors.velocity, 3), (tilt, 3), (heading, 3)]
