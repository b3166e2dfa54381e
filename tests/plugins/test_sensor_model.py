"""Sensor model: geometry by independent formulas, noise by its statistics.

A sum of n squared standard normals lies within the chi-square quantiles 1e-6 and 1 - 1e-6; the seeds are fixed, so the
tests never flicker, and the quantiles are not tuned to them.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.motion import (
    MotionTruth,
    circle,
    crash,
    rest,
    roundabout,
    specific_force,
    stop_and_go,
    straight,
)
from recon.numerics.rotation import Floats
from recon_simulators.sensor_model import (
    GnssModel,
    ImuModel,
    TriadModel,
    gnss_measurements,
    gnss_times,
    imu_measurements,
    imu_times,
    in_outage,
)

EPS = np.finfo(float).eps
SEEDS = range(10)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def at_rest(seconds: float = 100.0, rate_hz: float = 100.0) -> MotionTruth:
    return rest(seconds).at(np.arange(0.0, seconds, 1.0 / rate_hz))


def assert_standard_normal(samples: Floats) -> None:
    """Their sum of squares is that of independent standard normals."""
    low, high = (float(chi2.ppf(p, samples.size)) for p in (1e-6, 1.0 - 1e-6))
    assert low < np.sum(samples**2) < high


def test_a_perfect_imu_at_rest_reads_exactly_one_g_upwards_and_no_rate() -> None:
    accel_s, gyro_s = imu_measurements(at_rest(), ImuModel(), rng())
    np.testing.assert_array_equal(accel_s, np.tile([0.0, 0.0, STANDARD_GRAVITY], (len(accel_s), 1)))
    np.testing.assert_array_equal(gyro_s, 0.0)


def test_gravity_is_that_of_the_model() -> None:
    accel_s, _ = imu_measurements(at_rest(1.0), ImuModel(gravity=9.78), rng())
    np.testing.assert_array_equal(accel_s[:, 2], 9.78)


def test_a_perfect_imu_reports_the_truth_of_a_drive() -> None:
    truth = stop_and_go(120.0, rng()).at(np.arange(0.0, 120.0, 0.01))
    accel_s, gyro_s = imu_measurements(truth, ImuModel(), rng())
    np.testing.assert_array_equal(accel_s, specific_force(truth))
    np.testing.assert_array_equal(gyro_s, truth.gyro_v)


def test_a_box_turned_left_a_quarter_reads_left_on_x_and_backward_on_y() -> None:
    truth = crash().at(np.arange(0.0, 40.0, 0.01))
    # The axes of the box: x to the vehicle's left, y backwards. Vehicle to sensor is then a quarter turn about -z.
    accel_s, gyro_s = imu_measurements(truth, ImuModel(q_sv=(np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5))), rng())
    for measured, true_v in ((accel_s, specific_force(truth)), (gyro_s, truth.gyro_v)):
        expected = np.column_stack((true_v[:, 1], -true_v[:, 0], true_v[:, 2]))
        np.testing.assert_allclose(measured, expected, rtol=0.0, atol=8.0 * EPS * 250.0)  # 250 m/s^2 in the crash


def test_a_box_upside_down_about_its_long_axis_reads_minus_g() -> None:
    accel_s, _ = imu_measurements(at_rest(1.0), ImuModel(q_sv=(0.0, 1.0, 0.0, 0.0)), rng())
    np.testing.assert_array_equal(accel_s, np.tile([0.0, 0.0, -STANDARD_GRAVITY], (len(accel_s), 1)))


def test_bias_and_scale_act_on_the_axes_of_the_sensor() -> None:
    model = ImuModel(
        q_sv=(0.0, 1.0, 0.0, 0.0),
        accel=TriadModel(bias=(0.1, -0.2, 0.3), scale=(0.0, 0.0, 0.01)),
        gyro=TriadModel(bias=(0.01, 0.02, -0.03)),
    )
    accel_s, gyro_s = imu_measurements(at_rest(1.0), model, rng())
    np.testing.assert_allclose(accel_s[0], [0.1, -0.2, 0.3 - 1.01 * STANDARD_GRAVITY], rtol=4.0 * EPS)
    np.testing.assert_array_equal(gyro_s, np.tile([0.01, 0.02, -0.03], (len(gyro_s), 1)))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("rate_hz", [25.0, 400.0])
def test_white_noise_has_its_density_times_the_root_of_the_rate(rate_hz: float, seed: int) -> None:
    model = ImuModel(rate_hz=rate_hz, accel=TriadModel(noise_density=2e-3), gyro=TriadModel(noise_density=3e-4))
    accel_s, gyro_s = imu_measurements(at_rest(rate_hz=rate_hz), model, rng(seed))
    assert_standard_normal((accel_s - [0.0, 0.0, STANDARD_GRAVITY]) / (2e-3 * np.sqrt(rate_hz)))
    assert_standard_normal(gyro_s / (3e-4 * np.sqrt(rate_hz)))


def test_noise_is_independent_between_axes_and_from_sample_to_sample() -> None:
    model = ImuModel(accel=TriadModel(noise_density=0.1), gyro=TriadModel(noise_density=0.1))
    accel_s, gyro_s = imu_measurements(at_rest(), model, rng())
    channels = np.column_stack((accel_s, gyro_s, np.roll(accel_s, 1, axis=0), np.roll(gyro_s, 1, axis=0)))
    correlation = np.corrcoef(channels.T) - np.eye(12)
    # A correlation of 10 000 independent pairs has sigma 0.01; the largest of 66 exceeds 5 sigma once in 26 000 tries.
    assert np.abs(correlation).max() < 5.0 / np.sqrt(len(accel_s))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_bias_walks_by_the_root_of_the_time_between_irregular_samples(seed: int) -> None:
    model = ImuModel(jitter_s=0.004, gyro=TriadModel(bias_walk=1e-3))
    t_s = imu_times(0.0, 100.0, model, rng(seed))
    _, gyro_s = imu_measurements(rest(100.0).at(t_s), model, rng(seed))
    np.testing.assert_array_equal(gyro_s[0], 0.0)
    assert_standard_normal(np.diff(gyro_s, axis=0) / (1e-3 * np.sqrt(np.diff(t_s)))[:, None])


def test_output_is_quantised_to_the_nearest_step() -> None:
    step = 9.80665 / 1024.0
    truth = roundabout().at(np.arange(0.0, 45.0, 0.01))
    accel_s, _ = imu_measurements(truth, ImuModel(accel=TriadModel(quantisation=step)), rng())
    counts = accel_s / step
    np.testing.assert_allclose(counts, np.round(counts), rtol=4.0 * EPS, atol=0.0)
    error = np.abs(accel_s - specific_force(truth)).max()
    assert 0.49 * step < error <= 0.5 * step * (1.0 + 4096.0 * EPS)


def test_output_is_clipped_at_full_scale_on_both_sides() -> None:
    truth = crash().at(np.arange(0.0, 40.0, 0.001))
    model = ImuModel(accel=TriadModel(full_scale=20.0), gyro=TriadModel(full_scale=0.1))
    accel_s, gyro_s = imu_measurements(truth, model, rng())
    assert accel_s.min() == -20.0  # the pulse itself reaches -240 m/s^2
    assert (gyro_s.min(), gyro_s.max()) == (-0.1, 0.1)  # the dive turns at up to 1.0, its return at -0.13 rad/s
    inside = np.abs(specific_force(truth)) < 20.0
    np.testing.assert_array_equal(accel_s[inside], specific_force(truth)[inside])


def test_the_same_seed_gives_the_same_data_and_another_seed_other_data() -> None:
    imu = ImuModel(jitter_s=0.001, accel=TriadModel(noise_density=0.01), gyro=TriadModel(bias_walk=0.01))
    gnss = GnssModel(horizontal_sigma=1.0, velocity_sigma=0.1)

    def simulate(seed: int) -> list[Floats]:
        noise, motion = rng(seed), straight()
        samples = imu_measurements(motion.at(imu_times(0.0, 40.0, imu, noise)), imu, noise)
        fixes = gnss_measurements(motion.at(gnss_times(0.0, 40.0, gnss)), gnss, noise)
        return [*samples, fixes.pos_n, fixes.vel_n, fixes.speed, fixes.course]

    for first, again, other in zip(simulate(1), simulate(1), simulate(2), strict=True):
        np.testing.assert_array_equal(first, again)
        assert not np.array_equal(first, other)


def test_imu_times_are_regular_without_jitter() -> None:
    t_s = imu_times(5.0, 15.0, ImuModel(rate_hz=100.0), rng())
    np.testing.assert_array_equal(t_s, 5.0 + np.arange(1000) / 100.0)


def test_jittered_imu_times_increase_and_stay_near_their_grid() -> None:
    model = ImuModel(rate_hz=100.0, jitter_s=0.0049)
    t_s = imu_times(0.0, 100.0, model, rng())
    offset = t_s - np.arange(10_000) / 100.0
    assert np.diff(t_s).min() > 0.0
    assert -0.0049 - 100.0 * EPS <= offset.min() < -0.0048
    assert 0.0048 < offset.max() <= 0.0049 + 100.0 * EPS


@pytest.mark.parametrize("jitter_s", [-0.001, 0.005, float("nan")])
def test_a_jitter_that_could_swap_samples_is_refused(jitter_s: float) -> None:
    with pytest.raises(ValueError, match=r"must be .* half a period"):
        ImuModel(rate_hz=100.0, jitter_s=jitter_s)


@pytest.mark.parametrize("lever_arm_v", [(1.5, 0.0, 0.0), (0.0, -0.8, 0.0), (-1.2, 0.5, 1.4)])
def test_the_antenna_of_a_turning_car_runs_on_its_own_circle(lever_arm_v: tuple[float, float, float]) -> None:
    radius, speed = 20.0, 8.0
    truth = circle(radius, speed).at(np.arange(0.0, 30.0, 0.1))
    fixes = gnss_measurements(truth, GnssModel(lever_arm_v=lever_arm_v), rng())
    forward, left, up = lever_arm_v
    from_centre = fixes.pos_n - [0.0, radius, up]
    antenna_radius = np.hypot(radius - left, forward)
    rtol = 64.0 * EPS  # the phase of 12 rad is rounded to 12 eps
    np.testing.assert_allclose(np.linalg.norm(from_centre, axis=1), antenna_radius, rtol=rtol)
    np.testing.assert_allclose(fixes.speed, speed / radius * antenna_radius, rtol=rtol)
    spun = np.column_stack((-from_centre[:, 1], from_centre[:, 0], np.zeros(len(from_centre)))) * speed / radius
    np.testing.assert_allclose(fixes.vel_n, spun, rtol=0.0, atol=rtol * speed)


def test_the_antenna_rises_when_the_nose_dives_behind_it() -> None:
    drive = crash(dive=0.05)
    truth = drive.at(drive.edges_s[4:5])
    fixes = gnss_measurements(truth, GnssModel(lever_arm_v=(-2.0, 0.0, 0.0)), rng())
    np.testing.assert_allclose(
        fixes.pos_n[0] - truth.pos_n[0], [-2.0 * np.cos(0.05), 0.0, 2.0 * np.sin(0.05)], atol=1e-13
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_gnss_noise_has_its_sigmas(seed: int) -> None:
    model = GnssModel(horizontal_sigma=1.8, vertical_sigma=3.0, velocity_sigma=0.1)
    truth = circle(50.0, 10.0).at(np.arange(0.0, 2000.0))
    fixes = gnss_measurements(truth, model, rng(seed))
    assert_standard_normal((fixes.pos_n - truth.pos_n)[:, :2] / 1.8)
    assert_standard_normal((fixes.pos_n - truth.pos_n)[:, 2] / 3.0)
    assert_standard_normal((fixes.vel_n - truth.vel_n) / 0.1)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_error_of_positions_fades_with_its_correlation_time(seed: int) -> None:
    model = GnssModel(rate_hz=5.0, horizontal_sigma=1.8, vertical_sigma=3.0, correlation_s=20.0)
    truth = at_rest(2000.0, rate_hz=5.0)
    error = gnss_measurements(truth, model, rng(seed)).pos_n / [1.8, 1.8, 3.0]
    kept = np.exp(-0.2 / 20.0)
    # The innovations of the process, and its first value, are white: with them the whole law is proved.
    innovations = (error[1:] - kept * error[:-1]) / np.sqrt(1.0 - kept**2)
    assert_standard_normal(np.vstack((error[:1], innovations)))


def test_speed_and_course_are_those_of_the_velocity_that_is_reported() -> None:
    fixes = gnss_measurements(at_rest(rate_hz=1.0), GnssModel(velocity_sigma=0.1), rng())
    east_north = fixes.speed[:, None] * np.column_stack((np.sin(fixes.course), np.cos(fixes.course)))
    np.testing.assert_allclose(east_north, fixes.vel_n[:, :2], rtol=0.0, atol=16.0 * EPS)


def test_course_runs_clockwise_from_north() -> None:
    quarter = np.pi / 2.0 * 20.0 / 8.0
    to_the_left = circle(20.0, 8.0).at(quarter * np.array([0.5, 1.5, 2.5, 3.5]))  # north-east, then left round
    fixes = gnss_measurements(to_the_left, GnssModel(), rng())
    np.testing.assert_allclose(fixes.course, np.radians([45.0, 315.0, 225.0, 135.0]), rtol=32.0 * EPS)


def test_a_fix_describes_the_moment_before_its_lag() -> None:
    model = GnssModel(rate_hz=5.0, lag_s=0.3)
    t_s = gnss_times(0.0, 50.0, model)
    motion = straight()
    fixes = gnss_measurements(motion.at(t_s - model.lag_s), model, rng())
    np.testing.assert_allclose(fixes.t_s, t_s, rtol=0.0, atol=EPS * 50.0)
    cruising = (t_s > 26.0) & (t_s < 34.0)
    behind = motion.at(t_s).pos_n[cruising, 0] - fixes.pos_n[cruising, 0]
    np.testing.assert_allclose(behind, 15.0 * 0.3, rtol=0.0, atol=8.0 * EPS * 350.0)


def test_an_outage_leaves_out_its_fixes_and_ends_with_one() -> None:
    model = GnssModel(rate_hz=1.0, outages=((3.0, 6.0), (8.5, 9.5)))
    t_s = gnss_times(0.0, 12.0, model)
    np.testing.assert_array_equal(t_s[~in_outage(t_s, model)], [0.0, 1.0, 2.0, 6.0, 7.0, 8.0, 10.0, 11.0])
