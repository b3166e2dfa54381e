"""Geometric integrators against motions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.geometric import magnus_turns, verlet_position, verlet_velocity
from recon.numerics.rotation import angle, from_rotvec
from recon.numerics.rotation_series import compose
from recon.testing.motions import RollingCircle


def attitude_error(t_s: np.ndarray) -> float:
    truth = RollingCircle().at(t_s)
    found = compose(from_rotvec(magnus_turns(t_s, truth.gyro_v)), truth.q_nv[0])
    return float(np.max(angle(found, truth.q_nv)))


@pytest.mark.parametrize("uneven", [0.0, 0.3])
def test_the_attitude_is_of_fourth_order(uneven: float) -> None:
    def times(n: int) -> np.ndarray:
        x = np.linspace(0.0, 1.0, n + 1)
        return 10.0 * (x + uneven * np.sin(2.0 * np.pi * x) / (2.0 * np.pi))

    order = np.log2(attitude_error(times(500)) / attitude_error(times(1000)))
    # The next term is smaller by about h = 0.02 times rates of the sway of 2.6 rad/s.
    assert order == pytest.approx(4.0, abs=0.3)


def test_a_steady_turn_is_exact_whatever_the_step() -> None:
    t_s = np.array([0.0, 0.1, 3.0, 3.2, 9.0])
    turns = magnus_turns(t_s, np.tile([0.1, -0.2, 0.3], (5, 1)))
    assert turns == pytest.approx(np.diff(t_s)[:, None] * [0.1, -0.2, 0.3], abs=1e-14)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_a_few_samples_suffice(count: int) -> None:
    t_s = np.arange(float(count))
    assert magnus_turns(t_s, np.ones((count, 3))) == pytest.approx(np.ones((max(count - 1, 0), 3)), abs=1e-15)


def test_an_error_of_a_sample_beside_a_gap_is_not_blown_up() -> None:
    gyro = np.zeros((6, 3))
    gyro[2, 0] = 1.0
    turns = magnus_turns(np.array([0.0, 0.01, 0.02, 1.02, 1.03, 1.04]), gyro)
    assert turns[2, 0] == pytest.approx(0.5, abs=1e-12)  # the triangle of the straight line


def test_verlet_is_exact_for_constant_acceleration_at_irregular_times() -> None:
    t_s = np.array([0.0, 0.5, 0.7, 2.0])
    acc, held = np.tile([1.0, -2.0, 0.0], (4, 1)), np.zeros(3, dtype=bool)
    vel = verlet_velocity(t_s, acc, held)
    assert vel == pytest.approx(t_s[:, None] * acc, abs=1e-15)
    assert verlet_position(t_s, vel, acc, held) == pytest.approx(0.5 * t_s[:, None] ** 2 * acc, abs=1e-15)


def test_a_step_that_is_held_gets_no_kick() -> None:
    t_s, acc = np.arange(4.0), np.ones((4, 3))
    held = np.array([False, True, False])
    vel = verlet_velocity(t_s, acc, held)
    assert vel[:, 0].tolist() == [0.0, 1.0, 1.0, 2.0]
    assert verlet_position(t_s, vel, acc, held)[:, 0].tolist() == [0.0, 0.5, 1.5, 3.0]


def test_with_a_force_of_the_place_the_energy_of_a_spring_stays_for_40_000_steps() -> None:
    place, speed, step, free = 1.0, 0.0, 0.1, np.zeros(1, dtype=bool)
    energy = []
    for _ in range(40_000):
        # The force at the end of a step follows from the place, which needs only the force at its start.
        t_s, acc = np.array([0.0, step]), np.array([[-place], [0.0]])
        later = place + verlet_position(t_s, np.full((2, 1), speed), acc, free)[1, 0]
        speed += verlet_velocity(t_s, np.array([[-place], [-later]]), free)[1, 0]
        place = later
        energy.append(0.5 * (place**2 + speed**2))
    # It swings by (w h)^2 / 4 of itself about that of a nearby motion and does not drift.
    assert np.ptp(energy) < 2.0 * 0.5 * 0.1**2 / 4.0
    assert np.mean(energy[-1000:]) == pytest.approx(np.mean(energy[:1000]), abs=1e-4 * 0.5)
