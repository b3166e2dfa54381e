"""Sensor model: geometry by independent formulas, noise by its statistics.

A sum of n squared standard normals lies within the chi-square quantiles 1e-6 and 1 - 1e-6; the seeds are fixed, so the
tests never flicker, and the quantiles are not tuned to them.
"""

from __future__ import annotations

import numpy as np
import pytest
from chance import assert_standard_normal

from recon.numerics.geodesy import Anchor
from recon.numerics.motion import Drive, EarthTruth, OnEarth, crash, rest, roundabout, stop_and_go, straight
from recon.numerics.rotation import Floats
from recon_simulators.sensor_model import ImuModel, TriadModel, imu_measurements, imu_times

EPS = np.finfo(float).eps
SEEDS = range(10)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def on_earth(drive: Drive, t_s: Floats) -> EarthTruth:
    return OnEarth(drive, Anchor(45.0, 10.0, 0.0), drive.duration_s).at(t_s)


def at_rest(seconds: float = 100.0, rate_hz: float = 100.0) -> EarthTruth:
    return on_earth(rest(seconds), np.arange(0.0, seconds, 1.0 / rate_hz))


def outputs(truth: EarthTruth, model: ImuModel, seed: int = 0) -> tuple[Floats, Floats]:
    """What the accelerometers and the gyroscopes report."""
    accel, gyro = imu_measurements(truth, model, rng(seed))
    return accel.output_s, gyro.output_s


def test_a_perfect_imu_reports_the_truth_of_a_drive() -> None:
    truth = on_earth(stop_and_go(120.0, rng()), np.arange(0.0, 120.0, 0.01))
    accel_s, gyro_s = outputs(truth, ImuModel())
    np.testing.assert_array_equal(accel_s, truth.force_v)
    np.testing.assert_array_equal(gyro_s, truth.rate_v)


def test_a_box_turned_left_a_quarter_reads_left_on_x_and_backward_on_y() -> None:
    truth = on_earth(crash(), np.arange(0.0, 40.0, 0.01))
    # The axes of the box: x to the vehicle's left, y backwards. Vehicle to sensor is then a quarter turn about -z.
    accel_s, gyro_s = outputs(truth, ImuModel(q_sv=(np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5))))
    for measured, true_v in ((accel_s, truth.force_v), (gyro_s, truth.rate_v)):
        expected = np.column_stack((true_v[:, 1], -true_v[:, 0], true_v[:, 2]))
        np.testing.assert_allclose(measured, expected, rtol=0.0, atol=8.0 * EPS * 250.0)  # 250 m/s^2 in the crash


def test_a_box_upside_down_about_its_long_axis_reads_minus_g() -> None:
    truth = at_rest(1.0)
    accel_s, _ = outputs(truth, ImuModel(q_sv=(0.0, 1.0, 0.0, 0.0)))
    np.testing.assert_array_equal(accel_s, truth.force_v * [1.0, -1.0, -1.0])


def test_bias_and_scale_act_on_the_axes_of_the_sensor() -> None:
    model = ImuModel(
        q_sv=(0.0, 1.0, 0.0, 0.0),
        accel=TriadModel(bias=(0.1, -0.2, 0.3), scale=(0.0, 0.0, 0.01)),
        gyro=TriadModel(bias=(0.01, 0.02, -0.03)),
    )
    truth = at_rest(1.0)
    accel_s, gyro_s = outputs(truth, model)
    np.testing.assert_allclose(accel_s[0], [0.1, -0.2, 0.3 - 1.01 * truth.force_v[0, 2]], rtol=4.0 * EPS, atol=EPS)
    np.testing.assert_allclose(
        gyro_s - truth.rate_v * [1.0, -1.0, -1.0], np.tile([0.01, 0.02, -0.03], (100, 1)), atol=EPS
    )


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("rate_hz", [25.0, 400.0])
def test_white_noise_has_its_density_times_the_root_of_the_rate(rate_hz: float, seed: int) -> None:
    model = ImuModel(rate_hz=rate_hz, accel=TriadModel(noise_density=2e-3), gyro=TriadModel(noise_density=3e-4))
    truth = at_rest(rate_hz=rate_hz)
    accel_s, gyro_s = outputs(truth, model, seed)
    assert_standard_normal((accel_s - truth.force_v) / (2e-3 * np.sqrt(rate_hz)))
    assert_standard_normal((gyro_s - truth.rate_v) / (3e-4 * np.sqrt(rate_hz)))


def test_noise_is_independent_between_axes_and_from_sample_to_sample() -> None:
    model = ImuModel(accel=TriadModel(noise_density=0.1), gyro=TriadModel(noise_density=0.1))
    accel_s, gyro_s = outputs(at_rest(), model)
    channels = np.column_stack((accel_s, gyro_s, np.roll(accel_s, 1, axis=0), np.roll(gyro_s, 1, axis=0)))
    correlation = np.corrcoef(channels.T) - np.eye(12)
    # A correlation of 10 000 independent pairs has sigma 0.01; the largest of 66 exceeds 5 sigma once in 26 000 tries.
    assert np.abs(correlation).max() < 5.0 / np.sqrt(len(accel_s))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_bias_walks_by_the_root_of_the_time_between_irregular_samples(seed: int) -> None:
    model = ImuModel(jitter_s=0.004, gyro=TriadModel(bias_walk=1e-3))
    t_s = imu_times(0.0, 100.0, model, rng(seed))
    truth = on_earth(rest(100.0), t_s)
    accel, gyro = imu_measurements(truth, model, rng(seed))
    np.testing.assert_array_equal(gyro.bias_s[0], 0.0)
    np.testing.assert_array_equal(gyro.output_s, truth.rate_v + gyro.bias_s)
    np.testing.assert_array_equal(accel.bias_s, 0.0)
    assert_standard_normal(np.diff(gyro.bias_s, axis=0) / (1e-3 * np.sqrt(np.diff(t_s)))[:, None])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_bias_wanders_about_its_constant_by_its_instability(seed: int) -> None:
    model = ImuModel(rate_hz=10.0, accel=TriadModel(bias=(1.0, 2.0, 3.0), instability=0.01, correlation_s=50.0))
    accel, _ = imu_measurements(at_rest(3000.0, rate_hz=10.0), model, rng(seed))
    wander, kept = (accel.bias_s - [1.0, 2.0, 3.0]) / 0.01, np.exp(-0.1 / 50.0)
    innovations = (wander[1:] - kept * wander[:-1]) / np.sqrt(1.0 - kept**2)
    assert_standard_normal(np.vstack((wander[:1], innovations)))


@pytest.mark.parametrize("rate_hz", [100.0, 400.0])
def test_vibration_lies_in_its_band_and_grows_with_the_speed(rate_hz: float) -> None:
    drive = Drive(
        (*rest(20.0).segments, *straight(7.5, cruise_s=200.0).segments, *straight(60.0, cruise_s=200.0).segments)
    )
    t_s = np.arange(0.0, drive.duration_s, 1.0 / rate_hz)
    truth = on_earth(drive, t_s)
    model = ImuModel(rate_hz=rate_hz, accel=TriadModel(vibration=0.3), gyro=TriadModel(vibration=0.005))
    accel_s, gyro_s = outputs(truth, model)
    speed = np.linalg.norm(truth.vel_n, axis=1)
    for shaking, sigma in ((accel_s - truth.force_v, 0.3), (gyro_s - truth.rate_v, 0.005)):
        assert np.abs(shaking[speed == 0.0]).max() == 0.0
        for at, times in ((7.5, 0.5), (60.0, 1.5)):
            cruising = shaking[np.abs(speed - at) < 1e-6]
            # 3 axes, 200 s and a band 37 Hz wide: 2 * 37 * 600 independent values, so that sigma is known to 0.3 %.
            assert np.std(cruising) == pytest.approx(times * sigma, rel=0.02)
            power = np.abs(np.fft.rfft(cruising, axis=0)) ** 2
            frequency = np.fft.rfftfreq(len(cruising), 1.0 / rate_hz)
            # In the variable x = (f^2 - 360) / (37 f) of its low-pass, |H|^2 = 1 / (1 + x^4); 4 and 90 Hz are at
            # x = -+2.32, beyond which lies 1 / (3 x^3) / (pi / (2 sqrt(2))) = 2.4 % of the whole.
            inside = power[(frequency > 4.0) & (frequency < 90.0)].sum() / power.sum()
            assert inside > 0.95


def test_vibration_above_what_the_sampling_resolves_is_white() -> None:
    drive = straight(15.0, cruise_s=2000.0)
    t_s = np.arange(0.0, drive.duration_s, 0.1)
    truth = on_earth(drive, t_s)
    accel_s, _ = outputs(truth, ImuModel(rate_hz=10.0, accel=TriadModel(vibration=0.3)))
    cruising = np.abs(np.linalg.norm(truth.vel_n, axis=1) - 15.0) < 1e-6
    assert_standard_normal((accel_s - truth.force_v)[cruising] / 0.3)


def test_output_is_quantised_to_the_nearest_step() -> None:
    step = 9.80665 / 1024.0
    truth = on_earth(roundabout(), np.arange(0.0, 45.0, 0.01))
    accel_s, _ = outputs(truth, ImuModel(accel=TriadModel(quantisation=step)))
    counts = accel_s / step
    np.testing.assert_allclose(counts, np.round(counts), rtol=4.0 * EPS, atol=0.0)
    error = np.abs(accel_s - truth.force_v).max()
    assert 0.49 * step < error <= 0.5 * step * (1.0 + 4096.0 * EPS)


def test_output_is_clipped_at_full_scale_on_both_sides() -> None:
    truth = on_earth(crash(), np.arange(0.0, 40.0, 0.001))
    model = ImuModel(accel=TriadModel(full_scale=20.0), gyro=TriadModel(full_scale=0.1))
    accel_s, gyro_s = outputs(truth, model)
    assert accel_s.min() == -20.0  # the pulse itself reaches -240 m/s^2
    assert (gyro_s.min(), gyro_s.max()) == (-0.1, 0.1)  # the dive turns at up to 1.0, its return at -0.13 rad/s
    inside = np.abs(truth.force_v) < 20.0
    np.testing.assert_array_equal(accel_s[inside], truth.force_v[inside])


def test_the_same_seed_gives_the_same_data_and_another_seed_other_data() -> None:
    model = ImuModel(jitter_s=0.001, accel=TriadModel(noise_density=0.01), gyro=TriadModel(bias_walk=0.01))

    def simulate(seed: int) -> tuple[Floats, Floats]:
        noise = rng(seed)
        truth = on_earth(straight(), imu_times(0.0, 40.0, model, noise))
        accel, gyro = imu_measurements(truth, model, noise)
        return accel.output_s, gyro.output_s

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
