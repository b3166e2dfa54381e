"""Steps of the solver: where each component goes, and that nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics.smoothing.soa import mm, mmt, rotation_exp, rotation_log
from recon.numerics.smoothing.state import (
    ACCEL_BIAS,
    COMMON_SIZE,
    DRIFT,
    GYRO_BIAS,
    KNOT_SIZE,
    LAG,
    LARGEST_TURN,
    MOUNT,
    POSITION,
    ROTATION,
    VELOCITY,
    State,
)

KNOTS = 4
# Products of rotation matrices, whose elements are at most one.
ROUNDING = 1e-14


@pytest.fixture
def state() -> State:
    rng = np.random.default_rng(1)
    vel_n, pos_n, gyro, accel, drift_n = rng.normal(size=(5, 3, KNOTS))
    common = rng.normal(size=COMMON_SIZE)
    common[MOUNT] = 0.0
    rot_ns = rotation_exp(rng.normal(size=(3, KNOTS)))
    return State(rot_ns, vel_n, pos_n, gyro, accel, drift_n, rotation_exp(rng.normal(size=(3, 1)))[..., 0], common)


def step_of(columns: slice, values: np.ndarray) -> np.ndarray:
    step = np.zeros((KNOT_SIZE, KNOTS))
    step[columns] = values
    return step


def test_every_component_of_a_knot_has_its_own_columns():
    used = np.concatenate([np.r_[s] for s in (DRIFT, ROTATION, VELOCITY, POSITION, GYRO_BIAS, ACCEL_BIAS)])
    assert_array_equal(np.sort(used), np.arange(KNOT_SIZE))


@pytest.mark.parametrize(
    ("columns", "name"),
    [
        (DRIFT, "drift_n"),
        (VELOCITY, "vel_n"),
        (POSITION, "pos_n"),
        (GYRO_BIAS, "gyro_bias"),
        (ACCEL_BIAS, "accel_bias"),
    ],
)
def test_a_step_adds_to_its_component_and_to_no_other(state, columns, name):
    change = np.arange(3.0 * KNOTS).reshape(3, KNOTS)
    moved = state.moved(step_of(columns, change), np.zeros(COMMON_SIZE))
    for each in ("drift_n", "vel_n", "pos_n", "gyro_bias", "accel_bias", "rot_ns", "rot_vs", "common"):
        expected = getattr(state, each) + (change if each == name else 0.0)
        assert_allclose(getattr(moved, each), expected, atol=ROUNDING)


def test_a_rotation_turns_the_sensor_about_the_axes_n(state):
    turn = np.linspace(-0.3, 0.3, 3 * KNOTS).reshape(3, KNOTS)
    moved = state.moved(step_of(ROTATION, turn), np.zeros(COMMON_SIZE))
    assert_allclose(rotation_log(mmt(moved.rot_ns, state.rot_ns)), turn, atol=ROUNDING)


def test_a_step_of_the_mounting_turns_it_about_the_axes_of_the_vehicle_and_leaves_no_rest(state):
    step = np.zeros(COMMON_SIZE)
    step[MOUNT] = [0.1, -0.2, 0.3]
    moved = state.moved(np.zeros((KNOT_SIZE, KNOTS)), step)
    assert_allclose(
        moved.rot_vs, mm(rotation_exp(step[MOUNT][:, None]), state.rot_vs[..., None])[..., 0], atol=ROUNDING
    )
    assert_array_equal(moved.common, state.common)


@pytest.mark.parametrize("where", ["knot", "mounting"])
def test_a_step_that_turns_too_far_is_shortened_as_a_whole(state, where):
    rng = np.random.default_rng(2)
    step, common = rng.normal(size=(KNOT_SIZE, KNOTS)), rng.normal(size=COMMON_SIZE)
    step[ROTATION], common[MOUNT] = 0.0, 0.0
    if where == "knot":
        step[4, 2] = -4.0 * LARGEST_TURN
    else:
        common[1] = -4.0 * LARGEST_TURN
    moved, quarter = state.moved(step, common), state.moved(0.25 * step, 0.25 * common)
    for name in ("rot_ns", "vel_n", "pos_n", "gyro_bias", "accel_bias", "drift_n", "rot_vs", "common"):
        assert_allclose(getattr(moved, name), getattr(quarter, name), atol=ROUNDING)


def test_no_step_is_the_same_state(state):
    moved = state.moved(np.zeros((KNOT_SIZE, KNOTS)), np.zeros(COMMON_SIZE))
    assert_array_equal(moved.rot_ns, state.rot_ns)
    assert_array_equal(moved.common, state.common)


def test_the_state_before_and_the_step_stay_as_they_were(state):
    rng = np.random.default_rng(3)
    step, common = rng.normal(size=(KNOT_SIZE, KNOTS)), rng.normal(size=COMMON_SIZE)
    before = step.copy(), common.copy(), state.common.copy(), state.pos_n.copy()
    state.moved(step, common)
    state.with_common(LAG, 3.0)
    for array, old in zip((step, common, state.common, state.pos_n), before, strict=True):
        assert_array_equal(array, old)


def test_one_common_value_can_be_replaced(state):
    other = state.with_common(LAG, 3.0)
    assert other.common[LAG] == 3.0
    assert_array_equal(np.delete(other.common, LAG), np.delete(state.common, LAG))
    assert other.knots == KNOTS
