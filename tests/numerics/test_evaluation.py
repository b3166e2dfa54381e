from __future__ import annotations

import numpy as np
import pytest

from recon.numerics.evaluation import (
    Motion,
    aligned,
    associate,
    errors,
    mounting_between,
    path,
    relative_errors,
    segments,
    statistics,
    turn_between,
)
from recon.numerics.geodesy import WGS84, Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.rotation import angle, from_euler, from_rotvec, multiply, rotate

EPS = np.finfo(np.float64).eps
EVO = 1e-9
"""Relative: both work in doubles, evo on matrices."""
START_NS = 1_700_000_000_000_000_000
UNKNOWN = np.nan
ROWS = 400


def motion(t_s: np.ndarray, pos_n: np.ndarray, q_nv: np.ndarray | None = None) -> Motion:
    """A motion without sigmas; its velocity has the numbers of its position."""
    rows = len(t_s)
    none = np.full((rows, 3), UNKNOWN)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (rows, 1)) if q_nv is None else q_nv
    return Motion(START_NS + np.round(t_s * 1e9).astype(np.int64), pos_n, pos_n, q, none, none, none)


def winding(seed: int = 5) -> Motion:
    """A winding way of 400 rows at 10 Hz, in all three axes, nowhere at rest."""
    rng = np.random.default_rng(seed)
    t_s = 0.1 * np.arange(ROWS)
    yaw = 0.8 * np.sin(0.2 * t_s)
    step = np.column_stack([np.cos(yaw), np.sin(yaw), 0.05 * np.cos(t_s)]) * rng.uniform(0.5, 1.5, (ROWS, 1))
    return motion(t_s, np.cumsum(step, axis=0), from_euler(yaw, 0.1 * np.sin(t_s), 0.05 * np.cos(0.5 * t_s)))


def disturbed(truth: Motion, seed: int = 6) -> Motion:
    """The truth with errors that wander, of metres and degrees."""
    rng = np.random.default_rng(seed)
    wander = np.cumsum(rng.standard_normal((ROWS, 3)), axis=0)
    turned = multiply(truth.q_nv, from_rotvec(0.01 * wander[:, ::-1]))
    return motion((truth.t_ns - START_NS) * 1e-9, truth.pos_n + 0.2 * wander, turned)


# --- agreement with evo ---------------------------------------------------------------------------------------------


def evo_error(relation: str, run: Motion, truth: Motion, **segment: object) -> np.ndarray:
    """Errors by evo: absolute, or relative where a segment is given."""
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed: pip install recon-dynamics[bench]")
    from evo.core.trajectory import PosePath3D

    pair = [PosePath3D(positions_xyz=one.pos_n, orientations_quat_wxyz=one.q_nv) for one in (truth, run)]
    wanted = metrics.PoseRelation[relation]
    made = metrics.RPE(wanted, all_pairs=True, pairs_from_reference=True, **segment) if segment else metrics.APE(wanted)
    made.process_data(tuple(pair))
    return np.asarray(made.error)


def test_absolute_errors_are_those_of_evo():
    truth = winding()
    run = disturbed(truth)
    found = errors(run, truth)
    translation = np.linalg.norm(found.pos_n, axis=1)
    np.testing.assert_allclose(translation, evo_error("translation_part", run, truth), rtol=EVO)
    np.testing.assert_allclose(np.degrees(found.angle), evo_error("rotation_angle_deg", run, truth), rtol=EVO)


def test_statistics_are_those_of_evo():
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed: pip install recon-dynamics[bench]")
    made = metrics.APE()
    made.error = evo_error("translation_part", disturbed(winding()), winding())
    found = statistics(np.asarray(made.error))
    for name in ("rmse", "mean", "median", "max"):
        expected = made.get_statistic(metrics.StatisticsType[name])
        assert getattr(found, name) == pytest.approx(expected, rel=EVO)


@pytest.mark.parametrize("rows", [1, 10, 73])
def test_relative_errors_over_rows_are_those_of_evo(rows):
    units = pytest.importorskip("evo.core.units", reason="evo is not installed: pip install recon-dynamics[bench]")
    truth = winding()
    run = disturbed(truth)
    start = np.arange(ROWS - rows)
    translation, rotation = relative_errors(run, truth, np.column_stack([start, start + rows]))
    segment = {"delta": rows, "delta_unit": units.Unit.frames}
    np.testing.assert_allclose(translation, evo_error("translation_part", run, truth, **segment), rtol=EVO)
    np.testing.assert_allclose(np.degrees(rotation), evo_error("rotation_angle_deg", run, truth, **segment), rtol=EVO)


@pytest.mark.parametrize("length", [5.0, 100.0])
def test_relative_errors_over_metres_are_those_of_evo(length):
    units = pytest.importorskip("evo.core.units", reason="evo is not installed: pip install recon-dynamics[bench]")
    truth = winding()
    run = disturbed(truth)
    translation, rotation = relative_errors(run, truth, segments(path(truth.pos_n), length))
    segment = {"delta": length, "delta_unit": units.Unit.meters}
    np.testing.assert_allclose(translation, evo_error("translation_part", run, truth, **segment), rtol=EVO)
    np.testing.assert_allclose(np.degrees(rotation), evo_error("rotation_angle_deg", run, truth, **segment), rtol=EVO)


@pytest.mark.parametrize("how", ["se3", "start"])
def test_alignment_is_that_of_evo(how):
    trajectory = pytest.importorskip(
        "evo.core.trajectory", reason="evo is not installed: pip install recon-dynamics[bench]"
    )
    truth = winding()
    run = disturbed(truth).moved(from_euler(0.4, -0.1, 0.2), np.array([30.0, -5.0, 2.0]))
    ours = aligned(run, truth, how)
    theirs, target = (
        trajectory.PosePath3D(positions_xyz=one.pos_n, orientations_quat_wxyz=one.q_nv) for one in (run, truth)
    )
    _ = theirs.align(target) if how == "se3" else theirs.align_origin(target)
    # 400 m and rotations by matrices on one side: some tens of roundings of 1e-14 m
    np.testing.assert_allclose(ours.pos_n, theirs.positions_xyz, rtol=0.0, atol=1e-11)
    assert angle(ours.q_nv, theirs.orientations_quat_wxyz).max() < 1e-12


# --- association ----------------------------------------------------------------------------------------------------


def straight(t_s: np.ndarray, speed: float = 10.0) -> Motion:
    zero = np.zeros_like(t_s)
    return motion(t_s, np.column_stack([speed * t_s, zero, zero]))


def test_the_finer_one_is_interpolated_at_the_times_of_the_coarser():
    fine, coarse = straight(0.01 * np.arange(1000)), straight(0.005 + 1.0 * np.arange(9))
    for run, reference in ((fine, coarse), (coarse, fine)):
        found = associate(run, reference)
        assert [one.t_ns.tolist() for one in found] == [coarse.t_ns.tolist()] * 2
        # 100 m, products and sums of a line between two rows
        np.testing.assert_allclose(found[0].pos_n, found[1].pos_n, rtol=0.0, atol=8 * 100.0 * EPS)


def test_nothing_is_extrapolated():
    run, reference = straight(0.1 * np.arange(100)), straight(5.05 + 0.1 * np.arange(100))
    found, truth = associate(run, reference)
    assert found.t_ns[0] >= reference.t_ns[0]
    assert found.t_ns[-1] == run.t_ns[-1]
    assert len(found) == len(truth) == 49  # of 0 to 9.9 s those from 5.1 s on


def test_nothing_is_interpolated_across_a_gap_but_across_one_lost_row():
    t_s = np.delete(0.1 * np.arange(100), [20, *range(50, 60)])
    found = straight(t_s).at(straight(0.1 * np.arange(100)).t_ns)
    missing = np.flatnonzero(np.isnan(found.pos_n[:, 0]))
    assert missing.tolist() == list(range(50, 60))
    assert np.isnan(found.q_nv[50:60]).all()
    assert np.isfinite(found.q_nv[[20, 49, 60]]).all()


def test_two_motions_without_common_time_have_no_row():
    assert len(associate(straight(np.arange(5.0)), straight(10.0 + np.arange(5.0)))[0]) == 0
    assert len(associate(straight(np.arange(0.0)), straight(np.arange(5.0)))[0]) == 0


def test_what_one_does_not_know_has_no_error():
    truth = winding()
    flat = Motion(**{**vars(truth), "q_nv": np.full((ROWS, 4), UNKNOWN), "vel_n": np.full((ROWS, 3), UNKNOWN)})
    found = errors(*associate(truth, flat))
    assert np.isnan(found.att).all()
    assert np.isnan(found.angle).all()
    assert np.isnan(found.vel_n).all()
    assert (found.pos_n == 0.0).all()


# --- alignment ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("how", "turn"), [("yaw", (2.5, 0.0, 0.0)), ("se3", (2.5, -0.2, 0.3)), ("start", (2.5, 0.1, 3))]
)
def test_a_motion_that_was_only_moved_is_moved_back(how, turn):
    truth = winding()
    found = errors(aligned(truth.moved(from_euler(*turn), np.array([50.0, -20.0, 3.0])), truth, how), truth)
    # positions up to 500 m: rounding 1e-13 m, some tens of operations
    assert np.abs(found.pos_n).max() < 1e-11
    assert np.abs(found.vel_n).max() < 1e-11
    assert found.angle.max() < 1e-13


def test_yaw_alone_does_not_level_a_tilted_motion():
    truth = winding()
    found = errors(aligned(truth.moved(from_euler(0.3, 0.0, 0.1), np.zeros(3)), truth, "yaw"), truth)
    # the tilt stays; its axis may turn a little, which the cosine of 0.1 rad bounds
    np.testing.assert_allclose(found.angle, 0.1, rtol=0.01)


def test_no_alignment_changes_nothing():
    truth = winding()
    assert aligned(truth, truth, "none") is truth


@pytest.mark.parametrize(
    ("how", "run", "message"),
    [
        ("se3", straight(np.arange(20.0)), "lie on a line"),
        ("yaw", straight(np.arange(20.0), speed=0.0), "the vehicle stands"),
        ("start", motion(np.arange(2.0), np.zeros((2, 3)), np.full((2, 4), UNKNOWN)), "whole pose"),
        ("yaw", motion(np.arange(2.0), np.full((2, 3), UNKNOWN)), "all three axes"),
    ],
)
def test_positions_that_say_no_turn_are_refused(how, run, message):
    with pytest.raises(ValueError, match=message):
        aligned(run, run, how)


# --- segments and relative errors -----------------------------------------------------------------------------------


def test_a_segment_ends_at_the_row_closest_to_its_length():
    assert segments(np.array([0.0, 0.4, 1.04, 1.45, 2.0]), 1.0).tolist() == [[0, 2], [1, 3], [2, 4]]


def test_a_segment_longer_or_shorter_by_more_than_a_tenth_is_none():
    assert segments(np.array([0.0, 0.8, 1.2]), 1.0).tolist() == []
    assert segments(np.array([3.0]), 1.0).shape == (0, 2)
    assert segments(np.empty(0), 1.0).shape == (0, 2)


def test_a_segment_ends_at_the_first_of_the_rows_of_a_standstill():
    assert segments(np.array([0.0, 1.0, 1.0, 1.0]), 1.0).tolist() == [[0, 1]]


def test_a_relative_error_does_not_see_an_error_from_before():
    truth = winding()
    moved = truth.moved(from_euler(0.7, 0.1, 0.2), np.array([9.0, 9.0, 9.0]))
    translation, rotation = relative_errors(moved, truth, segments(path(truth.pos_n), 100.0))
    assert len(translation) > 100
    assert translation.max() < 1e-11  # as for alignment
    assert rotation.max() < 1e-13


def test_a_scale_error_is_its_share_of_the_way():
    truth = straight(0.1 * np.arange(ROWS))
    run = straight(0.1 * np.arange(ROWS), speed=10.1)
    way = path(truth.pos_n)
    pairs = segments(way, 100.0)
    translation, _ = relative_errors(run, truth, pairs)
    driven = way[pairs[:, 1]] - way[pairs[:, 0]]
    np.testing.assert_allclose(translation, 0.01 * driven, rtol=1e-11)  # 400 m less 400 m leaves 1 m: 3 digits fewer


# --- places ---------------------------------------------------------------------------------------------------------


def test_east_north_up_turn_between_anchors_as_positions_do():
    here, there = Anchor(44.5, 11.3, 50.0), Anchor(45.2, 12.9, 700.0)
    pos_n = np.array([[0.0, 0.0, 0.0], [1000.0, -500.0, 300.0]])
    seen = geodetic_to_enu(*enu_to_geodetic(pos_n, here, WGS84), there, WGS84)
    # through coordinates of 6e6 m, whose rounding is 1e-9 m; Bowring's formula adds as much
    np.testing.assert_allclose(rotate(turn_between(here, there), pos_n[1]), seen[1] - seen[0], rtol=0.0, atol=2e-8)


# --- statistics -----------------------------------------------------------------------------------------------------


def test_statistics_are_of_sizes_without_what_is_not_known():
    found = statistics(np.array([-3.0, UNKNOWN, 4.0]))
    assert found is not None
    assert (found.mean, found.median, found.max, found.count) == (3.5, 3.5, 4.0, 2)
    assert found.rmse == pytest.approx(np.sqrt(12.5), rel=4 * EPS)
    assert found.p95 == pytest.approx(3.95, rel=4 * EPS)
    assert statistics(np.array([UNKNOWN])) is None
    assert statistics(np.empty(0)) is None


# --- another mounting -----------------------------------------------------------------------------------------------


def test_a_constant_turn_of_the_body_is_found_below_errors_of_attitude() -> None:
    truth, turn = winding(), from_euler(2.0, -0.3, 0.5)
    wrong = np.random.default_rng(3).normal(0.0, 0.01, (ROWS, 3))
    q_nv = multiply(multiply(truth.q_nv, turn), from_rotvec(wrong))
    q_nv[5:9] = UNKNOWN
    q_nv[20:30] *= -1.0  # the same attitudes
    found, left = mounting_between(motion(0.1 * np.arange(ROWS), truth.pos_n, q_nv), truth)
    # the mean of 396 errors of 0.01 rad on each axis: 0.0005 rad on each, of which five sigmas
    assert angle(found, turn) < 0.0025 * np.sqrt(3.0)
    assert np.isnan(left).tolist() == [5 <= row < 9 for row in range(ROWS)]
    np.testing.assert_allclose(np.delete(left, range(5, 9)), np.linalg.norm(np.delete(wrong, range(5, 9), 0), axis=1),
                               atol=0.0025 * np.sqrt(3.0))  # fmt: skip


def test_without_attitudes_there_is_no_turn() -> None:
    truth = winding()
    found, left = mounting_between(motion(0.1 * np.arange(ROWS), truth.pos_n, np.full((ROWS, 4), UNKNOWN)), truth)
    assert np.isnan(found).all()
    assert np.isnan(left).all()
