"""Rotations against pyquaternion and scipy's Rotation, which share no code with ours."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

from recon.numerics import rotation

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
# Some ten roundings of numbers of magnitude one to four, in ours and in the oracle.
ROUNDING = 40 * EPS

components = st.floats(-1.0, 1.0, allow_subnormal=False)
vectors = st.tuples(components, components, components).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)
quaternions = (
    st.tuples(components, components, components, components)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(rotation.normalize)
)


def random_quaternions(n: int, seed: int = 0) -> np.ndarray:
    return rotation.normalize(np.random.default_rng(seed).normal(size=(n, 4)))


def to_scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q[..., [1, 2, 3, 0]])


@given(quaternions, quaternions)
def test_product_is_that_of_pyquaternion(p, q):
    assert_within(rotation.multiply(p, q), (Quaternion(p) * Quaternion(q)).elements, atol=ROUNDING)


@given(quaternions, vectors)
def test_rotated_vector_is_that_of_pyquaternion(q, v):
    assert_within(rotation.rotate(q, v), Quaternion(q).rotate(v), atol=ROUNDING)


@given(quaternions, quaternions, vectors)
def test_product_rotates_by_the_right_factor_first(p, q, v):
    both = rotation.rotate(rotation.multiply(p, q), v)
    assert_within(both, rotation.rotate(p, rotation.rotate(q, v)), atol=2 * ROUNDING)


@given(quaternions, vectors)
def test_conjugate_takes_the_vector_back(q, v):
    assert_within(rotation.rotate(rotation.conjugate(q), rotation.rotate(q, v)), v, atol=2 * ROUNDING)


def test_product_and_rotation_broadcast():
    q, v = random_quaternions(5), np.random.default_rng(1).normal(size=(7, 1, 3))
    turned = rotation.rotate(q, v)
    assert turned.shape == (7, 5, 3)
    assert_array_equal(turned[3, 2], rotation.rotate(q[2], v[3, 0]))
    assert_array_equal(rotation.multiply(q[0], q)[4], rotation.multiply(q[0], q[4]))


def test_normalize_gives_unit_length_and_keeps_the_direction():
    q = rotation.normalize([[3.0, 0.0, 4.0, 0.0], [0.0, -1e-30, 0.0, 0.0]])
    assert_allclose(q, [[0.6, 0.0, 0.8, 0.0], [0.0, -1.0, 0.0, 0.0]], rtol=2 * EPS)


@given(vectors, st.floats(0.0, 10.0))
def test_quaternion_of_a_rotation_vector_is_that_of_pyquaternion(axis, size):
    axis = axis / np.linalg.norm(axis)  # pyquaternion takes an axis whose square is within 1e-12 of 1 as it is
    rotvec = axis * size
    expected = Quaternion(axis=axis, radians=size).elements
    # The half angle, up to 5 rad, is rounded before its sine is taken.
    assert_within(rotation.from_rotvec(rotvec), expected, atol=ROUNDING)


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-160, 1e-12, 1e-3, 1.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rotation_vector_survives_the_round_trip_from_zero_to_a_half_turn(size, sign):
    rotvec = size * np.array([0.6, -0.64, 0.48])
    back = rotation.to_rotvec(sign * rotation.from_rotvec(rotvec))
    if size == np.pi:  # both directions of a half turn are right, and rounding chooses
        back *= np.sign(back @ rotvec)
    assert_allclose(back, rotvec, rtol=10 * EPS, atol=0.0 if size < 1e-3 else ROUNDING)


def test_rotation_vector_takes_the_shorter_way():
    back = rotation.to_rotvec(rotation.from_rotvec([0.0, 0.0, 1.5 * np.pi]))
    assert_within(back, [0.0, 0.0, -0.5 * np.pi], atol=ROUNDING)


@given(quaternions)
def test_matrix_is_that_of_scipy_and_leads_back(q):
    matrix = rotation.to_matrix(q)
    assert_within(matrix, to_scipy(q).as_matrix(), atol=ROUNDING)
    assert rotation.angle(rotation.from_matrix(matrix), q) < 2 * ROUNDING


@pytest.mark.parametrize("axis", np.vstack((np.eye(3), [[0.0, 0.6, 0.8], [-0.8, 0.0, 0.6], [0.6, -0.8, 0.0]])))
def test_matrix_of_a_half_turn_gives_its_axis(axis):
    q = rotation.from_matrix(2.0 * np.outer(axis, axis) - np.eye(3))
    assert_within(np.abs(q), [0.0, *np.abs(axis)], atol=ROUNDING)
    assert_within(rotation.rotate(q, axis), axis, atol=ROUNDING)


def test_from_matrix_takes_many_and_keeps_the_scalar_part_positive():
    q = random_quaternions(200)
    back = rotation.from_matrix(rotation.to_matrix(q.reshape(20, 10, 4)))
    assert back.shape == (20, 10, 4)
    assert np.all(back[..., 0] >= 0.0)
    assert np.all(rotation.angle(back.reshape(-1, 4), q) < 2 * ROUNDING)


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_are_the_intrinsic_zyx_of_scipy_and_lead_back(yaw, pitch, roll):
    q = rotation.from_euler(yaw, pitch, roll)
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert_within(rotation.to_matrix(q), expected.as_matrix(), atol=ROUNDING)
    # Yaw and roll are known to rounding / (cos p - sin p), and cos p - sin p = 0.035 at a pitch of 1.5.
    assert_within(rotation.to_euler(q), (yaw, pitch, roll), atol=ROUNDING / 0.035)


def test_positive_yaw_turns_left_pitch_puts_the_nose_down_and_roll_lifts_the_left_side():
    forward, left, right_angle = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.5 * np.pi
    assert_within(rotation.rotate(rotation.from_euler(right_angle, 0.0, 0.0), forward), left, atol=ROUNDING)
    assert_within(rotation.rotate(rotation.from_euler(0.0, right_angle, 0.0), forward), [0, 0, -1], atol=ROUNDING)
    assert_within(rotation.rotate(rotation.from_euler(0.0, 0.0, right_angle), left), [0, 0, 1], atol=ROUNDING)


@pytest.mark.parametrize("pitch", [0.5 * np.pi, -0.5 * np.pi])
@pytest.mark.parametrize(("yaw", "roll"), [(0.0, 0.0), (0.4, 0.0), (0.4, 0.7), (-2.9, 3.0)])
def test_vertical_nose_gives_no_roll_and_the_same_rotation(pitch, yaw, roll):
    q = rotation.from_euler(yaw, pitch, roll)
    angles = rotation.to_euler(q)
    assert_within(angles[1], pitch, atol=ROUNDING)
    assert angles[2] == 0.0
    assert rotation.angle(rotation.from_euler(*angles), q) < 2 * ROUNDING


def test_nearly_vertical_nose_keeps_all_digits_of_pitch():
    pitch = 0.5 * np.pi - 1e-6
    # An arcsin would lose half the digits: rounding / 1e-6 instead of rounding.
    assert_within(rotation.to_euler(rotation.from_euler(0.3, pitch, -0.2))[1], pitch, atol=ROUNDING)


@given(vectors, vectors)
def test_shortest_arc_takes_a_to_b_by_the_angle_between_them(a, b):
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    q = rotation.shortest_arc(3.0 * a, 0.5 * b)
    assert_within(rotation.rotate(q, a), b, atol=ROUNDING)
    between = 2.0 * np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b))
    assert_within(np.linalg.norm(rotation.to_rotvec(q)), between, atol=ROUNDING)


@pytest.mark.parametrize("apart", [0.0, 1e-16, 1e-15, 1e-12, 1e-9, 1e-8, 1e-6, 1e-3])
def test_shortest_arc_of_nearly_opposite_directions_arrives(apart):
    rng = np.random.default_rng(0)
    a = np.vstack((np.eye(3), -np.eye(3), rng.normal(size=(20_000, 3))))
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    b = -a + apart * rng.normal(size=a.shape)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    q = rotation.shortest_arc(a, b)
    assert_within(np.linalg.norm(q, axis=1), 1.0, atol=ROUNDING)
    # Ten roundings of numbers up to one: a half turn about an axis that is not across b to rounding would show.
    assert_within(rotation.rotate(q, a), b, atol=10 * EPS)
    # Below a sine of 16 EPS any half turn will do, and its angle is off by as much.
    between = 2.0 * np.arctan2(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    assert_within(np.linalg.norm(rotation.to_rotvec(q), axis=1), between, atol=ROUNDING)


def test_shortest_arc_of_equal_directions_is_the_identity():
    a = np.array([[0.3, -0.4, 9.7], [1e-9, 2.0, 3.0]])
    assert_array_equal(rotation.shortest_arc(a, a), [[1.0, 0.0, 0.0, 0.0]] * 2)


@given(quaternions, vectors, st.floats(0.0, np.pi))
def test_angle_between_is_that_of_the_rotation_that_separates_them(q, axis, size):
    turned = rotation.multiply(q, rotation.from_rotvec(axis / np.linalg.norm(axis) * size))
    assert_within(rotation.angle(q, turned), size, atol=ROUNDING)
    assert_within(rotation.angle(q, -turned), size, atol=ROUNDING)


def test_cross_matrix_multiplies_as_the_vector_product():
    v, w = np.random.default_rng(0).normal(size=(2, 5, 3))
    assert_within((rotation.cross_matrix(v) @ w[..., None])[..., 0], np.cross(v, w), atol=ROUNDING)
    assert_array_equal(rotation.cross_matrix(v[0]), rotation.cross_matrix(v)[0])


@pytest.mark.parametrize(("yaw", "heading"), [(0.0, 90.0), (90.0, 0.0), (180.0, 270.0), (-90.0, 180.0), (91.0, 359.0)])
def test_heading_is_clockwise_from_north(yaw, heading):
    assert_within(rotation.heading_from_yaw(np.radians(yaw)), np.radians(heading), atol=ROUNDING)


@given(st.floats(-3.14, np.pi))
def test_yaw_survives_the_round_trip_through_heading(yaw):
    heading = rotation.heading_from_yaw(yaw)
    assert 0.0 <= heading < 2.0 * np.pi
    assert_within(rotation.yaw_from_heading(heading), yaw, atol=ROUNDING)


def test_heading_never_rounds_up_to_a_full_turn():
    assert rotation.heading_from_yaw(np.nextafter(0.5 * np.pi, 4.0)) == 0.0
