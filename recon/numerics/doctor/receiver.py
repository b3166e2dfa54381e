"""What a GNSS receiver says of itself: from which north it counts, from which surface, and how good it claims to be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from typing import Final

import numpy as np

from recon.numerics.doctor.clocks import plane
from recon.numerics.doctor.finding import (
    Curve,
    Finding,
    Floats,
    Picture,
    confidence_of,
    confirmed,
    contradicted,
    unknown,
)
from recon.numerics.doctor.log import Claims, Gnss, pairs
from recon.numerics.signals import wrap_angle

_LEAST_SPEED: Final = 4.0
"""m/s, below which a course says little."""
_FEWEST: Final = 20
"""Fixes that a finding rests on."""
_FROM_EAST: Final = "anticlockwise from east"
_SPAN_S: Final = 2.0
"""Least time between two positions that tell a velocity."""
_OFF_DEG: Final = 3.0
"""From which a course is not from true north."""
_GEOID_M: Final = (8.0, 115.0)
"""Between ellipsoid and sea level: what may be mistaken for noise, and the most that there is on Earth."""
_TOO_GOOD: Final = 3.0
"""Times that errors may exceed what the receiver says before it is told."""


def _tracks(gnss: Gnss) -> tuple[Floats, Floats, Floats]:
    """Spans of about two seconds in motion: first and last row, (s,) int; displacement (s, 2) m."""
    east, north = plane(gnss)
    rows = np.flatnonzero(np.isfinite(east))
    t_s = gnss.t_s[rows]
    first, last = (rows[ends] for ends in pairs(t_s, _SPAN_S - 1e-6, 2.0 * _SPAN_S + 1.0))
    moved = np.column_stack([east[last] - east[first], north[last] - north[first]])
    far = np.linalg.norm(moved, axis=1) > _LEAST_SPEED * (gnss.t_s[last] - gnss.t_s[first])
    return first[far], last[far], moved[far]


def heading_kind(gnss: Gnss) -> Finding:
    """Is the course that from true north, clockwise, of the motion?"""
    code = "heading_kind"
    if not np.isfinite(gnss.course).any():
        return unknown(code, "GNSS tells no course.")
    course = gnss.course
    vector = np.arctan2(gnss.vel_n[:, 0], gnss.vel_n[:, 1])
    use = np.isfinite(course + vector) & (np.hypot(gnss.vel_n[:, 0], gnss.vel_n[:, 1]) > _LEAST_SPEED)
    if use.sum() >= _FEWEST:
        told, track, how, t_s = course[use], vector[use], "the vectors of velocity", gnss.t_s[use]
    else:
        first, last, moved = _tracks(gnss)
        middle = (first + last) // 2
        straight = np.isfinite(course[middle]) & (np.abs(wrap_angle(course[last] - course[first])) < np.radians(10.0))
        told, track = course[middle][straight], np.arctan2(moved[straight, 0], moved[straight, 1])
        how, t_s = "the way between the positions", gnss.t_s[middle][straight]
    if len(told) < _FEWEST:
        return unknown(
            code, "Too little straight driving with positions or vectors of velocity to compare the course with."
        )
    off, spread = _circular(told - track)
    mirrored, other = _circular(told + track)
    numbers = {"offset_deg": np.degrees(off), "spread_deg": np.degrees(spread)}
    picture = Picture(
        "Course less the direction of the way", "deg",
        (Curve("course as told", t_s, np.degrees(wrap_angle(told - track)), points=True),),
    )  # fmt: skip
    if spread > np.radians(0.8) and other < 0.4 * spread and other < np.radians(25.0):
        turned = np.degrees(mirrored)
        kind = _FROM_EAST if abs(turned - 90.0) < 15.0 else "anticlockwise"
        text = (
            f"The course counts {kind} (as mathematicians do), not clockwise from north: it turns to the other side "
            f"than {how}."
        )
        return contradicted(code, kind, text, **numbers).shown_by(picture)
    if spread > np.radians(40.0):
        text = (
            f"The course has little to do with {how}: it may be where the nose or the phone points rather than where "
            "the vehicle goes."
        )
        return contradicted(code, "not a course", text, **numbers).shown_by(picture)
    if abs(off) > np.radians(_OFF_DEG) and abs(off) > 3.0 * spread / np.sqrt(len(told) / 10.0 + 1.0):
        return _turned(code, float(np.degrees(off)), how, picture, numbers)
    text = f"The course is that of the motion from true north: it agrees with {how} to {abs(np.degrees(off)):.1f} deg."
    return confirmed(code, "course_true", text, **numbers)


def _turned(code: str, off: float, how: str, picture: Picture, numbers: Mapping[str, float]) -> Finding:
    if abs(off) < 35.0:
        text = (
            f"The course is {abs(off):.1f} deg off {how}, throughout: it counts from magnetic north (a compass "
            "needle) or is the heading of a box that is mounted at that angle, not the course from true north."
        )
        return contradicted(code, "magnetic", text, **numbers).shown_by(picture)
    kind = "reversed" if abs(abs(off) - 180.0) < 20.0 else f"turned by {off:.0f} deg"
    text = f"The course is {off:.0f} deg off {how}, throughout: it counts from elsewhere than north."
    return contradicted(code, kind, text, **numbers).shown_by(picture)


def _circular(angle: Floats) -> tuple[float, float]:
    """Median direction of angles, rad, and their spread about it (1.5 times the median distance)."""
    mean = float(np.angle(np.exp(1j * angle).mean()))
    centre = mean + float(np.median(wrap_angle(angle - mean)))
    return float(wrap_angle(centre)), 1.4826 * float(np.median(np.abs(wrap_angle(angle - centre))))


def lat_lon(gnss: Gnss) -> Finding:
    """Are latitude and longitude what they are called? By the direction in which speeds and courses say it went."""
    code = "lat_lon"
    if not np.isfinite(gnss.lat + gnss.lon).any():
        return unknown(code, "GNSS tells no positions.")
    known = np.isfinite(gnss.lat)
    if (np.abs(gnss.lat[known]) > 90.0).any():
        text = (
            "Latitudes exceed 90 deg, which no place on Earth has: latitude and longitude are swapped, or not in "
            "degrees."
        )
        return contradicted(code, "swapped", text, largest_deg=float(np.abs(gnss.lat[known]).max()))
    zero = float(((gnss.lat == 0.0) & (gnss.lon == 0.0)).sum())
    misses = {"as told": _miss(gnss)}
    misses["course from east"] = _miss(_from_east(gnss))
    misses["swapped"] = _miss(_swapped(gnss))
    misses["south is north"] = _miss(replace(gnss, lat=-gnss.lat))
    misses["west is east"] = _miss(replace(gnss, lon=-gnss.lon))
    known_misses = {name: miss for name, miss in misses.items() if np.isfinite(miss)}
    numbers = {f"miss_{name.replace(' ', '_')}": miss for name, miss in known_misses.items()}
    numbers["rows_at_0_0"] = zero
    if not np.isfinite(misses["as told"]):
        return unknown(code, "GNSS tells no courses at speed to compare the positions with.", **numbers)
    best = min(known_misses, key=known_misses.__getitem__)
    if best == "as told" or misses[best] > 0.5 * misses["as told"] or misses["as told"] < 0.3:
        return confirmed(code, "as told", "Positions move the way that speed and course say.", **numbers)
    if best == "course from east":
        text = "Positions move the way that speed says, and the course where it counts as heading_kind tells."
        return confirmed(code, "as told", text, **numbers)
    what = "Latitude and longitude are swapped" if best == "swapped" else f"A sign is wrong ({best})"
    text = (
        f"{what}: speeds and courses fit the positions that way and do not as they stand. The map would show the "
        "drive mirrored, in another country."
    )
    return contradicted(code, best, text, **numbers)


def placed(gnss: Gnss, places: Finding) -> Gnss:
    """The fixes with latitude and longitude in their places, where `lat_lon` found them swapped."""
    right = _swapped(gnss)
    swapped = places.status == "contradicted" and places.value == "swapped"
    return right if swapped and np.isfinite(right.lat).any() else gnss


def clockwise(gnss: Gnss, kind: Finding) -> Gnss:
    """The fixes with the course clockwise from north, where `heading_kind` found it anticlockwise from east."""
    return _from_east(gnss) if kind.value == _FROM_EAST else gnss


def _from_east(gnss: Gnss) -> Gnss:
    return replace(gnss, course=0.5 * np.pi - gnss.course)


def _swapped(gnss: Gnss) -> Gnss:
    return replace(gnss, lat=np.where(np.abs(gnss.lon) < 90.0, gnss.lon, np.nan), lon=gnss.lat)


def _miss(gnss: Gnss) -> float:
    """Median distance between the ways by positions and by velocities, as a share of the latter; NaN if not known."""
    first, last, moved = _tracks(gnss)
    course, speed = gnss.direction, gnss.over_ground
    course = np.where(speed > _LEAST_SPEED, course, np.nan)
    length = gnss.t_s[last] - gnss.t_s[first]
    middle = (
        0.5 * length * np.array([f(course[rows]) * speed[rows] for rows in (first, last) for f in (np.sin, np.cos)])
    )
    way = np.column_stack([middle[0] + middle[2], middle[1] + middle[3]])
    known = np.isfinite(way).all(axis=1)
    if known.sum() < _FEWEST:
        return float("nan")
    return float(np.median(np.linalg.norm(moved[known] - way[known], axis=1) / np.linalg.norm(way[known], axis=1)))


def height_datum(heights: Mapping[str, tuple[Floats, Floats]], claims: Claims) -> Finding:
    """Do all sources of height count from the same surface?"""
    code = "height_datum"
    for one, other in combinations(heights, 2):
        (t_s, first), (at_s, second) = heights[one], heights[other]
        both = (
            np.interp(t_s, at_s[np.isfinite(second)], second[np.isfinite(second)], np.nan, np.nan)
            if np.isfinite(second).sum() > 5
            else np.full(len(t_s), np.nan)
        )
        off = first - both
        off = off[np.isfinite(off)]
        if len(off) < 10:
            continue
        middle, spread = float(np.median(off)), float(1.4826 * np.median(np.abs(off - np.median(off))))
        numbers = {"difference_m": middle, "spread_m": spread}
        if _GEOID_M[0] < abs(middle) < _GEOID_M[1] and spread < 0.25 * abs(middle):
            text = (
                f"Heights of {one} and {other} differ by {abs(middle):.1f} m throughout: one counts from the ellipsoid "
                "that satellites know, the other from sea level."
            )
            return contradicted(code, round(middle, 1), text, **numbers)
        text = (
            f"Heights of {one} and {other} agree to {max(abs(middle), 0.1):.1f} m: both count from the same surface. "
            f"Which one that is they do not tell; {_taken(claims)}."
        )
        return confirmed(code, round(middle, 1), text, **numbers)
    if not any(np.isfinite(height).any() for _, height in heights.values()):
        return unknown(code, "The log holds no heights.")
    text = (
        "A single source of heights does not tell whether it counts from the ellipsoid or from sea level (up to 100 m "
        f"apart); {_taken(claims)}."
    )
    return unknown(code, text)


def _taken(claims: Claims) -> str:
    """From where heights are taken to count."""
    surface = {"ellipsoid": "the ellipsoid", "mean_sea_level": "mean sea level"}.get(claims.height_datum)
    return f"they are taken to count from {surface}" if surface else "the log does not say which is meant"


def gnss_sigma(gnss: Gnss) -> Finding:
    """Are errors as small as the receiver says? By how positions jump against velocities; slow ones do not show."""
    code = "gnss_sigma"
    told = np.hypot(gnss.pos_std[:, 0], gnss.pos_std[:, 1]) / np.sqrt(2.0)
    east, north = plane(gnss)
    vel = gnss.over_ground[:, None] * np.column_stack([np.sin(gnss.direction), np.cos(gnss.direction)])
    rows = np.flatnonzero(np.isfinite(told + east) & np.isfinite(vel).all(axis=1) & (told > 0.0))
    if not (np.isfinite(told) & (told > 0.0)).any():
        return unknown(code, "The receiver does not say how good its positions are.")
    if len(rows) < 30:
        return unknown(code, "Too few positions with velocities to see how they jump.")
    t_s, place, vel = gnss.t_s[rows], np.column_stack([east, north])[rows], vel[rows]
    step = np.diff(t_s)
    near = (step < 3.0 * np.median(step))[:-1] & (step < 3.0 * np.median(step))[1:]
    jump = np.diff(place, axis=0) - 0.5 * (vel[1:] + vel[:-1]) * step[:, None]
    second = np.diff(jump, axis=0)[near] / np.sqrt(6.0)  # of white errors with one sigma; slow ones cancel
    if len(second) < 20:
        return unknown(code, "Too few positions in a row to see how they jump.")
    white = float(1.4826 * np.median(np.abs(second)))
    wide = float(np.percentile(np.linalg.norm(second, axis=1), 90.0) / 2.146)
    model = float(np.median(step)) ** 2 * 0.15  # m, by what the speed between two fixes is not known
    usual = float(np.median(told[rows]))
    numbers = {"told_m": usual, "seen_m": white, "seen_90_m": wide, "model_m": model}
    ratio = np.sqrt(max(white**2 - model**2, 0.0)) / usual
    if ratio < _TOO_GOOD:
        text = (
            f"The receiver says {usual:.2g} m; positions jump by {white:.2g} m, which does not contradict it. (An "
            "error that changes slowly does not show.)"
        )
        return confirmed(code, round(ratio, 2), text, **numbers)
    text = (
        f"The receiver says that its positions are good to {usual:.2g} m, and they jump by {white:.2g} m from fix to "
        f"fix: {ratio:.0f} times as much. Trust it less."
    )
    return contradicted(code, round(ratio, 1), text, confidence_of(ratio), **numbers)
