"""The Earth in axes n against pymap3d and a gravity field in spherical harmonics."""

from __future__ import annotations

from functools import partial

import numpy as np
import pymap3d
import pytest
from numpy.testing import assert_allclose

from recon.numerics.geodesy import EARTH_RATE, WGS84, Anchor, geodetic_to_ecef
from recon.numerics.smoothing.earth import GravityField, geodetic, gravity_n, level_rotation, positions_n

assert_within = partial(assert_allclose, rtol=0.0)
EPS = np.finfo(float).eps
ANCHOR = Anchor(lat=44.5, lon=11.3, height=60.0)
# Earth-fixed coordinates of 6.4e6 m, rounded a few times: 1e-8 m.
ROUNDING_M = 20 * EPS * 6.4e6


def places(reach: float, n: int = 50) -> np.ndarray:
    """Points up to `reach` metres east and north of the anchor, from below sea level to 5 km: (3, n) m."""
    rng = np.random.default_rng(7)
    lat, lon = ANCHOR.lat + rng.uniform(-1, 1, n) * reach / 1.1e5, ANCHOR.lon + rng.uniform(-1, 1, n) * reach / 0.8e5
    return positions_n(lat, lon, rng.uniform(-400.0, 5000.0, n), ANCHOR)


def ecef_axes(anchor: Anchor) -> np.ndarray:
    """Rotation from axes n to Earth-fixed, from pymap3d's vectors of east, north and up."""
    axes = [pymap3d.enu2uvw(*unit, anchor.lat, anchor.lon) for unit in np.eye(3)]
    return np.array(axes).T


@pytest.mark.parametrize("reach", [1e3, 5e5])
def test_positions_are_those_of_pymap3d_and_survive_the_round_trip_500_km_away(reach):
    pos_n = places(reach)
    lat, lon, height = geodetic(pos_n, ANCHOR)
    expected = pymap3d.geodetic2enu(lat, lon, height, ANCHOR.lat, ANCHOR.lon, ANCHOR.height)
    assert pos_n.flags.c_contiguous
    assert_within(pos_n, expected, atol=ROUNDING_M)
    assert_within(positions_n(lat, lon, height, ANCHOR), pos_n, atol=ROUNDING_M)


def test_many_positions_are_those_of_each_alone():
    pos_n = places(5e5, 40_000)
    some = np.array([0, 16_383, 16_384, 39_999])
    np.testing.assert_allclose(
        np.array(geodetic(pos_n, ANCHOR))[:, some], geodetic(pos_n[:, some], ANCHOR), rtol=0, atol=ROUNDING_M
    )


def test_level_is_that_of_the_axes_at_the_anchor_and_leans_with_the_distance():
    here = level_rotation(np.zeros((3, 1)), ANCHOR)[..., 0]
    assert_within(here, np.eye(3), atol=10 * EPS)
    pos_n = places(5e5)
    lat, lon, _ = geodetic(pos_n, ANCHOR)
    rot_ln = level_rotation(pos_n, ANCHOR)
    assert rot_ln.shape == (3, 3, 50)
    for i in range(50):
        expected = ecef_axes(Anchor(lat[i], lon[i], 0.0)).T @ ecef_axes(ANCHOR)
        assert_within(rot_ln[..., i], expected, atol=10 * EPS)


def potential(pos_e: np.ndarray) -> np.ndarray:
    """Of attraction and rotation of the WGS84 ellipsoid, zonal harmonics to degree 6: pos_e (..., 3) m, m^2/s^2."""
    gm, zonals = 3.986004418e14, {2: 1.082629821e-3, 4: -2.370911e-6, 6: 6.083e-9}
    r = np.linalg.norm(pos_e, axis=-1)
    zonal = sum(
        j * (WGS84.a / r) ** n * np.polynomial.legendre.legval(pos_e[..., 2] / r, np.eye(n + 1)[n])
        for n, j in zonals.items()
    )
    return gm / r * (1.0 - zonal) + 0.5 * EARTH_RATE**2 * (pos_e[..., 0] ** 2 + pos_e[..., 1] ** 2)


@pytest.mark.parametrize("lat", [0.0, 44.5, -60.0, 89.0])
def test_gravity_is_the_gradient_of_the_potential_of_the_rotating_ellipsoid(lat):
    anchor = Anchor(lat, 11.3, 0.0)
    height = np.array([-400.0, 0.0, 1000.0, 3000.0])
    pos_n = positions_n(np.full(4, lat + 0.01), np.full(4, 11.31), height, anchor)
    origin, axes, step = geodetic_to_ecef(lat, 11.3, 0.0), ecef_axes(anchor), 500.0
    ahead = np.array([[potential(origin + axes @ (p + s)) for p in pos_n.T] for s in step * np.eye(3)])
    behind = np.array([[potential(origin + axes @ (p - s)) for p in pos_n.T] for s in step * np.eye(3)])
    # The potential of 6e7 rounds to 7e-9, the difference over 1 km to 3e-11; its third derivative of 9.8 * 6 / R^2
    # adds 500^2 / 6 times that: 6e-8. Eq. 4-3 leaves out 3 f^2 h/a and 4 (h/a)^3 of gravity: 2e-7 at 3 km. The bend
    # of the plumb line is given to three digits and holds to first order in f: 1 % of 2.4e-5 at 3 km.
    assert_within(gravity_n(pos_n, anchor), (ahead - behind) / (2 * step), atol=6e-7)


def test_gravity_turns_with_the_place_in_axes_that_do_not():
    pos_n = positions_n(np.array([ANCHOR.lat + 1.0]), np.array([ANCHOR.lon]), np.array([0.0]), ANCHOR)
    east, north, up = gravity_n(pos_n, ANCHOR)[:, 0]
    # One degree further north, on the ellipsoid, the plumb line points one degree south of straight down.
    assert_within(np.degrees(np.arctan2(-north, -up)), 1.0, atol=1e-12)
    assert_within(east, 0.0, atol=1e-14)


def test_field_to_first_order_agrees_with_gravity_nearby():
    places_n = places(5e5)
    field = GravityField.around(places_n, ANCHOR)
    away = np.random.default_rng(3).normal(0.0, 1.0, places_n.shape)
    away *= 100.0 / np.linalg.norm(away, axis=0)
    found, expected = field.at(places_n + away), gravity_n(places_n + away, ANCHOR)
    # Gradients of a sphere: those of the ellipsoid differ by f and m, 1 % at most, of 2 g 100 m / R = 3e-4 m/s^2.
    assert_within(found, expected, atol=3e-6)
    assert np.abs(expected - field.value_n).max() > 1e-4


def test_field_at_its_own_places_is_gravity_itself():
    pos_n = places(1e4)
    assert_within(GravityField.around(pos_n, ANCHOR).at(pos_n), gravity_n(pos_n, ANCHOR), atol=4 * EPS * 9.9)
