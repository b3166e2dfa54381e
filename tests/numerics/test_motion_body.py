"""The sprung body: the truth of its points agrees with itself, and it leans the way a car does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from recon.numerics.motion import Drive, MotionTruth, Segment, Springs, SprungBody, ferry, rounds, straight, traffic
from recon.numerics.rotation import Floats, conjugate, multiply, rotate, to_euler

EPS = np.finfo(float).eps
SOFT = Springs(slip=0.0026, pitch=0.008, roll=0.01, bounce=0.0026, heave=0.004)
ARM = (-1.2, 0.2, -0.4)
KNOT_S = 0.04


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def body(drive: Drive, springs: Springs = SOFT, lever_v: tuple[float, float, float] = ARM) -> SprungBody:
    return SprungBody(drive, springs, lever_v, None, rng(1))


def change_and_integral(
    value: Callable[[MotionTruth], Floats], rate: Callable[[MotionTruth], Floats], motion: SprungBody
) -> tuple[Floats, Floats]:
    """Changes between the knots of the splines and the edges of the drive, and six-node Gauss-Legendre integrals."""
    edges = motion.drive.edges_s
    grid = np.union1d(edges, np.arange(0.0, edges[-1], KNOT_S / 2.0))
    nodes, weights = np.polynomial.legendre.leggauss(6)
    half, middle = np.diff(grid) / 2.0, (grid[1:] + grid[:-1]) / 2.0
    rates = rate(motion.at((middle[:, None] + half[:, None] * nodes).ravel())).reshape(len(half), 6, -1)
    return np.diff(value(motion.at(grid)), axis=0), half[:, None] * np.einsum("k,nkj->nj", weights, rates)


def q_rate(truth: MotionTruth) -> Floats:
    return 0.5 * multiply(truth.q_nv, np.column_stack((np.zeros(len(truth.t_s)), truth.gyro_v)))


@pytest.mark.parametrize("kind", ["mixed", "reverse"])
@pytest.mark.parametrize(
    ("value", "rate"),
    [
        (lambda truth: truth.pos_n, lambda truth: truth.vel_n),
        (lambda truth: truth.vel_n, lambda truth: truth.acc_n),
        (lambda truth: truth.q_nv, q_rate),
    ],
    ids=["position", "velocity", "attitude"],
)
def test_each_quantity_is_the_integral_of_its_rate(kind: str, value: Callable, rate: Callable) -> None:  # type: ignore[type-arg]
    change, integral = change_and_integral(value, rate, body(traffic(kind, 180.0, rng(2))))
    # Between knots all is analytic, and the rule exact but for rounding: of the values, up to 2e3 m, and of the time,
    # 180 s, which is worth eps t times the rate, up to 30 m/s; the splines divide by knots of 0.04 s twice.
    np.testing.assert_allclose(change, integral, rtol=0.0, atol=32.0 * EPS * 2e3)


def test_a_rigid_body_without_arm_is_the_drive_itself() -> None:
    drive = traffic("mixed", 120.0, rng(3))
    t_s = np.arange(0.0, 120.0, 0.05)
    axle, point = drive.at(t_s), body(drive, Springs(), (0.0, 0.0, 0.0)).at(t_s)
    for name in ("pos_n", "vel_n", "acc_n", "q_nv", "gyro_v"):
        np.testing.assert_array_equal(getattr(point, name), getattr(axle, name))


def test_the_rear_axle_stays_at_its_arm() -> None:
    drive = traffic("mixed", 180.0, rng(4))
    t_s = np.arange(0.0, 180.0, 0.05)
    axle, point = drive.at(t_s), body(drive, Springs(slip=0.0026, pitch=0.008, roll=0.01)).at(t_s)
    seen_v = rotate(conjugate(point.q_nv), axle.pos_n - point.pos_n)
    np.testing.assert_allclose(seen_v, np.tile(ARM, (len(t_s), 1)), rtol=0.0, atol=8.0 * EPS * 2e3)


def test_a_steady_bend_to_the_left_leans_the_body_outwards_and_turns_it_inwards() -> None:
    speed, radius = 8.0, 20.0
    drive = rounds(speed, radius)
    middle = float(np.mean(drive.edges_s[[3, 4]]))
    truth = body(drive, Springs(slip=0.0026, roll=0.01)).at(np.array([middle]))
    lateral = speed**2 / radius
    (yaw,), _, (roll,) = to_euler(truth.q_nv)
    (course,), _, _ = to_euler(drive.at(np.array([middle])).q_nv)
    # The rotations about z and x of 0.03 rad and less do not mix: roll is taken about the new x axis.
    assert roll == pytest.approx(0.01 * lateral, rel=1e-9)
    assert np.angle(np.exp(1j * (yaw - course))) == pytest.approx(0.0026 * lateral, rel=1e-9)


def test_the_nose_rises_under_power_and_dives_under_the_brake() -> None:
    drive = Drive((Segment(5.0, 0.0), Segment(20.0, 30.0), Segment(10.0, 30.0), Segment(20.0, 0.0), Segment(5.0, 0.0)))
    _, pitch, _ = to_euler(body(drive, Springs(pitch=0.008)).at(np.array([15.0, 45.0])).q_nv)
    # Peaks of the haversine, 3 m/s^2; the springs smooth by 0.25 s: (2 pi 0.25 / 20)^2 / 2 of the half wave is lost.
    np.testing.assert_allclose(pitch, [-0.008 * 3.0, 0.008 * 3.0], rtol=(2.0 * np.pi * 0.25 / 20.0) ** 2)


def test_the_body_is_still_where_the_vehicle_stands() -> None:
    truth = body(straight(rest_s=20.0)).at(np.linspace(0.0, 18.0, 500))
    np.testing.assert_array_equal(truth.vel_n, 0.0)
    np.testing.assert_array_equal(truth.acc_n, 0.0)
    np.testing.assert_array_equal(truth.gyro_v, 0.0)


def test_bounce_and_heave_have_their_sigmas_at_speed() -> None:
    drive = straight(15.0, cruise_s=2000.0)
    t_s = np.arange(60.0, 1900.0, 0.5)
    springs = Springs(bounce=0.003, heave=0.005)
    moved = body(drive, springs, (0.0, 0.0, 0.0)).at(t_s)
    _, pitch, roll = to_euler(moved.q_nv)
    # 3680 values every 0.5 s: independent, as the noise fades within 0.1 s, so that sigma is known to 1.2 %; the
    # spline itself smooths away (2 pi f knot)^2 / 6 of the amplitude at f, 3 % at 2 Hz and 4.5 % (rms) at 3 Hz.
    assert np.std(roll) == pytest.approx(0.003, rel=0.1)
    assert np.std(pitch) == pytest.approx(0.003, rel=0.1)
    assert np.std(moved.pos_n[:, 2]) == pytest.approx(0.005, rel=0.1)


def test_on_a_ferry_the_swell_takes_the_place_of_the_springs() -> None:
    drive, span = ferry(1200.0, rng(5))
    t_s = np.arange(span[0] + 30.0, span[1] - 30.0, 1.0)
    _, _, roll = to_euler(SprungBody(drive, Springs(), ARM, span, rng(6)).at(t_s).q_nv)
    # Swell fades within 3 s: some 150 independent values, so that sigma is known to 6 %.
    assert np.degrees(np.std(roll)) == pytest.approx(1.5, rel=0.25)
    around = np.array([span[0] - 1.0, span[1] + 1.0])
    before = drive.at(around)
    np.testing.assert_allclose(SprungBody(drive, Springs(), ARM, span, rng(6)).at(around).q_nv, before.q_nv, atol=EPS)
