"""detector.driving: events of motions known in closed form, and of simulated drives against the simulator's truth."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from handling_drives import DT_S, START_NS, braking, cornering, gentle, told, trajectory_of
from hypothesis import given, settings
from hypothesis import strategies as st

from recon import ConfigError, Event, Pipeline, Registry, matrix, time_ns
from recon import events as event_table
from recon.check import check
from recon.numerics.handling import smoothed, spells
from recon.rows import spans
from recon.testing.drives import GRAVITY
from recon_detectors._driving_thresholds import KINDS, sets
from recon_detectors.driving import DrivingParams, driving
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

G = 9.80665
BLUR_S = 0.23
"""Four running means of 0.114 s (2 Hz) reach so far: an edge may move by as much."""


def events(trajectory, **params):
    return driving(events=None, trajectory=trajectory, params=DrivingParams(**params))["events"].to_pylist()


def kinds(trajectory, **params):
    return [row["kind"] for row in events(trajectory, **params) if row["kind"] != "trip"]


# --- motions known in closed form ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("limit", "found"), [(0.45, ["harsh_braking"]), (0.55, [])])
def test_braking_at_half_a_g_is_harsh_below_that_limit_alone(limit, found):
    assert kinds(braking(0.5 * G), harsh_braking=limit * G) == found


def test_braking_lasts_as_long_as_it_did_and_peaks_at_what_it_was():
    """2 s of 0.5 g from the 20th second on; the plateau is longer than the means, so the peak is exact."""
    (row,) = [row for row in events(braking(0.5 * G, duration_s=2.0)) if row["kind"] == "harsh_braking"]
    start, end = ((row[name].value - START_NS) * 1e-9 for name in ("time", "end_time"))
    assert start == pytest.approx(20.0, abs=BLUR_S)
    assert end == pytest.approx(22.0, abs=BLUR_S)
    assert row["value"] == pytest.approx(0.5 * G, rel=1e-6)


def test_the_same_from_velocities_alone():
    """Without accelerations in the trajectory; the derivative of exact velocities at 100 Hz is exact on the plateau."""
    whole = braking(0.5 * G)
    bare = whole.drop_columns([f"accel_{axis}" for axis in "xyz"])
    (one,), (other,) = ([r for r in events(t) if r["kind"] == "harsh_braking"] for t in (whole, bare))
    assert other["value"] == pytest.approx(one["value"], rel=1e-6)
    assert abs(other["time"].value - one["time"].value) <= 2 * DT_S * 1e9


def test_an_impact_is_no_braking_and_what_came_before_it_is():
    """A second of 0.6 g, half a second later a crash of 6 g and 100 ms; the means would spread that over 0.23 s."""
    accel, yaw = np.zeros((6000, 3)), np.zeros(6000)
    accel[2000:2100, 0], accel[2150:2160, 0] = -0.6 * G, -6.0 * G
    drive = trajectory_of(accel, yaw, 20.0)
    crash = event_table([Event(START_NS + 21_500_000_000, START_NS + 21_600_000_000, "crash", 20.0, "km/h")])
    found = driving(events=crash, trajectory=drive, params=DrivingParams())
    (row,) = [row for row in found["events"].to_pylist() if row["kind"] == "harsh_braking"]
    assert row["value"] == pytest.approx(0.6 * G, rel=1e-6)
    assert (row["end_time"].value - START_NS) * 1e-9 == pytest.approx(21.0, abs=BLUR_S)
    assert told(found)["crashes_left_out"]["value"] == 1.0


def test_gaining_speed_is_harsh_acceleration_and_backwards_too():
    assert kinds(braking(-0.4 * G)) == ["harsh_acceleration"]
    assert kinds(braking(0.5 * G, backwards=True)) == ["harsh_braking"]
    assert kinds(braking(-0.4 * G, backwards=True)) == ["harsh_acceleration"]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_bend_is_harsh_to_either_side(side):
    """v^2 / r = 0.6 g, at 15 m/s on a radius of 38 m."""
    assert kinds(cornering(side * 15.0**2 / (0.6 * G))) == ["harsh_cornering"]
    assert kinds(cornering(side * 15.0**2 / (0.4 * G))) == []


def test_a_climb_is_no_acceleration():
    """At a steady 15 m/s up a slope of 30 % the trajectory has no acceleration, whatever the box feels."""
    assert kinds(gentle(slope=0.3)) == []


def test_a_jolt_of_a_tenth_of_a_second_is_taken_off():
    """0.6 g for 0.1 s: behind four means of 0.114 s it is at most 2/3 * 0.1 / 0.114 of that, 0.35 g."""
    assert kinds(braking(0.6 * G, duration_s=0.1)) == []


def test_braking_twice_within_three_seconds_is_one_event():
    assert kinds(braking(0.5 * G, duration_s=1.0, again_after_s=2.0)) == ["harsh_braking"]
    assert kinds(braking(0.5 * G, duration_s=1.0, again_after_s=5.0)) == ["harsh_braking"] * 2


def test_pauses_within_the_limit_are_no_time_beyond_it():
    """Of each five seconds one is beyond: within 36 s there are eight."""
    t_ns = START_NS + np.arange(4000) * 10_000_000
    beyond = np.arange(4000) % 500 <= 100
    assert spells(t_ns, beyond, 5.0, 8.0, 1.0).tolist() == [[0, 3600]]
    assert not len(spells(t_ns, beyond, 5.0, 8.01, 1.0))


def test_speeding_needs_a_limit_and_tells_by_how_much():
    fast = gentle(speed=30.0)
    assert kinds(fast) == []
    assert kinds(fast, speed_limit=100.0 / 3.6) == ["speeding"]
    (row,) = [row for row in events(fast, speed_limit=100.0 / 3.6) if row["kind"] == "speeding"]
    assert row["value"] == pytest.approx(30.0)
    assert row["note"] == "8.0 km/h beyond 100 km/h"
    assert kinds(fast, speed_limit=106.0 / 3.6) == []


@given(st.floats(5.0, 50.0), st.floats(5.0, 50.0))
@settings(max_examples=20)
def test_speeding_is_found_above_limit_and_tolerance_alone(speed, limit):
    found = kinds(gentle(speed=speed), speed_limit=limit)
    assert found == (["speeding"] if speed > limit + 3.0 / 3.6 else [])


def test_a_long_stop_ends_a_trip_and_a_short_one_does_not():
    def trips(pause_s):
        rows = events(gentle(pause_s=pause_s), trip_pause=60.0)
        return [row["value"] for row in rows if row["kind"] == "trip"]

    way = 60.0 * 15.0 - 0.5 * 15.0 * 6.0  # less what a ramp of 6 s takes
    assert trips(30.0) == pytest.approx([2 * way], rel=0.01)
    assert trips(90.0) == pytest.approx([way] * 2, rel=0.01)


@pytest.mark.parametrize("every", [1, 100])
def test_a_trip_is_as_long_as_its_way_also_where_it_begins_at_speed(every):
    """From 30 m/s on the brake at 0.5 m/s^2 for 50 s: (30^2 - 5^2) / 2 / 0.5 = 875 m, and 10 s at 5 m/s."""
    accel = np.zeros((6001, 3))
    accel[:5000, 0] = -0.5
    (trip,) = events(trajectory_of(accel, np.zeros(6001), 30.0).take(np.arange(0, 6001, every)))
    assert trip["value"] == pytest.approx(875.0 + 50.0, abs=0.1)


def test_a_gap_of_the_log_ends_a_trip_and_hides_no_event():
    whole = gentle()
    t_s = (time_ns(whole) - START_NS) * 1e-9
    torn = whole.filter((t_s < 20.0) | (t_s > 40.0))
    rows = events(torn, trip_pause=10.0)
    assert [row["kind"] for row in rows] == ["trip", "trip"]


def test_which_limits_were_used_is_told():
    found = told(
        driving(events=None, trajectory=gentle(), params=DrivingParams(thresholds="telematics", harsh_braking=3.0))
    )
    assert found["thresholds_version"]["method"] == "telematics"
    assert found["harsh_braking_limit"]["value"] == 3.0
    assert found["harsh_braking_limit"]["method"] == "given"
    assert found["harsh_acceleration_limit"]["method"] == "telematics 1"
    assert found["harsh_acceleration_limit"]["value"] == pytest.approx(0.20 * G)


def test_every_set_is_whole_and_says_where_it_comes_from():
    assert tuple(sets()) == get_args(DrivingParams.model_fields["thresholds"].annotation)
    for one in sets().values():
        assert one.version >= 1
        assert len(one.source) > 40
        assert all(0.1 * G < one.limits[kind] < G for kind in KINDS)


def test_a_set_that_is_not_there_is_a_wrong_parameter():
    pipeline = Pipeline.from_text(
        "name: x\nsteps: [{use: simulator.drive}, {use: detector.driving, params: {thresholds: nobody}}]"
    )
    _, problems = check(pipeline, Registry.installed())
    assert "must be 'naturalistic', 'telematics' or 'damoov'" in str(ConfigError(problems))


def test_a_slow_trajectory_is_warned_of():
    rows = driving(events=None, trajectory=gentle().take(list(range(0, 6000, 100))), params=DrivingParams())[
        "metrics"
    ].to_pylist()
    assert any(row["name"] == "warning" and "1 rows a second" in row["note"] for row in rows)


# --- simulated drives against the truth ------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[1, 2])
def drive(request):
    """A drive in town of 5 minutes, its truth, and what fuser.map makes of a good box."""
    made = simulate_drive(DriveParams(motion="city", route=request.param, seed=request.param, sensors="automotive"))
    found = fuse_map(imu=made["imu"], gnss=made["gnss"], wheel=None, attitude=None, params=MapParams())
    return made["reference"], found["trajectory"]


def truth(reference):
    """Accelerations along the way and to the left (n,), from the true speed and course alone, low-passed as ours."""
    t_ns, vel = time_ns(reference), matrix(reference, "vel")
    t_s = (t_ns - t_ns[0]) * 1e-9
    speed = np.hypot(vel[:, 0], vel[:, 1])
    rate = np.stack([np.gradient(vel[:, axis], t_s) for axis in (0, 1)], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        along = np.nan_to_num((rate * vel[:, :2]).sum(axis=1) / speed)
        left = np.nan_to_num((vel[:, 0] * rate[:, 1] - vel[:, 1] * rate[:, 0]) / speed)
    return t_ns, speed, *(smoothed(t_ns, values, 2.0, 1.0) for values in (along, left))


MARGIN = 0.25
"""m/s^2; the body leans by 0.4 deg/(m/s^2) and the trajectory's attitude errs by 0.2 deg, which together is 0.1."""


def test_events_agree_with_the_truth_of_the_simulator(drive):
    """What is beyond a limit by a margin is found, and what is found is beyond the limit less the margin."""
    reference, trajectory = drive
    t_ns, speed, along, left = truth(reference)
    limits = {"harsh_acceleration": 1.2, "harsh_braking": 1.6, "harsh_cornering": 1.8}
    found = driving(events=None, trajectory=trajectory, params=DrivingParams(**limits))["events"]
    sizes = {"harsh_acceleration": along, "harsh_braking": -along, "harsh_cornering": np.abs(left)}
    seen = 0
    for kind, limit in limits.items():
        sure = spells(t_ns, (sizes[kind] > limit + MARGIN) & (speed > 11.0 / 3.6), 0.0, 0.3, 1.0)
        possible = spells(t_ns, (sizes[kind] > limit - MARGIN) & (speed > 9.0 / 3.6), 0.0, 0.0, 1.0)
        ours = np.array(spans(found, kind)).reshape(-1, 2)
        for first, last in sure:
            assert ((ours[:, 0] <= t_ns[last]) & (ours[:, 1] >= t_ns[first])).any(), f"{kind} was missed"
        for start, end in ours:
            assert ((t_ns[possible[:, 0]] <= end) & (t_ns[possible[:, 1]] >= start)).any(), f"{kind} was not there"
        seen += len(sure)
    assert seen >= 3


def test_a_trip_is_as_long_as_the_true_way(drive):
    reference, trajectory = drive
    way = np.hypot(*np.diff(matrix(reference, "pos")[:, :2], axis=0).T).sum()
    (row,) = [row for row in events(trajectory) if row["kind"] == "trip"]
    assert row["value"] == pytest.approx(way, rel=0.005)


def test_the_trajectory_of_tests_is_what_it_says():
    """Positions change by velocities, and velocities by accelerations, of the row before."""
    made = braking(0.5 * GRAVITY)
    vel, pos, accel = (matrix(made, name) for name in ("vel", "pos", "accel"))
    assert np.allclose(np.diff(pos[:, 0]) / DT_S, vel[:-1, 0], atol=1e-9)
    assert np.allclose(np.diff(vel[:, 0]) / DT_S, accel[:-1, 0], atol=1e-9)
    assert trajectory_of(np.zeros((5, 3)), np.zeros(5)).num_rows == 5
