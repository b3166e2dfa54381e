"""Turns of a box among attitudes, when its gyroscope read them, and samples turned back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from recon.numerics.rotation import Floats, from_euler, from_rotvec, multiply, to_matrix
from recon.numerics.turned_box import Attitudes, Turn, attitudes, refined, sizes, turned_back, turns_of, when_read

T_S = np.arange(0.0, 200.0, 2.0)


def matrices(*degrees: tuple[float, float, float]) -> list[Floats]:
    """Of yaw, pitch and roll."""
    return [np.asarray(to_matrix(from_euler(*np.radians(angles)))) for angles in degrees]


def seen(steps: dict[float, Floats], noise: float = 0.3, sigma: float = 0.2, seed: int = 0) -> Attitudes:
    """Attitudes of a box whose axes are from each time on turned by a matrix against those of the beginning; deg."""
    true = np.repeat(np.eye(3)[None], len(T_S), axis=0)
    for since, first_from_new in steps.items():
        true[since <= T_S] = first_from_new
    jitter = from_rotvec(np.radians(noise) * np.random.default_rng(seed).normal(size=(len(T_S), 3)))
    return Attitudes(T_S, np.asarray(to_matrix(jitter)) @ true, np.full(len(T_S), np.radians(sigma)))


@given(
    st.tuples(st.floats(-175.0, 175.0), st.floats(-80.0, 80.0), st.floats(-175.0, 175.0)),
    st.integers(20, 80),
    st.integers(0, 1000),
)
def test_a_turn_is_found_where_it_is_and_as_large_as_it_is(angles, at, seed):
    (turned,) = matrices(angles)
    assume(np.degrees(sizes([Turn(0.0, 0.0, turned)])[0]) > 4.0)
    (turn,) = turns_of(seen({T_S[at]: turned}, seed=seed))
    assert (turn.start_s, turn.end_s) == (T_S[at - 1], T_S[at])
    # Means of twenty attitudes at least, 0.3 deg each on three axes: five sigmas.
    assert np.degrees(sizes([Turn(0.0, 0.0, turn.first_from_new @ turned.T)])[0]) < 5.0 * 0.3 * np.sqrt(3.0 / 20.0)


def test_several_turns_are_told_against_the_first_mounting():
    first, second = matrices((10.0, 0.0, 0.0), (0.0, 8.0, 0.0))
    turns = turns_of(seen({60.0: first, 130.0: first @ second}))
    assert [turn.end_s for turn in turns] == [60.0, 130.0]
    assert np.degrees(sizes(turns)) == pytest.approx([10.0, 8.0], abs=0.4)


@pytest.mark.parametrize(
    "case",
    [
        seen({}),
        seen({100.0: matrices((2.0, 0.0, 0.0))[0]}),  # a body leans as much by itself
        seen({100.0: matrices((6.0, 0.0, 0.0))[0]}, sigma=2.0),  # not known well enough
        seen({100.0: matrices((30.0, 0.0, 0.0))[0], 104.0: np.eye(3)}),  # a few attitudes that go astray
        Attitudes(T_S[:10], np.repeat(np.eye(3)[None], 10, axis=0), np.zeros(10)),
        Attitudes(T_S[:0], np.zeros((0, 3, 3)), np.zeros(0)),
    ],
    ids=["none", "small", "unsure", "outliers", "short", "empty"],
)
def test_what_is_no_turn_is_none(case):
    assert turns_of(case) == []


def test_a_heading_that_creeps_is_no_turn():
    """By 12 degrees in all, and nowhere by more than two."""
    axes = np.asarray(to_matrix(from_euler(np.radians(np.linspace(0.0, 12.0, len(T_S))), 0.0, 0.0)))
    assert turns_of(Attitudes(T_S, axes, np.full(len(T_S), 1e-3))) == []


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.6, 0.0, 0.8)])
def test_the_gyroscope_tells_when_also_beside_a_bend(axis):
    """The vehicle turns by 90 degrees in the same minute, the box by 15 in two seconds."""
    t_s = np.arange(0.0, 60.0, 0.01)
    rate = np.where((t_s > 10.0) & (t_s < 16.0), np.radians(15.0), 0.0)
    gyro = np.array([0.0, 0.0, 1.0]) * rate[:, None]
    gyro += np.array(axis) * np.where((t_s > 40.0) & (t_s < 42.0), np.radians(7.5), 0.0)[:, None]
    course, up_s = np.cumsum(rate) * 0.01, np.tile([0.0, 0.0, 1.0], (len(t_s), 1))
    turned = np.asarray(to_matrix(from_rotvec(np.radians(15.0) * np.array(axis))))
    (turn,) = when_read([Turn(5.5, 54.0, turned)], t_s, gyro, course, up_s)
    assert 39.0 < turn.start_s <= 40.1
    assert 41.9 <= turn.end_s < 43.0


def test_a_course_that_jumps_while_the_gyroscope_reads_nothing_is_no_turn():
    """By as much as the box were turned the other way: velocities in multipath."""
    t_s = np.arange(0.0, 60.0, 0.01)
    turns = [Turn(20.0, 30.0, matrices((15.0, 0.0, 0.0))[0]), Turn(40.0, 50.0, np.eye(3))]
    still, up_s = np.zeros((len(t_s), 3)), np.tile([0.0, 0.0, 1.0], (len(t_s), 1))
    course = np.where((t_s > 25.0) & (t_s < 45.0), np.radians(-15.0), 0.0)
    assert when_read(turns, t_s, still, course, up_s) == []


def test_in_a_silence_of_the_gyroscope_there_is_no_turn():
    t_s = np.concatenate([np.arange(0.0, 20.0, 0.01), np.arange(60.0, 80.0, 0.01)])
    still, up_s = np.zeros((len(t_s), 3)), np.tile([0.0, 0.0, 1.0], (len(t_s), 1))
    turns = [Turn(38.0, 40.0, matrices((15.0, 0.0, 0.0))[0])]
    assert when_read(turns, t_s, still, np.zeros(len(t_s)), up_s) == []
    assert when_read(turns, t_s[:500], still[:500], np.zeros(500), up_s[:500]) == []


def test_samples_turned_back_are_those_of_a_box_that_stayed():
    rng = np.random.default_rng(1)
    t_s, true, bias = np.arange(0.0, 10.0, 0.1), rng.normal(size=(100, 3)), np.array([0.3, -0.2, 0.1])
    first, second = matrices((40.0, 10.0, -5.0), (-100.0, 0.0, 70.0))
    logged = true + bias
    for since, first_from_new in ((3.0, first), (7.0, second)):
        logged[t_s >= since] = true[t_s >= since] @ first_from_new + bias
    turns = [Turn(2.9, 3.0, first), Turn(6.9, 7.0, second)]
    np.testing.assert_allclose(turned_back(turns, t_s, logged, bias), true + bias, atol=1e-12)


def test_what_is_left_of_a_turn_corrects_it_and_none_is_dropped():
    """Attitudes of a box that was turned back by 9 instead of 10 degrees, and by a turn that there was not."""
    whole, too_little, wrong = matrices((10.0, 0.0, 0.0), (9.0, 0.0, 0.0), (9.0, 5.0, 0.0))
    guessed = [Turn(58.0, 60.0, too_little), Turn(128.0, 130.0, wrong)]
    left = seen({60.0: whole @ too_little.T, 130.0: whole @ wrong.T}, noise=0.0)
    (turn,) = refined(guessed, left)
    np.testing.assert_allclose(turn.first_from_new, whole, atol=1e-9)


def test_only_straight_and_fast_parts_tell_attitudes():
    vel = np.tile([[20.0], [0.0], [0.0]], 30)
    vel[:, :10] *= 0.1
    rate = np.zeros((3, 30))
    rate[2, 20:] = 0.2
    mount = matrices((30.0, 2.0, 3.0))[0]
    rot_ns = np.repeat(mount[:, :, None], 30, axis=2)
    told = attitudes(np.arange(30.0), rot_ns, vel, np.einsum("ij,ik->jk", mount, rate), np.zeros(30))
    np.testing.assert_array_equal(told.t_s, np.arange(10.0, 20.0))
    np.testing.assert_allclose(told.axes, np.repeat(mount[None], 10, axis=0), atol=1e-12)


def test_a_box_that_is_put_down_turned_a_little_later_turns_twice():
    """Twelve seconds between the two are six attitudes."""
    turns = turns_of(seen({100.0: matrices((30.0, 0.0, 0.0))[0], 112.0: matrices((0.0, 20.0, 0.0))[0]}))
    assert [(turn.start_s, turn.end_s) for turn in turns] == [(98.0, 100.0), (110.0, 112.0)]


def test_a_hand_that_turns_a_box_to_and_fro_is_told_as_long_as_it_does():
    """By 40 degrees for two seconds and more than back for four: its axis is that of neither."""
    t_s = np.arange(0.0, 60.0, 0.01)
    gyro = np.outer(np.where((t_s > 20.0) & (t_s < 22.0), np.radians(-20.0), 0.0), (0.6, 0.0, 0.8))
    gyro += np.outer(np.where((t_s > 22.0) & (t_s < 26.0), np.radians(15.0), 0.0), (0.0, 0.6, 0.8))
    turned = np.asarray(
        to_matrix(
            multiply(
                from_rotvec(np.radians(-40.0) * np.array([0.6, 0.0, 0.8])),
                from_rotvec(np.radians(60.0) * np.array([0.0, 0.6, 0.8])),
            )
        )
    )
    up_s = np.tile([0.0, 0.0, 1.0], (len(t_s), 1))
    (turn,) = when_read([Turn(24.0, 26.0, turned)], t_s, gyro, np.zeros(len(t_s)), up_s)
    assert 18.0 < turn.start_s <= 20.3
    assert 25.7 <= turn.end_s < 28.0
