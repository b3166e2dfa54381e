"""Rotations in time against SciPy's and pyquaternion's."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation, Slerp

from recon.numerics.rotation import angle, from_euler, from_rotvec, normalize, to_euler
from recon.numerics.rotation_series import compose, sign_continuous, slerp

EPS = np.finfo(float).eps
assert_within = partial(assert_allclose, rtol=0.0)
# Some ten roundings of numbers of magnitude one to four, in ours and in the oracle.
ROUNDING = 40 * EPS


def random_quaternions(n: int, seed: int = 0) -> np.ndarray:
    return normalize(np.random.default_rng(seed).normal(size=(n, 4)))


def test_sign_continuous_removes_jumps_and_changes_no_rotation():
    q = from_rotvec(np.linspace(0.0, 20.0, 300)[:, None] * [0.0, 0.6, 0.8])
    jumping = q * np.random.default_rng(0).choice([-1.0, 1.0], size=(300, 1))
    smooth = sign_continuous(jumping)
    assert_array_equal(smooth * np.sign(smooth[0] @ q[0]), q)
    assert sign_continuous(np.zeros((0, 4))).shape == (0, 4)


def test_slerp_is_that_of_scipy_and_exact_at_the_samples():
    q = random_quaternions(50)
    t = np.cumsum(np.random.default_rng(1).uniform(0.1, 1.0, 50))
    t_new = np.random.default_rng(2).uniform(t[0], t[-1], 400)
    expected = Slerp(t, Rotation.from_quat(q[:, [1, 2, 3, 0]]))(t_new).as_quat()[:, [3, 0, 1, 2]]
    # The fraction of an interval is known to eps * t / step, and the turn is at most pi.
    assert np.all(angle(slerp(t_new, t, q), expected) < ROUNDING + np.pi * EPS * t[-1] / 0.1)
    assert np.all(angle(slerp(t, t, q), q) < ROUNDING)


def test_slerp_does_not_jump_in_sign_where_the_samples_do():
    q = from_rotvec(np.arange(6)[:, None] * [0.0, 0.6, 0.8])
    t, signs = np.arange(6.0), np.array([[1.0], [-1.0], [-1.0], [1.0], [-1.0], [1.0]])
    t_new = np.linspace(0.0, 5.0, 200)
    expected = from_rotvec(t_new[:, None] * [0.0, 0.6, 0.8])
    assert_within(slerp(t_new, t, signs * q), expected, atol=ROUNDING)


def test_slerp_invents_nothing_outside_the_span():
    result = slerp(np.array([-1, 0, 10, 11]), np.array([0, 10]), random_quaternions(2))
    assert_array_equal(np.isnan(result).all(axis=1), [True, False, False, True])


def test_slerp_skips_what_is_not_known_and_invents_nothing_in_gaps():
    q = from_euler([0.0, 9.0, 0.2, 0.3, 1.3], 0.0, 0.0)
    q[1] = np.nan
    t = np.array([0, 1, 2, 3, 13])
    found = slerp(np.array([1, 2, 3, 8, 13]), t, q, 2)
    expected = np.array([0.1, 0.2, 0.3, np.nan, 1.3])
    assert_within(to_euler(found)[0], expected, atol=ROUNDING)
    assert_within(to_euler(slerp(np.array([8]), t, q))[0], [0.8], atol=ROUNDING)


def test_slerp_needs_a_sample():
    with pytest.raises(ValueError, match="no samples"):
        slerp(np.array([0.0]), np.zeros(0), np.zeros((0, 4)))


@pytest.mark.parametrize("n", [0, 1, 2, 3, 10, 997, 5000])
def test_composition_is_the_sequential_product(n):
    dq = from_rotvec(np.random.default_rng(n).normal(0.0, 0.3, (n, 3)))
    q0 = random_quaternions(1)[0]
    expected = [Quaternion(q0)]
    for increment in dq:
        expected.append(expected[-1] * Quaternion(increment))
    composed = compose(dq, q0)
    # Either road rounds four products and three sums of at most one per increment; at worst all errors add.
    assert_within(composed, [q.normalised.elements for q in expected], atol=2 * 7 * EPS * (n + 1))
    assert_within(np.linalg.norm(composed, axis=1), 1.0, atol=4 * EPS)


def test_composition_of_a_constant_rate_is_one_large_rotation():
    n, rate = 100_000, np.array([1e-3, -2e-3, 2e-3])
    composed = compose(np.tile(from_rotvec(rate), (n, 1)), [1.0, 0.0, 0.0, 0.0])
    k = np.arange(n + 1)
    expected = from_rotvec(k[:, None] * rate)
    # One increment is rounded by about eps and n of them repeat that error; k * rate is rounded in 300 rad.
    assert np.all(angle(composed, expected) < 4 * EPS * (k + 1) + 300 * EPS)


def test_composition_leaves_its_arguments_alone():
    dq, q0 = random_quaternions(20), random_quaternions(1)[0]
    before = dq.copy(), q0.copy()
    compose(dq, q0)
    assert_array_equal(dq, before[0])
    assert_array_equal(q0, before[1])
