"""The peers solve drives whose truth is known, and their parts hold what they promise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.peers import ekf_rts, scores
from benchmarks.peers.drives import Drive, Estimate, Noise, Solve, World
from benchmarks.peers.ekf_model import MOUNT, ROTATION, SIZE, VELOCITY, Model, State, turn
from benchmarks.peers.simulated import simulated
from benchmarks.peers.start import find_start, standstill
from benchmarks.peers.steps import steps_between, with_none_longer

from recon.numerics.integration import cumulative
from recon.numerics.motion import specific_force, stop_and_go
from recon.numerics.rotation import Floats, conjugate, from_euler, from_rotvec, multiply, rotate
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import interpolate
from recon_simulators.drive_params import DriveParams

GRAVITY = 9.81
DURATION_S = 120.0
MOUNT_Q_VS = from_euler(0.3, -0.1, 0.05)
LEVER_S = np.array([0.5, -0.3, 0.8])
NOISE = Noise(
    gyro=1e-4,
    accel=1e-3,
    gyro_walk=1e-6,
    accel_walk=1e-4,
    gyro_bias=1e-2,
    accel_bias=0.2,
    gyro_scale=5e-3,
    drift_n=np.array([1e-3, 1e-3, 1e-3]),
    drift_s=100.0,
    white_n=np.array([2.0, 2.0, 3.0]),
    velocity_n=np.array([0.1, 0.1, 0.15]),
)


def perfect() -> tuple[Drive, Estimate]:
    """A city drive as ideal sensors log it, at 100 Hz and 1 Hz; the IMU in the rear axle."""
    motion = stop_and_go(DURATION_S, np.random.default_rng(3))
    imu = motion.at(np.arange(round(100 * DURATION_S) + 1) / 100.0)
    fix = motion.at(np.arange(0.43, DURATION_S - 0.5))
    q_ns, fix_q_ns = (multiply(truth.q_nv, MOUNT_Q_VS) for truth in (imu, fix))
    q_sv = conjugate(MOUNT_Q_VS)
    rate_s = rotate(q_sv, fix.gyro_v)
    drive = Drive(
        t_s=imu.t_s,
        gyro_s=rotate(q_sv, imu.gyro_v),
        accel_s=rotate(q_sv, specific_force(imu, GRAVITY)),
        fix_t_s=fix.t_s,
        fix_pos_n=fix.pos_n + rotate(fix_q_ns, LEVER_S),
        fix_vel_n=fix.vel_n + rotate(fix_q_ns, np.cross(rate_s, LEVER_S)),
        noise=NOISE,
        world=World.plane(GRAVITY),
        start_q_ns=q_ns[0],
        lever_s=LEVER_S,
        rear_s=np.zeros(3),
        mount_q_vs=MOUNT_Q_VS,
    )
    return drive, Estimate(imu.t_s, imu.pos_n, imu.vel_n, q_ns)


def noisy(seed: int) -> tuple[Drive, Estimate]:
    """The same with noise and biases as NOISE says, and without fixes from 60 s to 80 s."""
    drive, truth = perfect()
    rng = np.random.default_rng(seed)
    shape, fixes = drive.gyro_s.shape, drive.fix_pos_n.shape
    gyro = rng.normal(0.0, NOISE.gyro_bias, 3) + rng.normal(0.0, 10.0 * NOISE.gyro, shape)
    accel = rng.normal(0.0, NOISE.accel_bias, 3) + rng.normal(0.0, 10.0 * NOISE.accel, shape)
    seen = (drive.fix_t_s < 60.0) | (drive.fix_t_s > 80.0)
    return replace(
        drive,
        gyro_s=drive.gyro_s + gyro,
        accel_s=drive.accel_s + accel,
        fix_t_s=drive.fix_t_s[seen],
        fix_pos_n=(drive.fix_pos_n + rng.normal(0.0, NOISE.white_n, fixes))[seen],
        fix_vel_n=(drive.fix_vel_n + rng.normal(0.0, NOISE.velocity_n, fixes))[seen],
    ), truth


def solver(name: str) -> Solve:
    if name == "ekf_rts":
        return ekf_rts.solve
    pytest.importorskip("gtsam", reason="the peer gtsam_batch needs GTSAM: pip install recon-dynamics[bench]")
    from benchmarks.peers import gtsam_batch

    return gtsam_batch.solve if name == "gtsam_batch" else gtsam_batch.solve_scatter


PEERS = pytest.mark.parametrize("name", ["ekf_rts", "gtsam_batch", "gtsam_scatter"])


@PEERS
def test_perfect_sensors_give_the_truth(name: str) -> None:
    """What is left is that lines join the samples: rates miss 3e-5 rad/s and forces 2e-4 m/s^2 at most, h^2/12 of the
    second derivatives, for some tenths of a second where a bend begins or ends, with either sign. That is
    1e-5 rad and 1e-4 m/s a time; some ten of one sign are allowed, and 10 s of such a velocity."""
    drive, truth = perfect()
    found = scores.run(solver(name), drive, truth)
    assert found.drive.horizontal < 1e-2
    assert found.drive.vertical < 1e-2
    assert found.drive.velocity < 1e-3
    assert found.drive.tilt < 1e-4
    assert found.drive.heading < 1e-4


@PEERS
def test_noise_is_averaged_and_an_outage_bridged(name: str) -> None:
    """About 100 fixes and a path known to decimetres leave 2 m / sqrt(100) per axis of the place of the path, three
    times that is allowed. Velocity: 0.1 m/s over the some ten fixes in which the biases let tilt be told. A tilt of
    1 mrad bends the path of 20 s without fixes by at most g 1e-3 (20 s)^2 / 16 = 0.25 m between its ends."""
    drive, truth = noisy(0)
    found = scores.run(solver(name), drive, truth)
    assert found.drive.horizontal < 3.0 * np.hypot(0.2, 0.2)
    assert found.drive.velocity < 0.1
    assert found.drive.tilt < np.radians(0.1)
    assert found.outages.horizontal < 3.0 * np.hypot(0.2, 0.2) + 0.25
    assert np.isfinite(found.worst)


@PEERS
def test_fixes_far_off_hardly_matter(name: str) -> None:
    """Eight fixes are 40 m off, so 20 sigma. Cauchy's weight there is (2.4 / 20)^2 = 1.4 %: together they pull the mean
    of 100 fixes by at most 8 * 40 m * 1.4 % / 100 = 0.05 m; some of them are neighbours, so four times that is allowed.
    As many good fixes are lost: 0.1 of sigma / sqrt(100) more."""
    drive, _ = noisy(1)
    solve = solver(name)
    clean = solve(drive)
    pos_n = drive.fix_pos_n.copy()
    pos_n[[20, 21, 22, 40, 55, 70, 71, 90]] += [40.0, 0.0, 0.0]
    hit = solve(replace(drive, fix_pos_n=pos_n))
    apart = np.hypot(*(hit.pos_n - clean.pos_n)[:, :2].T)
    assert np.sqrt((apart**2).mean()) < 0.2 + 0.2


def test_the_filter_finds_back_after_a_start_amid_multipath() -> None:
    """Twelve fixes of a burst make the first velocity 1.2 m/s wrong, and after 20 s more nothing fits; the last 40 s
    are as good as those of a drive that began well, but for what attitude has still to settle: twice the limit."""
    drive, truth = noisy(3)
    fix_pos_n, fix_vel_n = drive.fix_pos_n.copy(), drive.fix_vel_n.copy()
    fix_pos_n[2:14] += [-30.0, 20.0, 8.0]
    fix_vel_n[2:14] += [-1.0, 1.2, 0.3]
    found = ekf_rts.solve(replace(drive, fix_pos_n=fix_pos_n, fix_vel_n=fix_vel_n))
    late = found.t_s > 80.0
    apart = found.pos_n[late, :2] - interpolate(found.t_s[late], truth.t_s, truth.pos_n)[:, :2]
    assert np.sqrt((apart**2).sum(axis=1).mean()) < 2.0 * 3.0 * np.hypot(0.2, 0.2)


@PEERS
def test_a_drive_is_not_changed_by_solving_it(name: str) -> None:
    drive, _ = noisy(0)
    same, _ = noisy(0)
    solver(name)(drive)
    for field in ("t_s", "gyro_s", "accel_s", "fix_t_s", "fix_pos_n", "fix_vel_n", "start_q_ns"):
        np.testing.assert_array_equal(getattr(drive, field), getattr(same, field))


def test_the_car_stands_where_it_stands_and_nowhere_else() -> None:
    """Where there are fixes. A launch starts with no jerk at all: its first 2 cm/s, the sigma of a standing car, may
    pass for it. Up to a second is lost at each end of a stop, and a fix of 4 sigma would take a second more."""
    drive, truth = noisy(2)
    seen = (truth.t_s < 59.0) | (truth.t_s > 81.0)
    still = standstill(drive)[seen]
    speed = np.linalg.norm(truth.vel_n, axis=1)[seen]
    assert speed[still].max() < 0.02
    stops = np.diff(speed == 0.0, prepend=False, append=False).sum() / 2
    lost_s = (~still[speed == 0.0]).sum() / 100.0
    assert lost_s < 2.0 * stops + 1.0


def test_a_creeping_car_does_not_stand_though_its_imu_is_quiet() -> None:
    drive, _ = noisy(2)
    creeping = np.broadcast_to([0.8, 0.0, 0.0], drive.fix_vel_n.shape)
    with_outage = np.searchsorted(drive.t_s, [59.0, 81.0])
    still = standstill(replace(drive, fix_vel_n=creeping))
    assert not still[: with_outage[0]].any()
    assert not still[with_outage[1] :].any()


def test_the_gyro_bias_is_found_at_rest() -> None:
    """Over ten seconds and more of rest the white noise leaves 1e-4 / sqrt(10) rad/s; four sigma."""
    drive, _ = perfect()
    bias = np.array([0.01, -0.02, 0.005])
    white = np.random.default_rng(0).normal(0.0, 10.0 * NOISE.gyro, drive.gyro_s.shape)
    begin = find_start(replace(drive, gyro_s=drive.gyro_s + bias + white))
    np.testing.assert_allclose(begin.gyro_bias, bias, atol=4.0 * NOISE.gyro / np.sqrt(10.0))


def test_steps_keep_the_integral_and_cross_no_edge() -> None:
    drive, _ = perfect()
    edges_s = np.array([0.0, 0.433, 1.0, 7.7777, 60.0])
    steps = steps_between(drive, edges_s)
    np.testing.assert_allclose(np.add.reduceat(steps.dt_s, steps.first[:-1]), np.diff(edges_s), rtol=1e-12)
    turned = (steps.rate_s * steps.dt_s[:, None]).sum(axis=0)
    until = drive.t_s <= 60.0
    expected = cumulative(drive.t_s[until], drive.gyro_s[until], "trapezoid")[-1]
    np.testing.assert_allclose(turned, expected, atol=1e-12)


def test_gaps_are_filled_by_equal_parts() -> None:
    np.testing.assert_allclose(
        with_none_longer(np.array([0.0, 1.0, 3.5, 4.0]), 1.0), [0.0, 1.0, 1.0 + 2.5 / 3, 1.0 + 5 / 3, 3.5, 4.0]
    )


def anywhere(seed: int) -> tuple[Model, State, np.random.Generator]:
    """A state of no special symmetry on the Earth."""
    rng = np.random.default_rng(seed)
    drive, _ = perfect()
    x = rng.normal(0.0, 1.0, SIZE)
    x[9:18], x[MOUNT], x[20] = 0.01 * x[9:18], 0.02 * x[MOUNT], 0.01
    x[ROTATION], x[VELOCITY] = 0.0, 10.0 * x[VELOCITY]
    tilted = replace(drive, world=World.at(48.0), rear_s=np.array([-1.2, 0.2, -0.4]))
    return Model(tilted, x[9:12].copy()), State(turn(rng.normal(0.0, 1.0, 3)), x), rng


def difference(one: State, other: State) -> Floats:
    """The error that takes the other to one, to first order."""
    error = one.x - other.x
    skew = 0.5 * (one.rot_ns @ other.rot_ns.T - other.rot_ns @ one.rot_ns.T)
    error[ROTATION] = skew[2, 1], skew[0, 2], skew[1, 0]
    return error


SMALL = 1e-6


def test_the_transition_is_the_derivative_of_the_motion() -> None:
    """Of second order and left out: half a block's turn of 0.05 rad in the bias terms, gravity's change with place."""
    model, state, rng = anywhere(0)
    dt_s = 0.1
    angle_s, velocity_s = rng.normal(0.0, 0.05, 3), rng.normal(0.0, 1.0, 3)
    after, transition, _ = model.moved(state, angle_s, velocity_s, dt_s)
    for column in np.eye(SIZE):
        moved, _, _ = model.moved(state.moved(SMALL * column), angle_s, velocity_s, dt_s)
        np.testing.assert_allclose(difference(moved, after) / SMALL, transition @ column, atol=0.02 * dt_s)


@pytest.mark.parametrize("what", ["position", "velocity", "standing", "rear_axle"])
def test_each_measurement_has_the_right_derivative(what: str) -> None:
    """Left out: the Earth's rate times a lever and the scale of the gyro times a lever, up to 1 m here."""
    model, state, rng = anywhere(1)
    rate_s, fix_n = rng.normal(0.0, 0.3, 3), rng.normal(0.0, 1.0, 3)
    arguments = {"position": (fix_n,), "velocity": (rate_s, fix_n), "standing": (), "rear_axle": (rate_s,)}[what]
    residual, by_error, *_ = getattr(model, what)(state, *arguments)
    mounted_askew = 10.0 * np.hypot(*state.x[MOUNT]) if what == "rear_axle" else 0.0  # the mount's error is not a sum
    for number, column in enumerate(np.eye(SIZE)[:-1]):
        moved, *_ = getattr(model, what)(state.moved(SMALL * column), *arguments)
        allowed = 1e-3 + mounted_askew * (number in range(18, 20))
        np.testing.assert_allclose((residual - moved) / SMALL, by_error @ column, atol=allowed)


def trajectory(count: int = 50) -> Estimate:
    t_s = np.arange(count) / 10.0
    still = np.zeros((count, 3))
    return Estimate(t_s, still, still, np.tile(from_euler(0.5, 0.1, -0.2), (count, 1)))


def test_a_known_error_is_scored_as_such() -> None:
    truth = trajectory()
    turned = multiply(from_rotvec(np.array([0.0, 0.0, 0.02])), truth.q_ns)
    wrong = Estimate(
        truth.t_s, truth.pos_n + np.array([3.0, 4.0, -2.0]), truth.vel_n + np.array([0.0, 0.0, 0.5]), turned
    )
    outage = truth.t_s > 3.0
    found = scores.score(wrong, truth, outage, 1.5)
    expected = scores.Errors(horizontal=5.0, vertical=2.0, velocity=0.5, tilt=0.0, heading=0.02)
    for errors in (found.drive, found.outages):
        assert vars(errors) == pytest.approx(vars(expected), abs=1e-12)
    assert found.worst == pytest.approx(5.0)
    assert found.wall_s == 1.5


def test_tilt_is_that_of_the_sensor_however_it_is_mounted() -> None:
    truth = trajectory()
    turned = multiply(from_rotvec(np.array([0.03, 0.04, 0.0])), truth.q_ns)
    found = scores.score(replace(truth, q_ns=turned), truth, truth.t_s < 0.0, 0.0)
    assert found.drive.tilt == pytest.approx(0.05 / np.sqrt(2.0))
    assert found.drive.heading == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(found.outages.horizontal)
    assert np.isnan(found.worst)


def test_outages_lie_between_fixes_far_apart() -> None:
    fix_t_s = np.array([1.0, 2.0, 12.0, 13.0])
    t_s = np.array([0.0, 1.5, 2.5, 11.9, 12.5, 14.0])
    assert scores.in_outage(t_s, fix_t_s).tolist() == [False, False, True, True, False, False]


def test_the_table_has_a_line_for_each_peer() -> None:
    errors = scores.Errors(1.0, 2.0, 0.1, np.radians(0.5), np.radians(0.25))
    twice = scores.Errors(7.0, 2.0, 0.1, np.radians(0.5), np.radians(0.25))
    lines = scores.table({"one": [scores.Score(errors, errors, 3.0, 1.0), scores.Score(twice, errors, 5.0, 2.0)]})
    assert lines.splitlines()[2] == (
        "| one | 2 | 5.00 | 2.00 | 0.100 | 0.500 | 0.250 | 1.00 | 2.00 | 0.100 | 0.500 | 0.250 | 4.00 | 1.50 |"
    )


def test_gravity_turns_with_the_place() -> None:
    world = World.at(48.0)
    east = world.gravity_at(np.array([10_000.0, 0.0, 0.0]))
    assert np.degrees(np.arctan2(-east[0], -east[2])) == pytest.approx(0.0898, abs=1e-4)  # 10 km of 6378 km
    np.testing.assert_array_equal(World.plane(9.8).gravity_at(np.array([1e4, 1e4, 1e4])), [-0.0, -0.0, -9.8])


def test_the_truth_itself_has_no_error() -> None:
    """But for rounding: 1e-16 of positions under a kilometre and of unit quaternions, some ten operations each."""
    _, truth = perfect()
    found = scores.score(truth, truth, truth.t_s > 60.0, 0.0)
    assert max(vars(found.drive).values()) < 1e-12
    assert max(vars(found.outages).values()) < 1e-12


def test_a_simulated_drive_agrees_with_its_truth() -> None:
    """Without errors of the sensors the fixes are the antenna's place and velocity, joined by lines over 10 ms: they
    miss h^2/8 of the acceleration and its derivative, under 5 m/s^2 and 50 m/s^3, and rounding of degrees (1e-9 m)."""
    params = DriveParams(sensors="perfect", motion="city", duration=60.0, mount_yaw=0.5, lever_arm=(1.0, -0.5, 1.5))
    drive, truth = simulated(params)
    at = drive.fix_t_s
    pos_n, vel_n = (interpolate(at, truth.t_s, values) for values in (truth.pos_n, truth.vel_n))
    q_ns = slerp(at, truth.t_s, truth.q_ns)
    rate_n = rotate(q_ns, interpolate(at, drive.t_s, drive.gyro_s)) - drive.world.earth_rate_n
    lever_n = rotate(q_ns, drive.lever_s)
    h = float(np.diff(drive.t_s).max())
    np.testing.assert_allclose(drive.fix_pos_n, pos_n + lever_n, atol=h**2 / 8 * 5.0 + 1e-6)
    np.testing.assert_allclose(drive.fix_vel_n, vel_n + np.cross(rate_n, lever_n), atol=h**2 / 8 * 50.0 + 1e-6)


def test_a_peer_solves_a_simulated_drive_on_the_turning_earth() -> None:
    """Without errors, but told of some, as on the plane and with its bound; if the Earth's rate were left out, the
    heading would be wrong by ten times that, the part of 7e-5 rad/s * 60 s that does not pass for a bias."""
    drive, truth = simulated(DriveParams(sensors="perfect", motion="city", duration=60.0))
    found = scores.run(ekf_rts.solve, replace(drive, noise=NOISE), truth)
    assert found.drive.heading < 1e-4
    assert found.drive.tilt < 1e-4
