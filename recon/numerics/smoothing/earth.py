"""The Earth in axes n: East, North, Up at the anchor, carried along straight lines, fixed to the rotating Earth.

Axes n are never re-levelled: 100 km from the anchor the plumb line leans by 0.9 degrees in them. Positions go through
Earth-fixed coordinates and are exact at any distance. Arrays have their long axis last.

    g_l = (0, -c h sin 2 lat, -gamma(lat, h)),    g_n = R_ln^T g_l

with gamma the normal gravity, attraction plus centrifugal force, and the northern part the bend of the plumb line.

References
    Groves (2013), 2nd ed., eq. 2.140 (bend of the plumb line, after Moritz), eq. 2.150 (axes of the local level).
    NIMA TR8350.2 (2000), eq. 4-1 and 4-3 (normal gravity), by way of recon.numerics.geodesy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.geodesy import (
    EARTH_RATE,
    WGS84,
    Anchor,
    earth_rate_n,
    enu_to_geodetic,
    geodetic_to_enu,
    local_axes_e,
    normal_gravity,
)
from recon.numerics.smoothing.soa import Floats, mtm, mtv

__all__ = ["EARTH_RATE", "GravityField", "earth_rate_n", "geodetic", "gravity_n", "level_rotation", "positions_n"]

_BEND: Final = 8.08e-9
"""1/s^2; how fast gravity turns north of the ellipsoid's normal with height (Groves 2013, eq. 2.140)."""

_CHUNK: Final = 16_384
"""Positions worked on at a time: their arrays stay in the cache, which halves the time."""


def positions_n(lat_deg: Floats, lon_deg: Floats, height_m: Floats, anchor: Anchor) -> Floats:
    """Positions in axes n.

    lat_deg, lon_deg : (n,) deg; height_m : (n,) m
    returns : (3, n) m
    """
    return np.ascontiguousarray(geodetic_to_enu(lat_deg, lon_deg, height_m, anchor).T)


def geodetic(pos_n: Floats, anchor: Anchor) -> tuple[Floats, Floats, Floats]:
    """The inverse of `positions_n`: lat (n,) deg, lon (n,) deg in [-180, 180], height (n,) m.

    pos_n : (3, n) m
    """
    found = np.empty_like(pos_n)
    for start in range(0, pos_n.shape[1], _CHUNK):
        part = slice(start, start + _CHUNK)
        found[:, part] = enu_to_geodetic(pos_n[:, part].T, anchor)
    lat, lon, height = found
    return lat, lon, height


def level_rotation(pos_n: Floats, anchor: Anchor) -> Floats:
    """R_ln: takes axes n to East, North, Up at each place. Groves 2013, eq. 2.150.

    pos_n : (3, n) m
    returns : (3, 3, n)
    """
    lat, lon, _ = geodetic(pos_n, anchor)
    return mtm(local_axes_e(lat, lon), local_axes_e(anchor.lat, anchor.lon)[..., None])


def gravity_n(pos_n: Floats, anchor: Anchor) -> Floats:
    """Normal gravity at each place. The true one differs by up to about 2e-3 m/s^2 (anomalies).

    pos_n : (3, n) m, some tens of km high at most
    returns : (3, n) m/s^2, axes n
    """
    lat, _, height = geodetic(pos_n, anchor)
    north = -_BEND * height * np.sin(2.0 * np.radians(lat))
    gravity_l = np.stack([np.zeros_like(lat), north, -normal_gravity(lat, height)])
    return mtv(level_rotation(pos_n, anchor), gravity_l)


@dataclass(frozen=True)
class GravityField:
    """Gravity near n places, to first order in the distance from them: -g/R per metre aside, +2 g/R upwards.

    100 m away the rest is 3 g (100 m / R)^2 = 7e-9 m/s^2.

    pos_n : (3, n) m, the places; value_n : (3, n) m/s^2, gravity there
    """

    pos_n: Floats
    value_n: Floats

    @classmethod
    def around(cls, pos_n: Floats, anchor: Anchor) -> GravityField:
        """The field near the places pos_n (3, n) m."""
        return cls(pos_n, gravity_n(pos_n, anchor))

    def at(self, pos_n: Floats) -> Floats:
        """Gravity at pos_n (3, n) m, each near its place: (3, n) m/s^2, axes n."""
        away = pos_n - self.pos_n
        magnitude = np.sqrt((self.value_n * self.value_n).sum(axis=0))
        down = self.value_n / magnitude
        return np.asarray(self.value_n + magnitude / WGS84.a * (3.0 * down * (down * away).sum(axis=0) - away))
