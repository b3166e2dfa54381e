"""analyzer.driving: figures of motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from handling_drives import START_NS, braking, cornering, gentle, told

from recon import TRAJECTORY, Event, build, events, select_rows, time_ns
from recon.numerics.handling import poisson_limits, weighted_quantile
from recon_analyzers.driving import DrivingParams, analyze_driving

G = 9.80665


def analyzed(trajectory, happened=None, **params):
    return analyze_driving(trajectory=trajectory, events=happened, params=DrivingParams(**params))


def happened(*rows):
    return events(Event(START_NS + round(a * 1e9), START_NS + round(b * 1e9), kind) for kind, a, b in rows)


def test_a_steady_drive_has_its_way_time_and_speed_and_nothing_else():
    """6000 rows at 100 Hz stand for 59.99 s."""
    found = told(analyzed(gentle(speed=15.0)))
    assert found["distance"]["value"] == pytest.approx(15.0 * 59.99)
    assert found["duration"]["value"] == pytest.approx(59.99)
    assert found["mean_moving_speed"]["value"] == pytest.approx(15.0)
    assert found["friction_demand_max"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert found["rpa"]["value"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("step_s", "jitter_s"), [(1.0, 0.001), (1.0, 0.2), (2.0, 0.0), (2.0, 0.001)])
def test_a_trajectory_of_a_row_a_second_and_fewer_has_its_way_and_time(step_s, jitter_s):
    t_s = step_s * np.arange(200) + np.random.default_rng(2).uniform(-jitter_s, jitter_s, 200)
    still, ahead = np.zeros((200, 1)), np.full((200, 1), 12.0)
    trajectory = build(
        TRAJECTORY,
        time=START_NS + np.rint(t_s * 1e9).astype(np.int64),
        pos=np.hstack([12.0 * t_s[:, None], still, still]),
        vel=np.hstack([ahead, still, still]),
        q=np.tile([1.0, 0.0, 0.0, 0.0], (200, 1)),
    )
    found = told(analyzed(trajectory))
    assert found["duration"]["value"] == pytest.approx(t_s[-1] - t_s[0], abs=1e-6)
    assert found["distance"]["value"] == pytest.approx(12.0 * (t_s[-1] - t_s[0]), abs=1e-5)


def test_a_silence_counts_neither_for_the_way_nor_for_the_time():
    whole = gentle(speed=15.0)
    t_ns = time_ns(whole) - time_ns(whole)[0]
    for every, silence in ((1, 1.5), (100, 5.0)):
        kept = (np.arange(len(t_ns)) % every == 0) & ~((t_ns > 20e9) & (t_ns < (20.0 + silence) * 1e9))
        found = told(analyzed(select_rows(whole, kept)))
        lasting = (t_ns[kept][-1] - t_ns[kept][0]) * 1e-9 - silence
        assert found["duration"]["value"] == pytest.approx(lasting, abs=0.02 * every)


def test_the_friction_circle_of_braking_is_its_deceleration():
    found = told(analyzed(braking(0.5 * G)))
    assert found["friction_demand_max"]["value"] == pytest.approx(0.5, rel=1e-6)
    assert found["brake_max"]["value"] == pytest.approx(0.5 * G, rel=1e-6)
    assert found["friction_time"]["value"] == pytest.approx(2.0, abs=0.2)


def test_a_bend_to_the_left_shows_on_the_left():
    found = told(analyzed(cornering(15.0**2 / (0.4 * G))))
    assert found["left_max"]["value"] == pytest.approx(0.4 * G, rel=1e-6)
    assert found["right_max"]["value"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("every", [1, 10, 50])
def test_relative_positive_acceleration_and_its_percentile_are_those_of_the_speed_each_second(every):
    """From 20 to 30 m/s in two seconds, worked out by hand by appendix 7a: at 20, 21 and 22 s a is 2.5, 5 and 2.5 m/s^2
    and v a 50, 125 and 75 m^2/s^3; the speeds of the seconds 1 to 58 are 1535 m/s together. 95 % of three lie 85 % of
    the way from the second to the third.
    """
    found = told(analyzed(select_rows(braking(-5.0, duration_s=2.0), np.arange(0, 6000, every))))
    assert found["rpa"]["value"] == pytest.approx(250.0 / 1535.0, rel=2e-3)
    assert found["va_pos_p95"]["value"] == pytest.approx(75.0 + 0.85 * 50.0, rel=2e-3)


def test_a_crash_and_rows_rarer_than_a_second_give_no_positive_acceleration():
    marks = happened(("crash", 20.0, 22.0))
    assert told(analyzed(braking(-5.0, duration_s=2.0), marks), "whole")["rpa"]["value"] == 0.0
    rare = told(analyzed(select_rows(braking(-5.0, duration_s=2.0), np.arange(0, 6000, 200))))
    assert "rpa" not in rare


def test_hardly_any_acceleration_is_none():
    found = told(analyzed(braking(-0.05, duration_s=20.0)))
    assert found["rpa"]["value"] == pytest.approx(0.0, abs=1e-9)


def test_jerk_is_that_of_the_low_passed_edge():
    """The rate of an edge behind four means of width w is a cubic B-spline, of whose square the integral is
    151 / 315 / w; there are two edges of 5 m/s^2."""
    w = 0.22751 / 2.0
    found = told(analyzed(braking(5.0)))
    expected = np.sqrt(2 * 5.0**2 * 151.0 / 315.0 / w / 59.99)
    assert found["jerk_along_rms"]["value"] == pytest.approx(expected, rel=0.02)


def test_rates_count_events_and_know_how_little_they_tell():
    marks = happened(("trip", 0.0, 59.0), ("harsh_braking", 20.0, 21.0), ("harsh_braking", 40.0, 41.0))
    found = told(analyzed(gentle(), marks), "whole")
    way_100km = found["distance"]["value"] / 1e5
    rate = found["harsh_braking_per_100km"]
    assert found["harsh_braking"]["value"] == 2.0
    assert rate["value"] == pytest.approx(2.0 / way_100km)
    assert rate["low"] == pytest.approx(0.2422 / way_100km, rel=1e-3)  # Garwood's table for a count of 2
    assert rate["high"] == pytest.approx(7.2247 / way_100km, rel=1e-3)
    assert found["harsh_cornering_per_100km"]["value"] == 0.0
    assert found["harsh_cornering_per_100km"]["high"] == pytest.approx(3.6889 / way_100km, rel=1e-3)


def test_a_crash_is_left_out_and_a_short_way_tells_no_rate():
    """0.5 g for 2 s, called a crash; 20 m/s for a second are 20 m."""
    marks = happened(("crash", 20.0, 22.0), ("harsh_braking", 40.0, 41.0))
    assert told(analyzed(braking(0.5 * G), marks), "whole")["friction_demand_max"]["value"] == pytest.approx(
        0.0, abs=1e-6
    )
    short = told(analyzed(gentle().slice(0, 101), happened(("harsh_braking", 0.2, 0.4))), "whole")
    assert short["harsh_braking"]["value"] == 1.0
    assert "harsh_braking_per_100km" not in short


def test_trips_have_figures_of_their_own():
    marks = happened(("trip", 0.0, 19.0), ("trip", 30.0, 59.0), ("harsh_braking", 20.0, 22.0))
    streams = analyzed(braking(0.5 * G), marks)
    assert told(streams, "trip 1")["friction_demand_max"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert told(streams, "trip 1")["distance"]["value"] == pytest.approx(20.0 * 19.0, rel=0.01)
    assert told(streams, "trip 1")["harsh_braking"]["value"] == 0.0
    assert told(streams, "whole")["harsh_braking"]["value"] == 1.0
    assert set(streams["gg"]["trip"].to_pylist()) == {0, 1, 2}


def test_the_diagram_holds_all_time_in_motion_and_its_cells_where_they_belong():
    streams = analyzed(braking(0.5 * G))
    rows = [row for row in streams["gg"].to_pylist() if row["trip"] == 0]
    assert sum(row["duration"] for row in rows) == pytest.approx(told(streams)["moving_time"]["value"])
    hard = [row for row in rows if row["accel_along"] == pytest.approx(-0.5 * G)]
    assert sum(row["duration"] for row in hard) == pytest.approx(1.7, abs=0.15)
    assert max(rows, key=lambda row: row["duration"])["accel_along"] == 0.0


def test_without_events_nothing_is_counted():
    assert not any(name.endswith("per_100km") for name in told(analyzed(gentle())))


def test_limits_of_a_count_are_garwoods():
    """Table of Garwood (1936) for 95 %."""
    assert poisson_limits(0) == pytest.approx((0.0, 3.689), abs=1e-3)
    assert poisson_limits(10) == pytest.approx((4.795, 18.390), abs=1e-3)


def test_a_quantile_by_weight_is_the_usual_one_for_equal_weights():
    values = np.arange(101.0)
    assert weighted_quantile(values, np.ones(101), 0.95) == pytest.approx(95.0, abs=1.0)
    assert weighted_quantile(np.array([1.0, 100.0]), np.array([99.0, 1.0]), 0.95) == 1.0
    assert np.isnan(weighted_quantile(np.array([np.nan]), np.ones(1), 0.5))
