from __future__ import annotations

import numpy as np
import pytest
from metric_rows import row_named
from sampling import irregular

from recon import ATTITUDE, GNSS, IMU, Event, build, events, matrix, meta, time_ns, vector, with_meta
from recon.errors import DataError, NotEnoughData
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.integration import RULES
from recon.numerics.motion import Drive, Segment, Spring, circle, rest
from recon.numerics.rotation import conjugate, rotate
from recon.rows import warnings_of
from recon_integrators.motion import MotionParams, declare_integrators, integrate_motion

ANCHOR = {"lat": 44.5, "lon": 11.35, "height": 60.0}
# 10 s of rest, 6 s of driving to 9 m/s and back, 10 s of rest, the same again, 10 s of rest
TRIPS = Drive(
    (Segment(10.0, 0.0), *(Segment(3.0, 9.0), Segment(3.0, 0.0), Segment(10.0, 0.0)) * 2),
    yaw=0.6,
)
STOPS = [(0.0, 10.0), (16.0, 26.0), (32.0, 42.0)]


def ns(t_s):
    return np.round(np.asarray(t_s) * 1e9).astype(np.int64)


def tables(truth, bias_n=(0.0, 0.0, 0.0)):
    """The imu without gravity, its accelerations wrong by bias_n m/s^2 (local), and the attitude."""
    accel = rotate(conjugate(truth.q_nv), truth.acc_n + bias_n)
    imu = build(IMU, time=ns(truth.t_s), accel=accel, gyro=truth.gyro_v)
    return imu, build(ATTITUDE, time=ns(truth.t_s), q=truth.q_nv)


def gnss_of(motion, t_s, **columns):
    truth = motion.at(np.asarray(t_s, dtype=float))
    return build(GNSS, time=ns(t_s), pos=truth.pos_n, vel=truth.vel_n, **columns)


def stops_of(spans_s):
    return events([Event(int(a * 1e9), int(b * 1e9), "standstill") for a, b in spans_s])


def run(truth, bias_n=(0.0, 0.0, 0.0), stops=None, gnss=None, **params):
    imu, attitude = tables(truth, bias_n)
    return integrate_motion(imu=imu, attitude=attitude, events=stops, gnss=gnss, params=MotionParams(**params))


@pytest.mark.parametrize("motion", [circle(20.0, 8.0), Spring(20.0, 0.4, 0.5, 1.0, 1.3, turning=False)])
@pytest.mark.parametrize(("rule", "order"), [("rectangle", 1), ("trapezoid", 2), ("parabola", 3)])
def test_the_error_from_the_analytic_path_falls_with_the_order_of_the_rule(motion, rule, order):
    worst = []
    for rate_hz in (50.0, 200.0):
        truth = motion.at(irregular(rate_hz, 30.0))
        trajectory = run(truth, gnss=gnss_of(motion, [0.0]), rule=rule)["trajectory"]
        worst.append(np.abs(matrix(trajectory, "pos") - truth.pos_n).max())
    # A quarter of the step divides the error by 4^order; the random part of the steps scatters the exponent.
    assert np.log2(worst[0] / worst[1]) / 2.0 == pytest.approx(order, abs=0.6)


def test_a_parabola_is_integrated_exactly_at_irregular_times():
    t_s = irregular(10.0, 20.0)
    accel = np.column_stack([0.3 * t_s**2, 1.0 - t_s, np.full_like(t_s, 2.0)])
    attitude = build(ATTITUDE, time=ns(t_s), q=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_s), 1)))
    imu = build(IMU, time=ns(t_s), accel=accel, gyro=np.zeros_like(accel))
    result = integrate_motion(imu=imu, attitude=attitude, events=None, gnss=None, params=MotionParams())
    expected = np.column_stack([0.1 * t_s**3, t_s - t_s**2 / 2.0, 2.0 * t_s])
    # Sums of 200 areas: rounding of 1e-16 times the largest value of 800 m/s, times are of 1 ns: 120 m/s^2 x 1e-9 s.
    np.testing.assert_allclose(matrix(result["trajectory"], "vel"), expected, atol=1e-6)


def test_rest_stays_at_rest():
    trajectory = run(rest(20.0).at(np.arange(0.0, 20.0, 0.01)))["trajectory"]
    assert not matrix(trajectory, "vel").any()
    assert not matrix(trajectory, "pos").any()


def test_velocity_is_exactly_zero_at_stops_and_position_holds_still():
    truth = TRIPS.at(np.arange(0.0, 42.0, 0.01))
    trajectory = run(truth, (0.02, -0.01, 0.05), stops_of(STOPS))["trajectory"]
    # The parabola of the last interval of a stop passes through the sample after it, so that interval is left out.
    for start, end in STOPS:
        inside = (truth.t_s >= start) & (truth.t_s <= end)
        assert not matrix(trajectory, "vel")[inside].any()
        assert not np.diff(matrix(trajectory, "pos")[inside][:-1], axis=0).any()


def test_a_steady_error_of_acceleration_is_taken_off_wholly_between_stops():
    truth = TRIPS.at(np.arange(0.0, 42.0, 0.01))
    result = run(truth, (0.02, -0.01, 0.05), stops_of(STOPS))
    # The error is a straight line through all stops, so only that of quadrature is left: h^3 / 24 of the third
    # derivative of acceleration (9 m/s in 3 s: 9 / 3 (2 pi / 3)^3 m/s^5) over 6 s, and a stop's last sample.
    np.testing.assert_allclose(matrix(result["trajectory"], "vel"), truth.vel_n, atol=2e-5)
    np.testing.assert_allclose(matrix(result["trajectory"], "pos"), truth.pos_n, atol=2e-4)
    assert row_named(result, "largest_velocity_error_at_a_stop")["value"] == pytest.approx(
        np.linalg.norm((0.02, -0.01, 0.05)) * 41.99, rel=1e-6
    )


def test_a_stop_whose_end_is_told_late_costs_little():
    truth = TRIPS.at(np.arange(0.0, 42.0, 0.01))
    late = stops_of([(0.4, 10.4), (16.4, 26.4), (32.4, 42.0)])
    trajectory = run(truth, (0.02, -0.01, 0.05), late)["trajectory"]
    # In its first 0.4 s the launch gains (2 pi^2 / 3) 9 m/s (0.4 s / 3 s)^3 = 0.14 m/s, growing with the cube of time:
    # 40 rows of 0.035 m/s in the mean are taken for standing. Each moves the end of the line through the 1000 rows of
    # the stop by 4 / 1000 of itself: 0.006 m/s.
    moving = (truth.t_s > 10.41) & (truth.t_s < 16.0)
    error = (matrix(trajectory, "vel") - truth.vel_n)[moving]
    assert np.abs(error).max() < 0.01


def test_plain_integration_keeps_the_error():
    truth = TRIPS.at(np.arange(0.0, 42.0, 0.01))
    trajectory = run(truth, (0.0, 0.0, 0.05), stops_of(STOPS), zero_at_stops=False)["trajectory"]
    assert vector(trajectory, "vel_u")[-1] == pytest.approx(0.05 * 41.99, rel=1e-6)


def test_before_the_first_and_after_the_last_stop_the_correction_is_constant():
    truth = TRIPS.at(np.arange(0.0, 32.0, 0.01))
    trajectory = run(truth, (0.0, 0.0, 0.05), stops_of([(16.0, 26.0)]))["trajectory"]
    error = vector(trajectory, "vel_u") - truth.vel_n[:, 2]
    np.testing.assert_allclose(error[:1600], 0.05 * (truth.t_s[:1600] - 16.0), atol=1e-6)
    np.testing.assert_allclose(error[2601:], 0.05 * (truth.t_s[2601:] - 26.0), atol=1e-6)


def test_the_first_fix_and_a_moving_start_are_taken_from_gnss_also_when_it_comes_late():
    motion = circle(20.0, 8.0)
    truth = motion.at(np.arange(0.0, 10.0, 0.005))
    gnss = gnss_of(motion, np.arange(1.3, 10.0, 0.2))
    trajectory = run(truth, gnss=gnss)["trajectory"]
    # The first fix lies on a record; the error of the parabola: see the order test, below 1e-4 m at 50 Hz.
    np.testing.assert_allclose(matrix(trajectory, "pos"), truth.pos_n, atol=1e-4)
    np.testing.assert_allclose(matrix(trajectory, "vel"), truth.vel_n, atol=1e-4)


def test_a_record_that_begins_at_rest_ignores_the_noise_of_gnss_velocity():
    truth = TRIPS.at(np.arange(0.0, 15.0, 0.01))
    gnss = build(GNSS, time=ns([0.0, 1.0]), pos=np.zeros((2, 3)), vel=np.full((2, 3), 0.4))
    result = run(truth, stops=stops_of([(0.1, 10.0)]), gnss=gnss, zero_at_stops=False)
    assert not matrix(result["trajectory"], "vel")[:1000].any()


def test_an_unknown_first_velocity_is_told():
    result = run(circle(20.0, 8.0).at(np.arange(0.0, 1.0, 0.01)))
    assert any("first velocity" in note for note in warnings_of(result["metrics"]))


def test_gaps_in_the_first_fixes_are_passed_over():
    motion = circle(20.0, 8.0)
    t_s = np.arange(0.0, 5.0, 0.5)
    fixes = motion.at(t_s)
    pos, vel = fixes.pos_n.copy(), fixes.vel_n.copy()
    pos[:3], vel[:4], pos[:, 2], vel[:, 2] = np.nan, np.nan, np.nan, np.nan
    truth = motion.at(np.arange(0.0, 5.0, 0.005))
    trajectory = run(truth, gnss=build(GNSS, time=ns(t_s), pos=pos, vel=vel))["trajectory"]
    np.testing.assert_allclose(matrix(trajectory, "pos"), truth.pos_n, atol=1e-4)


def test_the_place_on_the_earth_follows_from_the_anchor():
    motion = circle(20.0, 8.0)
    gnss = with_meta(gnss_of(motion, [0.0]), anchor=ANCHOR, height_datum="ellipsoid")
    result = run(motion.at(np.arange(0.0, 5.0, 0.01)), gnss=gnss)
    trajectory = result["trajectory"]
    place = [vector(trajectory, name) for name in ("lat", "lon", "height")]
    np.testing.assert_allclose(geodetic_to_enu(*place, Anchor(**ANCHOR)), matrix(trajectory, "pos"), atol=1e-7)
    assert meta(trajectory)["anchor"] == ANCHOR
    assert warnings_of(result["metrics"]) == []


def test_without_an_anchor_the_place_is_null_and_that_is_told():
    result = run(rest(1.0).at(np.arange(0.0, 1.0, 0.01)), stops=stops_of([(0.0, 1.0)]))
    assert result["trajectory"]["lat"].null_count == 100
    assert any("local frame" in note for note in warnings_of(result["metrics"]))


def test_sigmas_are_null_and_the_vehicle_frame_is_passed_on():
    truth = circle(20.0, 8.0).at(np.arange(0.0, 1.0, 0.01))
    imu, _ = tables(truth)
    trajectory = run(truth)["trajectory"]
    assert trajectory["pos_std_e"].null_count == trajectory["att_std_yaw"].null_count == 100
    for group in ("accel", "gyro"):
        np.testing.assert_array_equal(matrix(trajectory, group), matrix(imu, group))
    assert np.array_equal(time_ns(trajectory), time_ns(imu))


@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("stops", [None, stops_of([(0.0, 9.0)])])
def test_few_rows_are_no_matter(rows, rule, stops):
    motion = circle(20.0, 8.0)
    gnss = gnss_of(motion, [0.0, 5.0])
    trajectory = run(motion.at(0.01 * np.arange(rows)), stops=stops, gnss=gnss, rule=rule)["trajectory"]
    assert np.isfinite(matrix(trajectory, "pos")).all()
    assert trajectory.num_rows == rows


def test_an_empty_imu_is_not_enough():
    with pytest.raises(NotEnoughData):
        run(rest(1.0).at(np.zeros(0)))


def test_an_attitude_at_other_times_is_refused():
    imu, attitude = tables(rest(1.0).at(np.arange(0.0, 1.0, 0.1)))
    with pytest.raises(DataError, match="same times"):
        integrate_motion(imu=imu, attitude=attitude.slice(1), events=None, gnss=None, params=MotionParams())


def test_the_record_is_without_faults():
    (record,) = declare_integrators()
    assert record.faults() == []


def with_a_gap(start_s, end_s, t_s):
    return t_s[(t_s <= start_s) | (t_s >= end_s)]


@pytest.mark.parametrize("rule", RULES)
def test_over_a_gap_at_steady_speed_the_position_goes_on_with_the_velocity_held(rule):
    # Speed is 9 m/s and steady from 3 to 13 s; the gap lies inside.
    drive = Drive((Segment(3.0, 9.0), Segment(10.0, 9.0), Segment(3.0, 0.0), Segment(5.0, 0.0)), yaw=0.6)
    truth = drive.at(with_a_gap(6.0, 11.0, np.arange(0.0, 21.0, 0.0025)))
    gnss = gnss_of(drive, [0.0])
    result = run(truth, gnss=gnss, rule=rule)
    # The rectangle errs by half a step times the velocity, twice, as without a gap; the gap adds nothing to any rule.
    np.testing.assert_allclose(matrix(result["trajectory"], "pos"), truth.pos_n, atol=0.0025 * 9.0 + 1e-3)
    assert [note for note in warnings_of(result["metrics"]) if note.startswith("no imu for 5.0 s")]


def test_what_a_stop_shows_after_a_gap_is_put_down_to_the_gap():
    # Braking from 9 m/s to a stand lies inside the gap of 4 s.
    truth = TRIPS.at(with_a_gap(12.95, 16.95, np.arange(0.0, 42.0, 0.01)))
    trajectory = run(truth, stops=stops_of([(0.0, 10.0), (18.0, 26.0), (32.0, 42.0)]))["trajectory"]
    before = (truth.t_s > 10.0) & (truth.t_s < 12.95)
    # Of the error of 9 m/s (a little less: the gap begins just before the top speed) a share of 3 s in
    # 3 + 1 + 20 * 4 s falls on the drive before the gap.
    assert np.linalg.norm(matrix(trajectory, "vel") - truth.vel_n, axis=1)[before].max() < 9.0 * 3.0 / 84.0


@pytest.mark.parametrize("length_s", [2.0, 590.0])
def test_a_gap_at_rest_moves_nothing(length_s):
    t_s = np.arange(0.0, 10.0, 0.01)
    truth = rest(3600.0).at(np.concatenate((t_s, 10.0 + length_s + t_s)))
    # The detector tells the stops from speeds at 10 Hz: it knows nothing of the last rows before the gap.
    stops = stops_of([(0.0, 9.9), (10.1 + length_s, 20.0 + length_s)])
    trajectory = run(truth, (0.02, -0.01, 0.05), stops)["trajectory"]
    assert not matrix(trajectory, "vel").any()
    assert not matrix(trajectory, "pos").any()


def test_a_short_run_between_two_stops_is_not_taken_for_a_gap():
    truth = TRIPS.at(np.arange(0.0, 42.0, 0.01))
    trajectory = run(truth, stops=stops_of([(0.0, 10.0), (10.5, 26.0), (32.0, 42.0)]))["trajectory"]
    assert matrix(trajectory, "vel")[1001:1050].any()


def test_a_stop_that_holds_a_gap_leaves_no_error_of_its_line():
    t_s = np.concatenate((np.arange(0.0, 4.0, 0.01), np.arange(8.0, 42.0, 0.01)))
    truth = TRIPS.at(t_s)
    trajectory = run(truth, (0.02, -0.01, 0.05), stops_of(STOPS))["trajectory"]
    # As without the gap: see the test of a steady error.
    np.testing.assert_allclose(matrix(trajectory, "vel"), truth.vel_n, atol=2e-5)


def test_a_log_with_a_hole_is_refused():
    with pytest.raises(DataError, match=r"the log has a hole: no imu for 60\.0 min"):
        run(rest(4000.0).at(np.array([0.0, 0.01, 3600.01])))
