from __future__ import annotations

import numpy as np

from recon.numerics.doctor.clocks import plane
from recon.numerics.doctor.log import Gnss


def fixes(lat, lon):
    none, count = np.full((len(lat), 3), np.nan), len(lat)
    single = np.full(count, np.nan)
    return Gnss(np.arange(float(count)), lat, lon, single, single, single, none, none, none)


def test_a_drive_across_the_antimeridian_stays_in_one_piece():
    lat = np.full(4, -17.0)
    here, there = (
        plane(fixes(lat, lon))[0] for lon in (np.array([0.0, 1e-3, 2e-3, 3e-3]) + x for x in (178.0, 179.9985))
    )
    wrapped, _ = plane(fixes(lat, np.array([179.9985, 179.9995, -179.9995, -179.9985])))
    np.testing.assert_allclose(here, there, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(wrapped, there, rtol=0.0, atol=1e-6)  # degrees near 180 are rounded by 3e-14, 3 nm


def test_positions_that_are_not_known_stay_unknown():
    lat, lon = np.array([np.nan, 0.0, 45.0, 45.001]), np.array([8.0, 0.0, 8.0, 8.0])
    east, north = plane(fixes(lat, lon))
    np.testing.assert_array_equal(np.isfinite(east), [False, False, True, True])
    np.testing.assert_allclose(np.diff(north[2:]), 111.1, atol=0.1)  # 1e-3 deg of a meridian of 40 000 km
    np.testing.assert_array_equal(east[2:], 0.0)
