"""The band with its border against a dense matrix that is summed row by row."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import dense

from recon.numerics.smoothing.normal import ROWS_AT_ONCE, Normal
from recon.numerics.smoothing.state import COMMON_SIZE, KNOT_SIZE

# Sums of some thousand products of magnitude one.
ROUNDING = 1e-10


class Rows:
    """Rows of a dense least squares problem: Jacobian and residual, weight one."""

    def __init__(self, knots: int) -> None:
        self.columns = KNOT_SIZE * knots + COMMON_SIZE
        self.common = KNOT_SIZE * knots
        self.jacobian: list[np.ndarray] = []
        self.residual: list[float] = []

    def add(self, parts: list[tuple[int, np.ndarray]], residual: float) -> None:
        row = np.zeros(self.columns)
        for first, values in parts:
            row[first : first + len(values)] += values
        self.jacobian.append(row)
        self.residual.append(residual)

    def check(self, normal: Normal) -> None:
        jacobian, residual = np.array(self.jacobian), np.array(self.residual)
        matrix, right = dense(normal)
        assert_allclose(matrix, jacobian.T @ jacobian, atol=ROUNDING)
        assert_allclose(right, -jacobian.T @ residual, atol=ROUNDING)
        assert_allclose(normal.cost, residual @ residual, rtol=ROUNDING)
        assert_allclose(normal.corner, normal.corner.T, atol=ROUNDING)


@pytest.mark.parametrize("knots", [2, 7], ids=["one interval", "few"])
def test_factors_of_intervals_are_summed_where_both_knots_and_the_border_meet(knots):
    rng = np.random.default_rng(knots)
    here, there, common = slice(2, 7), slice(1, 5), slice(4, 10)
    tall = rng.normal(size=(knots - 1, 3, 5 + 4 + 6 + 1))
    normal, rows = Normal(knots), Rows(knots)
    normal.add_intervals(lambda part: tall[part], tall.shape[1], here, there, common)
    for k, block in enumerate(tall):
        for row in block:
            rows.add(
                [
                    (KNOT_SIZE * k + 2, row[:5]),
                    (KNOT_SIZE * (k + 1) + 1, row[5:9]),
                    (rows.common + 4, row[9:15]),
                ],
                -row[15],
            )
    rows.check(normal)


def test_intervals_of_several_chunks_are_those_of_their_parts():
    rng = np.random.default_rng(9)
    intervals = ROWS_AT_ONCE // 3  # of a chunk
    knots = intervals + 4
    tall = rng.normal(size=(knots - 1, 3, 5 + 4 + 6 + 1))
    whole, first, last = Normal(knots), Normal(intervals - 1), Normal(6)
    for normal, part in ((whole, tall), (first, tall[: intervals - 2]), (last, tall[intervals - 2 :])):
        normal.add_intervals(lambda k, part=part: part[k], 3, slice(2, 7), slice(1, 5), slice(4, 10))
    joint = intervals - 2  # the knot that both parts share
    assert_allclose(whole.blocks[:joint], first.blocks[:joint], atol=ROUNDING)
    assert_allclose(whole.blocks[joint + 1 :], last.blocks[1:], atol=ROUNDING)
    own = slice(0, KNOT_SIZE)
    assert_allclose(whole.blocks[joint, :, own], first.blocks[joint, :, own] + last.blocks[0, :, own], atol=ROUNDING)
    assert_allclose(whole.border[:, :joint], first.border[:, :joint], atol=ROUNDING)
    assert_allclose(whole.border[:, joint + 1 :], last.border[:, 1:], atol=ROUNDING)
    assert_allclose(whole.corner, first.corner + last.corner, atol=ROUNDING)


@pytest.mark.parametrize("chosen", [None, [1, 4, 5]])
def test_factors_of_single_knots_are_summed_at_the_knots_named(chosen):
    rng = np.random.default_rng(1)
    knots = 6
    at = range(knots) if chosen is None else chosen
    tall = rng.normal(size=(len(at), 2, 3 + 4 + 1))
    normal, rows = Normal(knots), Rows(knots)
    named = {} if chosen is None else {"knots": np.array(chosen)}
    normal.add_knots(slice(3, 6), slice(10, 14), tall, **named)
    for k, block in zip(at, tall, strict=True):
        for row in block:
            rows.add([(KNOT_SIZE * k + 3, row[:3]), (rows.common + 10, row[3:7])], -row[7])
    rows.check(normal)


def test_a_walk_holds_neighbours_together():
    rng = np.random.default_rng(2)
    knots = 5
    values, variance, kept = rng.normal(size=(3, knots)), rng.uniform(0.5, 2.0, (3, knots - 1)), rng.random(knots - 1)
    steps = values[:, 1:] - kept * values[:, :-1]
    normal, rows = Normal(knots), Rows(knots)
    normal.add_walk(slice(12, 15), steps, variance, kept)
    for k in range(knots - 1):
        for i in range(3):
            root = 1.0 / np.sqrt(variance[i, k])
            rows.add(
                [
                    (KNOT_SIZE * k + 12 + i, np.array([-kept[k] * root])),
                    (KNOT_SIZE * (k + 1) + 12 + i, np.array([root])),
                ],
                steps[i, k] * root,
            )
    rows.check(normal)


def test_values_of_knots_and_of_what_is_common_are_observed_directly():
    rng = np.random.default_rng(3)
    errors, weight = rng.normal(size=(2, 3)), rng.uniform(0.5, 2.0, (2, 3))
    shared, root = rng.normal(size=4), rng.normal(size=(4, 4))
    single = rng.normal(size=2)
    normal, rows = Normal(5), Rows(5)
    normal.add_values([1, 3], slice(6, 9), errors, weight)
    normal.add_common(slice(2, 6), shared, root.T @ root)
    normal.add_common(slice(7, 9), single, np.array([4.0, 9.0]))
    for knot, error, w in zip((1, 3), errors, weight, strict=True):
        for i in range(3):
            rows.add([(KNOT_SIZE * knot + 6 + i, np.sqrt(w[i : i + 1]))], error[i] * np.sqrt(w[i]))
    for row in root:
        rows.add([(rows.common + 2, row)], row @ shared)
    rows.add([(rows.common + 7, np.array([2.0]))], 2.0 * single[0])
    rows.add([(rows.common + 8, np.array([3.0]))], 3.0 * single[1])
    rows.check(normal)


def test_sums_can_be_weighted_added_and_forgotten():
    rng = np.random.default_rng(4)
    one, other = Normal(4), Normal(4)
    for normal in (one, other):
        tall = rng.normal(size=(4, 2, 3 + COMMON_SIZE + 1))
        normal.add_knots(slice(3, 6), slice(0, COMMON_SIZE), tall)
    (matrix, right), (matrix_other, right_other) = dense(one), dense(other)
    cost = one.cost + 0.25 * other.cost
    one.add(0.25, other)
    matrix_sum, right_sum = dense(one)
    assert_allclose(matrix_sum, matrix + 0.25 * matrix_other, atol=ROUNDING)
    assert_allclose(right_sum, right + 0.25 * right_other, atol=ROUNDING)
    assert_allclose(one.cost, cost, rtol=ROUNDING)
    one.clear()
    matrix, right = dense(one)
    assert not matrix.any()
    assert not right.any()
    assert one.cost == 0.0
    assert one.knots == 4
