"""The stream reference of solutions of GNSS and IMU: places, velocities and attitudes as columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from recon.numerics.geodesy import geodetic_to_enu
from recon.numerics.rotation import from_euler
from recon.tables import Array
from recon_readers._arrays import first_place

_STRETCH: Final = 1 << 17
"""Rows that are computed at a time: what is needed on the way stays small."""
_FARTHEST: Final = (90.0, 360.0, 1e5)
"""deg, deg, m of what can be a place."""


def reference_columns(
    place: Sequence[Array], vel_n: Sequence[Array], angles: Sequence[Array]
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns and facts of the stream reference; both empty where no place is known.

    place : lat, lon deg, height m above the ellipsoid; vel_n : m/s east, north, up; angles : yaw, pitch, roll rad of
    ISO 8855; (n,) each, NaN where unknown
    """
    lat, lon, height = _known_places(place)
    first = np.flatnonzero(np.isfinite(lat))[:1]
    anchor = first_place(np.column_stack([lat[first], lon[first], height[first]]))
    if anchor is None:
        return {}, {}
    pos = by_stretches(lambda *at: geodetic_to_enu(at[0], at[1], at[2], anchor), 3, lat, lon, height)
    q = by_stretches(from_euler, 4, *angles)
    facts = {"anchor": asdict(anchor), "earth": "wgs84", "height_datum": "ellipsoid"}
    columns = {f"pos_{axis}": values for axis, values in zip("enu", pos, strict=True)}
    columns |= {f"vel_{axis}": values for axis, values in zip("enu", vel_n, strict=True)}
    columns |= {f"q{part}": values for part, values in zip("wxyz", q, strict=True)}
    return {**columns, "lat": lat, "lon": lon, "height": height}, facts


def _known_places(place: Sequence[Array]) -> list[Array]:
    """The columns, NaN in rows where one of them can be no place."""
    with np.errstate(invalid="ignore"):
        good = np.logical_and.reduce([np.abs(values) <= limit for values, limit in zip(place, _FARTHEST, strict=True)])
    return list(place) if good.all() else [np.where(good, values, np.nan) for values in place]


def by_stretches(make: Callable[..., Array], width: int, *columns: Array) -> list[Array]:
    """The `width` columns, (n,) each, of what is made of columns, (n,) each, a stretch of rows at a time."""
    rows = len(columns[0])
    found = [np.empty(rows) for _ in range(width)]
    for start in range(0, rows, _STRETCH):
        part = make(*(values[start : start + _STRETCH] for values in columns))
        for into, values in zip(found, part.T, strict=True):
            into[start : start + _STRETCH] = values
    return found
