"""Turn rates from the steering wheel: the numbers of the single-track model, and how well they are known."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.steering import grips, single_track

RATIO_LENGTH, UNDERSTEER, OFFSET = 43.2, 0.028, np.radians(1.5)
BIAS = np.radians(0.3)
SIGMA = np.radians(0.2)


def drive(seed, seconds=900, bends=1.0):
    """Speeds, angles of the steering and turn rates of a gyroscope, means of a second."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(float(seconds))
    speed = 14.0 + 8.0 * np.sin(t_s / 40.0) + 2.0 * np.sin(t_s / 7.0)
    rate = bends * 0.12 * np.sin(t_s / 11.0) * np.sin(t_s / 61.0) * 14.0 / speed
    angle = OFFSET + rate * (RATIO_LENGTH + UNDERSTEER * speed**2) / speed + SIGMA * rng.standard_normal(len(t_s))
    return speed, angle, rate + BIAS, rate


def test_the_numbers_are_found_whatever_the_offset_of_the_gyroscope():
    found = [single_track(*drive(seed)[:3]) for seed in range(20)]
    assert all(found)
    error = np.array([model.ratio_length - RATIO_LENGTH for model in found])
    # Twenty independent errors in units of their sigma: the mean square scatters by sqrt(2 / 20) = 0.3 about one.
    assert 0.3 < np.mean((error / [model.ratio_length_sigma for model in found]) ** 2) < 2.5
    assert np.median([model.offset for model in found]) == pytest.approx(OFFSET, abs=np.radians(0.1))
    assert np.median([model.sigma for model in found]) == pytest.approx(SIGMA, rel=0.1)


def test_the_turn_rate_is_the_true_one_without_the_offset_of_the_gyroscope():
    speed, angle, felt, rate = drive(1)
    model = single_track(speed, angle, felt)
    turned, sigma = model.rate(speed, angle)
    assert abs(np.mean(turned - rate)) < 0.1 * BIAS
    # All values together say no more of a constant than the offset of the steering is known.
    weight = 1.0 / sigma**2
    gain = speed / (RATIO_LENGTH + UNDERSTEER * speed**2)
    assert 1.0 / np.sqrt(weight.sum()) >= 0.9 * gain.min() * model.offset_sigma


def test_tyres_that_slide_are_left_out():
    speed, angle, felt, _ = drive(2)
    slides = slice(100, 130)
    wild = felt.copy()
    wild[slides] = 1.5  # rad/s: 20 m/s^2 across
    assert not grips(speed, wild)[slides].any()
    assert single_track(speed, angle, wild).ratio_length == pytest.approx(RATIO_LENGTH, rel=0.02)


@pytest.mark.parametrize(("seconds", "bends"), [(40, 1.0), (900, 0.0), (900, 0.002)])
def test_nothing_is_made_of_a_drive_that_does_not_tell(seconds, bends):
    assert single_track(*drive(3, seconds, bends)[:3]) is None
