from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.channel_class import CLASSES, channel_class, coefficients

# SAE J211 at 10 kHz, as published by several implementations: a0, a1, b1, b2.
PUBLISHED = {
    60: (0.001452367, 0.002904735, 1.889343224, -0.895152694),
    180: (0.011796271, 0.023592542, 1.670117463, -0.717302548),
}


@pytest.mark.parametrize("cfc", PUBLISHED)
def test_coefficients_are_the_published_ones(cfc: int) -> None:
    a, b = coefficients(cfc, 10_000.0)
    # Published with nine digits.
    np.testing.assert_allclose((a[0], a[1], b[0], b[1]), PUBLISHED[cfc], rtol=0, atol=6e-10)
    assert a[2] == a[0]


@pytest.mark.parametrize("cfc", CLASSES)
def test_the_gain_is_one_at_rest_and_falls_by_3_db_at_five_thirds_of_the_class(cfc: int) -> None:
    rate = 200.0 * cfc
    t_s = np.arange(round(100 * rate / cfc)) / rate
    middle = slice(len(t_s) // 3, 2 * len(t_s) // 3)
    for f, wanted_db, within in ((0.05 * cfc, 0.0, 0.001), (cfc / 0.6, -3.01, 0.02), (2.0775 * cfc, -6.02, 0.02)):
        found = channel_class(np.sin(2 * np.pi * f * t_s), cfc, rate)[middle]
        # 1.667 for 5/3 and the warped frequency axis at 1/200 of the rate are worth 0.01 dB.
        assert 20 * np.log10(np.abs(found).max()) == pytest.approx(wanted_db, abs=within)


def test_nothing_is_delayed() -> None:
    pulse = np.zeros(2001)
    pulse[900:1101] = np.hanning(201)
    found = channel_class(pulse, 60, 10_000.0)
    assert found.argmax() == pulse.argmax()
    np.testing.assert_allclose(found, found[::-1], rtol=0, atol=1e-12)  # rounding of 2000 recursions


def test_a_constant_and_a_straight_line_pass_to_their_ends() -> None:
    t = np.arange(500.0)
    both = np.stack([np.full(500, 9.81), 3.0 - 0.02 * t], axis=1)
    # Point-mirrored ends continue a line; the filter then only delays it by what the way back takes off again.
    np.testing.assert_allclose(channel_class(both, 60, 1000.0)[:, 0], 9.81, rtol=1e-12)
    np.testing.assert_allclose(channel_class(both, 60, 1000.0)[:, 1], both[:, 1], rtol=0, atol=1e-4)


def test_sampling_slower_than_the_class_leaves_the_signal_as_it_is() -> None:
    y = np.random.default_rng(0).normal(size=(50, 3))
    np.testing.assert_array_equal(channel_class(y, 60, 200.0), y)
    with pytest.raises(ValueError, match="CFC 60 needs more than 249 samples per second, not 200"):
        coefficients(60, 200.0)


def test_short_signals_pass() -> None:
    for n in range(4):
        np.testing.assert_allclose(channel_class(np.ones(n), 60, 1000.0), np.ones(n), rtol=1e-12)
