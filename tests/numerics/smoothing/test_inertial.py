"""The factor of the IMU: zero at the truth, its Jacobian against differences, its weight against its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Linearised, Log, dense, derivatives, linearised

from recon.numerics.smoothing.inertial import HERE, THERE, add_inertial, covariance, inertial_jacobian, whitening
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.preintegration import preintegrate
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    COMMON_SIZE,
    GYRO_BIAS,
    KNOT_SIZE,
    POSITION,
    ROTATION,
    SCALES,
    VELOCITY,
    State,
)

LIVELY = Log(seconds=30.0, kind="nonstop", rest_s=3.0, imu_hz=100.0)
QUIET = Log(seconds=30.0, kind="nonstop", rest_s=3.0, imu_hz=100.0, quiet=True)


def tall_at(drive: Linearised, state: State) -> np.ndarray:
    return inertial_jacobian(state, drive.increments, drive.gravity, drive.smoother.earth_rate_n)


def spread_out(tall: np.ndarray, knots: int) -> np.ndarray:
    """Jacobians (K, r, 31) as rows of the whole problem: (K, r, 18 N + COMMON_SIZE)."""
    whole = np.zeros((*tall.shape[:2], KNOT_SIZE * knots + COMMON_SIZE))
    for k in range(knots - 1):
        here, there = KNOT_SIZE * k, KNOT_SIZE * (k + 1)
        whole[k][:, here + HERE.start : here + HERE.stop] = tall[k, :, :15]
        whole[k][:, there + THERE.start : there + THERE.stop] = tall[k, :, 15:24]
        whole[k][:, KNOT_SIZE * knots + SCALES.start : KNOT_SIZE * knots + SCALES.stop] = tall[k, :, 24:30]
    return whole


def test_the_truth_of_a_quiet_drive_leaves_no_residual():
    drive = linearised(QUIET)
    residual = -tall_at(drive, drive.state)[..., -1]
    samples, length = drive.sim.drive.samples, float(drive.increments.duration.max())
    # Trapezoidal rule: T h^2 / 12 |f''|, and h^2 f'' is the second difference of the samples. Coriolis acceleration is
    # taken at its mean and gravity at the knot before; the lean of the Earth's turn, w f t, is corrected at its mean
    # time, so that only what the force changes by is left: 5 m/s^2 at most.
    sharp_g, sharp_a = (np.linalg.norm(np.diff(x, 2, axis=0), axis=1).max() for x in (samples.gyro_s, samples.accel_s))
    turn = length / 12.0 * sharp_g
    speed = float(np.abs(drive.state.vel_n).max())
    rest = (2.0 + 1.0) * 7.3e-5 * 5.0 * length**2 / 8.0 + 9.8 / 6.4e6 * speed * length**2 / 2.0
    vel = length * (sharp_a / 12.0 + 12.0 * turn) + rest
    assert np.linalg.norm(residual[:, 0:3], axis=1).max() < turn
    assert np.linalg.norm(residual[:, 3:6], axis=1).max() < vel
    assert np.linalg.norm(residual[:, 6:9], axis=1).max() < vel * length
    # At rest, in the first interval, nothing is left but the square of the Earth's turn, w T, in front of f T^2 / 2,
    # and the bend of the plumb line 500 m above the ellipsoid, 4e-6 m/s^2, which the simulated gravity does not have.
    assert np.abs(residual[0]).max() < (7.3e-5 * length) ** 2 * 5.0 * length**2 + 8.1e-9 * 500.0 * length


@pytest.mark.parametrize("off", [0.0, 1.0], ids=["at the truth", "off"])
def test_the_jacobian_is_that_of_differences(off):
    drive = linearised(LIVELY, off)
    state, length = drive.state, float(drive.increments.duration.max())
    tall = tall_at(drive, state)
    found = spread_out(tall, state.knots)
    wanted = derivatives(lambda x: -tall_at(drive, x)[..., -1], state)
    residual = float(np.abs(tall[:, :3, -1]).max())
    # Left out are: Coriolis acceleration of the velocities, 2 w T, and the gradient of gravity, 2 g / R T; the Earth's
    # turn w T in front of unit vectors; and of the inverse right Jacobian of SO(3) what is beyond 1 + e / 2: e^2 / 12,
    # behind the bias also e / 2 itself.
    earth = 7.3e-5 * length
    rotation = earth + residual**2
    tolerance = (
        (ROTATION, (rotation, 1e-9, 1e-9)),
        (VELOCITY, (1e-9, 2.0 * earth, 2.0 * earth * length)),
        (POSITION, (1e-9, 3.1e-6 * length, 1.6e-6 * length**2 + earth)),
        (GYRO_BIAS, (residual * length, 1e-9, 1e-9)),
        (ACCEL_BIAS, (1e-9, 1e-9, 1e-9)),
    )
    knots = np.abs(found - wanted)[..., : KNOT_SIZE * state.knots].reshape(-1, 9, state.knots, KNOT_SIZE)
    for columns, allowed in tolerance:
        for rows, most in zip((slice(0, 3), slice(3, 6), slice(6, 9)), allowed, strict=True):
            assert knots[:, rows, :, columns].max() <= most + 1e-7, (columns, rows)
    common = np.abs(found - wanted)[..., KNOT_SIZE * state.knots :]
    assert common[..., : SCALES.start].max() == 0.0
    # Rates are below 1 rad/s, so a scale error turns no more than a bias of 1 rad/s.
    assert common[:, :3].max() <= residual * length + 1e-7
    assert common[:, 3:].max() <= 1e-7


def test_biases_and_scale_errors_act_like_integrating_anew():
    drive = linearised(LIVELY)
    state, samples = drive.state, drive.sim.drive.samples
    change = np.array([1e-4, -2e-4, 3e-4])[:, None]
    moved = State(
        state.rot_ns, state.vel_n, state.pos_n, state.gyro_bias + change, state.accel_bias + 10.0 * change,
        state.drift_n, state.rot_vs, state.with_common(SCALES, np.repeat([1e-4, 1e-3], 3)).common,
    )  # fmt: skip
    anew = preintegrate(samples, moved.gyro_bias[:, :-1], moved.accel_bias[:, :-1], moved.common[SCALES])
    wanted = inertial_jacobian(moved, anew, drive.gravity, drive.smoother.earth_rate_n)[..., -1]
    found = tall_at(drive, moved)[..., -1]
    shift = np.abs(found - tall_at(drive, state)[..., -1]).max(axis=0)
    # First order: what is left is the square of the turn, (4e-4 x 2 s)^2, times sums of force of 10 T and 10 T^2 / 2.
    turned = (4e-4 * 2.0) ** 2
    assert np.abs(found - wanted)[:, :3].max() < turned
    assert np.abs(found - wanted)[:, 3:].max() < turned * 20.0
    assert (shift > 100.0 * turned).all()


def test_weights_are_the_inverse_of_the_covariance():
    drive = linearised(LIVELY)
    count = len(drive.increments.duration)
    gyro, accel = np.linspace(1e-4, 1e-3, count), np.linspace(1e-3, 1e-2, count)
    root = whitening(drive.increments, gyro, accel)
    whole = covariance(drive.increments, gyro, accel)
    # Sums of nine products of factors whose sizes differ by the condition of the Cholesky factor, some 1e3.
    assert_allclose(root @ whole @ root.swapaxes(1, 2), np.tile(np.eye(9), (count, 1, 1)), atol=1e-11)
    assert_allclose(whole[:, 3:6, 3:6].trace(axis1=1, axis2=2) / 3.0 > accel**2 * drive.increments.duration, True)


def test_the_normal_equations_are_those_of_the_whole_weighted_jacobian():
    drive = linearised(LIVELY, 1.0)
    knots = drive.state.knots
    tall = tall_at(drive, drive.state)
    white = whitening(drive.increments, *drive.smoother.disturbed.densities(drive.sim.log.noise))
    normal = Normal(knots)
    add_inertial(normal, tall, white)
    matrix, right = dense(normal)
    jacobian = (white @ spread_out(tall, knots)).reshape(9 * (knots - 1), -1)
    residual = -(white @ tall[..., -1:]).ravel()
    size = np.maximum(np.sqrt((jacobian**2).sum(axis=0)), 1.0)
    # Sums of some hundred products, relative to the sizes of the columns.
    assert_allclose((matrix - jacobian.T @ jacobian) / np.outer(size, size), 0.0, atol=1e-12)
    assert_allclose((right + jacobian.T @ residual) / size, 0.0, atol=1e-12 * np.linalg.norm(residual))
    assert normal.cost == pytest.approx(residual @ residual, rel=1e-12)


def test_a_silent_imu_says_less_the_longer_it_is_silent():
    short, long = (linearised(Log(seconds=40.0, kind="nonstop", silent=((20.0, 20.0 + s),))) for s in (1.0, 5.0))
    for drive in (short, long):
        gyro, accel = drive.smoother.disturbed.densities(drive.sim.log.noise)
        bridged = drive.smoother.disturbed.gap_s > 0.0
        assert_allclose(gyro[~bridged], drive.sim.log.gyro, rtol=1e-12)
        assert (gyro[bridged] > 10.0 * drive.sim.log.gyro).all()
        assert (accel[bridged] > 10.0 * drive.sim.log.accel).all()
    assert (
        long.smoother.disturbed.densities(long.sim.log.noise)[0].max()
        > short.smoother.disturbed.densities(short.sim.log.noise)[0].max()
    )
