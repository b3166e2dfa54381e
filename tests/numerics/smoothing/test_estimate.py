"""From logs to trajectories: errors within honest sigmas, outliers told apart, gaps, rates and lacks of every kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from smoothing_drives import Log, Simulated, box, simulate

from recon.numerics.smoothing import Drive, Estimate, Fixes, Model, estimate, sigmas
from recon.numerics.smoothing.estimate import forward_speed, knots_of, part_of
from recon.numerics.smoothing.soa import mm, mmt, rotation_log
from recon.numerics.smoothing.state import ACCEL_BIAS, COMMON_SIZE, GYRO_BIAS, POSITION, ROTATION, VELOCITY, WHEEL

MOST_STEPS = 12


def solve(sim: Simulated, drive: Drive | None = None, learn: bool = False) -> Estimate:
    return estimate(drive or sim.drive, Model(), sim.log.noise, learn)


def errors(found: Estimate, sim: Simulated) -> np.ndarray:
    """Truth less estimate at the knots: rotation, velocity, position, biases, (15, N)."""
    true, state = sim.state(found.smoother.drive.samples.knot_times), found.solved.state
    return np.concatenate([
        rotation_log(mmt(true.rot_ns, state.rot_ns)), true.vel_n - state.vel_n, true.pos_n - state.pos_n,
        true.gyro_bias - state.gyro_bias, true.accel_bias - state.accel_bias,
    ])  # fmt: skip


def nees(found: Estimate, sim: Simulated) -> np.ndarray:
    """Mean normalised squared error per degree of freedom of rotation, velocity, position and both biases: (5,)."""
    error, out = errors(found, sim), []
    for index, part in enumerate((ROTATION, VELOCITY, POSITION, GYRO_BIAS, ACCEL_BIAS)):
        e = error[3 * index : 3 * index + 3]
        out.append(np.einsum("in,nij,jn->n", e, np.linalg.inv(found.covariance[:, part, part]), e).mean() / 3.0)
    return np.array(out)


def check_within_sigmas(found: Estimate, sim: Simulated, limit: float = 4.5) -> None:
    """No error of rotation, velocity or position beyond `limit` sigmas: 4.5 are exceeded by 7e-6 of Gaussian errors."""
    assert found.solved.converged
    assert found.solved.steps <= MOST_STEPS
    sigma = np.sqrt(np.einsum("nii->in", found.covariance[:, 3:12, 3:12]))
    assert (np.abs(errors(found, sim)[:9]) < limit * sigma).all()


def with_fixes(sim: Simulated, **changes: np.ndarray) -> Drive:
    return replace(sim.drive, fixes=replace(sim.drive.fixes, **changes))


def unknown(fixes: Fixes) -> np.ndarray:
    return np.full_like(fixes.pos_n, np.inf)


def test_sigmas_are_honest_where_the_model_is_true():
    model = Model(
        gyro_bias=np.radians(0.5), accel_bias=0.2, gyro_scale=0.0, accel_scale=0.0, lag=0.0, velocity_lag=0.0,
        wheels=False, lever=(0.8, -0.3, 1.1), lever_sigma=(1e-3,) * 3,
        mounting=Log().box,
    )  # fmt: skip
    found = []
    for seed in range(24):
        sim = simulate(Log(kind="nonstop", seconds=120.0, seed=seed))
        found.append(nees(estimate(sim.drive, model, sim.log.noise, False), sim))
    # Errors of a drive of 120 s hang together: those of the position by the slow error of 60 s, two independent ones
    # of three components; a heading has one, a bias as well. 24 drives hold 72 or more, so NEES is 1 within
    # 3.3 sqrt(2 / 72) = 0.55.
    assert_allclose(np.mean(found, axis=0), 1.0, atol=0.55)


def test_sigmas_are_not_too_small_where_all_is_estimated():
    found = []
    for seed in range(100, 116):
        sim = simulate(Log(seed=seed))
        found.append(nees(solve(sim, learn=True), sim)[:3])
    # 48 independent ones or more: 1 + 3.3 sqrt(2 / 48). The model allows for slip and swaying that this car lacks.
    assert (np.mean(found, axis=0) < 1.0 + 0.67).all()
    assert (np.mean(found, axis=0) > 0.2).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_outliers_are_found_and_hardly_any_good_fix_is_lost(seed):
    sim = simulate(Log(outliers=0.06, seconds=300.0, seed=seed))
    found = solve(sim, learn=True)
    epochs = found.solved.epochs
    at = epochs.fix >= 0
    kept = found.solved.pos_weight[at] > 0.5
    wild = sim.outlier[epochs.fix[at]]
    assert wild.sum() >= 5
    assert not kept[wild].any()
    # Beyond four sigmas of three components lie 0.11 % of good fixes; the noise, learnt from 300, may be 10 % off,
    # which makes it 0.4 %: five of 300 would be one in ten thousand.
    assert (~kept[~wild]).sum() < 5
    check_within_sigmas(found, sim)


@pytest.mark.parametrize(
    "mounted", [(90.0, 0.0, 0.0), (180.0, 0.0, 0.0), (0.0, 0.0, 180.0)], ids=["sideways", "backwards", "upside down"]
)
def test_a_box_mounted_anyhow_gives_the_vehicle(mounted):
    sim = simulate(Log(box=box(*mounted)))
    found = solve(sim)
    check_within_sigmas(found, sim)
    assert np.median(forward_speed(found.solved.state)) > 0.0


def test_a_gap_of_the_imu_is_bridged_with_sigmas_that_grow_with_it():
    widest = []
    for seconds in (0.0, 1.0, 5.0):
        sim = simulate(Log(seconds=240.0, silent=((100.0, 100.0 + seconds),)))
        found = solve(sim)
        check_within_sigmas(found, sim)
        knots = found.smoother.drive.samples.knot_times
        beside = (knots > 97.0) & (knots < 108.0)
        widest.append(np.einsum("nii->in", found.covariance[beside, ROTATION, ROTATION]).max(axis=1))
    assert (np.diff(widest, axis=0) > 0.0).all()


def test_a_minute_without_the_imu_leaves_both_sides_right():
    sim = simulate(Log(seconds=240.0, silent=((100.0, 160.0),)))
    check_within_sigmas(solve(sim, learn=True), sim)


@pytest.mark.parametrize("imu_hz", [10.0, 25.0, 100.0, 1000.0])
def test_every_rate_of_the_imu_will_do(imu_hz):
    sim = simulate(Log(imu_hz=imu_hz))
    check_within_sigmas(solve(sim), sim)


@pytest.mark.parametrize("gnss_hz", [0.2, 1.0, 5.0, 10.0])
def test_every_rate_of_gnss_will_do(gnss_hz):
    sim = simulate(Log(gnss_hz=gnss_hz, seconds=300.0))
    check_within_sigmas(solve(sim), sim)


def test_positions_alone_will_do():
    sim = simulate(Log())
    found = solve(sim, with_fixes(sim, vel_sigma=unknown(sim.drive.fixes)))
    check_within_sigmas(found, sim)


def test_velocities_alone_tell_the_shape_of_the_path():
    sim = simulate(Log())
    found = solve(sim, with_fixes(sim, pos_sigma=unknown(sim.drive.fixes), pos_n=0.0 * sim.drive.fixes.pos_n))
    error = errors(found, sim)
    sigma = np.sqrt(np.einsum("nii->in", found.covariance[:, 3:12, 3:12]))
    assert (np.abs(error[:6]) < 4.5 * sigma[:6]).all()
    moved = error[6:9] - error[6:9, :1]
    assert (np.abs(moved) < 4.5 * sigma[6:9] + 1e-3).all()


def test_speed_alone_tells_the_path_but_for_its_heading():
    sim = simulate(Log())
    fixes, count = sim.drive.fixes, len(sim.drive.fixes.t_s)
    none = np.zeros(count)
    drive = with_fixes(
        sim,
        pos_sigma=unknown(fixes),
        pos_n=0.0 * fixes.pos_n,
        vel=np.stack([np.hypot(fixes.vel[0], fixes.vel[1]), none, none]),
        vel_sigma=np.stack([fixes.vel_sigma[0], *np.full((2, count), np.inf)]),
        speed_only=np.ones(count, bool),
    )
    found = solve(sim, drive)
    assert found.solved.converged
    true, state = sim.at(drive.samples.knot_times), found.solved.state
    turn = rotation_log(mmt(true.rot_ns, state.rot_ns))
    # The first heading is set; from it on, all errors are those of the gyro, within their sigmas.
    whole = mm(true.rot_ns[..., :1], state.rot_ns[..., :1].swapaxes(0, 1))
    yaw = np.arctan2(whole[1, 0, 0], whole[0, 0, 0])
    sigma = np.sqrt(np.einsum("nii->in", found.covariance[:, 3:12, 3:12]))
    about = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    rest = rotation_log(mmt(true.rot_ns, mm(about[..., None], state.rot_ns)))
    assert (np.abs(rest) < 4.5 * (sigma[:3] + sigma[:3, :1])).all()
    assert np.abs(turn).max() > 10.0 * np.abs(rest).max()
    path = about @ state.pos_n - true.pos_n
    path = path - path[:, :1]
    reach = np.linalg.norm(true.pos_n - true.pos_n[:, :1], axis=0)
    assert (np.linalg.norm(path, axis=0) < 4.5 * (np.linalg.norm(sigma[6:9], axis=0) + reach * sigma[2, 0]) + 0.1).all()


def test_heights_that_are_missing_cost_the_height_alone():
    sim = simulate(Log())
    sigma = sim.drive.fixes.pos_sigma.copy()
    sigma[2] = np.inf
    check_within_sigmas(solve(sim, with_fixes(sim, pos_sigma=sigma)), sim)


def test_wheel_speeds_carry_through_an_outage():
    sim = simulate(Log(seconds=300.0))
    fixes = sim.drive.fixes
    lost = (fixes.t_s > 150.0) & (fixes.t_s < 250.0)
    kept = with_fixes(
        sim, pos_sigma=np.where(lost, np.inf, fixes.pos_sigma), vel_sigma=np.where(lost, np.inf, fixes.vel_sigma)
    )
    t_s = np.arange(0.0, 300.0, 0.1)
    axle = sim.motion.at(t_s)
    swing = np.cross(axle.gyro_v, np.broadcast_to(sim.log.rear_v, axle.gyro_v.shape))
    forward = np.einsum("ijn,in->jn", sim.at(t_s).rot_nv, sim.at(t_s).vel_n)[0] + swing[:, 0]
    noisy = 0.98 * forward + np.random.default_rng(7).normal(0.0, 0.05, len(t_s))
    without, with_wheels = solve(sim, kept), solve(sim, replace(kept, wheel_t_s=t_s, wheel_speed=np.abs(noisy)))
    inside = (kept.samples.knot_times > 160.0) & (kept.samples.knot_times < 240.0)
    for found in (without, with_wheels):
        check_within_sigmas(found, sim)
    widest = [
        np.einsum("nii->n", f.covariance[inside, POSITION, POSITION][:, :2, :2]).max() for f in (without, with_wheels)
    ]
    assert widest[1] < widest[0]
    # A hundred seconds and more at 10 Hz and 0.05 m/s tell the scale to 1e-4; the lever in bends and the slow error of
    # GNSS to some parts in a thousand.
    assert with_wheels.solved.state.common[WHEEL] == pytest.approx(1.0 / 0.98 - 1.0, abs=5e-3)


def test_sigmas_of_position_and_velocity_are_those_of_the_covariance():
    sim = simulate(Log())
    found = solve(sim)
    deviation = sigmas(found)
    assert deviation.shape == (9, found.solved.state.knots)
    # Less than a kilometre from the anchor the level frame leans by 1e-4: the same but for parts in ten thousand.
    for rows, part in ((slice(0, 3), POSITION), (slice(3, 6), VELOCITY)):
        own = np.sqrt(np.einsum("nii->in", found.covariance[:, part, part]))
        assert_allclose(deviation[rows], own, rtol=1e-3)


def test_sigmas_of_the_vehicle_share_the_doubt_of_the_mounting():
    sim = simulate(Log())
    found = solve(sim)
    deviation, state = sigmas(found), found.solved.state
    vehicle = mmt(state.rot_ns, state.rot_vs[..., None])
    step = 1e-6
    for k in (5, 40, 85):
        jacobian = np.zeros((3, 18 + COMMON_SIZE))
        for index in range(18 + COMMON_SIZE):
            knots, common = np.zeros((18, state.knots)), np.zeros(COMMON_SIZE)
            (knots[:, k] if index < 18 else common)[index % 18 if index < 18 else index - 18] = step
            moved = state.moved(knots, common)
            other = mmt(moved.rot_ns, moved.rot_vs[..., None])
            jacobian[:, index] = rotation_log(mmt(other, vehicle))[:, k] / step
        joint = np.block([[found.covariance[k], found.cross[k]], [found.cross[k].T, found.covariance_common]])
        covariance = jacobian @ joint @ jacobian.T
        # Differences of a step of 1e-6, and axes n that lean by 1e-4 against the local level.
        assert deviation[8, k] == pytest.approx(np.sqrt(covariance[2, 2]), rel=1e-3)
        assert (deviation[6:, k] ** 2).sum() == pytest.approx(np.trace(covariance), rel=1e-3)
    true = sim.at(sim.drive.samples.knot_times).rot_nv
    error_v = np.einsum("jin,jn->in", vehicle, rotation_log(mmt(true, vehicle)))
    # The axes of the vehicle lean with grades of 3 %, three sigmas of them, against those of the sigmas.
    assert (np.abs(error_v) < 4.5 * (deviation[6:] + 0.1 * deviation[6:].max(axis=0))).all()


def test_covariances_are_those_of_the_knots_with_what_is_common():
    sim = simulate(Log())
    found = solve(sim)
    assert found.covariance.shape == (found.solved.state.knots, 18, 18)
    for k in (0, 40, 89):
        cross = found.cross[k]
        joint = np.block([[found.covariance[k], cross], [cross.T, found.covariance_common]])
        size = np.sqrt(np.diag(joint))
        size[size == 0.0] = 1.0
        # A covariance; rounding of what is almost certain is 1e-16 times the condition of the problem, 1e8.
        assert np.linalg.eigvalsh(joint / np.outer(size, size)).min() > -1e-8


def test_a_part_of_a_drive_keeps_its_times_and_knots():
    sim = simulate(Log())
    part = part_of(sim.drive, slice(10, 25))
    assert part.samples.intervals == 15
    assert_allclose(part.samples.knot_times, sim.drive.samples.knot_times[10:26], rtol=0.0, atol=0.0)
    state = sim.state(sim.drive.samples.knot_times)
    cut = knots_of(state, slice(10, 25))
    assert cut.knots == 16
    for name in ("rot_ns", "vel_n", "pos_n", "gyro_bias", "accel_bias", "drift_n"):
        assert_allclose(getattr(cut, name), getattr(state, name)[..., 10:26], rtol=0.0, atol=0.0)


def test_noise_of_a_long_drive_is_learnt_from_its_liveliest_part():
    sim = simulate(Log(seconds=1500.0, imu_hz=20.0))
    found = estimate(sim.drive, Model(), replace(sim.log.noise, velocity=3.0 * sim.log.noise.velocity), True)
    check_within_sigmas(found, sim, 5.0)
    # 2400 residuals across tell sigma to 1.5 %, the search stops within a fifth of a unit of likelihood.
    assert_allclose(found.solved.noise.velocity, 1.0, rtol=0.15)


@pytest.mark.parametrize("smoothed_s", [1, 10])
@pytest.mark.parametrize("seed", [0, 2])
def test_the_slow_error_changes_in_twenty_seconds_as_told_whether_or_not_the_receiver_smooths_it(smoothed_s, seed):
    sim = simulate(Log(seconds=600.0, drift=0.0, white=0.03, seed=seed))
    count = len(sim.drive.fixes.t_s)
    steps = np.random.default_rng(seed).normal(size=(3, count + smoothed_s))
    wander = lfilter([np.sqrt(1.0 - np.exp(-2.0 / 30.0))], [1.0, -np.exp(-1.0 / 30.0)], steps)
    error = 2.0 * np.array([np.convolve(axis, np.ones(smoothed_s) / smoothed_s, "valid")[:count] for axis in wander])
    drive = with_fixes(sim, pos_n=sim.drive.fixes.pos_n + error)
    told = replace(sim.log.noise, drift=np.array([2.5, 2.5, 3.5]), drift_tau=100.0)
    noise = estimate(drive, Model(), told).solved.noise
    change = np.sqrt(((error[:, 20:] - error[:, :-20]) ** 2).mean())
    believed = np.sqrt((noise.drift**2).mean() * 2.0 * (1.0 - np.exp(-20.0 / noise.drift_tau)))
    # 90 stretches tell a sigma to 7.5 %, three of which are allowed. What changes from second to second alone would
    # make it 40 % too small where ten seconds are averaged.
    assert believed == pytest.approx(change, rel=0.23)
