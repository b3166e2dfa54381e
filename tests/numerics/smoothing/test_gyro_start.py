"""The bias of a gyroscope to start from, by the drift of an alignment and by the course."""

from __future__ import annotations

import numpy as np
import pytest
from alignment_drives import GRAVITY_N, Run, box, never_stopping, simulate

from recon.numerics.motion import Drive, Segment
from recon.numerics.smoothing import gyro_start


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
