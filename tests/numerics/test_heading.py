"""Heading from changes of velocity and from the field; hard iron from how the field turns with the box."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.heading import course_evidence, field_evidence, hard_iron, horizontal, smooth_angle
from recon.numerics.rotation import conjugate, from_euler, rotate

FIELD_N = np.array([1.3e-6, 22e-6, -42e-6])


def road(seconds: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times at 10 Hz and headings of a drive with bends."""
    t_s = np.arange(seconds * 10) / 10.0
    rng = np.random.default_rng(seed)
    bends = np.repeat(rng.normal(0.0, 0.15, seconds // 10 + 1), 100)[: len(t_s)]
    return t_s, np.cumsum(bends) / 10.0


def test_evidence_without_noise_gives_the_angle() -> None:
    drift = 0.3 + 0.002 * np.arange(600)
    angle, sigma = smooth_angle(4.0 * np.exp(1j * drift), 2e-4)
    np.testing.assert_allclose(angle, drift, atol=1e-6)
    assert (sigma < 0.1).all()


@pytest.mark.parametrize("rate", [-0.04, 0.0, 0.03])
def test_a_gyroscope_of_large_bias_does_not_lead_astray(rate: float) -> None:
    """At 2 deg/s the frame goes round in three minutes."""
    rng = np.random.default_rng(5)
    drift = 1.0 + rate * np.arange(900)
    weight = np.where(rng.random(900) < 0.3, 4.0, 0.0)
    evidence = weight * np.exp(1j * (drift + rng.normal(0.0, 0.5, 900)))
    angle, sigma = smooth_angle(evidence, 2e-4)
    error = np.angle(np.exp(1j * (angle - drift)))
    # a normalised error beyond 4.5 has a chance of 1e-5 for each of the some 20 independent stretches
    assert np.abs(error / sigma).max() < 4.5


def test_sigma_is_as_large_as_the_error() -> None:
    squares = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        drift = np.cumsum(np.cumsum(rng.normal(0.0, 2e-4, 600)))
        angle, sigma = smooth_angle(4.0 * np.exp(1j * (drift + rng.normal(0.0, 0.5, 600))), 2e-4)
        middle = slice(100, 500, 100)  # at the ends the angle is known less well than the formula says
        squares.append(np.mean(((angle - drift)[middle] / sigma[middle]) ** 2))
    # 40 seeds of 4 nearly independent errors: the mean of squares of 160 unit errors has sigma sqrt(2 / 160) = 0.11;
    # Huber's weights cost some 5 %, hence four sigma about 1.05
    assert 0.6 < np.mean(squares) < 1.5


def test_no_evidence_is_no_heading() -> None:
    angle, sigma = smooth_angle(np.zeros(50, dtype=complex), 2e-4)
    assert np.isinf(sigma).all()
    assert not angle.any()


def test_wrong_evidence_in_a_stretch_is_outvoted() -> None:
    evidence = np.full(600, 4.0 + 0.0j)
    evidence[200:215] *= np.exp(2.5j)
    angle, _ = smooth_angle(evidence, 2e-4)
    # 15 of some 100 seconds that count, each held to two sigma of 0.5 rad: 15 x 2 x 2 / (100 x 4) = 0.15 rad
    assert np.abs(angle).max() < 0.15


def test_changes_of_velocity_tell_the_angle_of_the_level_frame() -> None:
    t_s, course = road(300, 3)
    vel_n = 12.0 * np.exp(1j * course)
    turned = vel_n * np.exp(-0.8j)
    evidence = course_evidence(t_s, turned - turned[0], t_s[::10], vel_n[::10], 0.7, 300)
    angle, _ = smooth_angle(evidence, 2e-4)
    np.testing.assert_allclose(angle, 0.8, atol=1e-6)


def test_fixes_across_an_outage_say_nothing() -> None:
    t_s = np.arange(0.0, 20.0, 0.1)
    fix_s = np.array([0.0, 10.0, 19.0])
    assert not course_evidence(t_s, t_s * (1.0 + 0j), fix_s, fix_s * 1j, 0.7, 20).any()


def test_rejected_samples_of_the_field_are_no_evidence() -> None:
    t_s = np.arange(0.0, 10.0, 0.1)
    field = np.full(100, 1.0j)
    field[:50] = np.nan
    evidence = field_evidence(t_s, field, 1.0j, 0.15, 10)
    assert not evidence[:5].any()
    np.testing.assert_allclose(evidence[5:], 1.0 / 0.15**2)


@pytest.mark.parametrize("vertical", [None, -42e-6])
def test_hard_iron_is_found_from_a_drive_with_bends(vertical: float | None) -> None:
    true = np.array([15e-6, -22e-6, 9e-6])
    t_s, yaw = road(600, 8)
    rng = np.random.default_rng(1)
    q_ns = from_euler(yaw, 0.02 * np.sin(0.05 * t_s), 0.03 * np.sin(0.11 * t_s + 1.0))
    field_s = rotate(conjugate(q_ns), FIELD_N) + true + 3e-7 * rng.standard_normal((len(t_s), 3))
    q_ls = from_euler(yaw - 0.4 - 0.0005 * t_s, 0.02 * np.sin(0.05 * t_s), 0.03 * np.sin(0.11 * t_s + 1.0))
    found = hard_iron(q_ls, field_s, 10.0, vertical)
    error = found.offset_s - true
    sigma = np.sqrt(np.diag(found.covariance))
    axes = 3 if vertical is not None else 2  # a flat drive does not show the vertical part by itself
    assert (np.abs(error[:axes]) < 3.0 * sigma[:axes] + 3e-7).all()
    assert (sigma[:axes] < 2e-6).all()


def test_a_straight_road_leaves_the_hard_iron_unknown() -> None:
    field_s = np.tile(FIELD_N, (3000, 1)) + 1e-7 * np.random.default_rng(2).standard_normal((3000, 3))
    found = hard_iron(np.tile([1.0, 0.0, 0.0, 0.0], (3000, 1)), field_s, 10.0, -42e-6)
    sigma = np.sqrt(np.diag(found.covariance))
    assert (sigma[:2] > 20e-6).all()


def test_horizontal_is_east_and_north() -> None:
    assert horizontal(np.array([[1.0, 2.0, 3.0]]))[0] == 1.0 + 2.0j
