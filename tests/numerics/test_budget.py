from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from recon.numerics.budget import Doubt, Pulse, axes_errors, fineness, propagate, refined, swing

STEP = 1e-3
NOTHING = Doubt(np.zeros(3), np.zeros((6, 6)), np.eye(3), 0.0, 0.0, np.zeros(3), 0.0, np.zeros(3))
ACCEL = np.zeros((301, 3))
ACCEL[100:200] = [-50.0, 20.0, 0.0]
NONE = np.zeros((0, 301, 3))
PULSE = Pulse(ACCEL, np.zeros((301, 3)), STEP, 50, NONE, NONE)


def scaled(sigma: float) -> np.ndarray:
    """Covariance of three independent scale errors."""
    return np.diag([sigma**2] * 3 + [0.0] * 3)


def gained(accel: np.ndarray, yaw: np.ndarray) -> Mapping[str, np.ndarray]:
    """Change of velocity along x and y: linear, so that its sigmas follow by hand."""
    sums = accel.sum(axis=1) * STEP
    return {"x": sums[:, 0], "y": sums[:, 1]}


@pytest.mark.parametrize(
    ("doubt", "source", "sigma_x"),
    [
        (replace(NOTHING, bias=np.array([0.1, 0.0, 0.0])), "bias", 0.1 * 0.301),
        (replace(NOTHING, axes=scaled(0.01)), "scale", 0.05),
        # A yaw by psi moves psi times the lateral change into the longitudinal one.
        (replace(NOTHING, axes=np.diag([0.0, 0.0, 0.0, 0.0, 0.0, 0.02**2])), "alignment", 0.02 * 2.0),
        (replace(NOTHING, noise=np.full(3, 2.0)), "noise", 2.0 * np.sqrt(301) * STEP),
    ],
)
def test_sigmas_of_linear_numbers_are_those_of_the_formula(doubt: Doubt, source: str, sigma_x: float) -> None:
    found = propagate(PULSE, doubt, gained)["x"]
    # 48 draws know a sigma to 10 %, of which three: noise only; all else is exact.
    assert found.sigma == pytest.approx(sigma_x, rel=0.3 if source == "noise" else 1e-9)
    assert found.shares[source] == pytest.approx(found.sigma)
    assert found.high - found.low == pytest.approx(2 * 1.96 * found.sigma, rel=1e-3)


def test_scale_errors_of_an_oblique_box_err_along_and_across() -> None:
    """At 45 deg two axes feel a push along x: half of the sum of their errors along, half of the difference across."""
    box = np.sqrt(0.5) * np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]])
    ahead = replace(PULSE, accel=ACCEL * [1.0, 0.0, 0.0])
    found = propagate(ahead, replace(NOTHING, axes=scaled(0.01), box=box), gained)
    assert found["x"].sigma == pytest.approx(0.01 * 5.0 * np.sqrt(0.5), rel=1e-9)
    assert found["y"].sigma == pytest.approx(0.01 * 5.0 * np.sqrt(0.5), rel=1e-9)


def test_what_a_drive_knows_of_scale_and_mounting_together_counts() -> None:
    """Where a push ahead showed no push aside, a difference of scale errors and a turn of the box undo each other."""
    box = np.sqrt(0.5) * np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2.0)]])
    ahead = replace(PULSE, accel=ACCEL * [1.0, 0.0, 0.0])
    moved = axes_errors(np.eye(6), box)
    aside = np.array([matrix[1, 0] for part in moved.values() for matrix in part])
    aside /= np.linalg.norm(aside)
    known = np.eye(6) - np.outer(aside, aside)
    found = propagate(ahead, replace(NOTHING, axes=1e-4 * known, box=box), gained)
    assert found["y"].sigma == pytest.approx(0.0, abs=1e-9)
    assert found["x"].sigma > 0.02


def test_the_errors_of_axes_have_the_covariance_that_they_are_made_of() -> None:
    rng = np.random.default_rng(5)
    root, box = rng.normal(0.0, 0.01, (6, 6)), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    drawn = rng.standard_normal((200_000, 6)) @ root.T
    force = np.array([-50.0, 20.0, 10.0])
    scale, turn = drawn[:, :3], drawn[:, 3:]
    off = (scale * (force @ box)) @ box.T - np.cross(turn, force)
    columns = np.concatenate(list(axes_errors(root @ root.T, box).values())) @ force
    # 200 000 draws know a variance to 0.3 % of it.
    np.testing.assert_allclose(columns.T @ columns, np.cov(off.T), rtol=0.03, atol=2e-3)


def test_splines_between_samples_find_means_and_peaks_that_ten_samples_lose() -> None:
    t_s = np.arange(21) * 0.01
    pulse = 2.0 * np.sin(np.pi * np.clip((t_s - 0.053) / 0.1, 0.0, 1.0)) ** 2
    fine = refined(pulse[None, :, None], fineness(0.01))[0, :, 0]
    assert len(fine) == 201
    np.testing.assert_allclose(fine[::10], pulse, rtol=0.0, atol=1e-15)
    # Of a haversine of ten samples a cubic spline misses (pi / 10)^4 / 384 of its peak, its ends some ten times that.
    assert fine.max() == pytest.approx(2.0, rel=2e-3)
    middle = fine[(np.arange(201) >= 78) & (np.arange(201) <= 128)]
    assert np.trapezoid(middle, dx=1e-3) / 0.05 == pytest.approx(1.0 + 2.0 / np.pi, rel=2e-3)


def test_time_zero_moves_what_counts_from_it_and_no_peak() -> None:
    t_s = np.arange(301) * STEP
    pulse = replace(PULSE, accel=np.exp(-0.5 * ((t_s[:, None] - 0.15) / 0.02) ** 2) * [-100.0, 0.0, 0.0])

    def read(accel: np.ndarray, yaw: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"peak": accel[..., 0].min(axis=1), "late": accel[:, 170, 0]}

    found = propagate(pulse, replace(NOTHING, time=0.5 * STEP), read)
    # The flank at one sigma of the curve has a slope of 0.6065 peaks a sigma; a peak half a step off loses 3e-4.
    assert found["late"].sigma == pytest.approx(0.5 * STEP * 0.6065 * 100.0 / 0.02, rel=1e-2)
    assert found["peak"].sigma < 1e-3


def test_the_squares_of_the_shares_sum_up() -> None:
    doubt = replace(NOTHING, bias=np.full(3, 0.1), axes=np.eye(6) * 0.01**2, noise=np.full(3, 1.0))
    found = propagate(PULSE, doubt, gained)["y"]
    assert found.sigma**2 == pytest.approx(sum(share**2 for share in found.shares.values()))


def test_a_maximum_of_noise_may_be_nothing() -> None:
    still = replace(PULSE, accel=np.random.default_rng(3).normal(0.0, 1.0, (301, 3)))
    found = propagate(still, replace(NOTHING, noise=np.ones(3)), lambda a, _: {"peak": np.abs(a[..., 0]).max(axis=1)})
    assert found["peak"].value > 2.5
    assert found["peak"].low < 0.5


def test_angles_are_compared_the_short_way_round() -> None:
    def behind(accel: np.ndarray, yaw: np.ndarray) -> Mapping[str, np.ndarray]:
        return {"angle": np.degrees(np.arctan2(accel[:, 150, 1], -np.abs(accel[:, 150, 0])))}

    straight = replace(PULSE, accel=ACCEL * [1.0, 0.0, 0.0])
    found = propagate(straight, replace(NOTHING, bias=np.array([0.0, 1.0, 0.0])), behind, angles=("angle",))["angle"]
    assert found.value == 180.0
    assert found.sigma == pytest.approx(np.degrees(np.arctan2(1.0, 50.0)), rel=1e-6)


def test_what_clipping_hid_widens_the_interval_on_its_side_alone() -> None:
    missing = np.zeros_like(ACCEL)
    missing[140:160, 0] = -30.0
    found = propagate(replace(PULSE, clipped=missing[None]), NOTHING, gained)["x"]
    assert (found.value, found.high) == (pytest.approx(-5.0), pytest.approx(-5.0))
    assert found.low == pytest.approx(-5.6)
    assert found.clipped


def test_what_was_restored_is_as_wrong_as_it_is_known_and_as_its_courses_allow() -> None:
    one_sigma, flat = np.zeros_like(ACCEL), np.zeros_like(ACCEL)
    one_sigma[140:160, 0] = 10.0
    flat[140:160, 0] = 5.0
    found = propagate(replace(PULSE, clipped=np.stack([flat, -flat]), restored=one_sigma[None]), NOTHING, gained)["x"]
    assert found.value == pytest.approx(-5.0)
    assert found.shares["restoring"] == pytest.approx(0.2)
    assert found.shares["clipping"] == pytest.approx(0.2 / np.sqrt(12.0))
    assert (found.low, found.high) == (
        pytest.approx(-5.1 - 1.96 * 0.2, abs=1e-3),
        pytest.approx(-4.9 + 1.96 * 0.2, abs=1e-3),
    )
    assert found.clipped


def test_swing_is_the_acceleration_of_a_point_of_a_turntable() -> None:
    gyro = np.zeros((101, 3))
    gyro[:, 2] = 2.0 + 3.0 * np.arange(101) * STEP
    found = swing(gyro, np.array([0.5, 0.0, 0.0]), STEP)
    np.testing.assert_allclose(found[:, 0], -(gyro[:, 2] ** 2) * 0.5, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], 3.0 * 0.5, rtol=1e-9)
