"""The solver: where it starts does not matter, and where and when the drive took place does not either."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Log, Simulated, box, simulate, turned_about_up

from recon.numerics.geodesy import Anchor
from recon.numerics.smoothing import Model, Smoother, Solved, geodetic, level_rotation, positions_n
from recon.numerics.smoothing.soa import mm, mmt, rotation_exp, rotation_log
from recon.numerics.smoothing.start import start_state
from recon.numerics.smoothing.state import ACCEL_SCALE, GYRO_SCALE, LAG, SCALES, VELOCITY_LAG, State

MOST_STEPS = 12
# Sigmas on this drive: heading (tilt is known better), velocity, position.
SIGMA_TURN, SIGMA_VEL, SIGMA_POS = np.radians(0.25), 0.05, 0.8
# What may be left of them: increments and stamps are linearised anew only where biases have moved by 3e-3 rad/s and
# lags by 20 ms, so that another way to the solution ends 1e-5 rad and a centimetre beside.
REST = 0.03


def solved(sim: Simulated, model: Model = Model(), start: State | None = None) -> Solved:  # noqa: B008 frozen
    smoother = Smoother(sim.drive, model)
    closed = start_state(smoother)
    return smoother.solve(start or closed, sim.log.noise, "tls")


def check_same(found: State, wanted: State, share: float = REST) -> None:
    """Equal to a share of the sigmas."""
    assert np.abs(rotation_log(mmt(found.rot_ns, wanted.rot_ns))).max() < share * SIGMA_TURN
    assert np.abs(found.vel_n - wanted.vel_n).max() < share * SIGMA_VEL
    assert np.abs(found.pos_n - wanted.pos_n).max() < share * SIGMA_POS


@pytest.fixture(scope="module")
def sim() -> Simulated:
    return simulate(Log())


@pytest.fixture(scope="module")
def best(sim: Simulated) -> Solved:
    return solved(sim)


@pytest.mark.parametrize("degrees", [-150.0, -120.0, -60.0, 60.0, 120.0, 150.0])
def test_a_heading_that_starts_wrong_is_put_right(sim, best, degrees):
    smoother = Smoother(sim.drive, Model())
    start = start_state(smoother)
    turn = turned_about_up(np.radians(degrees))
    wrong = replace(start, rot_ns=mm(turn[..., None], start.rot_ns))
    soft = smoother.solve(wrong, sim.log.noise, "cauchy")
    assert soft.converged
    assert soft.steps <= MOST_STEPS
    found = smoother.solve(soft.state, sim.log.noise, "tls")
    assert found.converged
    # The mounting may come out turned by 180 deg. Its prior of 10 deg then pulls at a yaw known to 0.1 deg by
    # 180 (0.1 / 10)^2 = 0.02 deg, and with it at the heading.
    check_same(found.state, best.state, share=0.3)


def test_behind_the_last_fix_it_starts_with_the_way_that_the_imu_tells(sim):
    """Nothing is assumed of wheels: without it the start stands at the last fix with the last velocity."""
    fixes, knots = sim.drive.fixes, sim.drive.samples.knot_times
    heard = fixes.t_s < sim.log.seconds - 20.0
    lost = replace(
        fixes,
        pos_sigma=np.where(heard, fixes.pos_sigma, np.inf),
        vel_sigma=np.where(heard, fixes.vel_sigma, np.inf),
    )
    start = start_state(Smoother(replace(sim.drive, fixes=lost), Model(wheels=False)))
    silent = knots > fixes.t_s[heard][-1] + 1.0
    assert silent.sum() > 8
    truth = sim.at(knots).pos_n
    moved = np.linalg.norm(truth[:2, -1] - truth[:2, ~silent][:, -1])
    # 20 s with tilts of the closed form that are good to a degree: 0.5 g sin(1 deg) 20^2 = 34 m
    assert moved > 50.0
    assert np.linalg.norm((start.pos_n - truth)[:2, -1]) < 34.0


@pytest.mark.parametrize("about", [0, 1])
def test_a_box_that_starts_tilted_is_put_right(sim, best, about):
    smoother = Smoother(sim.drive, Model())
    start = start_state(smoother)
    tilt = np.zeros((3, 1))
    tilt[about] = np.radians(40.0)
    found = smoother.solve(replace(start, rot_ns=mm(rotation_exp(tilt), start.rot_ns)), sim.log.noise, "tls")
    assert found.converged
    assert found.steps <= MOST_STEPS
    check_same(found.state, best.state)


@pytest.mark.parametrize(
    "mounted",
    [
        (90.0, 0.0, 0.0),
        (-90.0, 20.0, 15.0),
        (180.0, 0.0, 0.0),
        (0.0, 0.0, 180.0),
        (0.0, 85.0, 0.0),
        (30.0, -60.0, 100.0),
    ],
    ids=["sideways", "sideways askew", "backwards", "upside down", "on end", "anyhow"],
)
def test_every_way_to_mount_a_box_is_found(mounted):
    sim = simulate(Log(box=box(*mounted)))
    found = solved(sim)
    assert found.converged
    assert found.steps <= MOST_STEPS
    off = np.degrees(rotation_log((found.state.rot_vs @ sim.log.box.T)[..., None])[:, 0])
    # Sigmas on this drive: 0.1 deg of pitch and yaw, 0.5 deg of roll, which only level roads tell.
    assert (np.abs(off) < [2.0, 0.4, 0.4]).all()


@pytest.mark.parametrize("degrees", [30.0, 90.0, 200.0])
def test_turning_the_world_turns_the_result(sim, best, degrees):
    angle = np.radians(degrees)
    other = simulate(replace(sim.log, turned=angle))
    found, turn = solved(other), turned_about_up(angle)
    true, true_other = (s.at(s.drive.samples.knot_times) for s in (sim, other))
    # The ellipsoid is not round: over the kilometre L driven, L^2 / R times its flattening and the change of the radii,
    # 1e6 / 6e6 x 1e-2 = 2 mm; the Earth turns a northbound car otherwise, which the gyro's noise exceeds a hundredfold.
    error = true_other.pos_n - found.state.pos_n
    assert np.abs(error - turn @ (true.pos_n - best.state.pos_n)).max() < REST * SIGMA_POS + 2e-3
    error_vel = true_other.vel_n - found.state.vel_n
    assert np.abs(error_vel - turn @ (true.vel_n - best.state.vel_n)).max() < REST * SIGMA_VEL
    heading = rotation_log(mmt(true_other.rot_ns, found.state.rot_ns))
    assert np.abs(heading - turn @ rotation_log(mmt(true.rot_ns, best.state.rot_ns))).max() < REST * SIGMA_TURN


def test_another_anchor_is_the_same_drive(sim, best):
    place = sim.log.place
    away = Anchor(place.lat + 0.03, place.lon - 0.04, place.height - 200.0)
    fixes = sim.drive.fixes
    pos_n = positions_n(*geodetic(fixes.pos_n, place), away)
    turn = mm(level_rotation(pos_n, away).swapaxes(0, 1), level_rotation(fixes.pos_n, place))
    moved = replace(fixes, pos_n=pos_n, vel_rows=mmt(fixes.vel_rows, turn))
    found = solved(replace(sim, drive=replace(sim.drive, fixes=moved, anchor=away)))
    lat, lon, height = geodetic(found.state.pos_n, away)
    back = positions_n(lat, lon, height, place)
    # Slow error and position sigmas lie along axes n, which lean by 5 km / R = 7e-4 between the anchors: of two metres,
    # 1.5 mm.
    assert np.abs(back - best.state.pos_n).max() < REST * SIGMA_POS + 2e-3
    level, level_best = level_rotation(found.state.pos_n, away), level_rotation(best.state.pos_n, place)
    turned = rotation_log(mmt(mm(level, found.state.rot_ns), mm(level_best, best.state.rot_ns)))
    assert np.abs(turned).max() < REST * SIGMA_TURN


def test_another_hour_is_the_same_drive(sim, best):
    samples, fixes = sim.drive.samples, sim.drive.fixes
    later = replace(
        sim.drive, samples=replace(samples, t_s=samples.t_s + 3600.0), fixes=replace(fixes, t_s=fixes.t_s + 3600.0)
    )
    found = solved(replace(sim, drive=later))
    assert found.steps == best.steps
    # Times of 3600 s are rounded to 5e-13 s, over steps of 0.02 s.
    check_same(found.state, best.state, share=1e-5)


def test_lags_are_found_and_stamps_moved():
    sim = simulate(Log(lag=0.2, velocity_lag=-0.1))
    found = solved(sim)
    assert found.converged
    sigma = np.sqrt(np.diag(found.solution.covariance_global))[[LAG, VELOCITY_LAG]]
    lags = np.array([found.moved_lag + found.state.common[LAG], found.state.common[VELOCITY_LAG]])
    # The prior's mean is zero, at a sigma of 0.1 s: what it holds back is lag (sigma / 0.1)^2.
    assert (np.abs(lags - [0.2, -0.1]) < 3.5 * sigma + np.abs(lags) * (sigma / 0.1) ** 2).all()
    assert abs(found.state.common[LAG]) < 0.02


def test_what_a_sigma_of_zero_fixes_does_not_move(sim):
    found = solved(sim, Model(gyro_scale=0.0, accel_scale=0.0, lag=0.0, velocity_lag=0.0, slip=0.0, roll=0.0))
    assert found.converged
    assert not found.state.common[SCALES].any()
    assert not found.state.common[[LAG, VELOCITY_LAG]].any()


def test_scale_errors_are_found_as_far_as_the_priors_let_them():
    sim = simulate(Log(seconds=400.0))
    drive, scale = sim.drive, np.array([0.0, 0.0, 0.01])
    wrong = replace(drive.samples, gyro_s=drive.samples.gyro_s / (1.0 - scale @ sim.log.box))
    found = solved(replace(sim, drive=replace(drive, samples=wrong)), Model(gyro_scale=0.01, accel_scale=0.0))
    names = [GYRO_SCALE.start + axis for axis in range(3)]
    free = np.flatnonzero(np.r_[np.ones(ACCEL_SCALE.start, bool), np.zeros(3, bool)])
    sigma = np.sqrt(np.diag(found.solution.covariance_global))[[int(np.flatnonzero(free == n)[0]) for n in names]]
    # Only the axis that the car turns about shows its scale.
    assert sigma[2] < 0.002
    assert abs(found.state.common[names[2]] - (scale @ sim.log.box)[2]) < 3.5 * sigma[2]


def test_mounting_that_is_known_is_not_moved(sim):
    known = Model(mounting=sim.log.box, mounting_sigma=(1e-5,) * 3)
    found = solved(sim, known)
    assert np.abs(rotation_log((found.state.rot_vs @ sim.log.box.T)[..., None])).max() < 1e-4


def test_a_first_attitude_that_is_known_decides(sim, best):
    true = sim.at(sim.drive.samples.knot_times[:1]).rot_ns[..., 0]
    found = solved(sim, Model(first_attitude=true, first_attitude_sigma=(1e-5,) * 3))
    assert np.abs(rotation_log(mmt(found.state.rot_ns[..., :1], true[..., None]))).max() < 1e-4
    assert np.abs(rotation_log(mmt(best.state.rot_ns[..., :1], true[..., None]))).max() > 1e-4


def test_solving_leaves_drive_and_start_as_they_were(sim):
    before = sim.drive.fixes.pos_n.copy(), sim.drive.samples.gyro_s.copy()
    smoother = Smoother(sim.drive, Model())
    start = start_state(smoother)
    rot, common = start.rot_ns.copy(), start.common.copy()
    smoother.solve(start, sim.log.noise, "tls")
    now = sim.drive.fixes.pos_n, sim.drive.samples.gyro_s, start.rot_ns, start.common
    for array, old in zip(now, (*before, rot, common), strict=True):
        assert_allclose(array, old, rtol=0.0, atol=0.0)


def test_the_same_problem_gives_the_same_answer_twice(sim, best):
    check_same(solved(sim).state, best.state, share=1e-9)


def test_a_box_that_never_moves_has_no_forward_direction():
    sim = simulate(Log())
    still = sim.drive.samples
    at_rest = replace(still, gyro_s=0.0 * still.gyro_s, accel_s=np.tile([0.0, 0.0, 9.8], (len(still.t_s), 1)))
    fixes = replace(sim.drive.fixes, pos_n=0.0 * sim.drive.fixes.pos_n, vel=0.0 * sim.drive.fixes.vel)
    smoother = Smoother(replace(sim.drive, samples=at_rest, fixes=fixes), Model())
    with pytest.raises(ValueError):
        start_state(smoother)
