"""GNSS positions approximated rather than interpolated: a smoothing spline, stiff where the vehicle stands or is slow.

The fixes of a standing receiver wander in a star of metres about the place, for its error changes with satellites and
atmosphere. No vehicle moves so. Each axis of the positions is approximated by the spline of recon.numerics.spline,

    fix = position + slow error + white error,    position'' = white noise of density a,
    a = acceleration * clip(speed / slow_speed, 0.01, 1),

with the reported speed. So at a stop the spline cannot bend and stands; in motion it bends as a car does. The slow
error is estimated beside the position: what wanders at a stop is its change. Without it the wander would be pushed
into the drive before and behind the stop. The reported speed and course, which come from the Doppler shift, are
measurements of the spline's derivative; in each event `standstill` it is zero.

Put this step behind filter.gnss_kinematics, which leaves out positions that cannot be. Do not put it before fuser.map,
which knows these errors itself and would count a fix that has seen its neighbours as a fresh one.

References
    Reinsch (1967), "Smoothing by spline functions", Numerische Mathematik 10, 177-183.
    Thesis, chapter 9.1: approximation of GNSS in place of interpolation.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    GNSS,
    SAME,
    Array,
    Filter,
    Metric,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    meta,
    metrics,
    quantity,
    replace,
    time_ns,
    vector,
    warning,
)
from recon.numerics.geodesy import enu_to_geodetic
from recon.numerics.signals import differentiate
from recon.numerics.spline import smoothing_spline
from recon.placing import EARTHS, anchor_of, rows_during
from recon.tables import vector_or_nan

_STIFFEST = 0.01
"""Of the density in motion, at rest: 1 cm/s^1.5 lets a spline that stands creep by 3 cm in 100 s."""
_STANDING = 0.01
"""m/s, sigma of the zero velocity in a standstill."""
_UP = (1.0, 1.0, 0.3)
"""Density of the acceleration east, north and up, relative to the horizontal: roads are flat."""
_HIGHER = (1.0, 1.0, 1.75)
"""Sigma of a position east, north and up where none is reported, relative to the horizontal."""


class GnssSmoothParams(Params):
    """Parameters of filter.gnss_smooth."""

    sigma: float = quantity(2.0, "m", gt=0, doc="Of a horizontal position on each axis, where gnss tells no pos_std.")
    white: float = quantity(
        25.0, "%", gt=0, le=100, doc="Share of that sigma which is new in every fix; the rest is slow."
    )
    correlation: float = quantity(100.0, "s", gt=0, doc="Time in which the slow error changes.")
    velocity_sigma: float = quantity(0.15, "m/s", gt=0, doc="Of the reported speed and course, on each axis.")
    acceleration: float = quantity(1.0, "m/s^2", gt=0, doc="How much a vehicle in motion accelerates, over a second.")
    slow_speed: float = quantity(5.0, "km/h", gt=0, doc="Below this the spline is stiffer, the more the slower.")


class Moving(NamedTuple):
    """What gnss and events tell of the motion at n fixes: velocity (n, 3) m/s local, its sigma, speed m/s or NaN."""

    vel_n: Array
    sigma: Array
    speed: Array


def gnss_smooth(*, gnss: pa.Table, events: pa.Table | None, params: GnssSmoothParams) -> Streams:
    """The gnss with pos smoothed, lat, lon and height moved with it, and vel and acc the spline's own.

    gnss : pos m, local; lat, lon deg, height m, vel m/s, acc m/s^2 are replaced where they are there and known; speed
        m/s, course rad and pos_std m are used. Rows without pos stay as they are.
    events : those of kind standstill count
    """
    pos_n = matrix(gnss, "pos", gaps=True)
    rows = np.flatnonzero(np.isfinite(pos_n[:, :2]).all(axis=1))
    if len(rows) < 3:
        none = warning("fewer than three positions in gnss: nothing is smoothed")
        return {"gnss": gnss, "metrics": metrics([none])}
    t_ns = time_ns(gnss)[rows]
    t_s = (t_ns - t_ns[0]) * 1e-9
    moving = _moving(gnss, events, rows, params)
    smooth_n, vel_n = _splines(t_s, pos_n[rows], _sigmas(gnss, rows, params), moving, params)
    groups = {"pos": smooth_n, "vel": vel_n}
    if has(gnss, "acc"):
        groups["acc"] = differentiate(t_s, vel_n)
    moved = _placed(_replaced(gnss, rows, groups), rows)
    by = np.linalg.norm((smooth_n - pos_n[rows])[:, :2], axis=1)
    learnt = [
        Metric("positions_smoothed", float(len(rows)), note=f"of {gnss.num_rows} rows"),
        Metric("positions_moved_rms", float(np.sqrt(np.mean(by**2))), "m", note="horizontally"),
        Metric("positions_standing", float((moving.sigma[:, 0] <= _STANDING).sum()), note="in events of standstill"),
    ]
    return {"gnss": moved, "metrics": metrics(learnt)}


def _moving(gnss: pa.Table, events: pa.Table | None, rows: NDArray[np.intp], params: GnssSmoothParams) -> Moving:
    vel_n, sigma = np.zeros((len(rows), 3)), np.full((len(rows), 3), np.inf)
    speed = vector_or_nan(gnss, "speed")[rows]
    if has(gnss, "speed") and has(gnss, "course"):
        course = vector(gnss, "course", gaps=True)[rows]
        vel_n[:, 0], vel_n[:, 1] = speed * np.sin(course), speed * np.cos(course)
        sigma[np.isfinite(vel_n[:, 0]), :2] = params.velocity_sigma
    standing = np.zeros(gnss.num_rows, dtype=bool)
    for start, stop in rows_during(gnss, events, "standstill"):
        standing[start:stop] = True
    vel_n[standing[rows]], sigma[standing[rows]], speed[standing[rows]] = 0.0, _STANDING, 0.0
    return Moving(vel_n, sigma, speed)


def _sigmas(gnss: pa.Table, rows: NDArray[np.intp], params: GnssSmoothParams) -> Array:
    """Sigma of each position: (n, 3) m."""
    usual = np.tile(params.sigma * np.array(_HIGHER), (len(rows), 1))
    if not has(gnss, "pos_std"):
        return usual
    told = matrix(gnss, "pos_std", gaps=True)[rows]
    return np.asarray(np.where(told > 0.0, told, usual))


def _splines(t_s: Array, pos_n: Array, sigma: Array, moving: Moving, params: GnssSmoothParams) -> tuple[Array, Array]:
    """Position and velocity (n, 3) m and m/s, local; NaN where a component of the position is not known."""
    faster = np.fmax(moving.speed[1:], moving.speed[:-1])
    stiff = np.clip(np.nan_to_num(faster / params.slow_speed, nan=1.0), _STIFFEST, 1.0)
    smooth_n, vel_n = np.full_like(pos_n, np.nan), np.full_like(pos_n, np.nan)
    for axis in range(3):
        known = np.isfinite(pos_n[:, axis])
        if known.any():
            found = smoothing_spline(
                t_s,
                pos_n[:, axis],
                moving.vel_n[:, axis],
                white=np.where(known, params.white * sigma[:, axis], np.inf),
                rate_sigma=moving.sigma[:, axis],
                bend=params.acceleration * _UP[axis] * stiff,
                slow=float(np.median(sigma[:, axis])),
                correlation_s=params.correlation,
            )
            smooth_n[known, axis], vel_n[known, axis] = found[0][known], found[1][known]
    return smooth_n, vel_n


def _replaced(gnss: pa.Table, rows: NDArray[np.intp], groups: dict[str, Array]) -> pa.Table:
    """The table with other values (m, 3) in these rows of the groups, where some were known."""
    for group, values in groups.items():
        if has(gnss, group):
            column = matrix(gnss, group, gaps=True)
            column[rows] = np.where(np.isfinite(column[rows]), values, np.nan)
            gnss = replace(gnss, **{group: column})
    return gnss


def _placed(gnss: pa.Table, rows: NDArray[np.intp]) -> pa.Table:
    """The table with lat, lon and height in these rows those of pos, where the anchor is known and they were there."""
    anchor = anchor_of(gnss)
    if anchor is None:
        return gnss
    pos_n = matrix(gnss, "pos", gaps=True)[rows]
    place = enu_to_geodetic(np.nan_to_num(pos_n), anchor, EARTHS[meta(gnss).get("earth", "wgs84")])
    for name, values in zip(("lat", "lon", "height"), place, strict=True):
        if has(gnss, name):
            column = vector(gnss, name, gaps=True).copy()
            column[rows] = np.where(np.isfinite(column[rows] + pos_n[:, 2]), values, column[rows])
            gnss = replace(gnss, **{name: column})
    return gnss


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.gnss_smooth."""
    yield Filter(
        name="gnss_smooth",
        summary="GNSS positions approximated by a spline that stands at stops.",
        params=GnssSmoothParams,
        reads={
            "gnss": GNSS.need(
                "pos", maybe=("lat", "lon", "height", "speed", "course", "vel", "acc", "pos_std"), frame="local"
            ),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
        },
        writes={"gnss": SAME},
        run=gnss_smooth,
        references=("Reinsch (1967), Numerische Mathematik 10, 177-183",),
    )
