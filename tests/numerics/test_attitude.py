"""Levelling a sensor: blocks keep every turn, the filter finds up and the bias."""

from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.attitude import blocks_of, first_level, mahony
from recon.numerics.rotation import angle, conjugate, from_euler, from_rotvec, multiply, rotate
from recon.numerics.rotation_series import compose

RATE_HZ = 100.0
G = 9.81


def record(seconds: float, bias: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, ...]:
    """Times, turn rates (3, n), specific forces (3, n), attitudes (n, 4) of a box that is waved about."""
    t_s = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    rate = np.column_stack([np.sin(0.9 * t_s), 0.7 * np.cos(1.3 * t_s), 0.4 * np.sin(0.5 * t_s + 1.0)])
    middle = 0.5 * (rate[1:] + rate[:-1])
    q_ls = compose(from_rotvec(middle / RATE_HZ), from_euler(0.4, 0.2, -0.3))
    force = rotate(conjugate(q_ls), [0.0, 0.0, G])
    return t_s, (rate + bias).T, force.T, q_ls


def tilt(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Angle between the two verticals: (n,) rad."""
    ups = [rotate(conjugate(q), [0.0, 0.0, 1.0]) for q in (found, true)]
    return np.arccos(np.clip((ups[0] * ups[1]).sum(axis=1), -1.0, 1.0))


@pytest.mark.parametrize("rate_hz", [100.0, 10.0, 2.5, 0.3])
def test_blocks_lose_no_turn_whatever_their_size(rate_hz: float) -> None:
    t_s, gyro, accel, q_true = record(30.07)
    blocks, rows = blocks_of(t_s, gyro, accel, rate_hz)
    at_ends = q_true[np.searchsorted(t_s, blocks.t_s)]
    # between samples the record turns about the mean of two rates; h^2/12 w x w' of the blocks, some 1e-5 x 0.01 rad a
    # step, is all that differs, and it changes sign: 3000 steps of 1e-7 at most
    assert angle(rows.attitude(blocks, at_ends).T, q_true).max() < 3e-4


def test_a_long_record_loses_no_turn_where_its_lots_meet() -> None:
    t_s, gyro, accel, _ = record(700.03)
    blocks, rows = blocks_of(t_s, gyro, accel, 5.0)
    one_by_one, _ = blocks_of(t_s, gyro, accel, RATE_HZ)
    # the same turns in another order: rounding alone, 70 000 products of some 1e-16
    assert angle(rows.attitude(blocks, blocks.q_gs).T, one_by_one.q_gs).max() < 1e-10


def test_specific_force_of_a_box_that_is_waved_about_stands_still_in_the_drifting_frame() -> None:
    t_s, gyro, accel, q_true = record(20.0)
    blocks, _ = blocks_of(t_s, gyro, accel, 1.0)
    up = rotate(conjugate(q_true[0]), [0.0, 0.0, G])
    assert np.abs(blocks.force_g - up).max() < G * 3e-4


def test_blocks_that_are_merged_are_those_that_were_larger_from_the_start() -> None:
    t_s, gyro, accel, _ = record(12.3)
    small, large = blocks_of(t_s, gyro, accel, 10.0)[0].merged(4), blocks_of(t_s, gyro, accel, 2.5)[0]
    assert np.array_equal(small.t_s, large.t_s)
    # all blocks of 40 rows but the last hold four whole blocks
    np.testing.assert_allclose(small.force_g[:-1], large.force_g[:-1], atol=1e-12)


def test_one_row_is_a_block() -> None:
    blocks, _ = blocks_of(np.zeros(1), np.zeros((3, 1)), np.array([[0.0], [3.0], [9.0]]), 10.0)
    up = rotate(first_level(blocks), [0.0, 3.0, 9.0])
    np.testing.assert_allclose(up, [0.0, 0.0, np.sqrt(90.0)], atol=1e-12)


def test_mahony_levels_a_box_whose_gyroscope_is_biased_and_finds_the_bias() -> None:
    bias = (0.02, -0.015, 0.01)
    t_s, gyro, accel, q_true = record(200.0, bias)
    blocks, rows = blocks_of(t_s, gyro, accel, 10.0)
    q_ls, found = mahony(blocks, 0.3, 0.02)
    # after 200 s, ten time constants of the slower pole of s^2 + 0.3 s + 0.02, nothing of the start is left but
    # exp(-10) of it; the axis that is vertical changes, so that all three axes show their bias. The first order step of
    # 0.1 s errs by half of what the bias turns in it, 1.4 mrad, which k_p forgets, and lags as much
    assert tilt(rows.attitude(blocks, q_ls).T, q_true)[-2000:].max() < 0.003
    np.testing.assert_allclose(found[-1], bias, atol=5e-4)


def test_the_second_round_begins_with_what_the_first_has_learnt() -> None:
    t_s, gyro, accel, _ = record(120.0, (0.02, 0.0, 0.0))
    _, found = mahony(blocks_of(t_s, gyro, accel, 10.0)[0], 0.3, 0.02)
    assert abs(found[0, 0] - 0.02) < 0.004


def test_attitude_of_the_blocks_is_of_unit_length() -> None:
    t_s, gyro, accel, _ = record(50.0)
    blocks, rows = blocks_of(t_s, gyro, accel, 10.0)
    q = rows.attitude(blocks, mahony(blocks, 0.06, 0.0004)[0])
    np.testing.assert_allclose(np.linalg.norm(q, axis=0), 1.0, atol=1e-11)


def test_turns_of_the_blocks_add_up_to_the_attitude() -> None:
    t_s, gyro, accel, q_true = record(10.0)
    blocks, _ = blocks_of(t_s, gyro, accel, 10.0)
    q = compose(from_rotvec(blocks.turns), q_true[0])
    assert float(angle(q[-1], multiply(q_true[0], blocks.q_gs[-1]))) < 1e-12
