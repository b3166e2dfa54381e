from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.saturation import clipped, hidden

T_S = np.arange(400) / 1000.0
PULSE = 250.0 * np.sin(np.pi * T_S / 0.4) ** 2


def seen(limit: float, sigma: float = 0.05) -> np.ndarray:
    return np.clip(PULSE + np.random.default_rng(0).normal(0.0, sigma, len(PULSE)), -limit, limit)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("limit", [80.0, 200.0, 240.0])
def test_a_clipped_plateau_is_found_to_its_last_sample(sign: float, limit: float) -> None:
    y = sign * seen(limit)
    np.testing.assert_array_equal(clipped(y[:, None])[:, 0], np.abs(y) >= limit)


@pytest.mark.parametrize("step", [0.01, 0.5, 5.0])
def test_the_top_of_a_quantised_pulse_is_not_clipped(step: float) -> None:
    y = np.round(PULSE / step) * step
    assert not clipped(y[:, None]).any()


def test_a_quantised_pulse_that_is_clipped_is_found() -> None:
    y = np.clip(np.round(PULSE / 0.5) * 0.5, -80.0, 80.0)
    assert clipped(y[:, None]).sum() == (y == 80.0).sum()


def test_a_given_range_is_believed() -> None:
    y = seen(80.0)
    np.testing.assert_array_equal(clipped(y[:, None], full_scale=80.0)[:, 0], y >= 79.92)


def test_what_was_cut_off_a_concave_top_lies_below_what_may_be_hidden() -> None:
    # From its half height on a haversine is concave.
    y = np.minimum(PULSE, 180.0)
    mask = y >= 180.0
    missing = hidden(T_S, y, mask)
    assert (missing[~mask] == 0.0).all()
    assert (missing[mask] >= (PULSE - y)[mask] - 1e-9).all()
    np.testing.assert_allclose(hidden(T_S, -y, mask), -missing)


def test_nothing_is_known_of_a_log_that_is_clipped_throughout() -> None:
    y = np.full(10, 80.0)
    assert (hidden(T_S[:10], y, y > 0.0) == 0.0).all()


@pytest.mark.parametrize("range_g", [8.0, 16.0])
def test_a_short_pulse_of_few_samples_is_clipped_where_a_range_usually_ends(range_g: float) -> None:
    limit = range_g * 9.80665
    y = np.random.default_rng(1).normal(0.0, 0.05, 50)
    y[20:25] = [40.0, 1.2 * limit, 1.5 * limit, 70.0, 10.0]
    cut = np.minimum(y, limit)
    np.testing.assert_array_equal(np.flatnonzero(clipped(cut[:, None])[:, 0]), [21, 22])
    assert not clipped(np.minimum(y, 1.03 * limit)[:, None]).any()
