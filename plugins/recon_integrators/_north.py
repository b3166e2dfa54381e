"""Which way a levelled sensor looks: by its magnetometer, by the course over ground, or by both.

The magnetometer is first freed of hard iron, found from how the field turns with the box. Samples whose strength or
vertical part differ from the usual are disturbed and left out; so is all of it where the usual field cannot be that of
the Earth, for on a straight road nothing else shows the iron about a phone. Its north is magnetic: the declination of
the World Magnetic Model at the place and date of the log, or a given one, leads to true north. The course comes from
changes of the GNSS velocity, set against what the accelerometer feels (recon.numerics.heading). Where the two disagree
by more than their sigmas allow, the course is believed: it has no iron about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from recon import Array, Metric, has, matrix, meta, time_ns, vector, warning
from recon.errors import DataError
from recon.magnetic import declination, magnetic_field_n
from recon.numerics.attitude import Blocks
from recon.numerics.heading import (
    Complexes,
    course_evidence,
    field_evidence,
    hard_iron,
    horizontal,
    smooth_angle,
)
from recon.numerics.rotation import conjugate, multiply, rotate
from recon.numerics.signals import interpolate

WANDER: Final = 2e-4
"""rad/s^1.5: a consumer's gyroscope, its bias and its scale error in bends."""
_MAG_GAP_S: Final = 1.0
_FIELD_SIGMA: Final = 0.8
"""rad, of a second of a calibrated magnetometer in a vehicle: 0.1 rad of soft iron and rest of hard iron, which stay
the same for about a minute, as long as the heading does.
"""
_COURSE_SIGMA: Final = 0.5
"""m/s, of a change of velocity in a second: GNSS, its delay, and the levelling in bends."""
_STRENGTH, _VERTICAL = 0.15, 0.2
"""Share of the usual strength by which the strength, and the vertical part, of the field may differ."""
_FIX_GAP_S: Final = 2.5
_UNKNOWN: Final = np.radians(45.0)
"""Sigma beyond which a heading is no heading."""
_DISAGREE: Final = np.radians(15.0)
_MISLED: Final = np.radians(25.0)
"""By which iron may turn the heading, of the field that it adds, before the magnetometer is left out."""
_SURE: Final = np.radians(6.0)


class Levelled(NamedTuple):
    """A piece of the record: time of its first row, its blocks, attitude (m, 4) in its level frame at their ends."""

    start_ns: int
    blocks: Blocks
    q_ls: Array

    @property
    def seconds(self) -> int:
        """Seconds that hold all of it."""
        return int(np.floor(self.blocks.t_s[-1])) + 1


@dataclass(frozen=True)
class Heading:
    """By how much the level frame of each piece is turned against East-North-Up at the ends of its blocks, rad."""

    turns: list[Array]
    kind: str
    learnt: list[Metric] = field(default_factory=list)


class North(NamedTuple):
    """Horizontal field of the Earth, east + i north of length 1, and the strength of its parts in T where known."""

    direction: complex
    strength: float | None
    vertical: float | None
    true: bool


def find_heading(
    pieces: Sequence[Levelled],
    mag: pa.Table | None,
    gnss: pa.Table | None,
    vel_n: Complexes | None,
    north: North,
    given_iron: tuple[float, float, float] | None,
) -> Heading:
    """The heading of each piece, from what there is.

    mag : None where it is not to be used; vel_n : horizontal velocity of each row of gnss, None likewise
    """
    learnt: list[Metric] = []
    by_course = [_course_of(piece, gnss, vel_n) for piece in pieces]
    by_field = None
    if mag is not None:
        by_field, found = _field_of(pieces, mag, north, given_iron)
        learnt += found
        by_field, found = _agreeing(by_field, by_course, north)
        learnt += found
    return _combined(pieces, by_field, by_course, north.true, learnt)


def north_of(mag: pa.Table | None, gnss: pa.Table | None, given: float | None) -> tuple[North, list[Metric]]:
    """The Earth's field where and when the log was made, its direction that of a given declination where there is one.

    Raises DataError where the date is outside the model and no declination is given.
    """
    place = _place(gnss)
    field_n = None
    if mag is not None and place is not None and meta(mag).get("clock") != "relative":
        try:
            field_n = magnetic_field_n(*place, int(time_ns(mag)[0]))
        except DataError:
            if given is None:
                raise
    if field_n is None and given is None:
        why = "date" if place else "place"
        note = f"the {why} of the log is not known, so neither is the declination: give the parameter declination"
        return North(1j, None, None, False), [warning(note)] if mag is not None else []
    angle, how = given, "given"
    if angle is None:
        assert field_n is not None
        angle, how = declination(field_n), "World Magnetic Model"
    learnt = [Metric("declination", float(np.degrees(angle)), "deg", method=how, note="true = magnetic + this")]
    direction = complex(np.exp(1j * (0.5 * np.pi - angle)))
    if field_n is None:
        return North(direction, None, None, True), learnt
    flat, up = float(np.hypot(field_n[0], field_n[1])), float(field_n[2])
    learnt.append(Metric("earth_field_horizontal", flat, "T", method="World Magnetic Model"))
    learnt.append(Metric("earth_field_vertical", up, "T", method="World Magnetic Model", note="positive upwards"))
    return North(direction, flat, up, True), learnt


def _place(gnss: pa.Table | None) -> tuple[float, float, float] | None:
    """Latitude, longitude and height in the middle of the fixes, None where there is none."""
    if gnss is None or not (has(gnss, "lat") and has(gnss, "lon")):
        return None
    lat, lon = (vector(gnss, name, gaps=True) for name in ("lat", "lon"))
    known = np.isfinite(lat + lon) & ((lat != 0.0) | (lon != 0.0))
    if not known.any():
        return None
    row = np.flatnonzero(known)[int(known.sum()) // 2]
    height = vector(gnss, "height", gaps=True)[row] if has(gnss, "height") else 0.0
    return float(lat[row]), float(lon[row]), float(np.nan_to_num(height))


def velocity_of(gnss: pa.Table | None, north: North) -> tuple[Complexes | None, list[Metric]]:
    """Horizontal velocity of each fix, east + i north of true north, NaN where it is not known."""
    if gnss is None or not gnss.num_rows:
        return None, []
    vel: Complexes | None = None
    notes: list[Metric] = []
    if has(gnss, "vel_e") and has(gnss, "vel_n"):
        vel = vector(gnss, "vel_e", gaps=True) + 1j * vector(gnss, "vel_n", gaps=True)
    elif has(gnss, "speed") and has(gnss, "course"):
        kind = str(meta(gnss).get("heading_kind", "true"))
        course, speed = vector(gnss, "course", gaps=True), vector(gnss, "speed", gaps=True)
        turn, known = _to_true(kind, north)
        if not known:
            return None, [warning(f"the course of gnss is of kind '{kind}', which is not true north: it is left out")]
        vel = np.where(speed == 0.0, 0.0, speed * np.exp(1j * (0.5 * np.pi - course - turn)))
    if vel is not None and "fix" in gnss.column_names:
        vel = np.where(vector(gnss, "fix", gaps=True) < 2, np.nan, vel)
    return vel, notes


def _to_true(kind: str, north: North) -> tuple[float, bool]:
    """What to add to a heading of this kind to count it from true north, and whether that is known."""
    if kind in ("true", "course_true"):
        return 0.0, True
    if kind == "magnetic" and north.true:
        return float(0.5 * np.pi - np.angle(north.direction)), True
    return 0.0, False


def _course_of(piece: Levelled, gnss: pa.Table | None, vel_n: Complexes | None) -> Complexes:
    if gnss is None or vel_n is None:
        return np.zeros(piece.seconds, dtype=np.complex128)
    q_lg = _from_drifting(piece)
    force_l = horizontal(rotate(q_lg, piece.blocks.force_g))
    change_l: Complexes = np.cumsum(force_l * piece.blocks.step_s).astype(np.complex128)
    fix_s = (time_ns(gnss) - piece.start_ns) * 1e-9
    return course_evidence(
        piece.blocks.t_s, change_l, np.asarray(fix_s, dtype=np.float64), vel_n, _COURSE_SIGMA, piece.seconds
    )


def acceleration_g(piece: Levelled, turn: Array, gnss: pa.Table | None, vel_n: Complexes) -> Array:
    """What GNSS shows of the vehicle's horizontal acceleration in each block: (m, 3) m/s^2, drifting frame; else 0.

    Without it a levelled sensor leans in every bend and whenever the vehicle brakes.
    """
    count = len(piece.blocks.t_s)
    if gnss is None:
        return np.zeros((count, 3))
    known = np.isfinite(vel_n)
    fix_s, vel = (time_ns(gnss)[known] - piece.start_ns) * 1e-9, vel_n[known]
    if len(fix_s) < 2:
        return np.zeros((count, 3))
    span = np.diff(fix_s)
    mean = np.where(span <= _FIX_GAP_S, np.diff(vel) / span, 0.0)
    left = np.searchsorted(fix_s, piece.blocks.t_s - 0.5 * piece.blocks.step_s) - 1
    inside = (left >= 0) & (left < len(mean))
    acc_l = np.where(inside, mean[np.clip(left, 0, len(mean) - 1)], 0.0) * np.exp(-1j * turn)
    return rotate(conjugate(_from_drifting(piece)), np.column_stack([acc_l.real, acc_l.imag, np.zeros(count)]))


def _from_drifting(piece: Levelled) -> Array:
    """Takes the drifting frame of the blocks to the level one at their ends: (m, 4)."""
    return multiply(piece.q_ls, conjugate(piece.blocks.q_end))


def _field_of(
    pieces: Sequence[Levelled], mag: pa.Table, north: North, given: tuple[float, float, float] | None
) -> tuple[list[Complexes], list[Metric]]:
    """Evidence of each piece from the calibrated and undisturbed field, and what was found out about it."""
    fields = [_at_blocks(piece, mag) for piece in pieces]
    iron, sigma_t, learnt = _iron(pieces, fields, north, given)
    strength = [np.linalg.norm(field_s - iron, axis=1) for field_s in fields]
    levelled = [rotate(piece.q_ls, field_s - iron) for piece, field_s in zip(pieces, fields, strict=True)]
    all_strength, all_up = np.concatenate(strength), np.concatenate([field_l[:, 2] for field_l in levelled])
    if not np.isfinite(all_strength).any():
        return [np.zeros(piece.seconds, dtype=np.complex128) for piece in pieces], [
            warning("mag holds no field at the times of imu")
        ]
    usual, usual_up = float(np.nanmedian(all_strength)), float(np.nanmedian(all_up))
    flat = max(np.sqrt(max(usual**2 - usual_up**2, 0.0)), 0.05 * usual)
    learnt.append(Metric("magnetic_strength", usual, "T", note="usual strength of the field, hard iron taken off"))
    refuted = _refuted(float(flat), usual_up, north)
    if refuted:
        return [np.zeros(piece.seconds, dtype=np.complex128) for piece in pieces], [*learnt, *refuted]
    sigma = float(np.hypot(_FIELD_SIGMA, sigma_t / flat))
    found, disturbed, measured_rows = [], 0, 0
    for piece, size, field_l in zip(pieces, strength, levelled, strict=True):
        known = np.isfinite(size)
        wrong = known & (
            (np.abs(size - usual) > _STRENGTH * usual) | (np.abs(field_l[:, 2] - usual_up) > _VERTICAL * usual)
        )
        disturbed, measured_rows = disturbed + int(wrong.sum()), measured_rows + int(known.sum())
        believed = np.where(known & ~wrong, horizontal(field_l), np.nan)
        found.append(field_evidence(piece.blocks.t_s, believed, north.direction, sigma, piece.seconds))
    share = disturbed / max(measured_rows, 1)
    learnt.append(_disturbance(share))
    if share > 0.3:
        learnt.append(warning(f"mag is disturbed in {100.0 * share:.0f} % of the time: its heading deserves doubt"))
    return found, learnt


def _disturbance(share: float) -> Metric:
    return Metric("magnetic_disturbance", 100.0 * share, "%", note="of the time, in which mag is rejected")


def _at_blocks(piece: Levelled, mag: pa.Table) -> Array:
    """The field in the sensor at the ends of the blocks: (m, 3) T, NaN where mag is silent."""
    mag_s = (time_ns(mag) - piece.start_ns) * 1e-9
    return interpolate(piece.blocks.t_s, mag_s, matrix(mag, "mag", gaps=True), _MAG_GAP_S)


def _iron(
    pieces: Sequence[Levelled], fields: Sequence[Array], north: North, given: tuple[float, float, float] | None
) -> tuple[Array, float, list[Metric]]:
    """Hard iron (3,) T, the sigma of what is left of it horizontally, and metrics."""
    if given is not None:
        return np.array(given), 0.0, []
    longest = int(np.argmax([np.isfinite(f).all(axis=1).sum() for f in fields]))
    known = np.isfinite(fields[longest]).all(axis=1)
    if known.sum() < 3:
        return np.zeros(3), 0.0, []
    piece = pieces[longest]
    rate_hz = len(piece.blocks.t_s) / max(float(piece.blocks.t_s[-1]), 1.0)
    found = hard_iron(piece.q_ls[known], fields[longest][known], rate_hz, north.vertical)
    axes_l = np.stack([rotate(piece.q_ls[known][0], axis) for axis in np.eye(3)], axis=1)
    across = (axes_l @ found.covariance @ axes_l.T)[:2, :2]
    sigma = float(np.sqrt(np.linalg.eigvalsh(across)[-1]))
    spread = np.sqrt(np.diag(found.covariance))
    note = "field that turns with the box, found from the drive, taken off"
    learnt = [
        Metric(f"hard_iron_{axis}", float(value), "T", float(s), note=note)
        for axis, value, s in zip("xyz", found.offset_s, spread, strict=True)
    ]
    size = north.strength or float(np.median(np.linalg.norm(fields[longest][known], axis=1)))
    if sigma < 0.3 * size:
        return found.offset_s, sigma, learnt
    note = "the drive has too few bends to find the hard iron about the magnetometer: none is taken off"
    return np.zeros(3), 0.5 * size, [warning(note)]


def _refuted(flat: float, up: float, north: North) -> list[Metric]:
    """Said where the usual field, T level and upwards, cannot be the Earth's; empty where it can, or that is not known.

    Level and upwards do not depend on the heading, so what they are off by is iron, a unit or the wrong axes, and would
    turn the heading by about its share of the level field.
    """
    if north.strength is None or north.vertical is None:
        return []
    off = float(np.hypot(flat - north.strength, up - north.vertical))
    if off <= np.sin(_MISLED) * north.strength:
        return []
    note = (
        f"mag measures {flat * 1e6:.0f} uT level and {up * 1e6:.0f} uT upwards where the Earth has "
        f"{north.strength * 1e6:.0f} and {north.vertical * 1e6:.0f}: it is left out "
        "(iron about it that the drive does not show, or other axes or another unit than it says?)"
    )
    return [_disturbance(1.0), warning(note)]


def _agreeing(
    by_field: list[Complexes], by_course: list[Complexes], north: North
) -> tuple[list[Complexes] | None, list[Metric]]:
    """The evidence of the magnetometer, None where the course refutes it or it is of another north."""
    total = sum(float(np.abs(one).sum()) for one in by_course)
    if not total:
        return by_field, []
    apart = 0.0j
    for field_z, course_z in zip(by_field, by_course, strict=True):
        angle, sigma = smooth_angle(field_z, WANDER)
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
    return by_field, learnt


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
        angle, sigma = smooth_angle(evidence, WANDER)
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
