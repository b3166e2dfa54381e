from __future__ import annotations

import numpy as np
import pytest

from recon.numerics import severity
from recon.numerics.geodesy import STANDARD_GRAVITY as G

STEP = 1e-3


def constant(ax: float, ay: float = 0.0, az: float = 0.0, seconds: float = 1.0) -> np.ndarray:
    return np.tile([ax, ay, az], (round(seconds / STEP) + 1, 1))


def no_yaw(accel: np.ndarray) -> np.ndarray:
    return np.zeros(accel.shape[:-1])


@pytest.mark.parametrize("a", [5.0, 50.0, 200.0])
def test_thiv_of_pure_braking_is_that_of_a_fall_through_the_box(a: float) -> None:
    accel = constant(-a)
    flight = severity.head_flight(accel, no_yaw(accel), STEP)
    # The trapezoid is exact for the velocity, off by a step^2 / 12 for the way: far below 1e-3 of 0.6 m.
    assert np.hypot(*flight.velocity) == pytest.approx(np.sqrt(2 * a * 0.6), rel=1e-3)
    assert flight.time_s == pytest.approx(np.sqrt(2 * 0.6 / a), rel=1e-3)
    assert flight.velocity[0] > 0.0  # forward


def test_the_side_wall_is_nearer() -> None:
    accel = constant(0.0, 30.0)
    flight = severity.head_flight(accel, no_yaw(accel), STEP)
    assert flight.velocity[1] == pytest.approx(-np.sqrt(2 * 30.0 * 0.3), rel=1e-3)


def test_a_spinning_vehicle_that_is_not_pushed_still_meets_the_head() -> None:
    # The head stays where it was; a box that turns about it never touches it, as the head is the axis: with the head
    # 0.25 m ahead, the walls come round at omega r.
    accel, turn = constant(0.0), np.full(1001, np.pi)
    assert np.isnan(severity.head_flight(accel, turn, STEP).time_s)
    ahead = severity.head_flight(constant(0.0, seconds=2.0), np.full(2001, np.pi), STEP, ahead=0.31)
    # Aside by 0.31 sin(psi) = 0.3: psi = 75.4 deg; velocity omega times 0.31 m.
    assert ahead.time_s == pytest.approx(np.arcsin(0.3 / 0.31) / np.pi, abs=2e-3)
    assert np.hypot(*ahead.velocity) == pytest.approx(np.pi * 0.31, rel=1e-3)


def test_without_yaw_head_and_occupant_fly_alike() -> None:
    rng = np.random.default_rng(1)
    accel = -np.abs(rng.normal(40.0, 10.0, (1001, 3)))
    head, occupant = severity.head_flight(accel, no_yaw(accel), STEP), severity.occupant_flight(accel, STEP)
    np.testing.assert_allclose(head.velocity, occupant.velocity, rtol=1e-12)


def test_no_wall_is_no_number() -> None:
    accel = constant(-1.0, seconds=0.5)
    flight = severity.occupant_flight(accel, STEP)
    assert np.isnan(flight.time_s)
    assert np.isnan(severity.largest_after(accel, flight.time_s, STEP)).all()


@pytest.mark.parametrize("edition", ["1998", "2010"])
def test_asi_is_one_at_each_limit(edition: severity.Edition) -> None:
    for axis, limit in enumerate((12.0, 9.0, 10.0)):
        accel = np.zeros((1001, 3))
        accel[:, axis] = limit * G
        np.testing.assert_allclose(severity.asi(accel, STEP, edition), 1.0, rtol=1e-9)
    assert severity.asi(constant(12 * G, 9 * G, 10 * G), STEP, edition).max() == pytest.approx(np.sqrt(3.0))


def test_asi_of_1998_is_that_of_a_mean_over_50_ms() -> None:
    accel = np.zeros((1001, 3))
    accel[500:521, 0] = -24 * G  # 20 ms, by trapezoid 21 steps
    assert severity.asi(accel, STEP, "1998").max() == pytest.approx(24 * 21 / 50 / 12, rel=1e-9)


def test_asi_of_2010_falls_by_half_at_13_hz() -> None:
    # Two passes of -3 dB each.
    t_s = np.arange(4001) * STEP
    accel = np.stack([12 * G * np.sin(2 * np.pi * 13.0 * t_s), 0 * t_s, 0 * t_s], axis=1)
    assert severity.asi(accel, STEP, "2010")[1500:2500].max() == pytest.approx(0.5, rel=2e-3)


@pytest.mark.parametrize(
    ("push", "angle", "hour"),
    [((-1, 0), 0, 12), ((0, 1), 90, 3), ((1, 0), 180, 6), ((0, -1), -90, 9), ((-1, 1), 45, 1), ((-1, -0.5), -27, 11)],
)
def test_the_direction_of_force_is_clockwise_from_the_front(push: tuple[float, float], angle: int, hour: int) -> None:
    """Pushed to the left (y positive) it was struck from the right, at three o'clock; 45 deg lies between 1 and 2."""
    found = severity.pdof(np.array(push, dtype=float))
    assert np.degrees(found) == pytest.approx(angle, abs=0.6)
    assert severity.clock(float(found)) in (hour, hour + (angle == 45))


def test_many_pulses_at_once_are_each_as_alone() -> None:
    rng = np.random.default_rng(2)
    accel, turn = rng.normal(-30.0, 20.0, (4, 801, 3)), rng.normal(0.0, 1.0, (4, 801))
    together = severity.head_flight(accel, turn, STEP)
    for i in range(4):
        alone = severity.head_flight(accel[i], turn[i], STEP)
        np.testing.assert_allclose(together.velocity[i], alone.velocity, rtol=1e-12)
        all_asi, one_asi = (severity.asi(a, STEP, "2010") for a in (accel, accel[i]))
        np.testing.assert_allclose(all_asi[i], one_asi, rtol=1e-9)


def test_what_follows_a_time_between_samples_begins_there() -> None:
    falling = np.linspace(10.0, 0.0, 11)[:, None] * [1.0, -0.5]
    found = severity.largest_after(falling, np.array(0.0325), 0.01)
    np.testing.assert_allclose(found, [6.75, 3.375], rtol=1e-12)
    assert np.isnan(severity.largest_after(falling, np.array(0.11), 0.01)).all()
