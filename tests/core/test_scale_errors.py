"""recon.scale_errors: against sensors that are wrong by them, integrated step by step from one knot to the next."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from recon.knots import ATTITUDE, POSITION, SIZE, VELOCITY
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.rotation import Floats, conjugate, from_euler, from_rotvec, multiply, rotate, to_rotvec
from recon.scale_errors import COUNT, between_knots
from recon.schema import TRAJECTORY
from recon.tables import build, with_meta

START_NS = 1_714_550_400_000_000_000
LENGTH_S, STEP_S = 2.0, 1e-3
MOUNTING = from_euler(2.0, 0.4, -1.0)
"""Sensor to vehicle."""
UP = np.array([0.0, 0.0, STANDARD_GRAVITY])
T_S = np.arange(round(LENGTH_S / STEP_S) + 1) * STEP_S


def pulse(start_s: float, stop_s: float) -> Floats:
    """A half sine of height one: (n,)."""
    inside = np.clip((T_S - start_s) / (stop_s - start_s), 0.0, 1.0)
    return np.asarray(np.sin(np.pi * inside))


def wreck() -> tuple[Floats, Floats]:
    """Rate in the vehicle and acceleration, local, of one that is hit and spins for half a second: (n, 3) each."""
    rate = np.outer(pulse(0.2, 0.8), [0.3, -0.2, 2.5])
    return rate, np.outer(pulse(0.2, 0.5), [-30.0, 12.0, 2.0])


def strapdown(rate_s: Floats, force_s: Floats) -> tuple[Floats, Floats, Floats]:
    """Attitude of the sensor (n, 4), velocity and position (n, 3), from rest, by the middle of each step."""
    q = np.empty((len(T_S), 4))
    q[0] = MOUNTING
    for i, turn in enumerate(0.5 * (rate_s[1:] + rate_s[:-1]) * STEP_S):
        q[i + 1] = multiply(q[i], from_rotvec(turn))
    accel = rotate(q, force_s) - UP
    vel = np.vstack([np.zeros(3), np.cumsum(0.5 * (accel[1:] + accel[:-1]) * STEP_S, axis=0)])
    pos = np.vstack([np.zeros(3), np.cumsum(0.5 * (vel[1:] + vel[:-1]) * STEP_S, axis=0)])
    return q, vel, pos


def sensed(rate_v: Floats, accel_n: Floats) -> tuple[Floats, Floats]:
    """What a sensor without errors feels: rate and specific force along its axes."""
    rate_s = rotate(conjugate(MOUNTING), rate_v)
    q = strapdown(rate_s, np.zeros_like(rate_s))[0]
    return rate_s, rotate(conjugate(q), accel_n + UP)


def table(rate_s: Floats, force_s: Floats, *, every: int = 10) -> pa.Table:
    """The trajectory of an interval, a row each 10 ms."""
    q_ls, vel, pos = (part[::every] for part in strapdown(rate_s, force_s))
    q = multiply(q_ls, conjugate(MOUNTING))
    gyro, force = (rotate(MOUNTING, part[::every]) for part in (rate_s, force_s))
    time = START_NS + np.rint(T_S[::every] * 1e9).astype(np.int64)
    made = build(TRAJECTORY, time=time, pos=pos, vel=vel, q=q, gyro=gyro, accel=force - rotate(conjugate(q), UP))
    return with_meta(made, mounting=MOUNTING.tolist())


def bent(t_s: Floats, made: pa.Table) -> Floats:
    """What `between_knots` finds at some times of it."""
    at = START_NS + np.rint(t_s * 1e9).astype(np.int64)
    return between_knots(made, START_NS + np.array([0, round(LENGTH_S * 1e9)]), at)


def between_ends(error: Floats, u: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """Position and velocity (n, 3) less the cubic that meets both at the ends. error : position, slope : velocity"""
    u = u[:, None]
    cubic = (3.0 - 2.0 * u) * u**2 * error[-1] + (u - 1.0) * u**2 * LENGTH_S * slope[-1]
    its_slope = 6.0 * (u - u**2) / LENGTH_S * error[-1] + (3.0 * u - 2.0) * u * slope[-1]
    return error - cubic, slope - its_slope


@pytest.mark.parametrize("which", range(COUNT))
def test_it_is_what_wrong_sensors_make_of_a_wreck(which: int) -> None:
    rate_s, force_s = sensed(*wreck())
    size = 1e-5
    wrong = np.where(np.arange(COUNT) == which, 1.0 - size, 1.0)
    q, vel, pos = strapdown(rate_s, force_s)
    q_wrong, vel_wrong, pos_wrong = strapdown(rate_s * wrong[:3], force_s * wrong[3:])
    u, step = T_S / LENGTH_S, 37
    turn = to_rotvec(multiply(q_wrong, conjugate(q)))
    expected = np.zeros((len(T_S), SIZE))
    expected[:, ATTITUDE] = turn - u[:, None] * turn[-1]
    expected[:, POSITION], expected[:, VELOCITY] = between_ends(pos_wrong - pos, u, vel_wrong - vel)
    found = bent(T_S[::step], table(rate_s, force_s))[..., which]
    # Rows are ten steps apart: pulses of 0.3 s are (pi 10 ms / 0.3 s)^2 / 12 = 0.1 % smaller, and begin between rows.
    for rows in (POSITION, VELOCITY, ATTITUDE):
        limit = 0.005 * np.abs(expected[:, rows]).max() + 1e-9
        np.testing.assert_allclose(size * found[:, rows], expected[::step, rows], rtol=0.0, atol=limit)


def test_what_is_even_in_time_leaves_nothing() -> None:
    even = np.ones((len(T_S), 1))
    rate_s, force_s = sensed(even * [0.0, 0.0, 0.0], even * [1.5, -0.5, 0.2])
    np.testing.assert_allclose(bent(T_S[::100], table(rate_s, force_s)), 0.0, atol=1e-3 * 10.0 * STEP_S)


def test_a_trajectory_without_accelerations_or_mounting_tells_nothing() -> None:
    made = table(*sensed(*wreck()))
    assert not bent(T_S[::100], made.drop_columns([f"gyro_{axis}" for axis in "xyz"])).any()
    assert not bent(T_S[::100], with_meta(made, mounting=None)).any()


def test_a_thin_trajectory_whose_rows_are_none_at_the_knots_tells_it_as_well() -> None:
    made = table(*sensed(*wreck()))
    thin = made.take([0, *range(3, 201, 5), 200])
    np.testing.assert_allclose(bent(T_S[::50], thin), bent(T_S[::50], made), rtol=0.0, atol=0.1)
