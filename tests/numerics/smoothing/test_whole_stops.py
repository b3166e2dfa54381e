from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.numerics.smoothing.whole_stops import Floats, Mask, unmoved, without_creep

BLOCK_S = 0.1
COUNT = 400
NOISE = 5e-3
"""m/s^2 of the mean of a block: 1.5 mm/s^2/sqrt(Hz)."""
FIX = 0.05
"""m/s, noise of the speed of a standing receiver."""


def span(start_s: float, stop_s: float) -> Mask:
    t_s = (np.arange(COUNT) + 0.5) * BLOCK_S
    return np.asarray((t_s > start_s) & (t_s < stop_s))


def force(speed: Floats, seed: int) -> Floats:
    """(3, B) of a vehicle that gains speed along x, and gravity of a leaning box."""
    rng = np.random.default_rng(seed)
    accel = np.array([[0.3], [-0.2], [9.8]]) + NOISE * rng.standard_normal((3, COUNT))
    accel[0] += np.gradient(speed, BLOCK_S)
    return np.asarray(accel)


def told_speed(speed: Floats, seed: int) -> Floats:
    """(B,) m/s between fixes of one second."""
    fixes = np.abs(speed[::10] + FIX * np.random.default_rng(seed + 1).standard_normal(COUNT // 10))
    return np.interp(np.arange(COUNT), np.arange(0, COUNT, 10), fixes)


@given(
    start_s=st.floats(8.0, 25.0),
    lasts_s=st.floats(1.0, 12.0),
    errs=st.floats(0.5, 3.0),
    seed=st.integers(0, 10_000),
    backwards=st.booleans(),
)
def test_a_standstill_lasts_although_the_receiver_errs(start_s, lasts_s, errs, seed, backwards):
    still, quiet = np.zeros(COUNT), np.ones(COUNT, dtype=bool)
    erring = span(start_s, start_s + lasts_s)
    speed = told_speed(still + errs * erring, seed)
    told = ~span(start_s - 1.0, start_s + lasts_s + 1.0)  # a fix that errs shows in the second around it
    accel = force(still, seed)
    if backwards:
        accel, told, speed = accel[:, ::-1], told[::-1], speed[::-1]
    # 5 mm/s^2 of 12 s of blocks, and of the mean of 4 s of those before, is .02 m/s; fixes of 8 s rise by .01 m/s^2 in
    # three sigmas, which are .12 m/s.
    assert unmoved(accel, BLOCK_S, told, quiet, speed).all()


@given(gain=st.floats(0.05, 1.0), highest=st.floats(0.5, 3.0), seed=st.integers(0, 10_000))
def test_what_is_pushed_moves_however_quiet(gain, highest, seed):
    t_s = (np.arange(COUNT) + 0.5) * BLOCK_S
    speed = np.clip(gain * (t_s - 20.0), 0.0, highest)
    told = speed < 0.1
    stands = unmoved(force(speed, seed), BLOCK_S, told, np.ones(COUNT, dtype=bool), told_speed(speed, seed))
    assert stands[t_s < 20.0].all()
    # Fixes tell .25 m/s where it has .1 m/s too much, or three times more than the force: both with what noise adds.
    assert not stands[speed > 0.3].any()


def test_what_is_not_quiet_or_far_from_fixes_is_left_as_told():
    told = span(0.0, 20.0)
    quiet, speed = np.ones(COUNT, dtype=bool), np.where(told, FIX, 1.0)
    accel = force(np.zeros(COUNT), 0)
    assert unmoved(accel, BLOCK_S, told, quiet, speed).all()
    assert (unmoved(accel, BLOCK_S, told, quiet & ~span(20.0, 20.5), speed) == told).all()
    assert (unmoved(accel, BLOCK_S, told, quiet, np.where(told, speed, np.nan)) == told).all()


def test_a_short_standstill_tells_too_little():
    told = span(10.0, 14.0)
    speed = np.where(told, FIX, 1.0)
    assert (unmoved(force(np.zeros(COUNT), 0), BLOCK_S, told, np.ones(COUNT, dtype=bool), speed) == told).all()


@pytest.mark.parametrize("speed", [0.15, 0.3])
def test_creeping_throughout_is_no_standstill(speed):
    assert not without_creep(np.ones(COUNT, dtype=bool), np.full(COUNT, speed), size=50, most=0.1).any()


def test_of_a_standstill_with_creep_there_remains_what_stands_for_seconds():
    speed = np.where(span(0.0, 20.0), 0.05, 0.3)
    stands = without_creep(np.ones(COUNT, dtype=bool), speed, size=50, most=0.11)
    # A window of five seconds is too fast with 1.3 s of it at .3 m/s, and what it holds is left.
    assert (stands == span(0.0, 16.3)).all()


def test_a_standstill_that_is_slow_on_average_is_left_alone():
    speed = np.where(span(5.0, 9.0), 0.3, 0.05)
    assert without_creep(np.ones(COUNT, dtype=bool), speed, size=50, most=0.1).all()
