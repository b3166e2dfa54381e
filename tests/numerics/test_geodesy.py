"""Geodesy against pymap3d, published values and a gravity field in spherical harmonics."""

from __future__ import annotations

from functools import partial

import numpy as np
import pymap3d
import pytest
from geographiclib.test.test_geodesic import GeodesicTest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics import geodesy
from recon.numerics.geodesy import SPHERE, WGS84, Anchor, geodesic

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
# A few roundings of Earth-fixed coordinates of 6.4e6 m.
ROUNDING_M = 20 * EPS * 6.4e6

latitudes = st.one_of(st.sampled_from([-90.0, 0.0, 90.0, 89.9999999]), st.floats(-90.0, 90.0))
longitudes = st.floats(-180.0, 180.0)
BOLOGNA = Anchor(lat=44.4949, lon=11.3426, height=54.0)


@given(latitudes, longitudes, st.floats(-1e4, 1e6))
def test_earth_fixed_position_is_that_of_pymap3d(lat, lon, height):
    expected = np.array(pymap3d.geodetic2ecef(lat, lon, height))
    assert_within(geodesy.geodetic_to_ecef(lat, lon, height), expected, atol=ROUNDING_M)


@given(latitudes, longitudes, st.one_of(st.floats(-1e6, 1e6), st.floats(1e6, 4e8)))
def test_geodetic_position_survives_the_round_trip_at_any_height(lat, lon, height):
    back_lat, back_lon, back_height = geodesy.ecef_to_geodetic(geodesy.geodetic_to_ecef(lat, lon, height))
    # The coordinates are rounded to eps times the distance, seen from the centre under eps rad, ten times over.
    assert_within(back_lat, lat, atol=np.degrees(10 * EPS * np.pi))
    assert_within(back_height, height, atol=10 * EPS * (6.4e6 + abs(height)))
    if abs(lat) < 89.0:
        assert_within(back_lon, lon, atol=np.degrees(10 * EPS * np.pi))


def test_poles_and_axis_are_regular():
    lat, lon, height = geodesy.ecef_to_geodetic([[0.0, 0.0, WGS84.b + 100.0], [0.0, 0.0, -WGS84.b], [WGS84.a, 0, 0]])
    assert_array_equal(lat, [90.0, -90.0, 0.0])
    assert_array_equal(lon, [0.0, 0.0, 0.0])
    assert_within(height, [100.0, 0.0, 0.0], atol=ROUNDING_M)


@given(st.floats(-80.0, 80.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-500.0, 5000.0))
def test_local_position_is_that_of_pymap3d(lat, north, east, height):
    anchor = Anchor(lat, 179.9, 120.0)  # on either side of the date line
    expected = np.array(pymap3d.geodetic2enu(lat + north, 179.9 + east, height, lat, 179.9, 120.0))
    assert_within(geodesy.geodetic_to_enu(lat + north, 179.9 + east, height, anchor), expected, atol=ROUNDING_M)


@pytest.mark.parametrize("ellipsoid", [WGS84, SPHERE])
def test_local_position_survives_the_round_trip(ellipsoid):
    pos_n = np.random.default_rng(0).uniform(-1e5, 1e5, (200, 3))
    lat, lon, height = geodesy.enu_to_geodetic(pos_n, BOLOGNA, ellipsoid)
    assert lat.shape == lon.shape == height.shape == (200,)
    assert_within(geodesy.geodetic_to_enu(lat, lon, height, BOLOGNA, ellipsoid), pos_n, atol=ROUNDING_M)


def test_anchor_is_the_origin_and_the_axes_are_east_north_up():
    step = 1e-4
    lat = BOLOGNA.lat + np.array([0.0, 0.0, step, 0.0])
    lon = BOLOGNA.lon + np.array([0.0, step, 0.0, 0.0])
    height = BOLOGNA.height + np.array([0.0, 0.0, 0.0, 10.0])
    pos_n = geodesy.geodetic_to_enu(lat, lon, height, BOLOGNA)
    meridian, prime_vertical = geodesy.radii_of_curvature(BOLOGNA.lat)
    east = np.radians(step) * (prime_vertical + BOLOGNA.height) * np.cos(np.radians(BOLOGNA.lat))
    north = np.radians(step) * (meridian + BOLOGNA.height)
    # Over 11 m the ground curves away by 11^2 / 2R = 1e-5 m.
    assert_within(pos_n, [[0, 0, 0], [east, 0, 0], [0, north, 0], [0, 0, 10]], atol=2e-5)


def test_sphere_has_one_radius_and_geocentric_latitude():
    assert geodesy.radii_of_curvature(33.0, SPHERE) == (6_371_000.0, 6_371_000.0)
    lat, _, height = geodesy.ecef_to_geodetic([3e6, 0.0, 4e6], SPHERE)
    assert_allclose(lat, np.degrees(np.arctan2(4.0, 3.0)), rtol=4 * EPS)
    assert_within(height, 5e6 - 6_371_000.0, atol=ROUNDING_M)


def test_wgs84_has_the_derived_constants_of_the_standard():
    # TR8350.2 table 3.3, as many digits as it prints.
    assert_within(WGS84.b, 6_356_752.3142, atol=5e-5)
    assert_allclose(WGS84.e2, 6.694_379_990_14e-3, rtol=1e-12)


@pytest.mark.parametrize(
    ("lat", "meridian", "prime_vertical"),
    [(0.0, WGS84.b**2 / WGS84.a, WGS84.a), (90.0, WGS84.a**2 / WGS84.b, WGS84.a**2 / WGS84.b)],
)
def test_radii_of_curvature_at_equator_and_pole_are_those_of_the_ellipse(lat, meridian, prime_vertical):
    assert_allclose(geodesy.radii_of_curvature(lat), (meridian, prime_vertical), rtol=10 * EPS)


def test_gravity_at_equator_and_pole_is_that_of_the_standard():
    # TR8350.2 table 3.4 prints ten decimals; k of Somigliana's formula is rounded at 5e-15, g at 5e-11.
    assert_within(
        geodesy.normal_gravity([0.0, 90.0, -90.0], 0.0), [9.7803253359, 9.8321849378, 9.8321849378], atol=2e-10
    )


@pytest.mark.parametrize("lat", [0.0, 30.0, 44.5, 60.0, 90.0])
@pytest.mark.parametrize("height", [-400.0, 100.0, 3000.0, 10_000.0])
def test_gravity_falls_with_height_as_in_the_field_of_an_oblate_rotating_earth(lat, height):
    def potential(up: float) -> float:
        x, _, z = geodesy.geodetic_to_ecef(lat, 0.0, up)
        r, gm, j2 = np.hypot(x, z), 3.986004418e14, 1.08262982e-3
        legendre = 1.5 * (z / r) ** 2 - 0.5
        return gm / r * (1 - j2 * (WGS84.a / r) ** 2 * legendre) + 0.5 * (geodesy.EARTH_RATE * x) ** 2

    def field(up: float) -> float:
        return (potential(up - 500.0) - potential(up + 500.0)) / 1000.0

    fall = geodesy.normal_gravity(lat, height) - geodesy.normal_gravity(lat, 0.0)
    # Left out in units of gravity times h / a: J4, 5 * 2.4e-6 falling with 6 h / a (a little more at the pole, where r
    # is b), and by eq. 4-3 terms in f^2, three at most; then the cubic term. The potential of 6e7 is rounded to 7e-9,
    # so the field, twice, to 3e-11.
    distance = abs(height) / WGS84.a
    left_out = (5 * 2.4e-6 * 6 * 1.02 + 3 * WGS84.f**2) * distance + 4 * distance**3
    assert_within(fall, field(height) - field(0.0), atol=9.8 * left_out + 1e-10)


def test_earth_rate_points_north_and_up():
    rate = geodesy.earth_rate_n([0.0, 90.0, 30.0])
    expected = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, np.sqrt(0.75), 0.5]]) * 7.292115e-5
    assert_within(rate, expected, atol=4 * EPS * 7.3e-5)


def test_geodesics_are_those_of_the_published_test_cases() -> None:
    """The twenty cases that GeographicLib publishes with itself, as it prints them: 0.1 nm and 1e-13 deg."""
    cases = np.array(GeodesicTest.testcases)
    length, first, second = geodesic(cases[:, 0], cases[:, 1], cases[:, 3], cases[:, 4])
    # The package claims 15 nm; 1e-12 deg are 1e-7 m at the far end of the Earth.
    np.testing.assert_allclose(length, cases[:, 6], rtol=0.0, atol=15e-9)
    for found, printed in ((first, cases[:, 2]), (second, cases[:, 5])):
        np.testing.assert_allclose(np.degrees(found), printed % 360.0, rtol=0.0, atol=1e-12)


def test_a_geodesic_of_a_sphere_is_a_great_circle() -> None:
    length, first, second = geodesic(0.0, 10.0, 0.0, [11.0, 9.0, 10.0], SPHERE)
    np.testing.assert_allclose(length, [np.radians(SPHERE.a), np.radians(SPHERE.a), 0.0], rtol=1e-14)
    np.testing.assert_allclose(first, [np.pi / 2, 1.5 * np.pi, np.nan], rtol=1e-14)
    np.testing.assert_array_equal(np.isnan(second), [False, False, True])


def test_a_geodesic_from_nowhere_is_unknown() -> None:
    assert np.isnan(geodesic(np.nan, 0.0, 1.0, 1.0)).all()
    assert geodesic([], [], [], [])[0].shape == (0,)
