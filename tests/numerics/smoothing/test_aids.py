"""Ground, directions and turn rates against rows written out, their differences, and drives with truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Linearised, Log, check_rows, dense, height_error, linearised, simulate

from recon.numerics.smoothing import Model, estimate
from recon.numerics.smoothing.aids import Direction, Ground, Rate, Speed, around
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import cross, mtv, rotation_exp
from recon.numerics.smoothing.state import CAMERA, CAMERA_LEVER, KNOT_SIZE, VELOCITY, WHEEL

SEEDS = range(1, 7)
POOR = Log(seconds=200.0, kind="nonstop", gyro=np.radians(0.1), accel=0.1, gyro_walk=np.radians(5e-3), accel_walk=5e-3)


@pytest.fixture(scope="module")
def drive() -> Linearised:
    return linearised(Log(seconds=30.0, kind="nonstop", rest_s=3.0), off=0.01)


def test_the_box_keeps_its_distance_from_the_ground(drive):
    t_s = np.arange(0.0, 25.0, 1.0)
    there = drive.sim.at(t_s).pos_n
    normal_n = np.array([[-0.05], [0.02], [1.0]]) / np.sqrt(1.0029) * np.ones(len(t_s))
    aid = Ground(t_s, there + 0.2, normal_n, np.full(len(t_s), 0.5), 100.0)

    def rows(factors, state):
        away = (factors.normal_n * (state.pos_n[:, factors.k] - factors.pos_n)).sum(axis=0)
        return (away / np.sqrt(factors.variance))[None]

    check_rows(drive, aid, rows)


def directions(truth, rng=None):
    """What a camera at the IMU sees, to half a degree where there is an rng: (3, m)."""
    vel_s = mtv(truth.rot_ns, truth.vel_n)
    direction = vel_s / np.maximum(np.linalg.norm(vel_s, axis=0), 1e-9)
    if rng is not None:
        direction = direction + np.radians(0.5) * rng.standard_normal(direction.shape)
    return direction / np.maximum(np.linalg.norm(direction, axis=0), 1e-9)


def test_a_camera_tells_the_direction_of_travel(drive):
    t_s = np.arange(0.0, 30.0, 0.1)
    truth = drive.sim.at(t_s)
    rate = np.array([[0.1], [-0.2], [0.3]]) * np.sin(t_s)
    aid = Direction(t_s, directions(truth), np.full(len(t_s), 0.03), rate)

    def velocity(factors, state):
        lever = np.broadcast_to(state.common[CAMERA_LEVER, None], factors.rate_s.shape)
        return mtv(state.rot_ns[..., factors.k], state.vel_n[:, factors.k]) + cross(factors.rate_s, lever)

    def rows(factors, state):
        fixed = np.linalg.norm(velocity(factors, drive.state), axis=0)
        across = np.einsum("ij,ajm->aim", rotation_exp(state.common[CAMERA, None])[..., 0], factors.across_s)
        seen = np.einsum("aim,im->am", across, velocity(factors, state))
        return seen / np.maximum(fixed, 1.0) / np.sqrt(factors.variance) * (fixed > 1.0)

    check_rows(drive, aid, rows)


def test_a_state_that_moves_the_other_way_is_turned_round(drive):
    """It is as little across the direction as the right one; the nearest state that fits moves along it as fast."""
    t_s = np.arange(0.0, 30.0, 0.1)
    aid = Direction(t_s, directions(drive.sim.at(t_s)), np.full(len(t_s), 0.03), np.zeros((3, len(t_s))))
    factors = aid.at(drive.smoother.drive.samples.knot_times)
    back = replace(drive.state, vel_n=-drive.state.vel_n)
    normal = Normal(back.knots)
    factors.add(normal, back, drive.gravity)
    step = np.linalg.lstsq(*dense(normal), rcond=1e-12)[0][: KNOT_SIZE * back.knots].reshape(back.knots, KNOT_SIZE)
    before = drive.state.vel_n.T
    fast = factors.k[np.linalg.norm(before[factors.k], axis=1) > 2.0]
    assert len(fast) > 10
    after = (back.vel_n.T + step[:, VELOCITY])[fast]
    along = (after * before[fast]).sum(axis=1) / (before[fast] ** 2).sum(axis=1)
    # the lever at the camera that all share takes its part; directions of two seconds differ from that of their middle
    assert_allclose(along, 1.0, atol=0.2)


def test_a_speed_tells_the_length_of_the_velocity(drive):
    t_s = np.arange(0.0, 30.0, 0.1)
    aid = Speed(t_s, 1.02 * np.linalg.norm(drive.sim.at(t_s).vel_n, axis=0), 0.1)

    def rows(factors, state):
        speed = np.linalg.norm(state.vel_n[:, factors.k], axis=0)
        error = speed - (1.0 + state.common[WHEEL]) * factors.speed
        return (error / 0.1 * (np.linalg.norm(drive.state.vel_n[:, factors.k], axis=0) > 1.0))[None]

    check_rows(drive, aid, rows)


def test_what_a_camera_is_turned_by_and_where_it_stands_is_found():
    """A degree and a metre off, told to be known to a degree and a metre: a drive with bends shows both."""
    turned, lever = np.radians([0.0, 1.0, -0.8]), np.array([1.0, 0.3, -0.2])
    sim = simulate(Log(seconds=200.0, kind="nonstop", seed=2))
    t_s = np.arange(0.0, 200.0, 0.1)
    truth = sim.at(t_s)
    rate = np.array([np.interp(t_s, sim.drive.samples.t_s, axis) for axis in sim.drive.samples.gyro_s.T])
    vel_s = mtv(truth.rot_ns, truth.vel_n) + cross(rate, np.broadcast_to(lever[:, None], rate.shape))
    seen = mtv(rotation_exp(turned[:, None]), vel_s / np.maximum(np.linalg.norm(vel_s, axis=0), 1e-9))
    noise = np.radians(0.5) * np.random.default_rng(1).standard_normal(seen.shape)
    seen = (seen + noise) / np.linalg.norm(seen + noise, axis=0)
    aid = Direction(t_s, seen, np.full(len(t_s), np.radians(0.5)), rate)
    model = Model(camera=np.radians(1.0), camera_lever_sigma=1.0)
    found = estimate(replace(sim.drive, aids=(aid,)), model, sim.log.noise, learn_noise=False)
    sigma = np.sqrt(np.diag(found.covariance_common))
    for where, true in ((CAMERA, turned), (CAMERA_LEVER, lever)):
        off = found.solved.state.common[where] - true
        assert (np.abs(off) < 4.0 * sigma[where]).all()
    # about the way itself a camera turns no direction, and along the way a lever moves none: both keep their prior
    assert (sigma[CAMERA][1:] < np.radians(0.2)).all()
    assert sigma[CAMERA_LEVER][0] < 0.3


@pytest.mark.parametrize("one_axis", [False, True])
def test_another_sensor_of_turns_tells_the_bias_of_the_gyroscope(drive, one_axis):
    t_s = np.arange(0.0, 30.0, 0.1)
    count = len(t_s)
    gyro, seen = np.full((3, count), 0.02), np.tile(np.array([[0.01], [0.015], [0.018]]), count)
    axes = np.tile(np.array([[0.0], [0.6], [0.8]]), count) if one_axis else None
    aid = Rate(t_s, np.full(count, 0.1), gyro, seen, axes, np.full(count, 0.01))

    def rows(factors, state):
        error = (state.gyro_bias[:, factors.k] - factors.bias) / np.sqrt(factors.variance)
        return error if factors.axes_s is None else (factors.axes_s * error).sum(axis=0)[None]

    check_rows(drive, aid, rows)


def test_samples_count_for_the_knots_within_a_second():
    t_s = np.array([0.0, 0.5, 1.0, 1.5, 9.0])
    count, mean = around(np.array([0.0, 2.0, 5.0]), t_s, np.array([[1.0, 2.0, 3.0, 4.0, 5.0]]))
    assert count.tolist() == [3, 2, 0]
    assert mean.tolist() == [[2.0, 3.5, 0.0]]


def test_a_map_of_heights_lowers_the_error_and_a_bridge_is_let_go():
    """The ground is known to 0.5 m but where the vehicle crosses a bridge, 12 m above it."""
    for seed in SEEDS:
        sim = simulate(Log(seconds=300.0, seed=seed, drift=3.0, gnss_hz=0.5))
        rng = np.random.default_rng(seed)
        t_s = np.arange(0.0, 300.0, 1.0)
        ground = sim.at(t_s).pos_n + np.vstack([np.zeros((2, 300)), 0.5 * rng.standard_normal((1, 300))])
        ground[2, 150:170] -= 12.0
        up = np.tile(np.array([[0.0], [0.0], [1.0]]), 300)
        aid = Ground(t_s, ground, up, np.full(300, 0.5), 30.0)
        with_it, without = (np.sqrt(np.mean(height_error(sim, aids) ** 2)) for aids in ((aid,), ()))
        assert with_it < 0.6 * without


def test_directions_of_a_camera_bound_the_drift_across_in_an_outage_without_wheels():
    """Half a minute without GNSS, a poor IMU, nothing assumed of wheels: ten directions a second to 0.5 deg each."""
    gained = []
    for seed in SEEDS:
        sim = simulate(replace(POOR, seed=seed))
        fixes = sim.drive.fixes
        hidden = (fixes.t_s > 120.0) & (fixes.t_s < 150.0)
        fixes = replace(fixes, pos_sigma=np.where(hidden, np.inf, fixes.pos_sigma),
                        vel_sigma=np.where(hidden, np.inf, fixes.vel_sigma))  # fmt: skip
        t_s = np.arange(0.0, 200.0, 0.1)
        truth = sim.at(t_s)
        direction = directions(truth, rng=np.random.default_rng(seed))
        aid = Direction(t_s, direction, np.full(len(t_s), np.radians(0.5)), np.zeros((3, len(t_s))))
        knots = sim.drive.samples.knot_times
        inside = (knots > 125.0) & (knots < 145.0)
        true = sim.at(knots)
        way = true.vel_n[:2] / np.maximum(np.linalg.norm(true.vel_n[:2], axis=0), 1e-9)
        error = []
        for aids in ((), (aid,)):
            found = estimate(replace(sim.drive, fixes=fixes, aids=aids), Model(wheels=False), sim.log.noise, False)
            away = (found.solved.state.pos_n - true.pos_n)[:2]
            error.append(float(np.sqrt(np.mean((way[0] * away[1] - way[1] * away[0])[inside] ** 2))))
        gained.append(error[1] / error[0])
    assert max(gained) < 1.0
    assert np.median(gained) < 0.75
