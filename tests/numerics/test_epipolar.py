"""Motion between two views against motions that are known, with and without noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from recon.numerics.epipolar import across, forward, parallax, two_views
from recon.numerics.rotation import conjugate, from_matrix, from_rotvec, multiply, to_matrix, to_rotvec

FOCAL = 260.0
PIXEL = 1.0 / FOCAL


def points(seed: int, count: int = 200) -> tuple[np.ndarray, ...]:
    """Rays in both views of points 4 to 40 m ahead, the rotation, the direction of a move by 0.6 m."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(4.0, 40.0, count)
    a = np.column_stack([rng.uniform(-0.6, 0.6, count), rng.uniform(-0.45, 0.45, count), np.ones(count)])
    rot_ab = to_matrix(from_rotvec(0.02 * rng.standard_normal(3)))
    direction = np.array([0.1, -0.05, 1.0]) + 0.1 * rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    b = (a * depth[:, None] - 0.6 * direction) @ rot_ab
    return a, b / b[:, 2:], rot_ab, direction


def noisy(rays: np.ndarray, pixels: float, rng: np.random.Generator) -> np.ndarray:
    off = np.zeros_like(rays)
    off[:, :2] = pixels * PIXEL * rng.standard_normal((len(rays), 2))
    return rays + off


def turned(rot_ab: np.ndarray, true_ab: np.ndarray) -> np.ndarray:
    """Error rad, about the axes of the second view."""
    return to_rotvec(multiply(conjugate(from_matrix(true_ab)), from_matrix(rot_ab)))


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_the_motion_comes_out_exactly(seed):
    a, b, rot_ab, direction = points(seed)
    off = to_matrix(from_rotvec(np.radians([0.5, -0.5, 0.5])))
    near = direction + 0.05 * across(direction)[:, 0]
    found = two_views(a, b, rot_ab @ off, near / np.linalg.norm(near), 1e-9)
    # Gauss-Newton ends after a step below 1e-6 rad, whose square is left; the prior of one radian moves nothing.
    assert_allclose(turned(found.rot_ab, rot_ab), 0.0, atol=1e-8)
    assert_allclose(found.direction_a, direction, atol=1e-8)
    assert_allclose(found.residual, 0.0, atol=1e-9)


def test_errors_are_as_large_as_the_sigmas_say():
    """A tenth of a pixel in both views, 100 times."""
    rotations, directions = [], []
    for seed in range(100):
        rng = np.random.default_rng((seed, 1))
        a, b, rot_ab, direction = points(seed)
        found = two_views(noisy(a, 0.1, rng), noisy(b, 0.1, rng), rot_ab, direction, 0.01 * PIXEL)
        error = turned(found.rot_ab, rot_ab)
        rotations.append(error @ np.linalg.solve(found.covariance[:3, :3], error) / 3.0)
        error = across(found.direction_a).T @ (direction - found.direction_a)
        directions.append(error @ np.linalg.solve(found.covariance[3:, 3:], error) / 2.0)
    # Means of 100 chi-squares of 3 and of 2 degrees, each by its degrees, have sigmas of 0.08 and 0.10: three of them,
    # and as much again upwards, for points near the direction of travel are not linear in it.
    assert 0.75 < np.mean(rotations) < 1.5
    assert 0.7 < np.mean(directions) < 1.6


@pytest.mark.parametrize("seed", range(5))
def test_pairs_that_are_wrong_hardly_matter(seed):
    """A tenth of them anywhere within some pixels: the rest, good to a tenth of a pixel, decides."""
    rng = np.random.default_rng((seed, 2))
    a, b, rot_ab, direction = points(seed)
    wild = rng.random(len(a)) < 0.1
    b = np.where(wild[:, None], noisy(b, 3.0, rng), noisy(b, 0.1, rng))
    found = two_views(a, b, rot_ab, direction, 0.01 * PIXEL)
    assert np.degrees(np.linalg.norm(turned(found.rot_ab, rot_ab))) < 0.05
    assert np.degrees(np.linalg.norm(found.direction_a - direction)) < 1.0


def test_a_direction_that_nothing_tells_has_a_large_sigma():
    """Points that are seen exactly where the rotation takes them."""
    a, _, rot_ab, direction = points(3)
    b = a @ rot_ab
    found = two_views(a, b / b[:, 2:], rot_ab, direction, 0.1 * PIXEL)
    assert_allclose(turned(found.rot_ab, rot_ab), 0.0, atol=1e-8)
    assert found.direction_std > 0.5
    assert_allclose(parallax(a, b / b[:, 2:], rot_ab), 0.0, atol=1e-12)


def test_sigmas_are_those_of_the_worst_axis():
    a, b, rot_ab, direction = points(1)
    found = two_views(a, noisy(b, 0.5, np.random.default_rng(0)), rot_ab, direction, 0.01 * PIXEL)
    assert found.rotation_std**2 >= np.diag(found.covariance)[:3].max()
    assert found.direction_std**2 >= np.diag(found.covariance)[3:].max()


def test_points_lie_ahead():
    a, b, rot_ab, direction = points(2)
    assert_allclose(forward(a, b, rot_ab, -direction), direction)
    assert_allclose(forward(a, b, rot_ab, direction), direction)


def test_parallax_is_the_way_across_by_the_depth():
    """A camera that moves 1 m to the right sees points 10 m ahead 0.1 further left."""
    a = np.array([[0.0, 0.0, 1.0], [0.2, 0.1, 1.0]])
    assert_allclose(parallax(a, a - [0.1, 0.0, 0.0], np.eye(3)), 0.1)
