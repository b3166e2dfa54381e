from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from recon.numerics.smoothing.band import (
    Factor,
    Floats,
    Inverse,
    Solution,
    covariance_between,
    cross_covariances,
    factor,
    global_covariances,
    marginals,
    new_band,
    selected_inverse,
    solve_bordered,
)

KNOTS, SIZE = 7, 18

# The condition of the systems below is under 1e4 (tested), so rounding stays under 1e4 * 1e-16 * a sum of 131.
TOLERANCE = 1e-10


class System(NamedTuple):
    """A bordered system, the same dense, and its parts as the solver takes them."""

    dense: Floats
    right: Floats
    buffer: Floats
    border: Floats
    corner: Floats


def chain(globals_: int, knots: int = KNOTS, seed: int = 0) -> System:
    """Normal equations of random factors that each see two neighbouring knots and the globals."""
    rng = np.random.default_rng(seed)
    local, total = knots * SIZE, knots * SIZE + globals_
    dense = np.eye(total)
    for k in range(knots):
        seen = np.r_[k * SIZE : min(k + 2, knots) * SIZE, local:total]
        jacobian = rng.standard_normal((30, len(seen)))
        dense[np.ix_(seen, seen)] += jacobian.T @ jacobian
    right = rng.standard_normal(total)
    buffer, blocks = new_band(knots, SIZE)
    for k in range(knots):
        here, beyond = slice(k * SIZE, (k + 1) * SIZE), slice((k + 1) * SIZE, min(k + 2, knots) * SIZE)
        blocks[k, :, :SIZE] += dense[here, here]
        blocks[k, :, SIZE : SIZE + beyond.stop - beyond.start] += dense[here, beyond]
    border = np.column_stack((dense[:local, local:], right[:local]))
    corner = np.zeros((globals_ + 1, globals_ + 1))
    corner[:-1, :-1], corner[:-1, -1], corner[-1, :-1] = dense[local:, local:], right[local:], right[local:]
    return System(dense, right, buffer, border, corner)


def solved(system: System) -> tuple[Factor, Solution, Inverse]:
    made = factor(system.buffer, len(system.border) // SIZE, SIZE)
    solution = solve_bordered(made, system.border, system.corner)
    return made, solution, selected_inverse(made, solution)


GLOBALS = pytest.mark.parametrize("globals_", [0, 1, 5])


@GLOBALS
def test_the_solution_is_that_of_the_dense_system(globals_: int) -> None:
    system = chain(globals_)
    assert np.linalg.cond(system.dense) < 1e4
    _, solution, _ = solved(system)
    expected = np.linalg.solve(system.dense, system.right)
    assert solution.step == pytest.approx(expected[: KNOTS * SIZE].reshape(KNOTS, SIZE), abs=TOLERANCE)
    assert solution.step_global == pytest.approx(expected[KNOTS * SIZE :], abs=TOLERANCE)


@GLOBALS
def test_the_log_determinant_is_that_of_the_dense_system(globals_: int) -> None:
    system = chain(globals_)
    _, solution, _ = solved(system)
    assert solution.log_determinant == pytest.approx(np.linalg.slogdet(system.dense)[1], abs=TOLERANCE)


@GLOBALS
def test_the_covariances_are_blocks_of_the_dense_inverse(globals_: int) -> None:
    system = chain(globals_)
    _, solution, inverse = solved(system)
    dense = np.linalg.inv(system.dense)
    local = KNOTS * SIZE
    blocks = dense[:local, :local].reshape(KNOTS, SIZE, KNOTS, SIZE).swapaxes(1, 2)
    each = np.arange(KNOTS)
    assert marginals(inverse) == pytest.approx(blocks[each, each], abs=TOLERANCE)
    assert cross_covariances(inverse) == pytest.approx(blocks[each[:-1], each[1:]], abs=TOLERANCE)
    assert global_covariances(inverse) == pytest.approx(dense[:local, local:].reshape(KNOTS, SIZE, -1), abs=TOLERANCE)
    assert solution.covariance_global == pytest.approx(dense[local:, local:], abs=TOLERANCE)
    for i in range(KNOTS):
        for j in range(KNOTS):
            assert covariance_between(inverse, i, j) == pytest.approx(blocks[i, j], abs=TOLERANCE)


def test_one_knot_is_enough() -> None:
    system = chain(2, knots=1)
    _, solution, inverse = solved(system)
    expected = np.linalg.solve(system.dense, system.right)
    assert solution.step[0] == pytest.approx(expected[:SIZE], abs=TOLERANCE)
    assert marginals(inverse)[0] == pytest.approx(np.linalg.inv(system.dense)[:SIZE, :SIZE], abs=TOLERANCE)
    assert cross_covariances(inverse).shape == (0, SIZE, SIZE)


def test_the_blocks_of_the_factor_are_those_of_the_dense_factor() -> None:
    system = chain(0)
    made, _, _ = solved(system)
    lower = np.linalg.cholesky(system.dense)
    for k in range(KNOTS):
        here, beyond = slice(k * SIZE, (k + 1) * SIZE), slice((k + 1) * SIZE, (k + 2) * SIZE)
        assert made.blocks[k, :, :SIZE] == pytest.approx(lower[here, here].T, abs=TOLERANCE)
        assert made.blocks[k, :, SIZE:][:, : len(lower[beyond])] == pytest.approx(lower[beyond, here].T, abs=TOLERANCE)


def test_what_stands_below_the_diagonal_is_not_read() -> None:
    plain, marred = chain(5), chain(5)
    _, blocks = new_band(KNOTS, SIZE)
    below = np.ndarray(blocks.shape, np.float64, marred.buffer, 0, blocks.strides)[:, :, :SIZE]
    below += 7.0 * np.tril(np.ones((SIZE, SIZE)), -1)
    assert (solved(plain)[1].step == solved(marred)[1].step).all()


def test_the_border_is_solved_in_its_own_memory_and_the_corner_left_as_it_is() -> None:
    system = chain(5)
    border, corner = np.asfortranarray(system.border), system.corner.copy()
    found = solve_bordered(factor(system.buffer, KNOTS, SIZE), border, corner)
    assert np.shares_memory(found.reduced, border)
    assert (corner == system.corner).all()


def test_a_border_in_rows_is_left_as_it_is() -> None:
    system = chain(5)
    border = np.ascontiguousarray(system.border)
    solve_bordered(factor(system.buffer, KNOTS, SIZE), border, system.corner)
    assert (border == system.border).all()


@pytest.mark.parametrize("knot", [0, 3, 6])
@pytest.mark.parametrize("value", [-1e3, np.nan])
def test_a_chain_that_is_not_positive_definite_is_refused_at_its_place(knot: int, value: float) -> None:
    buffer = chain(5).buffer
    buffer[knot * SIZE * (2 * SIZE + 1) + 4 * 2 * SIZE + 4] += value  # element (4, 4) of the knot's block
    with pytest.raises(np.linalg.LinAlgError, match=f"not positive definite at unknown 4 of knot {knot}"):
        factor(buffer, KNOTS, SIZE)


def test_a_border_that_is_not_positive_definite_is_refused() -> None:
    system = chain(5)
    made = factor(system.buffer, KNOTS, SIZE)
    with pytest.raises(np.linalg.LinAlgError):
        solve_bordered(made, system.border, system.corner - 1e5 * np.eye(6))


def test_units_far_apart_cost_no_accuracy() -> None:
    # Scaling unknowns scales the factor row by row: rounding is relative to each unknown's own size.
    system, scaled = chain(5), chain(5)
    _, blocks = new_band(KNOTS, SIZE)
    scale = 10.0 ** np.linspace(-6, 6, SIZE)
    blocks = np.ndarray(blocks.shape, np.float64, scaled.buffer, 0, blocks.strides)
    blocks *= scale[:, None] * np.tile(scale, 2)
    border = scaled.border * np.tile(scale, KNOTS)[:, None]
    made = factor(scaled.buffer, KNOTS, SIZE)
    inverse = selected_inverse(made, solve_bordered(made, border, scaled.corner))
    rescaled = marginals(inverse) * np.outer(scale, scale)
    assert rescaled == pytest.approx(marginals(solved(system)[2]), abs=TOLERANCE)
