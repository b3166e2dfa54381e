"""Increments against closed forms, fine integration, finite differences, the recursion of Forster et al. and trials."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.soa import mm, mtm, mv, quat_to_matrix, rotation_exp, rotation_log

# Sums of some hundred terms of magnitude one to twenty.
ROUNDING = 1e-12


def samples_of(t_s: np.ndarray, gyro_s: np.ndarray, accel_s: np.ndarray, m: int) -> Samples:
    n = len(t_s) - 1
    return Samples(t_s, gyro_s, accel_s, np.zeros(n, bool), np.arange(n + 1), m)


def signals(t_s: np.ndarray, vibration: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A lively drive below 1 Hz: rad/s and m/s^2, with vibration at 21 and 33 Hz on demand."""
    t = t_s[:, None]
    gyro = [0.1, -0.05, 0.3] + 0.5 * np.sin(2.0 * np.pi * np.array([0.3, 0.5, 0.2]) * t + [0.0, 1.0, 2.0])
    accel = [0.5, -0.2, 9.8] + 2.0 * np.sin(2.0 * np.pi * np.array([0.4, 0.25, 0.6]) * t + [0.5, 0.0, 1.0])
    gyro = gyro + vibration * 0.1 * np.sin(2.0 * np.pi * 21.0 * t + [0.0, 1.0, 2.0])
    accel = accel + vibration * np.sin(2.0 * np.pi * 33.0 * t + [2.0, 0.0, 1.0])
    return gyro, accel


def drive(rate_hz: float, duration_s: float, m: int, vibration: float = 0.0) -> Samples:
    t_s = np.arange(round(rate_hz * duration_s) + 1) / rate_hz
    return samples_of(t_s, *signals(t_s, vibration), m)


def jittered(m: int, intervals: int, seed: int = 0) -> Samples:
    """Near 100 Hz, steps uneven by half, every interval with a step just short of a gap and a padded end."""
    step = np.random.default_rng(seed).uniform(0.005, 0.015, (intervals, m))
    step[:, m // 3] = 0.09
    step[:, -m // 4 :] = 0.0
    t_s = np.concatenate([[0.0], np.cumsum(step)])
    return samples_of(t_s, *signals(t_s), m)


def plain(samples: Samples) -> Increments:
    k = samples.intervals
    return preintegrate(samples, np.zeros((3, k)), np.zeros((3, k)), np.zeros(6))


def strapdown(t_s: np.ndarray, gyro_s: np.ndarray, accel_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation, velocity, position by the midpoint rule, step by step."""
    rotation, velocity, position = Rotation.identity(), np.zeros(3), np.zeros(3)
    for k, h in enumerate(np.diff(t_s)):
        rate, force = (0.5 * (x[k] + x[k + 1]) for x in (gyro_s, accel_s))
        push = (rotation * Rotation.from_rotvec(0.5 * h * rate)).apply(force)
        position = position + h * velocity + 0.5 * h * h * push
        velocity = velocity + h * push
        rotation = rotation * Rotation.from_rotvec(h * rate)
    return rotation.as_matrix(), velocity, position


def subdivided(samples: Samples, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, rates and forces, linear between the samples."""
    t_s = samples.t_s
    fine = np.concatenate([np.linspace(a, b, parts, endpoint=False) for a, b in pairwise(t_s)])
    fine = np.append(fine, t_s[-1])
    gyro, accel = (
        np.stack([np.interp(fine, t_s, x[:, i]) for i in range(3)], 1) for x in (samples.gyro_s, samples.accel_s)
    )
    return fine, gyro, accel


def coning(rate_hz: float) -> tuple[Samples, np.ndarray, np.ndarray]:
    """Two seconds of an axis that goes round a cone of 0.1 rad at 1 Hz, while the box swings; with the true increments.

    R_ns = exp(0.1 (cos w t, sin w t, 0)) has the body rate w (-sin 0.1 sin w t, sin 0.1 cos w t, cos 0.1 - 1). The
    specific force in n is (0, cos w t, 10), from which velocity and position follow.
    """
    angle, omega = 0.1, 2.0 * np.pi
    t = np.arange(round(2.0 * rate_hz) + 1) / rate_hz
    s, c, zero, one = np.sin(omega * t), np.cos(omega * t), np.zeros_like(t), np.ones_like(t)
    rot_ns = Rotation.from_rotvec(angle * np.stack([c, s, zero], 1))
    gyro = omega * np.stack([-np.sin(angle) * s, np.sin(angle) * c, (np.cos(angle) - 1.0) * one], 1)
    accel = rot_ns.inv().apply(np.stack([zero, c, 10.0 * one], 1))
    start = rot_ns[0].inv()
    velocity = start.apply(np.stack([zero, s / omega, 10.0 * t], 1))
    position = start.apply(np.stack([zero, (1.0 - c) / omega**2, 5.0 * t**2], 1))
    return samples_of(t, gyro, accel, len(t) - 1), velocity[-1], position[-1]


def errors_of_coning(rate_hz: float) -> np.ndarray:
    """Norms of the errors of rotation, velocity and position over two turns of the cone: the box is back as it was."""
    samples, velocity, position = coning(rate_hz)
    inc = plain(samples)
    off = (rotation_log(inc.rotation), inc.velocity - velocity[:, None], inc.position - position[:, None])
    return np.array([np.linalg.norm(x) for x in off])


def test_rest_on_the_ground_is_all_specific_force():
    t_s = np.arange(401) / 100.0
    inc = plain(samples_of(t_s, np.zeros((401, 3)), np.tile([0.0, 0.0, 9.8], (401, 1)), 200))
    assert_allclose(inc.duration, 2.0, rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.rotation, np.tile(np.eye(3)[:, :, None], 2), rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.velocity, [[0.0] * 2, [0.0] * 2, [19.6] * 2], rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.position, [[0.0] * 2, [0.0] * 2, [19.6] * 2], rtol=0.0, atol=ROUNDING)


def test_a_steady_turn_on_uneven_times_is_exact_in_rotation():
    samples = jittered(200, 2)
    rate = np.array([0.3, -0.4, 0.5])
    inc = plain(replace(samples, gyro_s=np.tile(rate, (401, 1))))
    expected = rotation_exp(rate[:, None] * np.diff(samples.knot_times))
    assert_allclose(inc.duration, np.diff(samples.knot_times), rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.rotation, expected, rtol=0.0, atol=ROUNDING)


def test_errors_on_a_coning_motion_are_of_second_order_in_the_step():
    coarse, fine = errors_of_coning(100.0), errors_of_coning(200.0)
    # Between samples the signals are linear: sines are too small by (w h)^2 / 12 = 3.3e-4. The tilt is back after a
    # turn, but the rotation about the cone, w 0.1^2 / 2 = 0.031 rad/s for 2 s, goes with the square and lacks twice as
    # much. A tilt error of 0.1 * 3.3e-4 turns the force of 10 m/s^2, and the swing of 1 m/s^2 loses 3.3e-4.
    small = (2.0 * np.pi * 0.01) ** 2 / 12.0
    assert np.all(coarse < small * np.array([0.14, 2.0 * (0.1 * 10.0 + 1.0), 2.0 * (0.1 * 10.0 + 1.0)]))
    # Half the step, a quarter of the error; the fourth order adds less than (w h)^2.
    assert_allclose(coarse / fine, 4.0, rtol=0.0, atol=0.05)


@pytest.mark.parametrize(
    "samples", [drive(10, 2.0, 20), drive(25, 2.0, 50), jittered(200, 1)], ids=["10 Hz", "25 Hz", "uneven"]
)
def test_coning_and_sculling_raise_the_order_of_the_increments(samples):
    inc = plain(samples)
    # A step that turns by phi pushes as sin(phi) / phi: the midpoint rule is off by phi^2 / 24, ours, which keeps the
    # square, by less than phi^3 / 24. The reference at twenty times the rate has 1/400 of the error of its rule.
    turn = np.max(np.linalg.norm(samples.gyro_s[:-1], axis=1) * np.diff(samples.t_s))
    coarse, fine = (strapdown(*subdivided(samples, parts)) for parts in (1, 20))
    for ours, once, reference in zip((inc.rotation, inc.velocity, inc.position), coarse, fine, strict=True):
        assert np.linalg.norm(ours[..., 0] - reference) < (turn + 1.0 / 400.0) * np.linalg.norm(once - reference)


def test_rates_of_10_100_and_1000_hz_agree_on_a_slow_motion():
    finest = plain(drive(1000, 20.0, 2000))
    for rate_hz in (10, 100):
        inc = plain(drive(rate_hz, 20.0, 2 * rate_hz))
        # Sines are too small by (w h)^2 / 12 between samples; the fastest has 0.6 Hz. Amplitudes 0.5 rad/s and
        # 2 m/s^2, forces of up to 15 m/s^2 tilted by the error of the rotation.
        small = (2.0 * np.pi * 0.6 / rate_hz) ** 2 / 12.0
        turn = 2.0 * small
        assert np.all(np.abs(rotation_log(mtm(finest.rotation, inc.rotation))) < turn)
        assert np.all(np.abs(inc.velocity - finest.velocity) < 15.0 * turn + 4.0 * small)
        assert np.all(np.abs(inc.position - finest.position) < 15.0 * turn + 4.0 * small)


def test_turning_the_box_turns_the_increments():
    samples = drive(100, 8.0, 200)
    turn = Rotation.from_rotvec([2.0, -1.0, 0.5]).as_matrix()
    turned = plain(replace(samples, gyro_s=samples.gyro_s @ turn.T, accel_s=samples.accel_s @ turn.T))
    inc, c = plain(samples), turn[:, :, None]
    assert_allclose(turned.rotation, mm(mm(c, inc.rotation), c.swapaxes(0, 1)), rtol=0.0, atol=ROUNDING)
    assert_allclose(turned.velocity, mv(c, inc.velocity), rtol=0.0, atol=10 * ROUNDING)
    assert_allclose(turned.position, mv(c, inc.position), rtol=0.0, atol=10 * ROUNDING)
    big = np.kron(np.eye(3), turn)
    assert_allclose(turned.covariance_gyro, big @ inc.covariance_gyro @ big.T, rtol=0.0, atol=1e-9)
    assert_allclose(turned.velocity_gyro, mm(mm(c, inc.velocity_gyro), c.swapaxes(0, 1)), rtol=0.0, atol=1e-10)


def test_two_intervals_chain_to_one_of_twice_the_length():
    long, short = plain(drive(100, 8.0, 200)), plain(drive(100, 8.0, 100))
    first, then = slice(0, None, 2), slice(1, None, 2)
    rotation, length = short.rotation[..., first], short.duration[then]
    velocity = short.velocity[:, first] + mv(rotation, short.velocity[:, then])
    position = short.position[:, first] + short.velocity[:, first] * length + mv(rotation, short.position[:, then])
    assert_allclose(long.rotation, mm(rotation, short.rotation[..., then]), rtol=0.0, atol=ROUNDING)
    assert_allclose(long.velocity, velocity, rtol=0.0, atol=10 * ROUNDING)
    assert_allclose(long.position, position, rtol=0.0, atol=10 * ROUNDING)


def test_partial_increments_start_at_the_knot_and_lead_to_the_next():
    long, short = plain(drive(100, 8.0, 200)), plain(drive(100, 8.0, 100))
    for partial, whole in (
        (quat_to_matrix(long.q), short.rotation),
        (long.dv, short.velocity),
        (long.dp, short.position),
    ):
        assert_allclose(partial[..., 100::200], whole[..., ::2], rtol=0.0, atol=ROUNDING)
    assert_array_equal(long.q[:, ::200], np.tile([[1.0], [0.0], [0.0], [0.0]], 4))
    assert_array_equal(long.dv[:, ::200], 0.0)
    assert_array_equal(long.dp[:, ::200], 0.0)


def test_intervals_worked_on_in_several_chunks_are_those_worked_on_alone():
    samples = drive(100, 600.0, 200)
    bias_g, bias_a = np.random.default_rng(1).normal(0.0, 0.1, (2, 3, 300))
    scale = np.array([0.01, -0.02, 0.03, -0.01, 0.02, 0.005])
    inc = preintegrate(samples, bias_g, bias_a, scale)
    for k in (0, 99, 100, 299):
        rows = slice(200 * k, 200 * (k + 1) + 1)
        alone = samples_of(samples.t_s[rows], samples.gyro_s[rows], samples.accel_s[rows], 200)
        one = preintegrate(alone, bias_g[:, k : k + 1], bias_a[:, k : k + 1], scale)
        assert_allclose(inc.position[:, k], one.position[:, 0], rtol=0.0, atol=ROUNDING)
        assert_allclose(inc.position_gyro_scale[..., k], one.position_gyro_scale[..., 0], rtol=0.0, atol=1e-10)
        assert_allclose(inc.covariance_gyro[k], one.covariance_gyro[0], rtol=0.0, atol=1e-9)
        assert_allclose(inc.dp[:, rows.start : rows.stop - 1], one.dp, rtol=0.0, atol=ROUNDING)


def test_increments_of_some_intervals_are_those_of_their_samples():
    samples = jittered(10, 12)
    biases, scale = np.random.default_rng(3).normal(0.0, 0.01, (2, 3, 12)), np.full(6, 0.01)
    rows, steps = slice(40, 91), slice(40, 90)
    alone = Samples(
        samples.t_s[rows], samples.gyro_s[rows], samples.accel_s[rows], samples.filled[steps], samples.row[rows], 10
    )
    part = preintegrate(samples, *biases, scale).part(slice(4, 9))
    summed = preintegrate(alone, *biases[..., 4:9], scale)
    for name, value in vars(summed).items():
        # Quaternions are multiplied in blocks, whose size is another one: rounding of a few products.
        assert_allclose(getattr(part, name), value, rtol=0.0, atol=1e-14, err_msg=name)


def test_biases_and_scale_errors_are_taken_off():
    samples, true = drive(100, 4.0, 200), plain(drive(100, 4.0, 200))
    bias_g, bias_a = np.array([0.01, -0.02, 0.03]), np.array([0.3, -0.1, 0.2])
    scale = np.array([0.01, -0.02, 0.03, -0.01, 0.02, 0.005])
    spoilt = replace(
        samples,
        gyro_s=samples.gyro_s / (1.0 - scale[:3]) + bias_g,
        accel_s=samples.accel_s / (1.0 - scale[3:]) + bias_a,
    )
    inc = preintegrate(spoilt, np.tile(bias_g[:, None], 2), np.tile(bias_a[:, None], 2), scale)
    assert_allclose(inc.rotation, true.rotation, rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.velocity, true.velocity, rtol=0.0, atol=10 * ROUNDING)
    assert_allclose(inc.position, true.position, rtol=0.0, atol=10 * ROUNDING)


def differences(samples: Samples, which: str, axis: int) -> list[np.ndarray]:
    """Central differences of rotation (to the right), velocity and position about the linearisation used below."""
    k, size = samples.intervals, 1e-4
    both = []
    for sign in (1.0, -1.0):
        bias_g, bias_a, scale = linearisation(k)
        {"gyro": bias_g, "accel": bias_a, "gyro_scale": scale[:3], "accel_scale": scale[3:]}[which][axis] += sign * size
        both.append(preintegrate(samples, bias_g, bias_a, scale))
    plus, minus = both
    turn = rotation_log(mtm(minus.rotation, plus.rotation))
    return [x / (2.0 * size) for x in (turn, plus.velocity - minus.velocity, plus.position - minus.position)]


def linearisation(k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    bias_g = np.tile([[0.02], [-0.01], [0.03]], k)
    bias_a = np.tile([[0.1], [0.2], [-0.1]], k)
    return bias_g, bias_a, np.array([0.01, -0.02, 0.03, -0.01, 0.02, 0.005])


# For biases the rule is Simpson's on panels of H = 0.04 s: w = 2 pi 0.6 / s at most leaves (w H)^4 / 180 = 2.9e-6; a
# step that turns by phi = 0.011 was itself integrated to phi^3 / 24 = 6e-8. At 10 Hz H = 0.1 s and phi = 0.11 rad:
# 1.2e-4 and 6e-5. Beside a step of 0.09 s panels of up to 0.12 s are left to the trapezoid, (w H)^2 / 12 = 1.7e-2 of
# two of fifty panels: 7e-4. For scale errors the smooth factor is linear in a panel: (w H)^2 / 12 = 1.9e-3, at 10 Hz
# 1.2e-2. Vibration shakes the box by 0.1 / (2 pi 21) = 8e-4 rad unseen by the panels. Central differences leave 1e-8.
@pytest.mark.parametrize(
    ("samples", "of_bias", "of_scale"),
    [
        (drive(10, 20.0, 20), 1.8e-4, 1.2e-2),
        (drive(100, 20.0, 200), 3e-6, 1.9e-3),
        (drive(1000, 20.0, 2000), 3e-6, 1.9e-3),
        (jittered(200, 5), 7e-4, 2.6e-3),
        (drive(100, 20.0, 200, vibration=1.0), 8e-4, 2.7e-3),
    ],
    ids=["10 Hz", "100 Hz", "1000 Hz", "uneven", "vibrating"],
)
@pytest.mark.parametrize("which", ["gyro", "accel", "gyro_scale", "accel_scale"])
def test_derivatives_are_those_of_finite_differences(samples, of_bias, of_scale, which):
    inc = preintegrate(samples, *linearisation(samples.intervals))
    tolerance = of_scale if which.endswith("scale") else of_bias
    found = np.stack([np.concatenate(differences(samples, which, axis)) for axis in range(3)], axis=1)
    for rows, name in ((slice(0, 3), "rotation"), (slice(3, 6), "velocity"), (slice(6, 9), "position")):
        expected = found[rows]
        jacobian = getattr(inc, f"{name}_{which}", np.zeros_like(expected))
        assert_allclose(jacobian, expected, rtol=0.0, atol=tolerance * np.abs(expected).max() + 1e-9)


def forster(samples: Samples, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Covariances for unit gyro and accelerometer noise, step by step: Forster et al. 2017, eqs. A.7 to A.9."""
    t_s, gyro_s, accel_s = subdivided(samples, parts)
    rotation = np.eye(3)
    by_gyro, by_accel = np.zeros((2, 9, 9))
    for k, h in enumerate(np.diff(t_s)):
        if h == 0.0:
            continue
        rate, force = (0.5 * (x[k] + x[k + 1]) for x in (gyro_s, accel_s))
        turn = Rotation.from_rotvec(h * rate).as_matrix()
        pull = rotation @ np.cross(force, np.eye(3)).T
        step, noise_g, noise_a = np.eye(9), np.zeros((9, 3)), np.zeros((9, 3))
        step[:3, :3], step[3:6, :3], step[6:, :3], step[6:, 3:6] = turn.T, -h * pull, -0.5 * h**2 * pull, h * np.eye(3)
        noise_g[:3], noise_a[3:6], noise_a[6:] = h * np.eye(3), h * rotation, 0.5 * h**2 * rotation
        by_gyro = step @ by_gyro @ step.T + noise_g @ noise_g.T / h
        by_accel = step @ by_accel @ step.T + noise_a @ noise_a.T / h
        rotation = rotation @ turn
    return by_gyro, by_accel


@pytest.mark.parametrize(
    "samples",
    [drive(10, 2.0, 20), drive(100, 2.0, 200), drive(1000, 2.0, 2000), jittered(200, 1)],
    ids=["10 Hz", "100 Hz", "1000 Hz", "uneven"],
)
def test_covariances_are_those_of_the_step_by_step_recursion(samples):
    inc = plain(samples)
    # The noise of a step begins to act at its end: of a variance that grows with the cube of the time the recursion
    # lacks 1.5 steps in the whole. In 2000 or more parts that is 7.5e-4; the step of 0.09 s, in ten, lacks its own.
    parts = max(2000 // samples.per_interval, 1)
    for ours, reference in zip((inc.covariance_gyro[0], inc.covariance_accel[0]), forster(samples, parts), strict=True):
        sigma = np.sqrt(np.diag(reference))
        scale = np.outer(sigma, sigma)
        assert np.all(np.abs(ours - reference) <= 0.005 * scale)


def test_covariances_are_those_of_trials():
    # One interval 1800 times over, signals repeated so that the trials differ by their noise alone.
    trials, m, h = 1800, 200, 0.01
    t_s = np.arange(trials * m + 1) * h
    gyro, accel = signals(np.arange(m) * h)
    gyro, accel = (np.append(np.tile(x, (trials, 1)), x[:1], axis=0) for x in (gyro, accel))
    rng = np.random.default_rng(2)
    density_g, density_a = 1e-3, 1e-2
    noisy = samples_of(
        t_s,
        gyro + rng.normal(0.0, density_g / np.sqrt(h), gyro.shape),
        accel + rng.normal(0.0, density_a / np.sqrt(h), accel.shape),
        m,
    )
    clean, inc = plain(samples_of(t_s[: m + 1], gyro[: m + 1], accel[: m + 1], m)), plain(noisy)
    off = np.concatenate(
        [rotation_log(mtm(clean.rotation, inc.rotation)), inc.velocity - clean.velocity, inc.position - clean.position]
    )
    predicted = density_g**2 * clean.covariance_gyro[0] + density_a**2 * clean.covariance_accel[0]
    whitened = np.linalg.solve(np.linalg.cholesky(predicted), off)
    # Of 1800 trials a variance is known to sqrt(2 / 1800) = 3.3 %, a covariance to 2.4 %; 4.5 sigma of 45 numbers.
    assert_allclose(whitened @ whitened.T / trials, np.eye(9), rtol=0.0, atol=4.5 * np.sqrt(2.0 / trials))


def test_covariances_of_uneven_intervals_can_be_factored():
    inc = plain(jittered(200, 20))
    np.linalg.cholesky(inc.covariance_gyro + inc.covariance_accel)
    assert_allclose(inc.covariance_gyro, inc.covariance_gyro.swapaxes(1, 2), rtol=ROUNDING)


def test_a_bridged_gap_lasts_as_long_as_it_did():
    t_s = np.delete(np.arange(6001) / 100.0, np.arange(1001, 3000))
    samples = regular_samples(t_s, *signals(t_s))
    inc = plain(samples)
    assert_allclose(inc.duration.sum(), 60.0, rtol=0.0, atol=ROUNDING)
    assert_allclose(inc.duration, np.diff(samples.knot_times), rtol=0.0, atol=ROUNDING)
    # Rows 1001 to 1199 are filled in; the interval of 20 s but for the first of its steps lies still on its own force.
    rotation, velocity, position = strapdown(
        *subdivided(
            replace(
                samples,
                t_s=samples.t_s[1000:1201],
                gyro_s=samples.gyro_s[1000:1201],
                accel_s=samples.accel_s[1000:1201],
            ),
            20,
        )
    )
    assert_allclose(inc.rotation[..., 5], rotation, rtol=0.0, atol=1e-5)
    assert_allclose(inc.velocity[:, 5], velocity, rtol=0.0, atol=1e-3)
    assert_allclose(inc.position[:, 5], position, rtol=0.0, atol=1e-2)


def test_arguments_are_left_alone():
    samples = drive(100, 4.0, 200)
    gyro, accel = samples.gyro_s.copy(), samples.accel_s.copy()
    bias_g, bias_a, scale = linearisation(2)
    preintegrate(samples, bias_g, bias_a, scale)
    assert_array_equal(samples.gyro_s, gyro)
    assert_array_equal(samples.accel_s, accel)
    for ours, expected in zip((bias_g, bias_a, scale), linearisation(2), strict=True):
        assert_array_equal(ours, expected)
