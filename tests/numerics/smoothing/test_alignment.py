"""The closed-form start on simulated drives, for boxes mounted in every way.

The bounds on attitude and mounting are those that the start has to keep: the iterations after it are linear to 1 % up
to 10 degrees and converge from 30. Noise leaves about a third of them: GNSS velocities of 0.1 m/s make accelerations of
0.07 m/s^2 over 2 s, and 60 s of driving with 1 m/s^2 rms hold 30 of them, so the heading is known to 0.7 degrees; an
accelerometer bias of 20 mg tilts by 1.1 degrees; 0.02 deg/s left of the gyroscope bias turn 1.2 degrees in 60 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from recon.numerics import rotation
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.motion import Drive, Segment, rest, specific_force, stop_and_go
from recon.numerics.smoothing import alignment, gyro_start
from recon.numerics.smoothing.preintegration import Increments, preintegrate
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.soa import mmt, rotation_log

GRAVITY_N = np.array([0.0, 0.0, -STANDARD_GRAVITY])
GYRO_BIAS = np.radians(0.5)
VEL_SIGMA = 0.1


@dataclass(frozen=True)
class Run:
    """What was logged, and the truth at the knots."""

    samples: Samples
    still: np.ndarray
    bias: np.ndarray
    vel_n: np.ndarray
    known: np.ndarray
    speed: np.ndarray
    rot_ns: np.ndarray
    rot_vs: np.ndarray

    @property
    def whole(self) -> list[slice]:
        return [slice(0, self.known.size)]

    def increments(self, bias: np.ndarray) -> Increments:
        each = np.zeros((3, self.samples.intervals))
        return preintegrate(self.samples, each + bias[:, None], each, np.zeros(6))

    def bias_at_stops(self) -> np.ndarray:
        return np.median(self.samples.gyro_s[self.still], axis=0)


def simulate(
    drive: Drive, seconds: float, rot_vs: np.ndarray, seed: int, start_s: float = 0.0, bias_size: float = GYRO_BIAS
) -> Run:
    """A box of 0.01 deg/s/sqrt(Hz), 150 ug/sqrt(Hz) and 20 mg at 100 Hz, and GNSS velocities at the knots."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, seconds + 0.005, 0.01)
    truth = drive.at(t_s + start_s)
    bias = bias_size * unit(rng.normal(size=3))
    gyro = truth.gyro_v @ rot_vs + bias + rng.normal(0.0, np.radians(0.1), truth.gyro_v.shape)
    accel = specific_force(truth) @ rot_vs + 0.2 * unit(rng.normal(size=3))
    samples = regular_samples(t_s, gyro, accel + rng.normal(0.0, 0.015, gyro.shape))
    at_knots = drive.at(samples.knot_times + start_s)
    vel_n = at_knots.vel_n.T
    return Run(
        samples=samples,
        still=np.linalg.norm(drive.at(samples.t_s + start_s).vel_n, axis=1) == 0.0,
        bias=bias,
        vel_n=vel_n + rng.normal(0.0, VEL_SIGMA, vel_n.shape),
        known=np.ones(vel_n.shape[1], bool),
        speed=np.linalg.norm(vel_n, axis=0),
        rot_ns=np.moveaxis(rotation.to_matrix(at_knots.q_nv) @ rot_vs, 0, -1),
        rot_vs=rot_vs,
    )


def box(number: int) -> np.ndarray:
    """R_vs of one of 24 boxes: each of the 24 ways in which a cube can lie, askew by up to 15 degrees."""
    rng = np.random.default_rng(number)
    faces = rotation.from_rotvec(
        np.pi / 2 * np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [0, 1, 0], [0, 3, 0]])
    )
    lies = rotation.multiply(faces[number % 6], rotation.from_rotvec([0.0, 0.0, np.pi / 2 * (number // 6)]))
    askew = rotation.from_rotvec(unit(rng.normal(size=3)) * np.radians(rng.uniform(0.0, 15.0)))
    return rotation.to_matrix(rotation.multiply(askew, lies))


def city(number: int, seconds: float = 300.0) -> Run:
    return simulate(stop_and_go(seconds, np.random.default_rng(number)), seconds, box(number), number)


def never_stopping(number: int, seconds: float = 300.0) -> Run:
    """Bends of 1 to 3 m/s^2, straights, slopes and changes of speed, cut out between start and end."""
    rng = np.random.default_rng(number)
    segments, speed = [Segment(10.0, 8.0)], 8.0
    for _ in range(int(seconds / 4.0) + 5):
        speed = rng.uniform(max(6.0, speed - 6.0), min(16.0, speed + 6.0))
        bend = rng.choice([0.0, 1.0, -1.0]) * rng.uniform(1.0, 3.0) / speed**2
        segments.append(Segment(rng.uniform(4.0, 10.0), speed, curvature=bend, slope=rng.uniform(-0.06, 0.06)))
    drive = Drive((*segments, Segment(10.0, 0.0)))
    return simulate(drive, seconds, box(number), number, start_s=12.0)


def turning_unseen(number: int) -> Run:
    """Straight ways of 36 s at 15 m/s, with turns between in which no velocity is known, and 3 deg/s of bias."""
    bend = np.pi / 180.0
    ways = [Segment(36.0, 15.0), Segment(2.0, 15.0, bend), Segment(10.0, 15.0, bend), Segment(2.0, 15.0)]
    drive = Drive((Segment(10.0, 15.0), *(5 * ways), Segment(10.0, 0.0)))
    run = simulate(drive, 250.0, box(number), number, start_s=10.0, bias_size=np.radians(3.0))
    run.known[run.samples.knot_times % 50.0 > 35.0] = False
    return run


def braking_unseen(number: int) -> Run:
    """Straight on, braking and one bend where no velocity is known, while the bias about the long axis wanders."""
    ways = [Segment(10.0, 23.0), Segment(42.0, 23.0), Segment(7.0, 14.0), Segment(18.0, 14.0), Segment(6.0, 9.0)]
    last = [
        Segment(2.0, 9.0, 0.02),
        Segment(10.0, 9.0, 0.02),
        Segment(2.0, 9.0),
        Segment(30.0, 14.0),
        Segment(9.0, 0.0),
    ]
    run = simulate(Drive((Segment(36.0, 0.0), *ways, *last)), 150.0, box(number), number)
    wanders = np.radians(-0.7) * (run.samples.t_s / 150.0 - 0.5)
    run.samples.gyro_s[...] += wanders[:, None] * run.rot_vs[0]
    run.known[(run.samples.knot_times > 88.0) & (run.samples.knot_times < 118.0)] = False
    return run


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between rotations (3, 3, ...)."""
    return np.degrees(np.linalg.norm(rotation_log(mmt(a, b)), axis=0))


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


@pytest.mark.parametrize("number", range(6))
def test_a_braking_that_no_velocity_shows_is_no_turn(number):
    """Changes of speed and a bend, 80 s apart, are known to some degrees each, and tell 0.1 deg/s of bias about up.

    Up to 0.35 deg/s wander about the long axis: where the level is out by 10 degrees, 0.06 deg/s of that seem to be
    about up.
    """
    run = braking_unseen(number)
    bias = gyro_start.gyro_bias_from_drift(run.increments(np.zeros(3)), run.vel_n, run.known, GRAVITY_N, run.whole)
    assert abs((run.rot_vs @ (bias - run.bias))[2]) < np.radians(0.25)


@pytest.mark.parametrize("number", range(24))
def test_the_course_tells_the_bias_of_a_box_in_a_vehicle(number):
    """Courses err by 0.5 deg at 12 m/s, so their changes in 2 s by 0.34 deg/s, and so does a slope that begins or ends:
    a median of 150 by 0.34 * 1.25 / 12 = 0.035 on each axis, the worst of 72 by three times that; bends all to one side
    add as much as up is off by the lean of accelerations, a degree or two of 8 deg/s."""
    run = never_stopping(number)
    bias = gyro_start.gyro_bias_from_course(run.increments(np.zeros(3)), run.vel_n, run.known)
    assert np.linalg.norm(bias - run.bias) < np.radians(0.3)


@pytest.mark.parametrize("number", range(6))
def test_the_course_is_believed_where_nothing_but_straight_ways_has_known_velocities(number):
    """The drift of the alignment cannot tell a bias about up there, for no change of velocity tells the heading."""
    run = turning_unseen(number)
    rest = gyro_start.gyro_bias_from_course(run.increments(np.zeros(3)), run.vel_n, run.known)
    increments = run.increments(rest)
    seen = (run.vel_n, run.known, GRAVITY_N, run.whole)
    bias = rest + gyro_start.steadier(increments, gyro_start.gyro_bias_from_drift(increments, *seen), *seen)
    assert np.linalg.norm(bias - run.bias) < np.radians(0.2)


def test_a_better_bias_is_taken_and_a_worse_one_is_not():
    run = never_stopping(7)
    seen = (run.vel_n, run.known, GRAVITY_N, run.whole)
    assert np.array_equal(gyro_start.steadier(run.increments(np.zeros(3)), run.bias, *seen), run.bias)
    assert not gyro_start.steadier(run.increments(run.bias), run.bias, *seen).any()


def test_a_course_that_is_hardly_known_tells_no_bias():
    run = never_stopping(8)
    run.known[9:] = False
    assert not gyro_start.gyro_bias_from_course(run.increments(np.zeros(3)), run.vel_n, run.known).any()


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
