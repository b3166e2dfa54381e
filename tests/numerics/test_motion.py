"""Motions: the truth agrees with itself, with independent formulas, and with what each drive promises.

Each interval of the check grid lies inside one segment, where every quantity is analytic. Over 0.02 s the six-node
Gauss-Legendre rule then leaves h^13 (6!)^4 / (13 (12!)^3) f^(12) < 2e-14, even in the 0.1 s crash pulse with
f^(12) = 240 (2 pi / 0.1)^12. What is left is rounding: of the value itself, and of the time t, worth eps t times the
rate.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.motion import (
    Drive,
    Motion,
    MotionTruth,
    Segment,
    Spring,
    circle,
    crash,
    hill,
    parking,
    rest,
    roundabout,
    rounds,
    s_curve,
    specific_force,
    stop_and_go,
    straight,
)
from recon.numerics.rotation import Floats, conjugate, multiply, rotate, to_euler

EPS = np.finfo(float).eps

DRIVES = {
    "rest": rest(20.0),
    "straight": straight(),
    "s_curve": s_curve(),
    "roundabout": roundabout(),
    "rounds": rounds(slope=0.1),
    "hill": hill(),
    "parking": parking(),
    "crash": crash(),
    "stop_and_go": stop_and_go(300.0, np.random.default_rng(3)),
    "everything_at_once": Drive(
        (
            Segment(4.0, 9.0, curvature=0.2, slope=0.3, bank=-0.2, dive=0.1),
            Segment(6.0, 5.0, curvature=-0.1, slope=-0.2, bank=0.3),
            Segment(5.0, 0.0),
        ),
        yaw=2.0,
    ),
}
SPRINGS = {
    "circle": circle(20.0, 8.0),
    "circle_facing_east": circle(20.0, 8.0, turning=False),
    "helix": Spring(radius=5.0, rate=-1.2, climb=0.7),
    "spring": Spring(radius=5.0, rate=1.2, climb=0.3, amplitude=0.5, oscillation=3.0),
}
MOTIONS: dict[str, Motion] = {**DRIVES, **SPRINGS}


def check_grid(motion: Motion) -> Floats:
    """Times at most 0.02 s apart that include the edges of the segments."""
    edges = motion.edges_s if isinstance(motion, Drive) else np.array([0.0, 20.0])
    return np.union1d(edges, np.arange(0.0, edges[-1], 0.02))


def integral(rate: Callable[[MotionTruth], Floats], motion: Motion, grid: Floats) -> Floats:
    """Six-node Gauss-Legendre integral of a rate over each interval of the grid: (n - 1, k)."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    half, middle = np.diff(grid) / 2.0, (grid[1:] + grid[:-1]) / 2.0
    rates = rate(motion.at((middle[:, None] + half[:, None] * nodes).ravel())).reshape(len(half), len(nodes), -1)
    total: Floats = half[:, None] * np.einsum("k,nkj->nj", weights, rates)
    return total


def assert_integrates(
    value: Callable[[MotionTruth], Floats], rate: Callable[[MotionTruth], Floats], motion: Motion
) -> None:
    """A value changes over each interval by the integral of its rate, to rounding (module docstring)."""
    grid = check_grid(motion)
    truth = motion.at(grid)
    rounding = 8.0 * EPS * (np.abs(value(truth)).max() + grid[-1] * np.abs(rate(truth)).max())
    np.testing.assert_allclose(np.diff(value(truth), axis=0), integral(rate, motion, grid), rtol=0.0, atol=rounding)


def forward_speed(truth: MotionTruth) -> Floats:
    return vel_v(truth)[:, 0]


def vel_v(truth: MotionTruth) -> Floats:
    return rotate(conjugate(truth.q_nv), truth.vel_n)


@pytest.mark.parametrize("name", MOTIONS)
def test_position_is_the_integral_of_velocity(name: str) -> None:
    assert_integrates(lambda truth: truth.pos_n, lambda truth: truth.vel_n, MOTIONS[name])


@pytest.mark.parametrize("name", MOTIONS)
def test_velocity_is_the_integral_of_acceleration(name: str) -> None:
    assert_integrates(lambda truth: truth.vel_n, lambda truth: truth.acc_n, MOTIONS[name])


@pytest.mark.parametrize("name", MOTIONS)
def test_attitude_is_the_integral_of_the_angular_rate(name: str) -> None:
    def q_rate(truth: MotionTruth) -> Floats:
        return 0.5 * multiply(truth.q_nv, np.column_stack((np.zeros(len(truth.t_s)), truth.gyro_v)))

    assert_integrates(lambda truth: truth.q_nv, q_rate, MOTIONS[name])


@pytest.mark.parametrize("name", DRIVES)
def test_acceleration_and_angular_rate_are_continuous_across_segments(name: str) -> None:
    edges = DRIVES[name].edges_s
    step = 1e-7
    before, after = DRIVES[name].at(edges - step), DRIVES[name].at(edges + step)
    # The steepest acceleration is that of the crash pulse, pi 240 / 0.1 = 7.6e3 m/s^3, and of its dive, pi 1.0 / 0.1 =
    # 31 rad/s^2. A jump would be of the size of the quantity: 1 m/s^2 and 0.05 rad/s and more.
    np.testing.assert_allclose(before.acc_n, after.acc_n, rtol=0.0, atol=7.6e3 * 2.0 * step)
    np.testing.assert_allclose(before.gyro_v, after.gyro_v, rtol=0.0, atol=31.5 * 2.0 * step)


@pytest.mark.parametrize("name", MOTIONS)
def test_truth_does_not_depend_on_the_order_or_the_company_of_times(name: str) -> None:
    times = np.random.default_rng(0).uniform(-1.0, 30.0, 200)
    truth, alone = MOTIONS[name].at(times), MOTIONS[name].at(times[7:8])
    ordered = MOTIONS[name].at(np.sort(times))
    # SIMD kernels may round a sine differently by its place in the array: one unit in the last place, times the yaw.
    np.testing.assert_allclose(truth.pos_n[np.argsort(times)], ordered.pos_n, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(truth.pos_n[7:8], alone.pos_n, rtol=0.0, atol=1e-12)


def test_rest_reads_exactly_one_g_upwards_and_no_rate() -> None:
    truth = rest(10.0).at(np.linspace(-5.0, 15.0, 50))
    np.testing.assert_array_equal(specific_force(truth), np.tile([0.0, 0.0, STANDARD_GRAVITY], (50, 1)))
    np.testing.assert_array_equal(truth.gyro_v, 0.0)
    np.testing.assert_array_equal(truth.pos_n, 0.0)


@pytest.mark.parametrize("name", sorted(set(DRIVES) - {"everything_at_once"}))
def test_a_drive_begins_with_ten_seconds_of_rest(name: str) -> None:
    truth = DRIVES[name].at(np.linspace(0.0, 10.0, 101))
    np.testing.assert_array_equal(truth.pos_n, 0.0)
    np.testing.assert_array_equal(truth.gyro_v, 0.0)
    np.testing.assert_array_equal(specific_force(truth)[:, 2], STANDARD_GRAVITY)


@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_stands_still_outside_its_time(name: str) -> None:
    end = DRIVES[name].duration_s
    truth = DRIVES[name].at(np.array([-100.0, 0.0, end, end + 100.0]))
    # At the end sin(pi) is 1e-16, and it enters squared.
    for quantity in (truth.vel_n, truth.acc_n, truth.gyro_v):
        np.testing.assert_allclose(quantity, 0.0, atol=EPS)
    np.testing.assert_array_equal(truth.pos_n[::2], truth.pos_n[1::2])


@pytest.mark.parametrize("name", DRIVES)
def test_a_car_has_no_side_slip_and_lifts_only_where_it_dives(name: str) -> None:
    truth = DRIVES[name].at(check_grid(DRIVES[name]))
    # Some twenty products of sines and cosines, each rounded to eps, times at most 15 m/s.
    atol = 20.0 * EPS * 15.0
    np.testing.assert_allclose(vel_v(truth)[:, 1], 0.0, atol=atol)
    assert (np.abs(vel_v(truth)[:, 2]).max() > atol) == (name in {"crash", "everything_at_once"})


def test_circle_agrees_with_complex_numbers_and_pulls_inwards() -> None:
    t_s, radius, speed = np.linspace(0.0, 40.0, 500), 20.0, 8.0
    truth = circle(radius, speed).at(t_s)
    spin = np.exp(1j * speed / radius * t_s)
    # The phase of 16 rad is rounded to 16 eps; times 20 m.
    atol = 4.0 * 16.0 * EPS * radius
    np.testing.assert_allclose(truth.pos_n @ [1.0, 1j, 0.0], radius * (spin - 1.0) / 1j, rtol=0.0, atol=atol)
    np.testing.assert_allclose(truth.vel_n @ [1.0, 1j, 0.0], speed * spin, rtol=0.0, atol=atol)
    inwards = np.tile([0.0, speed**2 / radius, STANDARD_GRAVITY], (500, 1))
    np.testing.assert_allclose(specific_force(truth), inwards, rtol=0.0, atol=atol)


def test_the_body_of_a_circle_turns_only_when_asked() -> None:
    t_s = np.linspace(0.0, 40.0, 500)
    facing_east = circle(20.0, 8.0, turning=False).at(t_s)
    np.testing.assert_array_equal(facing_east.q_nv, np.tile([1.0, 0.0, 0.0, 0.0], (500, 1)))
    np.testing.assert_array_equal(facing_east.gyro_v, 0.0)
    np.testing.assert_allclose(forward_speed(circle(20.0, 8.0).at(t_s)), 8.0, rtol=64.0 * EPS)


def test_helix_has_the_curvature_of_differential_geometry() -> None:
    helix = SPRINGS["helix"]
    truth = helix.at(np.linspace(0.0, 20.0, 300))
    pitch = helix.climb / helix.rate
    curvature = np.linalg.norm(np.cross(truth.vel_n, truth.acc_n), axis=1) / np.linalg.norm(truth.vel_n, axis=1) ** 3
    np.testing.assert_allclose(curvature, helix.radius / (helix.radius**2 + pitch**2), rtol=32.0 * EPS)


def test_spring_swings_about_a_steady_climb() -> None:
    spring = SPRINGS["spring"]
    t_s = np.linspace(0.0, 20.0, 300)
    truth = spring.at(t_s)
    swing = truth.pos_n[:, 2] - spring.climb * t_s
    assert np.abs(swing).max() == pytest.approx(0.5, rel=5e-3)  # samples lie within 0.1 rad of a peak
    np.testing.assert_allclose(truth.acc_n[:, 2], -9.0 * swing, rtol=0.0, atol=9.0 * 8.0 * EPS * 6.5)
    energy = (truth.vel_n[:, 2] - spring.climb) ** 2 + 9.0 * swing**2
    np.testing.assert_allclose(energy, (0.5 * 3.0) ** 2, rtol=0.0, atol=2.25 * 64.0 * EPS)


def test_a_bend_of_constant_curvature_is_an_arc_of_a_circle() -> None:
    drive = Drive((Segment(5.0, 10.0), Segment(2.0, 10.0, 0.05), Segment(12.0, 10.0, 0.05), Segment(5.0, 0.0)))
    start, stop = drive.edges_s[2:4]
    t_s = np.linspace(start, stop, 200)
    truth = drive.at(t_s)
    arc = circle(20.0, 10.0).at(t_s - start)
    q_start = truth.q_nv[0]
    # Sixteen pieces and eight nodes, each rounded to eps of the 100 m from the origin; phase 6 rad times 20 m.
    np.testing.assert_allclose(truth.pos_n - truth.pos_n[0], rotate(q_start, arc.pos_n), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(truth.acc_n, rotate(q_start, arc.acc_n), rtol=0.0, atol=1e-13)


def test_straight_covers_the_sum_of_its_mean_speeds() -> None:
    drive = straight(speed=15.0, cruise_s=10.0)
    launch, brake = 2.0 * 15.0 / 2.0, 2.0 * 15.0 / 3.0
    distance = 15.0 * (launch / 2.0 + 10.0 + brake / 2.0)
    end = drive.at(np.array([drive.duration_s])).pos_n[0]
    np.testing.assert_allclose(end, [distance, 0.0, 0.0], rtol=80.0 * EPS)  # 80 pieces are added up


def test_s_curve_and_roundabout_leave_in_the_promised_direction() -> None:
    bend, ring = s_curve(), roundabout(exit_angle=np.pi / 2.0)
    yaw = [float(to_euler(drive.at(np.array([drive.duration_s])).q_nv)[0][0]) for drive in (bend, ring)]
    assert yaw == pytest.approx([0.0, np.pi / 2.0], abs=16.0 * EPS * 2.0 * np.pi)


def test_roundabout_holds_its_radius_at_constant_speed() -> None:
    truth = roundabout(speed=6.0, radius=15.0).at(np.arange(0.0, 45.0, 0.01))
    turning = np.isclose(truth.gyro_v[:, 2], 6.0 / 15.0, rtol=1e-12, atol=0.0)
    assert turning.sum() > 500  # the arc of 3.7 radii lasts 9.3 s
    np.testing.assert_allclose(np.linalg.norm(truth.acc_n[turning], axis=1), 6.0**2 / 15.0, rtol=1e-11)


def test_rounds_on_a_slope_wind_upwards_like_a_spring() -> None:
    drive = rounds(speed=8.0, radius=20.0, turns=3.0, slope=0.1)
    start, stop = drive.edges_s[3:5]
    truth = drive.at(np.linspace(start, stop, 400))
    yaw_rate = rotate(truth.q_nv, truth.gyro_v)[:, 2]
    # The heading turns with the length of the road, so that seen from above the circle is smaller by cos(slope).
    # Twenty products, each rounded; the yaw of up to 19 rad is rounded to 19 eps.
    level_speed = np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1])
    np.testing.assert_allclose(level_speed / yaw_rate, 20.0 * np.cos(0.1), rtol=64.0 * EPS)
    np.testing.assert_allclose(truth.vel_n[:, 2], 8.0 * np.sin(0.1), rtol=64.0 * EPS)
    yaw = [float(to_euler(drive.at(np.array([t_s])).q_nv)[0][0]) for t_s in (0.0, drive.duration_s)]
    assert yaw == pytest.approx([0.0, 0.0], abs=16.0 * EPS * 6.0 * np.pi)


def test_hill_pitches_nose_up_by_its_slope_and_comes_back_down() -> None:
    drive = hill(speed=12.0, slope=0.1)
    truth = drive.at(np.arange(0.0, drive.duration_s, 0.01))
    _, pitch, _ = to_euler(truth.q_nv)
    climb_angle = np.arctan2(truth.vel_n[:, 2], np.hypot(truth.vel_n[:, 0], truth.vel_n[:, 1]))
    np.testing.assert_allclose(pitch, -climb_angle, rtol=0.0, atol=16.0 * EPS)
    assert (pitch.min(), pitch.max()) == pytest.approx((-0.1, 0.1), abs=4.0 * EPS)
    assert truth.pos_n[:, 2].max() > 11.0  # 60 m at a slope of 0.1, and twice 60 m at half of it on average: 12 m
    assert truth.pos_n[-1, 2] == pytest.approx(0.0, abs=200.0 * EPS * 12.0)


def test_parking_reverses_with_steering_both_ways_and_ends_parallel_beside() -> None:
    drive = parking()
    truth = drive.at(np.arange(0.0, drive.duration_s, 0.01))
    backwards = forward_speed(truth) < -0.1
    assert forward_speed(truth).min() == pytest.approx(-1.2, rel=8.0 * EPS)
    assert truth.gyro_v[backwards, 2].min() < -0.1 < 0.1 < truth.gyro_v[backwards, 2].max()
    assert to_euler(truth.q_nv[-1:])[0][0] == pytest.approx(0.0, abs=16.0 * EPS)
    assert -3.5 < truth.pos_n[-1, 1] < -1.5  # a lane's width to the right


@pytest.mark.parametrize("delta_v", [5.0, 15.0])
def test_crash_loses_exactly_its_delta_v_in_a_haversine(delta_v: float) -> None:
    drive = crash(speed=15.0, delta_v=delta_v, pulse_s=0.1)
    start, stop = drive.edges_s[3:5]
    assert stop - start == pytest.approx(0.1, abs=4.0 * EPS * stop)
    ends = drive.at(np.array([start, stop]))
    np.testing.assert_array_equal(np.diff(ends.vel_n[:, 0]), -delta_v)
    t_s = np.linspace(start, stop, 41)
    pulse = -2.0 * delta_v / 0.1 * np.sin(np.pi * (t_s - start) / 0.1) ** 2
    # Time is rounded to eps stop, worth that times the jerk of at most 2 pi delta_v / 0.1^2.
    atol = 8.0 * EPS * stop * 2.0 * np.pi * delta_v / 0.1**2
    np.testing.assert_allclose(drive.at(t_s).acc_n[:, 0], pulse, rtol=0.0, atol=atol)


def test_crash_kicks_the_nose_down_and_lets_it_come_back() -> None:
    drive = crash(dive=0.05)
    _, pitch, _ = to_euler(drive.at(drive.edges_s).q_nv)
    np.testing.assert_allclose(pitch, [0.0, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0], rtol=0.0, atol=4.0 * EPS)


@pytest.mark.parametrize("delta_v", [-0.1, -1.0, 15.1])
def test_crash_refuses_an_impossible_delta_v(delta_v: float) -> None:
    with pytest.raises(ValueError, match=r"loses between 0 and 15\.0 m/s"):
        crash(speed=15.0, delta_v=delta_v)


@pytest.mark.parametrize("duration_s", [20.0, 61.7, 600.0])
@pytest.mark.parametrize("seed", range(5))
def test_stop_and_go_lasts_as_long_as_asked(duration_s: float, seed: int) -> None:
    drive = stop_and_go(duration_s, np.random.default_rng(seed))
    # One addition per segment, of which there are about one per 4 s.
    assert drive.duration_s == pytest.approx(duration_s, rel=EPS * (4.0 + duration_s / 4.0))


def test_stop_and_go_stops_turns_both_ways_and_climbs_within_the_limits_of_a_driver() -> None:
    drive = stop_and_go(1200.0, np.random.default_rng(11))
    truth = drive.at(np.arange(0.0, 1200.0, 0.05))
    standing = np.all(truth.vel_n == 0.0, axis=1)
    assert np.count_nonzero(np.diff(standing.astype(int)) == 1) >= 3
    assert truth.gyro_v[:, 2].min() < -0.2 < 0.2 < truth.gyro_v[:, 2].max()
    assert np.ptp(truth.pos_n[:, 2]) > 1.0
    acc_v = rotate(conjugate(truth.q_nv), truth.acc_n)
    assert np.abs(acc_v[:, 0]).max() <= 3.0 * (1.0 + 1e-12)
    assert np.abs(acc_v[:, 1]).max() <= 2.5 * (1.0 + 1e-12)


def test_stop_and_go_is_the_same_for_the_same_seed_only() -> None:
    first, again, other = (stop_and_go(300.0, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("segments", "fault"),
    [
        ((), "at least one segment"),
        ((Segment(0.0, 0.0),), "segment 0 lasts 0.0 s"),
        ((Segment(float("nan"), 0.0),), "segment 0 lasts nan s"),
        ((Segment(1.0, 2.0), Segment(1.0, -2.0), Segment(1.0, 0.0)), "segment 1 reverses from 2.0 to -2.0"),
        ((Segment(1.0, 0.0, slope=0.1),), "segment 0 changes slope or bank while the vehicle stands"),
        ((Segment(1.0, 2.0),), "ends at 2.0 m/s"),
    ],
)
def test_a_drive_that_cannot_be_driven_is_refused(segments: tuple[Segment, ...], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        Drive(segments)
