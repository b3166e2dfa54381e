"""GNSS model: geometry by independent formulas, errors by their statistics.

A sum of n squared standard normals lies within the chi-square quantiles 1e-6 and 1 - 1e-6; the seeds are fixed, so the
tests never flicker, and the quantiles are not tuned to them.
"""

from __future__ import annotations

import numpy as np
import pytest
from chance import assert_standard_normal

from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.motion import Drive, EarthTruth, Motion, OnEarth, circle, crash, rest, straight
from recon.numerics.rotation import Floats
from recon_simulators.gnss_model import (
    GnssFixes,
    GnssModel,
    MultipathModel,
    gnss_measurements,
    in_outage,
    random_outages,
)
from recon_simulators.sensor_model import regular_times

EPS = np.finfo(float).eps
SEEDS = range(10)
PLACE = Anchor(45.0, 10.0, 0.0)
ROUNDING = 4e-9
"""m: positions on the Earth, 6.4e6 m from its centre, resolve 1e-9 m, and go there and back."""


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def on_earth(motion: Motion, t_s: Floats) -> EarthTruth:
    return OnEarth(motion, PLACE, float(np.max(t_s)) + 1.0).at(t_s)


def standing(seconds: float, rate_hz: float = 1.0) -> EarthTruth:
    return on_earth(rest(seconds), np.arange(0.0, seconds, 1.0 / rate_hz))


def measured(truth: EarthTruth, model: GnssModel, seed: int = 0) -> GnssFixes:
    return gnss_measurements(truth, truth, model, rng(seed))


def seen(fixes: GnssFixes) -> Floats:
    """Positions (m, 3) in m from the start."""
    return geodetic_to_enu(fixes.lat, fixes.lon, fixes.height, PLACE)


@pytest.mark.parametrize("lever_arm_v", [(1.5, 0.0, 0.0), (0.0, -0.8, 0.0), (-1.2, 0.5, 1.4)])
def test_the_antenna_of_a_turning_car_runs_on_its_own_circle(lever_arm_v: tuple[float, float, float]) -> None:
    radius, speed = 20.0, 8.0
    truth = on_earth(circle(radius, speed), np.arange(0.0, 30.0, 0.1))
    fixes = measured(truth, GnssModel(lever_arm_v=lever_arm_v))
    forward, left, up = lever_arm_v
    from_centre = seen(fixes) - [0.0, radius, up]
    antenna_radius = np.hypot(radius - left, forward)
    # East turns by tan(lat) east / R along the way, so that a circle by its headings ends 2 pi r^2 / R beside its
    # start: 8e-4 m in two rounds. The rates of the level frame, 1e-6 rad/s, move the antenna by 2e-6 m/s.
    off_m = 2.0 * 2.0 * np.pi * radius**2 / 6.3e6
    np.testing.assert_allclose(np.hypot(*from_centre[:, :2].T), antenna_radius, rtol=0.0, atol=off_m)
    np.testing.assert_allclose(fixes.speed, speed / radius * antenna_radius, rtol=0.0, atol=4e-6)
    spun = np.column_stack((-from_centre[:, 1], from_centre[:, 0], np.zeros(len(from_centre)))) * speed / radius
    np.testing.assert_allclose(fixes.vel_n, spun, rtol=0.0, atol=off_m * speed / radius)


def test_the_antenna_rises_when_the_nose_dives_behind_it() -> None:
    drive = crash(dive=0.05)
    truth = on_earth(drive, drive.edges_s[4:5])
    fixes, at_imu = (measured(truth, GnssModel(lever_arm_v=arm)) for arm in ((-2.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    # 2 m off, the plane leaves the Earth by 2^2 / 2R = 3.2e-7 m.
    assert fixes.height[0] - at_imu.height[0] == pytest.approx(2.0 * np.sin(0.05), abs=3.2e-7 + ROUNDING)


@pytest.mark.parametrize("seed", SEEDS)
def test_white_noise_has_its_sigmas(seed: int) -> None:
    model = GnssModel(slow_sigmas=(1.8, 3.0), white_sigmas=(2.4, 4.0), velocity_sigmas=(0.1, 0.2))
    fixes = measured(standing(2000.0), model, seed)
    # Without a correlation time the slow part is white too: 3 m and 5 m in all. 20 m off, a plane leaves the Earth by
    # 3e-5 m.
    assert_standard_normal(seen(fixes)[:, :2] / 3.0)
    assert_standard_normal(seen(fixes)[:, 2] / 5.0)
    assert_standard_normal(fixes.vel_n / [0.1, 0.1, 0.2])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_slow_error_fades_with_its_correlation_time(seed: int) -> None:
    model = GnssModel(rate_hz=5.0, slow_sigmas=(1.8, 3.0), correlation_s=20.0)
    error = seen(measured(standing(2000.0, rate_hz=5.0), model, seed)) / [1.8, 1.8, 3.0]
    kept = np.exp(-0.2 / 20.0)
    # The innovations of the process, and its first value, are white: with them the whole law is proved.
    innovations = (error[1:] - kept * error[:-1]) / np.sqrt(1.0 - kept**2)
    assert_standard_normal(np.vstack((error[:1], innovations)))


def test_speed_and_course_are_those_of_the_velocity_that_is_reported() -> None:
    fixes = measured(standing(100.0), GnssModel(velocity_sigmas=(0.1, 0.1)))
    east_north = fixes.speed[:, None] * np.column_stack((np.sin(fixes.course), np.cos(fixes.course)))
    np.testing.assert_allclose(east_north, fixes.vel_n[:, :2], rtol=0.0, atol=16.0 * EPS)


def test_course_runs_clockwise_from_north() -> None:
    quarter = np.pi / 2.0 * 20.0 / 8.0
    to_the_left = on_earth(circle(20.0, 8.0), quarter * np.array([0.5, 1.5, 2.5, 3.5]))  # north-east, then left round
    fixes = measured(to_the_left, GnssModel())
    np.testing.assert_allclose(fixes.course, np.radians([45.0, 315.0, 225.0, 135.0]), rtol=32.0 * EPS)


def test_a_slow_receiver_rounds_speed_and_course_and_holds_the_course_at_rest() -> None:
    drive = Drive((*straight(15.0).segments,), yaw=np.radians(60.7))
    truth = on_earth(drive, np.arange(0.0, drive.duration_s))
    step = 1.0 / 3.6
    fixes = measured(truth, GnssModel(speed_step=step, course_step=np.radians(1.0), course_hold=1.5))
    true_speed = np.hypot(*truth.vel_n[:, :2].T)
    np.testing.assert_allclose(fixes.speed / step, np.round(true_speed / step), rtol=4.0 * EPS)
    began = int(np.argmax(true_speed >= 1.5))
    np.testing.assert_array_equal(fixes.course[:began], 0.0)
    np.testing.assert_allclose(np.degrees(fixes.course[began:]), 29.0, rtol=8.0 * EPS)  # 90 deg - 60.7 deg
    assert true_speed[-1] == 0.0


def test_position_and_velocity_are_late_by_their_own_lags() -> None:
    drive = straight()
    t_s = regular_times(0.0, 40.0, 5.0)
    early, earlier = on_earth(drive, t_s - 0.2), on_earth(drive, t_s - 0.4)
    fixes = gnss_measurements(early, earlier, GnssModel(lag_s=0.2, velocity_lag_s=0.4), rng())
    now = measured(on_earth(drive, t_s), GnssModel())
    np.testing.assert_allclose(seen(fixes)[1:], seen(now)[:-1], rtol=0.0, atol=2.0 * ROUNDING)
    np.testing.assert_allclose(fixes.vel_n[2:], now.vel_n[:-2], rtol=0.0, atol=64.0 * EPS * 15.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_bursts_hit_the_share_of_fixes_that_they_should(seed: int) -> None:
    model = GnssModel(multipath=MultipathModel(share=0.05, size=(8.0, 35.0), length_s=(3.0, 18.0)))
    fixes = measured(standing(3600.0), model, seed)
    error = np.linalg.norm(seen(fixes), axis=1)
    hit = np.zeros(3600, dtype=bool)
    for burst in fixes.bursts:
        hit[burst.first : burst.stop] = True
        assert burst.stop - burst.first <= 18
        assert 8.0 <= burst.size <= 35.0
    # The last burst goes beyond the share by up to its length.
    assert 180 <= hit.sum() <= 180 + 17
    np.testing.assert_array_equal(error > 1.0, hit)
    np.testing.assert_array_equal(np.linalg.norm(fixes.vel_n, axis=1) > 0.0, hit)


def test_a_burst_is_off_by_one_vector_of_its_size() -> None:
    model = GnssModel(rate_hz=10.0, multipath=MultipathModel(share=1e-3, size=(30.0, 30.0), length_s=(5.0, 5.0)))
    fixes = measured(standing(3600.0, rate_hz=10.0), model)
    (burst,) = fixes.bursts
    assert burst.stop - burst.first == 50
    off = seen(fixes)[burst.first : burst.stop]
    # 30 m off, the plane leaves the Earth by 30^2 / 2R = 7e-5 m.
    np.testing.assert_allclose(off, np.tile(off[0], (50, 1)), rtol=0.0, atol=2.0 * ROUNDING)
    assert np.linalg.norm(off[0]) == pytest.approx(burst.size, abs=1e-3)
    assert np.ptp(fixes.vel_n[burst.first : burst.stop], axis=0).max() == 0.0


def test_bursts_alone_and_in_a_row_come_in_their_shares() -> None:
    model = GnssModel(multipath=MultipathModel(share=0.03, length_s=(2.0, 7.0), single=0.6))
    bursts = [burst for seed in SEEDS for burst in measured(standing(3600.0), model, seed).bursts]
    alone = np.mean([burst.stop - burst.first == 1 for burst in bursts])
    # Some 450 bursts: the share has a sigma of sqrt(0.6 * 0.4 / 450) = 0.023.
    assert alone == pytest.approx(0.6, abs=5.0 * 0.023)
    assert max(burst.stop - burst.first for burst in bursts) == 7


def test_without_multipath_nothing_is_hit() -> None:
    fixes = measured(standing(600.0), GnssModel())
    assert fixes.bursts == ()
    np.testing.assert_allclose(seen(fixes), 0.0, atol=ROUNDING)


def test_an_outage_leaves_out_its_fixes_and_ends_with_one() -> None:
    model = GnssModel(rate_hz=1.0, outages=((3.0, 6.0), (8.5, 9.5)))
    t_s = regular_times(0.0, 12.0, 1.0)
    np.testing.assert_array_equal(t_s[~in_outage(t_s, model)], [0.0, 1.0, 2.0, 6.0, 7.0, 8.0, 10.0, 11.0])


@pytest.mark.parametrize(("duration_s", "count"), [(3600.0, 8), (600.0, 2), (50.0, 0)])
@pytest.mark.parametrize("seed", SEEDS)
def test_random_outages_are_as_many_as_asked_and_apart(seed: int, duration_s: float, count: int) -> None:
    spans = np.array(random_outages(8.0 / 3600.0, (30.0, 60.0), duration_s, rng(seed))).reshape(-1, 2)
    assert len(spans) == count
    lengths = np.diff(spans, axis=1)
    assert np.all((lengths >= 30.0 * (1.0 - 1e-12)) & (lengths <= 60.0 * (1.0 + 1e-12)))
    assert np.all(spans[1:, 0] - spans[:-1, 1] >= 10.0 - 1e-9)
    assert np.all((spans >= 60.0) & (spans <= duration_s - 15.0))


def test_no_rate_means_no_outage() -> None:
    assert random_outages(0.0, (30.0, 60.0), 3600.0, rng()) == ()
