"""The closed-form start on simulated drives, for boxes mounted in every way.

The bounds on attitude and mounting are those that the start has to keep: the iterations after it are linear to 1 % up
to 10 degrees and converge from 30. Noise leaves about a third of them: GNSS velocities of 0.1 m/s make accelerations of
0.07 m/s^2 over 2 s, and 60 s of driving with 1 m/s^2 rms hold 30 of them, so the heading is known to 0.7 degrees; an
accelerometer bias of 20 mg tilts by 1.1 degrees; 0.02 deg/s left of the gyroscope bias turn 1.2 degrees in 60 s.
"""

from __future__ import annotations

import numpy as np
import pytest
from alignment_drives import GRAVITY_N, GYRO_BIAS, angle_deg, box, city, never_stopping, simulate

from recon.numerics import rotation
from recon.numerics.motion import Drive, Segment, rest, stop_and_go
from recon.numerics.smoothing import alignment, gyro_start
from recon.numerics.smoothing.soa import mm, mmt, rotation_exp, rotation_log


def tilt_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between the verticals of attitudes (3, 3, n)."""
    return np.degrees(np.arccos(np.clip((a[2] * b[2]).sum(axis=0), -1.0, 1.0)))


@pytest.mark.parametrize("number", range(24))
def test_attitude_and_mounting_are_found_for_every_mounting(number):
    run = city(number)
    rot_ns = alignment.align(run.increments(run.bias_at_stops()), run.vel_n, run.known, GRAVITY_N, run.whole)
    errors = angle_deg(rot_ns, run.rot_ns)
    assert errors.max() < 10.0
    assert errors.mean() < 5.0
    assert angle_deg(alignment.mounting(rot_ns, run.vel_n, run.known), run.rot_vs) < 5.0


@pytest.mark.parametrize("number", range(24))
def test_they_are_found_without_any_stop_for_every_mounting(number):
    run = never_stopping(number)
    increments = run.increments(np.zeros(3))
    bias = gyro_start.gyro_bias_from_drift(increments, run.vel_n, run.known, GRAVITY_N, run.whole)
    assert np.linalg.norm(bias - run.bias) < 0.2 * GYRO_BIAS
    rot_ns = alignment.align(run.increments(bias), run.vel_n, run.known, GRAVITY_N, run.whole)
    errors = angle_deg(rot_ns, run.rot_ns)
    assert errors.max() < 10.0
    assert errors.mean() < 5.0
    assert angle_deg(alignment.mounting(rot_ns, run.vel_n, run.known), run.rot_vs) < 5.0


def test_chain_carries_the_heading_through_an_outage_and_nothing_unknown_is_looked_at():
    run = city(3)
    run.known[60:90] = False
    run.vel_n[:, 60:90] = np.nan
    rot_ns = alignment.align(run.increments(run.bias_at_stops()), run.vel_n, run.known, GRAVITY_N, run.whole)
    assert angle_deg(rot_ns, run.rot_ns).max() < 10.0


def test_wild_velocities_count_little():
    run = city(4)
    wild = np.random.default_rng(0).choice(run.known.size, 5, replace=False)
    run.vel_n[:, wild] += np.random.default_rng(1).normal(0.0, 15.0, (3, 5))
    rot_ns = alignment.align(run.increments(run.bias_at_stops()), run.vel_n, run.known, GRAVITY_N, run.whole)
    assert angle_deg(rot_ns, run.rot_ns).max() < 10.0


def test_heading_survives_ten_minutes_of_standing():
    resting = Drive((*stop_and_go(200.0, np.random.default_rng(5)).segments, Segment(600.0, 0.0)))
    run = simulate(resting, 800.0, box(5), 5)
    rot_ns = alignment.align(run.increments(run.bias_at_stops()), run.vel_n, run.known, GRAVITY_N, run.whole)
    # The chain drifts while standing by the error of the bias, the median of 60 000 samples of 0.1 deg/s: 5e-4 deg/s,
    # 0.3 degrees. The velocities at rest speak, if at all, with their noise.
    assert angle_deg(rot_ns, run.rot_ns).max() < 20.0


@pytest.mark.parametrize("number", range(4))
def test_a_short_segment_that_goes_astray_is_turned_along_its_course_and_no_other_is(number):
    run = city(number)
    rot_ns = alignment.align(run.increments(run.bias_at_stops()), run.vel_n, run.known, GRAVITY_N, run.whole)
    moves, stands = (np.flatnonzero(fast[40:]) + 40 for fast in (run.speed > 6.0, run.speed < 0.1))
    short = slice(int(moves[0]), int(moves[0]) + 3)
    parts = [slice(0, short.start), short, slice(short.stop, run.known.size)]
    assert (alignment.along_course(rot_ns, run.vel_n, run.known, parts) == rot_ns).all()
    for yaw in (-2.5, 1.5, np.pi):
        astray = rot_ns.copy()
        astray[..., short] = mm(rotation_exp(np.array([[0.0], [0.0], [yaw]])), rot_ns[..., short])
        turned = alignment.along_course(astray, run.vel_n, run.known, parts)
        assert angle_deg(turned[..., short], run.rot_ns[..., short]).max() < 10.0
        assert (np.delete(turned, np.r_[short], axis=2) == np.delete(rot_ns, np.r_[short], axis=2)).all()
    still = slice(int(stands[0]), int(stands[0]) + 1)
    parts = [slice(0, still.start), still, slice(still.stop, run.known.size)]
    assert (alignment.along_course(rot_ns, run.vel_n, run.known, parts) == rot_ns).all()


def test_segments_know_nothing_of_each_other():
    first, second = city(6), city(7)
    increments = [run.increments(run.bias_at_stops()) for run in (first, second)]
    parts = [slice(0, 100), slice(100, 101), slice(101, first.known.size)]
    whole = alignment.align(increments[0], first.vel_n, first.known, GRAVITY_N, parts)
    disturbed = first.vel_n.copy()
    disturbed[:, :100] = second.vel_n[:, :100]
    other = alignment.align(increments[0], disturbed, first.known, GRAVITY_N, parts)
    np.testing.assert_array_equal(whole[..., 101:], other[..., 101:])
    np.testing.assert_array_equal(whole[..., 100], np.eye(3))
    assert angle_deg(whole[..., 101:], first.rot_ns[..., 101:]).max() < 10.0


def test_without_any_velocity_the_level_is_still_found():
    run = city(8)
    nothing = np.zeros_like(run.known)
    increments = run.increments(run.bias_at_stops())
    rot_ns = alignment.align(increments, run.vel_n, nothing, GRAVITY_N, run.whole)
    # 20 mg tilt by 1.1 degrees; starting and braking by 15 m/s leave 15 / 150 m/s^2 on average over the bell: 0.6.
    # At the ends the bell is halved.
    assert tilt_deg(rot_ns, run.rot_ns).max() < 1.1 + 2 * 0.6 + 1.0
    sigma = alignment.heading_sigma(increments, rot_ns, run.vel_n, nothing, GRAVITY_N, run.whole)
    np.testing.assert_array_equal(sigma, [np.pi])


def test_speed_alone_gives_level_mounting_and_the_shape_of_the_course():
    run = city(9)
    increments = run.increments(run.bias_at_stops())
    vel_n = alignment.pseudo_velocity(increments, run.speed, run.whole)
    np.testing.assert_allclose(np.linalg.norm(vel_n, axis=0), run.speed, atol=1e-12)
    first = int(np.argmax(run.speed > 1.0))
    # North at the start: what the car turned until it is seen to move remains.
    assert abs(np.arctan2(vel_n[0, first], vel_n[1, first])) < 0.1
    rot_ns = alignment.align(increments, vel_n, run.known, GRAVITY_N, run.whole)
    assert tilt_deg(rot_ns, run.rot_ns).max() < 5.0
    assert angle_deg(alignment.mounting(rot_ns, vel_n, run.known), run.rot_vs) < 5.0
    apart = rotation_log(mmt(rot_ns, run.rot_ns))[2]
    # All drives of the catalogue begin to the east, a quarter turn clockwise from north.
    assert abs(np.angle(np.exp(1j * (apart - np.pi / 2))).mean()) < np.radians(5.0)


@pytest.mark.parametrize("number", range(6))
def test_heading_is_known_after_a_drive_and_unknown_after_a_rest(number):
    drive, parked = city(number), simulate(rest(300.0), 300.0, box(number), number)
    for run, lowest, highest in ((drive, 0.0, 0.05), (parked, 0.2, np.pi)):
        increments = run.increments(run.bias_at_stops())
        rot_ns = alignment.align(increments, run.vel_n, run.known, GRAVITY_N, run.whole)
        sigma = alignment.heading_sigma(increments, rot_ns, run.vel_n, run.known, GRAVITY_N, run.whole)
        assert sigma.shape == (1,)
        assert lowest < sigma[0] <= highest


def test_mounting_of_what_never_moves_is_refused():
    with pytest.raises(ValueError, match="forward cannot be told"):
        alignment.mounting(np.eye(3)[..., None], np.ones((3, 1)), np.zeros(1, bool))


def test_mounting_is_right_handed_and_exact_on_exact_input():
    rot_vs = box(10)
    rot_nv = rotation.to_matrix(rotation.from_euler(np.linspace(0.0, 6.0, 50), 0.0, 0.0))
    vel_n = 10.0 * rot_nv[:, :, 0].T
    found = alignment.mounting(np.moveaxis(rot_nv @ rot_vs, 0, -1), vel_n, np.ones(50, bool))
    np.testing.assert_allclose(found, rot_vs, atol=1e-14)


def test_vehicle_that_mostly_reverses_is_flipped():
    forward = np.array([0.0, 0.1, -0.2, 5.0, 6.0, 7.0, -2.0])
    assert not alignment.flip_needed(forward)
    assert alignment.flip_needed(-forward)
    assert not alignment.flip_needed(np.zeros(5))


@pytest.mark.parametrize("astray", [-200.0, -2e4])
def test_seconds_that_run_away_backwards_turn_no_drive(astray):
    forward = np.concatenate([np.full(60, 12.0), np.full(5, astray), np.zeros(40), np.full(10, -1.0)])
    assert not alignment.flip_needed(forward)
    assert alignment.flip_needed(-forward)
