from __future__ import annotations

import numpy as np
import pytest
from metric_rows import row_named

from recon import GNSS, TRAJECTORY, build, matrix, meta, vector, with_meta
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.motion import circle
from recon.rows import warnings_of
from recon_fusers.weighted_average import AverageParams, declare_fusers, weighted_average

ANCHOR = {"lat": 44.5, "lon": 11.35, "height": 60.0}
CIRCLE = circle(30.0, 9.0)


def ns(t_s):
    return np.round(np.asarray(t_s) * 1e9).astype(np.int64)


def inertial(t_s, drift=(0.0, 0.0, 0.0)):
    """The circle as an inertial system of steady acceleration error `drift` m/s^2 sees it."""
    truth, t_s = CIRCLE.at(t_s), t_s[:, None]
    pos, vel = truth.pos_n + np.multiply(drift, t_s**2 / 2.0), truth.vel_n + np.multiply(drift, t_s)
    return build(TRAJECTORY, time=ns(truth.t_s), pos=pos, vel=vel, q=truth.q_nv)


def gnss_of(t_s, sigma=0.0, **groups):
    truth = CIRCLE.at(t_s)
    scatter = np.random.default_rng(8).normal(0.0, sigma, truth.pos_n.shape)
    columns = {"pos": truth.pos_n + scatter, "vel": truth.vel_n, **groups}
    return build(GNSS, time=ns(t_s), **{name: values for name, values in columns.items() if values is not None})


def fuse(trajectory, gnss, **params):
    return weighted_average(trajectory=trajectory, gnss=gnss, params=AverageParams(**params))


def written_out(t_s, pos, vel, gnss_pos, gnss_vel, weight, velocity_weight):
    """The recursion as the module states it, a record at a time; NaN in GNSS means weight zero."""
    fused_vel = vel.copy()
    for k in range(1, len(t_s)):
        predicted = fused_vel[k - 1] + vel[k] - vel[k - 1]
        w = np.where(np.isfinite(gnss_vel[k]), velocity_weight, 0.0)
        fused_vel[k] = (1.0 - w) * predicted + w * np.nan_to_num(gnss_vel[k])
    fused = pos.copy()
    for k in range(1, len(t_s)):
        correction = (fused_vel[k] - vel[k] + fused_vel[k - 1] - vel[k - 1]) / 2.0 * (t_s[k] - t_s[k - 1])
        predicted = fused[k - 1] + pos[k] - pos[k - 1] + correction
        w = np.where(np.isfinite(gnss_pos[k]), weight, 0.0)
        fused[k] = (1.0 - w) * predicted + w * np.nan_to_num(gnss_pos[k])
    return fused, fused_vel


def test_it_is_the_recursion_written_out_with_an_outage_and_irregular_times():
    rng = np.random.default_rng(9)
    t_s = np.sort(rng.uniform(0.0, 20.0, 2000))
    t_s = np.round((t_s - t_s[0]) * 1e9) * 1e-9
    fix_s = np.arange(0.0, 25.0, 0.5)
    fix_s = fix_s[(fix_s < 6.0) | (fix_s > 12.0)]
    trajectory = inertial(t_s, (0.05, -0.03, 0.1))
    gnss = gnss_of(fix_s, sigma=1.0)
    at_records = [
        np.column_stack([np.interp(t_s, fix_s, column) for column in matrix(gnss, group).T]) for group in ("pos", "vel")
    ]
    for values in at_records:
        values[(t_s > 5.5) & (t_s < 12.5)] = np.nan
    pos, vel = matrix(trajectory, "pos"), matrix(trajectory, "vel")
    # The first record lies on the first fix: it starts there.
    pos_0 = pos + (at_records[0][0] - pos[0])
    expected = written_out(t_s, pos_0, vel, *at_records, 0.02, 0.03)
    expected[1][0] = vel[0] + 0.03 * (at_records[1][0] - vel[0])
    fused = fuse(trajectory, gnss, weight=0.02, velocity_weight=0.03, vertical="gnss")["trajectory"]
    # Rounding of 2000 steps of numbers of some 10 m; times of 1 ns at 9 m/s.
    np.testing.assert_allclose(matrix(fused, "vel"), expected[1], atol=1e-6)
    np.testing.assert_allclose(matrix(fused, "pos"), expected[0], atol=1e-6)


def test_perfect_sensors_leave_a_perfect_trajectory():
    t_s = np.arange(0.0, 30.0, 0.01)
    fused = fuse(inertial(t_s), gnss_of(np.arange(0.0, 30.0, 0.1)))["trajectory"]
    truth = CIRCLE.at(t_s)
    # Straight lines between fixes cut the circle by v^2 / r dt^2 / 8 = 2.7 m/s^2 x 0.01 s^2 / 8 = 3.4 mm, and by
    # 9 (0.3 x 0.1)^2 / 8 = 1 mm/s in velocity, over the time constant of 1 s another 1 mm.
    assert np.abs(matrix(fused, "pos") - truth.pos_n).max() < 0.005
    assert np.abs(matrix(fused, "vel") - truth.vel_n).max() < 0.002


def test_a_drifting_inertial_trajectory_is_held_to_what_the_weights_promise():
    t_s = np.arange(0.0, 60.0, 0.01)
    drift = np.array([0.05, -0.03, 0.0])
    result = fuse(inertial(t_s, drift), gnss_of(np.arange(0.0, 60.1, 0.1)))
    error = matrix(result["trajectory"], "pos") - CIRCLE.at(t_s).pos_n
    # Steady state: velocity is off by drift x tau, position by that times tau once more; tau = 0.995 s. Besides, the
    # straight lines between fixes cut the circle by up to 5 mm: see the test with perfect sensors.
    tau = row_named(result, "velocity_time_constant")["value"]
    assert tau == pytest.approx(0.995, abs=1e-3)
    np.testing.assert_allclose(error[3000:], np.tile(drift * tau**2, (3000, 1)), atol=0.005)
    alone = np.linalg.norm(matrix(inertial(t_s, drift), "pos")[-1] - CIRCLE.at(t_s[-1:]).pos_n[0])
    assert alone > 100.0


def test_there_is_no_initial_transient_from_a_start_elsewhere():
    t_s = np.arange(0.0, 10.0, 0.01)
    shifted = inertial(t_s)
    gnss = gnss_of(
        np.arange(2.0, 10.0, 0.1), pos=np.add(CIRCLE.at(np.arange(2.0, 10.0, 0.1)).pos_n, (300.0, -40.0, 0.0))
    )
    fused = matrix(fuse(shifted, gnss)["trajectory"], "pos")
    np.testing.assert_allclose(fused - matrix(shifted, "pos"), np.tile([300.0, -40.0, 0.0], (1000, 1)), atol=0.005)


def test_inside_an_outage_the_trajectory_moves_as_inertia_says():
    t_s = np.arange(0.0, 20.0, 0.01)
    fix_s = np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(15.0, 20.0, 0.1)])
    result = fuse(inertial(t_s, (0.1, 0.0, 0.0)), gnss_of(fix_s), velocity_weight=0.0)
    inside = (t_s > 4.95) & (t_s < 14.95)
    steps = np.diff(matrix(result["trajectory"], "pos")[inside], axis=0)
    expected = np.diff(matrix(inertial(t_s, (0.1, 0.0, 0.0)), "pos")[inside], axis=0)
    np.testing.assert_allclose(steps, expected, atol=1e-12)
    assert row_named(result, "position_records_with_gnss")["value"] == pytest.approx(0.5, abs=0.01)


def test_height_is_inertial_unless_gnss_is_asked_for():
    t_s = np.arange(0.0, 20.0, 0.01)
    fix_s = np.arange(0.0, 21.0, 0.1)
    gnss = gnss_of(fix_s, pos=CIRCLE.at(fix_s).pos_n + np.outer(fix_s > 1.0, [0.0, 0.0, 5.0]))
    plain = fuse(inertial(t_s), gnss)["trajectory"]
    assert not vector(plain, "pos_u").any()
    assert not vector(plain, "vel_u").any()
    drawn = fuse(inertial(t_s), gnss, vertical="gnss")["trajectory"]
    assert vector(drawn, "pos_u")[-1] == pytest.approx(5.0, abs=1e-4)  # 18 time constants later


def test_without_a_velocity_of_gnss_the_inertial_one_stays():
    t_s = np.arange(0.0, 10.0, 0.01)
    trajectory = inertial(t_s, (0.1, 0.0, 0.0))
    for unknown in (None, np.full((100, 3), np.nan)):
        fused = fuse(trajectory, gnss_of(np.arange(0.0, 10.0, 0.1), vel=unknown))["trajectory"]
        np.testing.assert_array_equal(matrix(fused, "vel"), matrix(trajectory, "vel"))


@pytest.mark.parametrize("gnss", [None, build(GNSS, time=np.arange(3), speed=np.ones(3)), gnss_of(np.zeros(0))])
def test_without_positions_the_trajectory_passes_through_and_that_is_told(gnss):
    trajectory = inertial(np.arange(0.0, 1.0, 0.01))
    result = fuse(trajectory, gnss)
    assert result["trajectory"].equals(trajectory, check_metadata=True)
    assert warnings_of(result["metrics"]) == ["no GNSS positions: the trajectory is inertial alone"]


def test_a_weight_of_one_is_gnss_alone():
    t_s = np.arange(0.0, 5.0, 0.1)
    gnss = gnss_of(t_s, sigma=2.0)
    fused = fuse(inertial(t_s), gnss, weight=1.0, vertical="gnss")["trajectory"]
    np.testing.assert_allclose(matrix(fused, "pos"), matrix(gnss, "pos"), atol=1e-12)


def test_the_place_on_the_earth_is_that_of_the_fused_position():
    t_s = np.arange(0.0, 10.0, 0.01)
    gnss = with_meta(gnss_of(np.arange(0.0, 10.0, 0.1), sigma=2.0), anchor=ANCHOR)
    fused = fuse(inertial(t_s), gnss)["trajectory"]
    place = [vector(fused, name) for name in ("lat", "lon", "height")]
    np.testing.assert_allclose(geodetic_to_enu(*place, Anchor(**ANCHOR)), matrix(fused, "pos"), atol=1e-7)
    assert meta(fused)["anchor"] == ANCHOR


def test_fixes_further_apart_than_the_gap_are_told():
    (note,) = warnings_of(fuse(inertial(np.arange(0.0, 30.0, 0.01)), gnss_of(np.arange(0.0, 30.0, 5.0)))["metrics"])
    assert "every 5.0 s" in note


@pytest.mark.parametrize("rows", [0, 1, 2])
@pytest.mark.parametrize("fixes", [1, 2])
def test_few_rows_are_no_matter(rows, fixes):
    t_s = 0.01 * np.arange(rows)
    fused = fuse(inertial(t_s), gnss_of(0.01 * np.arange(fixes)))["trajectory"]
    # The circle itself: 9 mm of chord apart from it at the most.
    np.testing.assert_allclose(matrix(fused, "pos"), CIRCLE.at(t_s).pos_n, atol=0.01)


def test_the_record_is_without_faults():
    (record,) = declare_fusers()
    assert record.faults() == []


def test_after_a_gap_in_the_trajectory_it_begins_anew_on_gnss():
    t_s = np.concatenate((np.arange(0.0, 5.0, 0.01), np.arange(15.0, 20.0, 0.01)))
    trajectory = inertial(t_s, (0.3, 0.0, 0.0))
    fused = fuse(trajectory, gnss_of(np.arange(0.0, 20.1, 0.1)))["trajectory"]
    truth = CIRCLE.at(t_s)
    after = slice(500, None)
    # An inertial error of 3 m/s and 34 m in the gap is gone at once, for a fix lies on that record. Then the steady
    # 0.3 m/s^2 leaves e behind by a time constant of 1 s: 0.3 m/s; the chord of GNSS adds v^3 / r^2 h^2 / 8 = 1 mm/s.
    np.testing.assert_allclose(matrix(fused, "vel")[500], truth.vel_n[500], atol=0.01)
    np.testing.assert_allclose(matrix(fused, "pos")[500], truth.pos_n[500], atol=0.01)
    assert np.abs(matrix(fused, "vel")[after] - truth.vel_n[after]).max() < 0.31


def test_with_no_weight_of_velocity_a_gap_does_not_bring_one():
    t_s = np.concatenate((np.arange(0.0, 5.0, 0.01), np.arange(15.0, 20.0, 0.01)))
    trajectory = inertial(t_s, (0.3, 0.0, 0.0))
    fused = fuse(trajectory, gnss_of(np.arange(0.0, 20.0, 0.1)), velocity_weight=0.0)["trajectory"]
    assert (matrix(fused, "vel") == matrix(trajectory, "vel")).all()


@pytest.mark.parametrize("positions", [True, False])
@pytest.mark.parametrize(
    ("factor", "cause"), [(3.6, "in m/s where it is in km/h"), (1 / 3.6, "in km/h where it is in m/s")]
)
def test_a_speed_in_another_unit_is_warned_of_with_its_likely_cause(positions, factor, cause):
    t_s = np.arange(0.0, 20.0, 0.1)
    speed = np.full(len(t_s), 9.0 * factor)
    gnss = gnss_of(t_s, speed=speed) if positions else build(GNSS, time=ns(t_s), speed=speed)
    notes = warnings_of(fuse(inertial(np.arange(0.0, 20.0, 0.01)), gnss)["metrics"])
    assert [note for note in notes if "disagree" in note and cause in note]


def test_a_late_speed_that_agrees_is_not_warned_of():
    t_s = np.arange(0.0, 20.0, 0.1)
    result = fuse(inertial(np.arange(0.0, 20.0, 0.01)), gnss_of(t_s, speed=np.full(len(t_s), 9.0)))
    assert warnings_of(result["metrics"]) == []
    assert row_named(result, "speed_ratio")["value"] == pytest.approx(1.0, abs=0.01)
