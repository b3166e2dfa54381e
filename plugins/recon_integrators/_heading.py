"""Which way a levelled sensor looks: by its magnetometer, by the course over ground, or by both.

The course comes from changes of the GNSS velocity, set against what the accelerometer feels (recon.numerics.heading).
By what it and the magnetometer differ over the drive the magnetometer is turned, and where that is too much to be iron
it is left out: the course has no iron about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pyarrow as pa

from recon import Array, Metric, warning
from recon.numerics.heading import Complexes, course_evidence, horizontal, smooth_angle
from recon.numerics.rotation import rotate
from recon_integrators._field import field_of
from recon_integrators._levelled import Levelled
from recon_integrators._north import North, Velocities

_WANDER: Final = 2e-4
"""rad/s^1.5: a consumer's gyroscope, its bias and its scale error in bends."""
_COURSE_SIGMA: Final = 0.5
"""m/s, of a change of velocity in a second: GNSS, its delay, and the levelling in bends."""
_UNKNOWN: Final = np.radians(45.0)
"""Sigma beyond which a heading is no heading."""
_DISAGREE: Final = np.radians(15.0)
_SURE: Final = np.radians(6.0)
_LASTING: Final = np.radians(10.0)
"""What iron that is not found turns a magnetometer's heading by over a whole drive."""


@dataclass(frozen=True)
class Heading:
    """By how much the level frame of each piece is turned against East-North-Up at the ends of its blocks, rad."""

    turns: list[Array]
    kind: str
    learnt: list[Metric] = field(default_factory=list)


def find_heading(
    pieces: Sequence[Levelled],
    mag: pa.Table | None,
    velocities: Velocities | None,
    north: North,
    given_iron: tuple[float, float, float] | None,
) -> Heading:
    """The heading of each piece, from what there is.

    mag, velocities : None where they are not there, or not to be used
    """
    learnt: list[Metric] = []
    by_course = [_course_of(piece, velocities) for piece in pieces]
    by_field = None
    if mag is not None:
        by_field, found = field_of(pieces, mag, north, given_iron)
        learnt += found
        by_field, found = _agreeing(by_field, by_course, north)
        learnt += found
    return _combined(pieces, by_field, by_course, north.true, learnt)


def _course_of(piece: Levelled, velocities: Velocities | None) -> Complexes:
    """Evidence of a piece by the course: (seconds,) 1/rad^2."""
    if velocities is None:
        return np.zeros(piece.seconds, dtype=np.complex128)
    force_l = horizontal(rotate(piece.q_lg, piece.blocks.force_g))
    change_l: Complexes = np.cumsum(force_l * piece.blocks.step_s).astype(np.complex128)
    fix_s = piece.since_start_s(velocities.t_ns)
    return course_evidence(piece.blocks.t_s, change_l, fix_s, velocities.vel_n, _COURSE_SIGMA, piece.seconds)


def _agreeing(
    by_field: list[Complexes], by_course: list[Complexes], north: North
) -> tuple[list[Complexes] | None, list[Metric]]:
    """The evidence of the magnetometer, None where the course refutes it or it is of another north.

    What it is off the course by on average over the drive is taken off, as far as the course knows it.
    """
    total = sum(float(np.abs(one).sum()) for one in by_course)
    if not total:
        return by_field, []
    apart = 0.0j
    for field_z, course_z in zip(by_field, by_course, strict=True):
        angle, sigma = smooth_angle(field_z, _WANDER)
        apart += (course_z * np.exp(-1j * angle))[sigma < _UNKNOWN].sum()
    if not abs(apart):
        return by_field, []
    difference, sigma_all = float(np.angle(apart)), float(1.0 / np.sqrt(abs(apart)))
    learnt = [Metric("course_less_magnetometer", -float(np.degrees(difference)), "deg", float(np.degrees(sigma_all)))]
    if not north.true:
        if sigma_all < _SURE:
            learnt.append(warning("the heading comes from the course alone: that of mag counts from magnetic north"))
            return None, learnt
        return by_field, learnt
    if sigma_all < _SURE and abs(difference) > _DISAGREE:
        note = (
            f"the magnetometer's heading is {abs(np.degrees(difference)):.0f} deg off the course: it is left out "
            "(iron about it, or other axes than those of imu?)"
        )
        return None, [*learnt, warning(note)]
    turn = difference * _LASTING**2 / (_LASTING**2 + sigma_all**2)
    return [field_z * np.exp(1j * turn) for field_z in by_field], learnt


def _combined(
    pieces: Sequence[Levelled],
    by_field: list[Complexes] | None,
    by_course: list[Complexes],
    true: bool,
    learnt: list[Metric],
) -> Heading:
    """Both kinds of evidence together; those from two norths are never added."""
    magnetic = by_field is not None and any(one.any() for one in by_field)
    if magnetic and not true:
        by_course = [np.zeros_like(one) for one in by_course]
    turns, sigmas, unknown = [], [], 0
    for index, piece in enumerate(pieces):
        evidence = by_course[index] + (by_field[index] if by_field is not None else 0.0)
        angle, sigma = smooth_angle(evidence, _WANDER)
        if np.median(sigma) > _UNKNOWN:
            unknown += 1
        turns.append(np.interp(piece.blocks.t_s, np.arange(piece.seconds) + 0.5, angle))
        sigmas.append(sigma)
    used = [name for name, there in (("magnetometer", magnetic), ("course", any(c.any() for c in by_course))) if there]
    if unknown == len(pieces):
        note = "neither magnetometer nor course tells the heading: it is arbitrary, and drifts"
        return Heading(turns, "arbitrary", [*learnt, Metric("heading", method="none"), warning(note)])
    if unknown:
        learnt = [*learnt, warning(f"in {unknown} of {len(pieces)} pieces of imu nothing tells the heading")]
    kind = "true" if true or not magnetic else "magnetic"
    sigma_deg = float(np.degrees(min(np.median(np.concatenate(sigmas)), np.pi)))
    told = Metric(
        "heading", sigma_deg, "deg", method=" and ".join(used), note=f"typical sigma; counts from {kind} north"
    )
    return Heading(turns, kind, [*learnt, told, *_without(used)])


def _without(used: list[str]) -> list[Metric]:
    """Said where the heading rests on the course alone."""
    if "magnetometer" in used:
        return []
    note = (
        "the heading comes from the course of GNSS, without a magnetometer: while the speed is constant, or at rest, "
    )
    return [warning(note + "the gyroscope alone carries it")]
