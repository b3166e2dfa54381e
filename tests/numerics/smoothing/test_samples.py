"""The grid of samples: what the log says stays, and what was added is marked."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from recon.numerics.smoothing.samples import Samples, regular_samples

# Times of some hundred seconds, interpolated in a few operations.
ROUNDING = 1e-12


def at_rate(rate_hz: float, duration_s: float) -> np.ndarray:
    return np.arange(round(rate_hz * duration_s) + 1) / rate_hz


def sampled(t_s: np.ndarray, knot_s: float = 2.0) -> Samples:
    """Signals linear in time, so what is interpolated is known."""
    return regular_samples(t_s, *linear(t_s), knot_s=knot_s)


def linear(t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return t_s[:, None] * [1.0, -2.0, 3.0], 9.8 + t_s[:, None] * [0.1, 0.0, -0.2]


def assert_real_rows_are_those_of_the_log(samples: Samples, t_s: np.ndarray) -> None:
    real = samples.row >= 0
    gyro, accel = linear(t_s)
    assert_array_equal(samples.t_s[real], t_s[samples.row[real]])
    assert_array_equal(samples.gyro_s[real], gyro[samples.row[real]])
    assert_array_equal(samples.accel_s[real], accel[samples.row[real]])


@pytest.mark.parametrize(("rate_hz", "steps"), [(4, 10), (10, 20), (30, 60), (50, 100), (104, 200), (400, 800)])
def test_intervals_last_about_two_seconds_and_have_an_even_number_of_steps(rate_hz, steps):
    samples = sampled(at_rate(rate_hz, 20.0))
    assert samples.per_interval == steps
    assert samples.intervals * steps == len(samples.filled) == len(samples.t_s) - 1
    assert_array_equal(samples.knot_times, samples.t_s[::steps])


@pytest.mark.parametrize(("knot_s", "steps"), [(0.1, 50), (1.0, 100), (4.0, 400)])
def test_length_of_the_intervals_can_be_chosen(knot_s, steps):
    assert sampled(at_rate(100, 20.0), knot_s).per_interval == steps


def test_a_log_of_whole_intervals_stays_as_it_is():
    t_s = at_rate(100, 20.0)
    samples = sampled(t_s)
    assert_array_equal(samples.row, np.arange(len(t_s)))
    assert not samples.filled.any()
    assert_real_rows_are_those_of_the_log(samples, t_s)


def test_jitter_and_a_drifting_rate_keep_their_times():
    rng = np.random.default_rng(0)
    t_s = np.cumsum(rng.uniform(0.005, 0.015, 2001) * np.linspace(1.0, 1.5, 2001))
    samples = sampled(t_s - t_s[0])
    assert_array_equal(samples.row[:1801], np.arange(1801))
    assert not samples.filled.any()
    assert_real_rows_are_those_of_the_log(samples, t_s - t_s[0])


def test_a_gap_is_interpolated_at_the_nominal_rate():
    t_s = at_rate(100, 20.0)
    t_s = np.delete(t_s, np.arange(501, 600))
    samples = sampled(t_s)
    assert_array_equal(np.flatnonzero(samples.filled), np.arange(500, 600))
    assert_array_equal(np.flatnonzero(samples.row < 0), np.arange(501, 600))
    assert_allclose(samples.t_s, at_rate(100, 20.0), rtol=0.0, atol=ROUNDING)
    gyro, accel = linear(samples.t_s)
    assert_allclose(samples.gyro_s, gyro, rtol=0.0, atol=ROUNDING)
    assert_allclose(samples.accel_s, accel, rtol=0.0, atol=ROUNDING)
    assert_real_rows_are_those_of_the_log(samples, t_s)


def test_several_gaps_are_filled_each_at_its_place():
    t_s = np.delete(at_rate(100, 20.0), np.r_[101:150, 151:171, 900:1300])
    samples = sampled(t_s)
    assert_array_equal(np.flatnonzero(samples.row[:900] < 0), np.r_[101:150, 151:171])
    # The gap of 401 steps is bridged by one interval, 200.
    assert np.count_nonzero(samples.filled) == 50 + 21 + 200
    assert_real_rows_are_those_of_the_log(samples, t_s)
    assert_allclose(samples.gyro_s, linear(samples.t_s)[0], rtol=0.0, atol=ROUNDING)


def test_a_few_lost_samples_are_no_gap():
    samples = sampled(np.delete(at_rate(100, 20.0), np.arange(501, 509)))
    assert not samples.filled.any()


def test_a_slow_log_has_no_gap_at_every_step():
    assert not sampled(at_rate(5, 60.0)).filled.any()


def test_a_long_gap_is_bridged_at_rest_on_the_mean_force_of_its_ends():
    t_s = np.delete(at_rate(100, 60.0), np.arange(1001, 3000))
    samples = sampled(t_s)
    inside = samples.row < 0
    inside[4000:] = False
    assert_array_equal(samples.gyro_s[inside], 0.0)
    mean = (linear(t_s)[1][1000] + linear(t_s)[1][1001]) / 2.0
    assert_allclose(samples.accel_s[inside], np.tile(mean, (199, 1)), rtol=0.0, atol=ROUNDING)
    # 20 s in 200 steps.
    assert_allclose(np.diff(samples.t_s)[samples.filled], 0.1, rtol=0.0, atol=ROUNDING)


def test_the_last_interval_is_padded_with_steps_of_no_length():
    t_s = at_rate(100, 9.0)
    samples = sampled(t_s)
    assert samples.intervals == 5
    assert_array_equal(samples.row, np.r_[np.arange(901), np.full(100, -1)])
    assert_array_equal(samples.t_s[901:], 9.0)
    assert_array_equal(samples.gyro_s[901:], np.tile(linear(t_s)[0][-1], (100, 1)))
    assert not samples.filled.any()
    assert_real_rows_are_those_of_the_log(samples, t_s)


@pytest.mark.parametrize(("rest", "intervals"), [(0, 3), (1, 3), (19, 3), (20, 4), (199, 4)])
def test_a_rest_of_less_than_a_tenth_is_dropped(rest, intervals):
    samples = sampled(at_rate(100, 6.0 + rest / 100))
    assert samples.intervals == intervals
    assert np.count_nonzero(samples.row >= 0) == (601 if intervals == 3 else 601 + rest)


def test_knots_stand_at_cuts_and_nothing_is_lost():
    t_s = at_rate(400.0, 20.0)
    samples = regular_samples(t_s, *linear(t_s), cuts_s=(7.1, 7.25, 13.0))
    knots = samples.knot_times
    for cut in (7.1, 7.25, 13.0):
        assert np.abs(knots - cut).min() < ROUNDING
    assert np.diff(knots).min() == pytest.approx(0.15)
    assert_array_equal(samples.row[samples.row >= 0], np.arange(len(t_s)))
    assert_real_rows_are_those_of_the_log(samples, t_s)
    assert samples.intervals * samples.per_interval == len(samples.filled) == len(samples.t_s) - 1
    assert (np.diff(samples.t_s) >= 0.0).all()


def test_cuts_outside_and_next_to_each_other_are_none():
    t_s = at_rate(100.0, 20.0)
    plain = regular_samples(t_s, *linear(t_s))
    cut = regular_samples(t_s, *linear(t_s), cuts_s=(-3.0, 0.01, 25.0))
    assert_array_equal(cut.knot_times, plain.knot_times)
    near = regular_samples(t_s, *linear(t_s), cuts_s=(7.1, 7.12))
    assert np.diff(near.knot_times).min() > 0.5


def test_arguments_are_left_alone():
    t_s = np.delete(at_rate(100, 9.0), np.arange(300, 350))
    gyro, accel = linear(t_s)
    regular_samples(t_s, gyro, accel)
    assert_array_equal(t_s, np.delete(at_rate(100, 9.0), np.arange(300, 350)))
    assert_array_equal(gyro, linear(t_s)[0])
    assert_array_equal(accel, linear(t_s)[1])


@pytest.mark.parametrize("count", [0, 1, 2, 9, 201, 219])
def test_less_than_two_intervals_are_refused(count):
    with pytest.raises(ValueError, match="two intervals"):
        sampled(at_rate(100, 20.0)[:count])


@pytest.mark.parametrize("wrong", [0.5, 0.4])
def test_times_that_do_not_increase_are_refused(wrong):
    t_s = at_rate(100, 20.0)
    t_s[51] = wrong
    with pytest.raises(ValueError, match="strictly increase"):
        sampled(t_s)
