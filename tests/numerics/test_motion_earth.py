"""Motions on the ellipsoid, against an inertial navigation in Earth-fixed axes that shares no formula with them."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.geodesy import (
    EARTH_RATE,
    Anchor,
    ecef_to_geodetic,
    geodetic_to_ecef,
    normal_gravity,
    radii_of_curvature,
)
from recon.numerics.motion import (
    Drive,
    EarthTruth,
    Motion,
    OnEarth,
    Segment,
    Spring,
    Springs,
    SprungBody,
    rest,
    traffic,
)
from recon.numerics.rotation import Floats, angle, from_euler, multiply, normalize, rotate

EPS = np.finfo(float).eps
BOLOGNA = Anchor(44.5, 11.3, 100.0)
EARTH_E = np.array([0.0, 0.0, EARTH_RATE])


def level_axes(lat: Floats, lon: Floats) -> Floats:
    """East, north, up to Earth-fixed: (n, 4). A turn about z to where east points, then tilting z down to up."""
    return from_euler(np.radians(lon) + np.pi / 2.0, 0.0, np.pi / 2.0 - np.radians(lat))


def earth_fixed(truth: EarthTruth) -> tuple[Floats, Floats, Floats]:
    """Attitude (n, 4), velocity and position (n, 3), Earth-fixed."""
    q_en = level_axes(truth.lat, truth.lon)
    pos_e = geodetic_to_ecef(truth.lat, truth.lon, truth.height)
    return multiply(q_en, truth.q_nv), rotate(q_en, truth.vel_n), pos_e


def navigated(truth: EarthTruth) -> tuple[Floats, Floats, Floats]:
    """The last state, by Runge-Kutta steps over two samples of specific force and angular rate: Groves, sec. 5.3."""
    step = 2.0 * float(truth.t_s[1] - truth.t_s[0])
    state = tuple(part[0] for part in earth_fixed(truth))

    def rates(state: tuple[Floats, ...], row: int) -> tuple[Floats, Floats, Floats]:
        q, vel, pos = state
        lat, lon, height = ecef_to_geodetic(pos)
        (sin_lat, sin_lon), (cos_lat, cos_lon) = np.sin(np.radians((lat, lon))), np.cos(np.radians((lat, lon)))
        up = np.array([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
        turn = multiply(q, np.r_[0.0, truth.rate_v[row]]) - multiply(np.r_[0.0, EARTH_E], q)
        fall = -normal_gravity(lat, height) * up - 2.0 * np.cross(EARTH_E, vel)
        return 0.5 * turn, rotate(q, truth.force_v[row]) + fall, vel

    def moved(state: tuple[Floats, ...], rate: tuple[Floats, ...], by: float) -> tuple[Floats, ...]:
        return tuple(part + by * change for part, change in zip(state, rate, strict=True))

    for row in range(0, len(truth.t_s) - 2, 2):
        first = rates(state, row)
        second = rates(moved(state, first, step / 2.0), row + 1)
        third = rates(moved(state, second, step / 2.0), row + 1)
        fourth = rates(moved(state, third, step), row + 2)
        for rate, weight in ((first, 1.0), (second, 2.0), (third, 2.0), (fourth, 1.0)):
            state = moved(state, rate, weight * step / 6.0)
        state = (normalize(state[0]), *state[1:])
    q, vel, pos = state
    return q, vel, pos


def car(seed: int) -> Motion:
    drive = traffic("mixed", 200.0, np.random.default_rng(seed))
    return SprungBody(drive, Springs(0.0026, 0.008, 0.01), (-1.2, 0.2, -0.4), None, np.random.default_rng(0))


@pytest.mark.parametrize("place", [BOLOGNA, Anchor(-78.0, 179.999, 2500.0), Anchor(0.0, -60.0, -20.0)], ids=str)
def test_ideal_inertial_sensors_lead_along_the_truth(place: Anchor) -> None:
    truth = OnEarth(car(3), place, 200.0).at(np.arange(0.0, 200.0, 0.01)[: 20_000 - 1])
    q, vel, pos = navigated(truth)
    q_true, vel_true, pos_true = (part[-1] for part in earth_fixed(truth))
    # Runge-Kutta over H = 0.02 s errs by H^4 / 2880 times the fourth derivative of what is integrated: of the specific
    # force at corners of the splines and of the segments, where it jumps in the second, (1 m/s^2) / (0.04 s)^2, by less
    # than H^3 / 100 of that at each of a few hundred corners: 5e-5 m/s at most, 5e-7 where they add up as noise; times
    # 200 s, 1e-4 m to 1e-2 m. A term of the Coriolis force left out would come to 2e-3 m/s^2, 40 m.
    assert np.linalg.norm(pos - pos_true) < 2e-3
    assert np.linalg.norm(vel - vel_true) < 2e-5
    assert angle(q, q_true) < 1e-7


def test_rest_feels_gravity_and_the_turning_earth() -> None:
    truth = OnEarth(rest(10.0), BOLOGNA, 10.0).at(np.array([-1.0, 0.0, 5.0, 20.0]))
    np.testing.assert_array_equal(truth.lat, BOLOGNA.lat)
    np.testing.assert_array_equal(truth.lon, BOLOGNA.lon)
    gravity = float(normal_gravity(BOLOGNA.lat, BOLOGNA.height))
    np.testing.assert_allclose(truth.force_v, np.tile([0.0, 0.0, gravity], (4, 1)), rtol=0.0, atol=EPS * 10.0)
    lat = np.radians(BOLOGNA.lat)
    expected = EARTH_RATE * np.array([0.0, np.cos(lat), np.sin(lat)])
    np.testing.assert_allclose(truth.rate_v, np.tile(expected, (4, 1)), rtol=4.0 * EPS)


def test_a_drive_north_follows_its_meridian_and_stays_level() -> None:
    speed, duration_s = 40.0, 10_000.0
    cruise = Segment(duration_s, speed)
    drive = Drive((Segment(1.0, 0.0), Segment(100.0, speed), cruise, Segment(100.0, 0.0)), yaw=np.pi / 2.0)
    truth = OnEarth(drive, BOLOGNA, drive.duration_s).at(np.array([0.0, drive.duration_s]))
    lat = np.radians(np.linspace(truth.lat[0], truth.lat[1], 2001))
    meridian, _ = radii_of_curvature(np.degrees((lat[1:] + lat[:-1]) / 2.0))
    arc = np.sum((meridian + 100.0) * np.diff(lat))
    # 404 km; the midpoints of 2000 parts of 3e-5 rad err by 1e-10 of M's variation of 1 %: nothing.
    assert arc == pytest.approx(speed * (duration_s + 100.0), rel=1e-9)
    assert truth.lon[1] == pytest.approx(BOLOGNA.lon, abs=1e-12)
    assert truth.height[1] == pytest.approx(100.0, abs=1e-6)
    assert truth.q_nv[1] == pytest.approx(truth.q_nv[0])


def test_a_drive_east_follows_its_parallel() -> None:
    drive = Drive((Segment(100.0, 30.0), Segment(1000.0, 30.0), Segment(100.0, 0.0)))
    truth = OnEarth(drive, Anchor(60.0, 179.9, 0.0), drive.duration_s).at(np.array([0.0, drive.duration_s]))
    _, normal = radii_of_curvature(60.0)
    turned = np.degrees(30.0 * 1100.0 / (normal * np.cos(np.radians(60.0))))
    assert truth.lat[1] == pytest.approx(60.0, abs=1e-11)
    assert truth.lon[1] == pytest.approx(179.9 + turned - 360.0, abs=1e-10)


def test_places_do_not_depend_on_the_company_of_times() -> None:
    earth = OnEarth(Spring(radius=50.0, rate=0.3, climb=1.0), BOLOGNA, 60.0)
    t_s = np.random.default_rng(0).uniform(0.0, 60.0, 100)
    all_at_once, one = earth.at(t_s), earth.at(t_s[5:6])
    for name in ("lat", "lon", "height"):
        assert getattr(all_at_once, name)[5] == pytest.approx(getattr(one, name)[0], abs=1e-14 * 100.0)


def test_heights_are_those_of_the_motion() -> None:
    t_s = np.linspace(0.0, 60.0, 777)
    motion = Spring(radius=50.0, rate=0.3, climb=1.0)
    np.testing.assert_allclose(
        OnEarth(motion, BOLOGNA, 60.0).at(t_s).height, 100.0 + motion.at(t_s).pos_n[:, 2], rtol=1e-14
    )
