from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from recon.numerics.budget import Doubt, Pulse, propagate, swing

STEP = 1e-3
NOTHING = Doubt(np.zeros(3), 0.0, np.zeros(3), 0.0, 0.0, np.zeros(3), 0.0, np.zeros(3))
ACCEL = np.zeros((301, 3))
ACCEL[100:200] = [-50.0, 20.0, 0.0]
PULSE = Pulse(ACCEL, np.zeros((301, 3)), STEP, 50, np.zeros((301, 3)))


def gained(accel: np.ndarray, yaw: np.ndarray) -> Mapping[str, np.ndarray]:
    """Change of velocity along x and y: linear, so that its sigmas follow by hand."""
    sums = accel.sum(axis=1) * STEP
    return {"x": sums[:, 0], "y": sums[:, 1]}


@pytest.mark.parametrize(
    ("doubt", "source", "sigma_x"),
    [
        (replace(NOTHING, bias=np.array([0.1, 0.0, 0.0])), "bias", 0.1 * 0.301),
        (replace(NOTHING, scale=0.01), "scale", 0.05),
        # A yaw by psi moves psi times the lateral change into the longitudinal one.
        (replace(NOTHING, tilt=np.array([0.0, 0.0, 0.02])), "alignment", 0.02 * 2.0),
        (replace(NOTHING, noise=np.full(3, 2.0)), "noise", 2.0 * np.sqrt(301) * STEP),
    ],
)
def test_sigmas_of_linear_numbers_are_those_of_the_formula(doubt: Doubt, source: str, sigma_x: float) -> None:
    found = propagate(PULSE, doubt, gained)["x"]
    # 48 draws know a sigma to 10 %, of which three: noise only; all else is exact.
    assert found.sigma == pytest.approx(sigma_x, rel=0.3 if source == "noise" else 1e-9)
    assert found.shares[source] == pytest.approx(found.sigma)
    assert found.high - found.low == pytest.approx(2 * 1.96 * found.sigma, rel=1e-3)


def test_the_squares_of_the_shares_sum_up() -> None:
    doubt = replace(NOTHING, bias=np.full(3, 0.1), scale=0.01, tilt=np.full(3, 0.01), noise=np.full(3, 1.0))
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
    found = propagate(replace(PULSE, missing=missing), NOTHING, gained)["x"]
    assert (found.value, found.high) == (pytest.approx(-5.0), pytest.approx(-5.0))
    assert found.low == pytest.approx(-5.6)
    assert found.clipped


def test_swing_is_the_acceleration_of_a_point_of_a_turntable() -> None:
    gyro = np.zeros((101, 3))
    gyro[:, 2] = 2.0 + 3.0 * np.arange(101) * STEP
    found = swing(gyro, np.array([0.5, 0.0, 0.0]), STEP)
    np.testing.assert_allclose(found[:, 0], -(gyro[:, 2] ** 2) * 0.5, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], 3.0 * 0.5, rtol=1e-9)
