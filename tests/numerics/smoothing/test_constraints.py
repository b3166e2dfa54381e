"""Walks, stops, roads and priors against rows written out and their differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from smoothing_drives import Linearised, Log, dense, derivatives, linearised

from recon.numerics.smoothing.constraints import (
    LEANING,
    Road,
    add_drift,
    add_road,
    add_standing,
    add_value,
    add_walks,
    leans,
    relative_turn,
    road,
)
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.soa import mtv
from recon.numerics.smoothing.state import COMMON_SIZE, DRIFT, GYRO_BIAS, KNOT_SIZE, ROLL, State

SIGMA, TILT, HEADING = 0.02, 1e-4, 3e-5
# Central differences of a step of 1e-5, relative to the size of a column.
DIFFERENCE = 1e-6


@pytest.fixture(scope="module")
def drive() -> Linearised:
    return linearised(Log(seconds=30.0, kind="nonstop", rest_s=3.0), off=0.01)


def check(normal: Normal, state: State, rows: Callable[[State], np.ndarray], allowed: float) -> None:
    """The normal equations are those of weighted rows, whose Jacobian is found by differences."""
    jacobian = derivatives(rows, state).reshape(-1, KNOT_SIZE * state.knots + COMMON_SIZE)
    residual = rows(state).ravel()
    size = np.sqrt((jacobian**2).sum(axis=0))
    size = np.maximum(size, 1e-4 * size.max())  # columns that are next to nothing are next to rounding
    matrix, right = dense(normal)
    assert_allclose((matrix - jacobian.T @ jacobian) / np.outer(size, size), 0.0, atol=allowed)
    assert_allclose((right + jacobian.T @ residual) / size, 0.0, atol=allowed * np.linalg.norm(residual))
    assert normal.cost == pytest.approx(residual @ residual, rel=1e-9)


def test_biases_walk_with_the_root_of_time(drive):
    length = drive.smoother.length
    normal = Normal(drive.state.knots)
    add_walks(normal, drive.state, length, 3e-3, 2e-2)

    def rows(state: State) -> np.ndarray:
        return np.stack([
            np.diff(state.gyro_bias) / (3e-3 * np.sqrt(length)), np.diff(state.accel_bias) / (2e-2 * np.sqrt(length))
        ])  # fmt: skip

    check(normal, drive.state, rows, DIFFERENCE)


def test_the_drift_of_gnss_is_a_stationary_gauss_markov_process(drive):
    sigma, tau, length = np.array([1.0, 1.5, 2.0]), 20.0, drive.smoother.length
    normal = Normal(drive.state.knots)
    add_drift(normal, drive.state.drift_n, length, sigma, tau)
    times = np.concatenate([[0.0], np.cumsum(length)])
    information = dense(normal)[0]
    for axis in range(3):
        own = np.arange(drive.state.knots) * KNOT_SIZE + DRIFT.start + axis
        covariance = sigma[axis] ** 2 * np.exp(-np.abs(times[:, None] - times) / tau)
        # The product of a matrix and its inverse, condition tau / T = 10, of 15 terms.
        assert_allclose(information[np.ix_(own, own)] @ covariance, np.eye(len(own)), atol=1e-12)
    first = drive.state.drift_n[:, 0] / sigma
    kept = np.exp(-length / tau)
    later = (drive.state.drift_n[:, 1:] - kept * drive.state.drift_n[:, :-1]) / (
        sigma[:, None] * np.sqrt(1.0 - kept**2)
    )
    assert normal.cost == pytest.approx(first @ first + (later**2).sum(), rel=1e-12)


def test_standing_holds_velocity_and_attitude(drive):
    state, length = drive.state, drive.smoother.length
    still = np.zeros(state.knots, bool)
    still[[0, 1, 2, 7]] = True
    between = still[:-1] & still[1:]
    normal = Normal(state.knots)
    add_standing(normal, state, still, between, length, SIGMA, HEADING, TILT, robust=False)

    def rows(x: State) -> np.ndarray:
        at, k = np.flatnonzero(still), np.flatnonzero(between)
        sigma = np.array([TILT, TILT, HEADING])[:, None] * np.sqrt(length[k])
        return np.concatenate([(x.vel_n[:, at] / SIGMA).ravel(), (relative_turn(x, k) / sigma).ravel()])

    # The derivative of a turn is taken as one, and its inverse Jacobian is 1 +- e / 2, e the turn from knot to knot.
    turn = float(np.abs(relative_turn(state, np.flatnonzero(between))).max())
    assert 0.0 < turn < 1e-3
    check(normal, state, rows, DIFFERENCE + 2.0 * turn)


def test_a_stop_that_was_none_loses_its_weight(drive):
    state, length = drive.state, drive.smoother.length
    last = np.zeros(state.knots, bool)
    last[[-2, -1]] = True
    hard, soft = Normal(state.knots), Normal(state.knots)
    for normal, robust in ((hard, False), (soft, True)):
        add_standing(normal, state, last, last[:-1] & last[1:], length, SIGMA, HEADING, TILT, robust)
    assert np.linalg.norm(state.vel_n[:, -1]) > 100.0 * SIGMA
    assert soft.cost < 1e-3 * hard.cost


def test_a_drive_without_stops_is_not_held(drive):
    none = np.zeros(drive.state.knots, bool)
    normal = Normal(drive.state.knots)
    add_standing(normal, drive.state, none, none[1:], drive.smoother.length, SIGMA, HEADING, TILT, robust=False)
    assert not normal.buffer.any()
    assert normal.cost == 0.0


def leaning(drive: Linearised, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Sine of the vehicle's roll against the plumb line, and lateral acceleration without slip, at the knots."""
    pull = drive.gravity.value_n
    up_v = drive_axes(state, -pull / np.sqrt((pull**2).sum(axis=0)))
    rate = np.einsum("ij,jn->in", state.rot_vs, drive.smoother.knot_rate - state.gyro_bias)
    return up_v[1], np.sqrt((state.vel_n**2).sum(axis=0)) * rate[2]


def drive_axes(state: State, vector_n: np.ndarray) -> np.ndarray:
    return np.einsum("ij,jn->in", state.rot_vs, mtv(state.rot_ns, vector_n))


@pytest.mark.parametrize("roll", [0.0, 0.004], ids=["stiff", "leaning"])
def test_roads_are_level_across_once_per_stretch(drive, roll):
    sigma, length = 0.03, drive.smoother.length
    state = drive.state.with_common(ROLL, roll)
    still = np.zeros(state.knots, bool)
    still[5] = True
    normal = Normal(state.knots)
    add_road(normal, state, road(state, drive.gravity, drive.smoother.knot_rate, still, length, (20.0, 10.0)), sigma)
    speed = np.sqrt((state.vel_n**2).sum(axis=0)) * ~still
    each = 0.5 * (np.append(length, 0.0) + np.append(0.0, length))
    lean, lateral = leaning(drive, state)
    squared = ((lean - roll * lateral) / sigma) ** 2
    weight = np.where(speed > 0.5, speed * each / (20.0 + 10.0 * speed), 0.0) / (1.0 + squared / 9.0) / sigma**2
    tied = state  # velocity and gyro bias, which only scale the lateral acceleration, are held

    def rows(x: State) -> np.ndarray:
        held = replace(x, vel_n=tied.vel_n, gyro_bias=tied.gyro_bias)
        now, _ = leaning(drive, held)
        return (now - x.common[ROLL] * lateral) * np.sqrt(weight)

    check(normal, state, rows, DIFFERENCE)


@pytest.mark.parametrize(("lean", "stretches", "found"), [
    (LEANING, 10.0, True), (LEANING, 0.1, False), (0.01, 10.0, False), (0.0, 10.0, False), (0.4 * LEANING, 10.0, False)
])  # fmt: skip
def test_what_leans_into_bends_is_seen_where_bends_are_enough(lean, stretches, found):
    lateral = np.linspace(-2.0, 2.0, 41)
    up = np.tile([0.0, 0.0, 1.0], (41, 1)).T
    leaning = np.stack([0.0 * lateral, lean * lateral, np.ones(41)])
    seen = Road(np.arange(41), np.full(41, stretches / 41.0), lateral, up, leaning, leaning[1])
    assert leans(seen, np.radians(1.5)) == found


def test_nothing_is_said_of_roads_at_rest(drive):
    normal = Normal(drive.state.knots)
    still = np.ones(drive.state.knots, bool)
    length, rate = drive.smoother.length, drive.smoother.knot_rate
    add_road(normal, drive.state, road(drive.state, drive.gravity, rate, still, length, (20.0, 10.0)), 0.03)
    assert normal.cost == 0.0
    assert not normal.buffer.any()


def test_a_prior_is_known_axis_by_axis_and_an_infinite_sigma_says_nothing(drive):
    normal = Normal(drive.state.knots)
    add_value(normal, 2, GYRO_BIAS, np.array([1.0, 2.0, 3.0]), np.array([0.5, 2.0, np.inf]))
    matrix, right = dense(normal)
    own = slice(2 * KNOT_SIZE + GYRO_BIAS.start, 2 * KNOT_SIZE + GYRO_BIAS.stop)
    assert_allclose(np.diag(matrix)[own], [4.0, 0.25, 0.0], rtol=1e-15)
    assert_allclose(right[own], [-4.0, -0.5, 0.0], rtol=1e-15)
    assert normal.cost == pytest.approx(5.0, rel=1e-15)
    assert np.count_nonzero(matrix) == 2
