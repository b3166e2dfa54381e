"""GNSS positions in local metres, with velocity and acceleration.

    pos_n = R_ne (x_e(lat, lon, height) - x_e(anchor)),    vel_n = d pos_n / dt,    acc_n = d vel_n / dt

The anchor is the first valid fix. Derivatives are those of the parabola through three neighbouring fixes, so they
are of second order at irregular times; none is taken across an outage, where velocity would be invented. A receiver's
own velocity comes from the Doppler shift: it is less noisy than differences of positions, but many receivers filter
it and report it late.

Positions that a logger repeats between two reports, those that no vehicle could have driven through, and those that
the receiver's own speed refutes are left out (null): see _plausible.py. A derived speed that disagrees strongly with
the reported one gives a warning.

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., eq. 2.112
    and 2.158: the local frame.
    The sphere of 6 371 000 m serves comparisons with programs that use it; distances differ by up to 0.6 %.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    GNSS,
    Array,
    Change,
    Column,
    Filter,
    Metric,
    Params,
    Schema,
    Streams,
    has,
    hookimpl,
    matrix,
    meta,
    metrics,
    quantity,
    replace,
    setting,
    time_ns,
    vector,
    warning,
    with_meta,
)
from recon.agreement import agreement, as_metrics
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.signals import differentiate
from recon.placing import EARTHS, moment
from recon.tables import vector_or_nan
from recon_filters._plausible import drivable, reach, reported, scatter

_ADDED = ("pos", "vel", "acc")
_TWO_DIMENSIONAL = 2
"""Lowest value of the column fix at which a receiver claims to know where it is."""
_FEW = 0.1
"""Share of positions that may contradict the reported speed: where more do, it is the speed that is wrong."""


class GnssKinematicsParams(Params):
    """Parameters of filter.gnss_kinematics."""

    earth: Literal["wgs84", "sphere"] = setting("wgs84", doc="Figure of the Earth; sphere is one of 6 371 000 m.")
    velocity: Literal["derived", "reported"] = setting(
        "derived", doc="From differences of positions, or as the receiver reports it (vel, else speed and course)."
    )
    max_gap: float = quantity(
        1.5, "s", gt=0, le=3600, doc="Fixes further apart are an outage, across which nothing is derived."
    )
    max_speed: float = quantity(
        400.0,
        "km/h",
        gt=0,
        le=1e5,
        doc="Positions that could only be reached faster are left out; noise may explain 15 m, or what fixes scatter.",
    )


class Placed(NamedTuple):
    """The anchor, positions (n, 3) m local with NaN in other rows, and what had to be assumed."""

    anchor: Anchor
    pos: Array
    notes: list[Metric]


def gnss_kinematics(*, gnss: pa.Table, params: GnssKinematicsParams) -> Streams:
    """Add pos, vel and acc, each (n, 3) m, m/s, m/s^2, local; null where unknown.

    gnss : lat, lon deg; height m, speed m/s, course rad, vel m/s, fix where they are there
    returns : gnss with anchor {lat, lon deg, height m} and earth in its metadata; without positions its values are
        unchanged and a warning tells
    """
    fixed = _fixed(gnss)
    if not fixed.any():
        return _without_positions(gnss)
    t_ns, gap_ns = time_ns(gnss), round(params.max_gap * 1e9)
    fixed, (anchor, pos, notes), left_out = _believed(gnss, fixed, params)
    derived = _derivative(t_ns, pos, gap_ns)
    vel, more_notes = _velocities(gnss, derived, params)
    acc = _derivative(t_ns, vel, gap_ns)
    learnt = [
        Metric("anchor_lat", anchor.lat, "deg"),
        Metric("anchor_lon", anchor.lon, "deg"),
        Metric("anchor_height", anchor.height, "m"),
        Metric("positions", float(fixed.sum()), note=f"of {len(fixed)} rows"),
        Metric("outages", float((np.diff(t_ns[fixed]) > gap_ns).sum()), note=f"longer than {params.max_gap:g} s"),
        Metric("velocities", float(np.isfinite(vel).all(axis=1).sum()), note=f"of {len(fixed)} rows"),
    ]
    moved = with_meta(replace(gnss, pos=pos, vel=vel, acc=acc), anchor=dataclasses.asdict(anchor), earth=params.earth)
    return {"gnss": moved, "metrics": metrics([*learnt, *left_out, *notes, *more_notes, *_compared(gnss, derived)])}


def _fixed(gnss: pa.Table) -> NDArray[np.bool_]:
    """Rows with a valid fix: a latitude and a longitude that the receiver does not itself disown."""
    if not {"lat", "lon"} <= set(gnss.column_names):
        return np.zeros(gnss.num_rows, dtype=bool)
    fixed = np.isfinite(vector(gnss, "lat", gaps=True) + vector(gnss, "lon", gaps=True))
    if "fix" in gnss.column_names:
        fixed &= ~(vector(gnss, "fix", gaps=True) < _TWO_DIMENSIONAL)
    return np.asarray(fixed)


def _believed(
    gnss: pa.Table, fixed: NDArray[np.bool_], params: GnssKinematicsParams
) -> tuple[NDArray[np.bool_], Placed, list[Metric]]:
    """The rows with a newly reported position that can be driven through, where they are, and what was left out."""
    t_ns, rows = time_ns(gnss), np.flatnonzero(fixed)
    place = np.column_stack([vector(gnss, name, gaps=True)[rows] for name in ("lat", "lon")])
    new = reported(t_ns[rows], place, round(params.max_gap * 1e9))
    held, rows = int((~new).sum()), rows[new]
    placed = _positions(gnss, rows, params)
    t_s = (t_ns[rows] - t_ns[rows[0]]) * 1e-9
    scatter_m = scatter(t_s, placed.pos[rows], params.max_gap)
    good = drivable(t_s, placed.pos[rows], params.max_speed, scatter_m)
    learnt = [Metric("positions_repeated", float(held), note="between two reports: left out")]
    learnt.append(Metric("positions_scatter", scatter_m, "m", note="from fix to fix, that noise may explain"))
    learnt.append(Metric("positions_impossible", float((~good).sum()), note="too far apart in too short a time"))
    if not good.all():
        why = f"can only be reached faster than {params.max_speed * 3.6:g} km/h"
        learnt.append(_left_out(t_ns, rows, good, why))
    if has(gnss, "speed"):
        reach_m = reach(t_s, vector(gnss, "speed", gaps=True)[rows], params.max_speed, params.max_gap)
        agreeing = drivable(t_s, placed.pos[rows, :2], params.max_speed, scatter_m, reach_m)
        if 0.0 < np.mean(good & ~agreeing) <= _FEW:
            learnt.append(_left_out(t_ns, rows, agreeing | ~good, "contradict the speed that gnss itself tells"))
            good &= agreeing
    if not good.all():
        rows = rows[good]
        placed = _positions(gnss, rows, params)
    believed = np.zeros(len(t_ns), dtype=bool)
    believed[rows] = True
    return believed, placed, learnt


def _left_out(t_ns: NDArray[np.int64], rows: NDArray[np.intp], good: NDArray[np.bool_], why: str) -> Metric:
    bad = rows[~good]
    first = moment(t_ns, int(bad[0]))
    return warning(f"{len(bad)} of {len(rows)} gnss positions {why} and are left out, first at {first}")


def _compared(gnss: pa.Table, derived: Array) -> list[Metric]:
    """How the speed of the positions compares with the one that the receiver reports."""
    if not has(gnss, "speed"):
        return []
    t_ns, speed = time_ns(gnss), np.hypot(derived[:, 0], derived[:, 1])
    found = agreement(t_ns, speed, t_ns, vector(gnss, "speed", gaps=True))
    return as_metrics(found, "the speed of gnss positions", "the reported gnss speed")


def _without_positions(gnss: pa.Table) -> Streams:
    """The same stream; where it has empty columns of positions, the promised columns are added, empty as well."""
    if {"lat", "lon"} <= set(gnss.column_names):
        unknown = np.full((gnss.num_rows, 3), np.nan)
        gnss = replace(gnss, **{group: unknown for group in _ADDED if f"{group}_e" not in gnss.column_names})
    none = Metric("positions", 0.0, note="no positions in gnss: it is left as it is")
    return {"gnss": gnss, "metrics": metrics([none])}


def _positions(gnss: pa.Table, rows: NDArray[np.intp], params: GnssKinematicsParams) -> Placed:
    """Where these rows of gnss, the first of them the anchor, are in local metres."""
    lat, lon = (vector(gnss, name, gaps=True)[rows] for name in ("lat", "lon"))
    height, notes = _heights(gnss, rows)
    anchor = Anchor(float(lat[0]), float(lon[0]), float(height[0]))
    pos = np.full((gnss.num_rows, 3), np.nan)
    pos[rows] = geodetic_to_enu(lat, lon, height, anchor, EARTHS[params.earth])
    return Placed(anchor, pos, notes)


def _heights(gnss: pa.Table, rows: NDArray[np.intp]) -> tuple[Array, list[Metric]]:
    """Height of each fix: (m,) m. Missing ones are filled from their neighbours in time, and that is said."""
    height = vector_or_nan(gnss, "height")[rows]
    known = np.isfinite(height)
    if known.all():
        return height, []
    if not known.any():
        return np.zeros(len(rows)), [warning("no height in gnss: 0 m is used")]
    t_ns = time_ns(gnss)[rows]
    t_s = (t_ns - t_ns[0]) * 1e-9
    filled = np.interp(t_s, t_s[known], height[known])
    return filled, [warning(f"height is missing in {int((~known).sum())} fixes: filled from the fixes around them")]


def _velocities(gnss: pa.Table, derived: Array, params: GnssKinematicsParams) -> tuple[Array, list[Metric]]:
    """Velocity (n, 3) m/s local as asked for, and how it was found."""
    if params.velocity == "derived":
        return derived, [Metric("velocity", method="derived from positions")]
    if has(gnss, "vel"):
        return matrix(gnss, "vel", gaps=True), [Metric("velocity", method="reported vel")]
    if has(gnss, "speed") and has(gnss, "course"):
        speed, course = vector(gnss, "speed", gaps=True), vector(gnss, "course", gaps=True)
        vel = np.column_stack((speed * np.sin(course), speed * np.cos(course), derived[:, 2]))
        notes = [Metric("velocity", method="reported speed and course", note="vertical part from heights")]
        if meta(gnss).get("heading_kind") == "magnetic":
            notes.append(warning("course is from magnetic north: velocity is turned by the declination"))
        return vel, notes
    return derived, [warning("gnss reports neither vel nor speed and course: velocity is derived from positions")]


def _derivative(t_ns: NDArray[np.int64], y: Array, gap_ns: int) -> Array:
    """Derivative of y (n, 3) between outages; NaN where y is, and at a sample that stands alone."""
    rows = np.flatnonzero(np.isfinite(y).all(axis=1))
    result = np.full_like(y, np.nan)
    for piece in np.split(rows, np.flatnonzero(np.diff(t_ns[rows]) > gap_ns) + 1):
        if len(piece):
            result[piece] = differentiate((t_ns[piece] - t_ns[piece[0]]) * 1e-9, y[piece])
    return result


def _plan(schemas: Mapping[str, Schema], params: GnssKinematicsParams) -> dict[str, Schema]:
    """The columns are as certain as those of lat and lon; a column that is already certain stays so."""
    here = schemas["gnss"]
    if not {"lat", "lon"} <= set(here.names):
        return {"gnss": here}
    uncertain = here["lat"].optional or here["lon"].optional

    def added(column: Column) -> Column:
        certain = column.name in here and not here[column.name].optional
        return dataclasses.replace(column, optional=uncertain and not certain)

    return {"gnss": Change(adds=tuple(added(column) for column in GNSS.columns_of(*_ADDED))).apply(here)}


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.gnss_kinematics."""
    yield Filter(
        name="gnss_kinematics",
        summary="GNSS positions in local metres, with velocity and acceleration.",
        params=GnssKinematicsParams,
        reads={"gnss": GNSS.need(maybe=("lat", "lon", "height", "speed", "course", "vel", "fix"))},
        writes={"gnss": Change(adds=GNSS.columns_of(*_ADDED))},
        run=gnss_kinematics,
        version=3,
        plan=_plan,
        references=("Groves (2013), Principles of GNSS, inertial, and multisensor integrated navigation systems",),
    )
