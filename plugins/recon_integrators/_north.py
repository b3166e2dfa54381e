"""Which way north is where the log was made, and the velocities of GNSS counted from it.

The north of a magnetometer is magnetic: the declination of the World Magnetic Model at the place and date of the log,
or a given one, leads to true north. Courses and velocities of another kind are turned to true north, or left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import Metric, has, meta, time_ns, vector, warning
from recon.errors import DataError
from recon.magnetic import declination, magnetic_field_n
from recon.numerics.heading import Complexes


class North(NamedTuple):
    """Horizontal field of the Earth, east + i north of length 1, and the strength of its parts in T where known."""

    direction: complex
    strength: float | None
    vertical: float | None
    true: bool


class Velocities(NamedTuple):
    """Horizontal velocities (n,) m/s, east + i north of true north, and their times (n,) ns."""

    t_ns: NDArray[np.int64]
    vel_n: Complexes


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


def velocities_of(gnss: pa.Table | None, north: North) -> tuple[Velocities | None, list[Metric]]:
    """The horizontal velocities that gnss knows, None where it knows none or not from which north they count."""
    if gnss is None or not gnss.num_rows:
        return None, []
    vel: Complexes | None = None
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
    if vel is None:
        return None, []
    there = np.isfinite(vel)
    return Velocities(time_ns(gnss)[there], vel[there]), []


def _to_true(kind: str, north: North) -> tuple[float, bool]:
    """What to add to a heading of this kind to count it from true north, and whether that is known."""
    if kind in ("true", "course_true"):
        return 0.0, True
    if kind == "magnetic" and north.true:
        return float(0.5 * np.pi - np.angle(north.direction)), True
    return 0.0, False
