"""The algebra on component-first arrays against NumPy's stacked products and scipy's Rotation."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from recon.numerics.smoothing import soa

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
# Some ten roundings of numbers of magnitude one to four, in ours and in the oracle.
ROUNDING = 40 * EPS
LENGTHS = [0.0, 1e-300, 1e-12, 1e-5, 0.3, 1.5, 3.0, np.pi - 1e-7]


def last(x: np.ndarray, axes: int) -> np.ndarray:
    """The leading axis moved behind so many component axes."""
    return np.moveaxis(x, 0, axes)


def unit_vectors(n: int, seed: int = 0) -> np.ndarray:
    x = np.random.default_rng(seed).normal(size=(3, n))
    return x / np.linalg.norm(x, axis=0)


def to_scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q[[1, 2, 3, 0]].T)


def sequential_product(q: np.ndarray) -> np.ndarray:
    product = q.copy()
    for k in range(1, q.shape[1]):
        product[:, k] = soa.quat_multiply(product[:, k - 1], q[:, k])
    return product


def test_products_of_matrices_are_those_of_numpy():
    a, b = np.random.default_rng(1).uniform(-1.0, 1.0, size=(2, 7, 3, 3))
    at, bt = a.swapaxes(1, 2), b.swapaxes(1, 2)
    assert_within(soa.mm(last(a, 2), last(b, 2)), last(a @ b, 2), atol=ROUNDING)
    assert_within(soa.mmt(last(a, 2), last(b, 2)), last(a @ bt, 2), atol=ROUNDING)
    assert_within(soa.mtm(last(a, 2), last(b, 2)), last(at @ b, 2), atol=ROUNDING)


def test_products_with_vectors_are_those_of_numpy():
    rng = np.random.default_rng(2)
    a, x = rng.uniform(-1.0, 1.0, size=(7, 3, 3)), rng.uniform(-1.0, 1.0, size=(7, 3))
    assert_within(soa.mv(last(a, 2), x.T), (a @ x[..., None])[..., 0].T, atol=ROUNDING)
    assert_within(soa.mtv(last(a, 2), x.T), (a.swapaxes(1, 2) @ x[..., None])[..., 0].T, atol=ROUNDING)


def test_one_matrix_turns_many_vectors():
    rng = np.random.default_rng(3)
    a, x = rng.uniform(-1.0, 1.0, size=(3, 3)), rng.uniform(-1.0, 1.0, size=(3, 5, 2))
    assert_within(soa.mv(a[:, :, None, None], x), np.tensordot(a, x, 1), atol=ROUNDING)


def test_vector_product_is_that_of_numpy_and_of_its_matrix():
    a, b = np.random.default_rng(4).uniform(-1.0, 1.0, size=(2, 3, 6))
    expected = np.cross(a, b, axis=0)
    assert_within(soa.cross(a, b), expected, atol=ROUNDING)
    assert_within(soa.mv(soa.skew(a), b), expected, atol=ROUNDING)
    assert_within(soa.cross(a[:, :1], b), np.cross(a[:, :1], b, axis=0), atol=ROUNDING)
    assert_within(soa.cross(a[:, 0], b[:, 0]), expected[:, 0], atol=ROUNDING)


@pytest.mark.parametrize("length", [*LENGTHS, 4.0, 20.0])
def test_exponentials_are_those_of_scipy(length):
    phi = length * unit_vectors(20)
    expected = Rotation.from_rotvec(phi.T)
    # The half angle is rounded before its sine is taken: half an ulp of the angle besides.
    tolerance = ROUNDING + length * EPS
    assert_within(soa.rotation_exp(phi), last(expected.as_matrix(), 2), atol=tolerance)
    assert_within(last((to_scipy(soa.quat_exp(phi)) * expected.inv()).as_rotvec(), 1), 0.0, atol=2 * tolerance)


@pytest.mark.parametrize("length", LENGTHS)
def test_logarithm_takes_the_exponential_back(length):
    phi = length * unit_vectors(20)
    assert_within(soa.rotation_log(soa.rotation_exp(phi)), phi, atol=ROUNDING)


def test_logarithm_of_a_half_turn_is_the_axis_times_pi_in_either_sense():
    axis = unit_vectors(20)
    phi = soa.rotation_log(2.0 * axis[:, None] * axis[None] - np.eye(3)[:, :, None])
    sense = np.sign(np.sum(phi * axis, axis=0))
    assert_within(phi * sense, np.pi * axis, atol=ROUNDING)


def test_quaternion_product_rotates_by_the_right_factor_first():
    p, q = soa.quat_exp(2.0 * unit_vectors(9, 5)), soa.quat_exp(1.0 * unit_vectors(9, 6))
    both = soa.mm(soa.quat_to_matrix(p), soa.quat_to_matrix(q))
    assert_within(soa.quat_to_matrix(soa.quat_multiply(p, q)), both, atol=ROUNDING)


@pytest.mark.parametrize("length", LENGTHS)
def test_matrix_to_quaternion_and_back(length):
    q = soa.quat_exp(length * unit_vectors(20))
    matrix = soa.quat_to_matrix(q)
    assert_within(matrix, last(to_scipy(q).as_matrix(), 2), atol=ROUNDING)
    assert_within(soa.matrix_to_quat(matrix), q, atol=ROUNDING)


@pytest.mark.parametrize("shape", [(1,), (2,), (3,), (7, 4), (200, 5), (211,), (12, 2, 3), (5, 40)])
def test_running_product_is_the_sequential_product(shape):
    q = soa.quat_exp(np.random.default_rng(7).normal(size=(3, *shape)))
    # Each of up to 211 products adds roundings of four terms.
    assert_within(soa.running_product(q), sequential_product(q), atol=shape[0] * ROUNDING)


def test_running_sum_begins_with_nothing():
    x = np.arange(12.0).reshape(2, 3, 2)
    assert_array_equal(soa.running_sum(x), np.concatenate([np.zeros((2, 1, 2)), np.cumsum(x, axis=1)], axis=1))


def test_arguments_are_left_alone():
    phi = unit_vectors(16).reshape(3, 8, 2)
    q = soa.quat_exp(phi)
    before = q.copy()
    soa.running_product(q)
    soa.running_sum(q)
    soa.quat_multiply(q, q)
    assert_array_equal(q, before)
    assert_array_equal(phi, unit_vectors(16).reshape(3, 8, 2))
