"""What fuser.map makes of the sigmas that a receiver reports, and of those that it does not know."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from numpy.testing import assert_allclose

from recon import GNSS, build
from recon.fixes import Observed, Trust, observe

COUNT = 12
NONE_MM = 2**32 - 1
"""What receivers that count in millimetres write for a sigma that they do not know."""


def observed(pos_std: object, vel_std: object = 0.2) -> Observed:
    t_ns = np.arange(COUNT) * 10**9
    columns = {"lat": np.full(COUNT, 48.0), "lon": np.linspace(9.0, 9.001, COUNT), "height": np.full(COUNT, 300.0)}
    sigmas = {
        "pos_std": np.broadcast_to(np.reshape(pos_std, (-1, 1)), (COUNT, 3)),
        "vel_std": np.broadcast_to(np.reshape(vel_std, (-1, 1)), (COUNT, 3)),
    }
    table: pa.Table = build(GNSS, time=t_ns, vel=np.tile([6.8, 0.0, 0.0], (COUNT, 1)), **columns, **sigmas)
    return observe(table, 0, Trust(), reported=True)


def test_a_reported_sigma_parts_into_what_lasts_and_what_is_white():
    found = observed(2.0)
    assert_allclose(found.drift, 1.8)
    assert_allclose(found.fixes.pos_sigma, 0.8)
    assert_allclose(found.fixes.vel_sigma, 0.2)


@pytest.mark.parametrize("unknown", [NONE_MM / 1e3, 1e6, 0.0, np.nan])
def test_a_sigma_that_no_fix_knows_is_not_believed(unknown):
    found = observed(unknown, unknown)
    assert_allclose(found.drift, Trust().drift)
    assert_allclose(found.fixes.pos_sigma[:, 0], Trust().white)
    assert_allclose(found.fixes.vel_sigma[:, 0], Trust().velocity)


def test_a_fix_that_says_it_is_lost_counts_for_nothing_and_makes_the_others_no_worse():
    sigmas = np.full(COUNT, 2.0)
    sigmas[3:9] = NONE_MM / 1e3
    found = observed(sigmas)
    assert_allclose(found.drift, 1.8)
    assert_allclose(found.fixes.pos_sigma[:, :3], 0.8)
    assert (found.fixes.pos_sigma[:, 3:9] > 1e6).all()


def places(lat: np.ndarray, lon: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(3, m) m, the white sigma of places of which no receiver tells one."""
    table = build(GNSS, time=np.arange(len(lat)) * 10**9, lat=lat, lon=lon, height=height)
    return observe(table, 0, Trust(), reported=True).fixes.pos_sigma


def drive(count: int = 300) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude and longitude deg, height m, of a winding road."""
    t_s = np.arange(count, dtype=np.float64)
    return 48.0 + 0.02 * np.sin(t_s / 40.0), 9.0 + 0.02 * np.cos(t_s / 57.0), 300.0 + np.sin(t_s / 9.0)


@pytest.mark.parametrize("digits", [3, 4, 5])
def test_rounded_places_have_the_sigma_of_rounding(digits):
    lat, lon, height = drive()
    sigma = places(np.round(lat, digits), np.round(lon, digits), np.round(height, 1))
    to_m = np.radians(10.0**-digits) * 6_371_000.0 * np.array([np.cos(np.radians(48.0)), 1.0])
    # A sphere is within half a percent of the ellipsoid at 48 deg.
    rounding = np.append(to_m, 0.1) / np.sqrt(12.0)
    assert_allclose(sigma, np.tile(np.hypot(Trust().white, rounding)[:, None], 300), rtol=0.005)


def test_places_with_all_their_digits_do_not():
    assert_allclose(places(*drive())[:, 0], Trust().white, rtol=1e-6)


def test_nor_do_places_in_equal_distances_or_a_few():
    lat, lon, height = np.full(60, 48.0), 9.0 + 1e-3 * np.arange(60), np.full(60, 300.0)
    assert_allclose(places(lat, lon, height)[:, 0], Trust().white)
    assert_allclose(places(*(np.round(axis[::40], 3) for axis in drive()))[:, 0], Trust().white)
