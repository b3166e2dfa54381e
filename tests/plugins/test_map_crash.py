"""fuser.map in a crash: what an impact does to the pulse and to the speed before it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from crash_pulses import pulse
from map_drives import drive, fused
from turned_drives import flung

from recon.driving import impacts_of
from recon.numerics.rotation import angle, conjugate, from_rotvec, multiply, rotate
from recon.rows import spans, warnings_of
from recon.tables import Streams, matrix, replace, seconds, select_rows, time_ns, vector
from recon_detectors.crash import CrashParams, crash
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams


def wreck(seed: int, **params: Any) -> Streams:
    """A crash at 54 km/h, and what detector.crash finds in it."""
    usual = {"motion": "crash", "speed": 15.0, "delta_v": 9.0, "pulse": 0.1, "imu_rate": 200.0, "seed": seed}
    log = simulate_drive(DriveParams(**{**usual, **params}))
    log["events"] = crash(imu=log["imu"], params=CrashParams())["events"]
    return log


def speed_error(log: Streams, found: Streams, t_ns: int) -> tuple[float, float]:
    """Of the horizontal speed at a time, and its sigma: m/s."""
    one, true = found["trajectory"], log["reference"]
    row, same = (int(np.searchsorted(time_ns(table), t_ns)) for table in (one, true))
    speed, wanted = (np.hypot(*matrix(t, "vel")[i, :2]) for t, i in ((one, row), (true, same)))
    return float(speed - wanted), float(np.hypot(vector(one, "vel_std_e")[row], vector(one, "vel_std_n")[row]))


@pytest.fixture(scope="module")
def clipped() -> Streams:
    """An impact whose peak of 18 g the sensor of 8 g does not see."""
    return wreck(3, accel_full_scale=8 * 9.80665)


def test_a_clipped_impact_does_not_spoil_the_speed_before_it(clipped: Streams) -> None:
    ((start, _),) = spans(clipped["events"], "crash")
    with_crash, without = fused(clipped), fused({**clipped, "events": None})
    error, sigma = speed_error(clipped, with_crash, start)
    # About three of the sigmas that the trajectory tells; the model without impacts spreads the loss over two seconds.
    assert abs(error) < 3.0 * sigma + 0.02
    assert abs(speed_error(clipped, without, start)[0]) > 0.5


def test_a_push_from_aside_is_no_reason_to_turn_the_vehicle() -> None:
    log = wreck(5, direction=np.radians(80.0), delta_v=8.0)
    ((_, end),) = spans(log["events"], "crash")
    found = fused(log)
    error, sigma = speed_error(log, found, end + 200_000_000)
    assert abs(error) < 3.0 * sigma
    slip = angle(*(matrix(t, "q")[np.searchsorted(time_ns(t), end)] for t in (found["trajectory"], log["reference"])))
    assert np.degrees(slip) < 1.5  # it moves aside by 28 deg from where it points


def test_biases_do_not_change_in_an_impact(clipped: Streams) -> None:
    knots = fused(clipped)["knots"]
    ((start, end),) = spans(clipped["events"], "crash")
    t_ns = time_ns(knots)
    first, last = int(np.argmin(np.abs(t_ns - start))), int(np.argmin(np.abs(t_ns - end)))
    assert last == first + 1  # knots at both ends
    assert abs(t_ns[first] - start) <= 5_000_000
    steps = np.abs(np.diff(matrix(knots, "accel_bias"), axis=0)).max(axis=1)
    # Steps go with the square root of the time: 0.1 s times 1e-4 against 2 s, 2e-3 of an ordinary one, which are tiny.
    assert steps[first] < 0.05 * np.delete(steps, first).max() + 1e-9


def test_every_sample_of_the_pulse_is_in_the_trajectory(clipped: Streams) -> None:
    found, imu = fused(clipped)["trajectory"], clipped["imu"]
    ((start, end),) = spans(clipped["events"], "crash")
    inside = [t[(t >= start) & (t <= end)] for t in (time_ns(found), time_ns(imu))]
    np.testing.assert_array_equal(*inside)


def test_a_drive_without_a_crash_is_solved_as_ever() -> None:
    log = simulate_drive(DriveParams(motion="s_curve", imu_rate=100.0, seed=1))
    log["events"] = crash(imu=log["imu"], params=CrashParams())["events"]
    plain = fused({**log, "events": None})["trajectory"]
    assert fused(log)["trajectory"].equals(plain)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_spin_beyond_the_range_of_the_gyroscope_leaves_an_honest_heading(seed: int) -> None:
    """The box tells 250 of 350 deg/s; without more the heading would be 17 deg off, and told to half a degree."""
    log = wreck(seed, spin=3.0, direction=1.0, gyro_full_scale=np.radians(250.0))
    found = fused(log)
    ((start, _),) = spans(log["events"], "crash")
    (warned,) = (text for text in warnings_of(found["metrics"]) if "gyroscope was at the end of its range" in text)
    assert re.search(r"it may have turned \d\d deg further", warned)
    one, true = found["trajectory"], log["reference"]
    for t_ns in (start - 1_000_000_000, start + 3_000_000_000):
        row, same = (int(np.searchsorted(time_ns(table), t_ns)) for table in (one, true))
        off = angle(matrix(one, "q")[row], matrix(true, "q")[same])
        sigma = np.linalg.norm([vector(one, f"att_std_{name}")[row] for name in ("roll", "pitch", "yaw")])
        assert off < 3.0 * sigma
        assert sigma < np.radians(2.0)


def test_a_gyroscope_within_its_range_is_believed() -> None:
    log = wreck(3, spin=3.0, direction=1.0)
    assert all(impact.turn == 0.0 for impact in impacts_of(log["imu"], log["events"], 0.01, 10.0))
    assert not any("end of its range" in text for text in warnings_of(fused(log)["metrics"]))


@pytest.mark.parametrize("turns", [0.25, 0.5, 1.5])
def test_a_vehicle_that_rolls_over_is_followed(turns: float) -> None:
    """Onto its side, its roof, and one and a half times: no road is level there, and no wheel binds."""
    log = wreck(6, direction=1.2, accel_bias=0.0, gyro_bias=0.0)  # which would roll with the box
    ((start, _),) = spans(log["events"], "crash")
    share = np.clip((time_ns(log["imu"]) - start - 200_000_000) / 1.5e9, 0.0, 1.0)
    about = np.array([2.0 * np.pi * turns, 0.0, 0.0])
    q_rolled = from_rotvec((share**2 * (3.0 - 2.0 * share))[:, None] * about)
    accel, gyro = (rotate(conjugate(q_rolled), matrix(log["imu"], name)) for name in ("accel", "gyro"))
    gyro += (6.0 * share * (1.0 - share) / 1.5)[:, None] * about
    found = fused({**log, "imu": replace(log["imu"], accel=accel, gyro=gyro)})
    (note,) = warnings_of(found["metrics"])
    assert re.search(r"the vehicle leans by (\d+) deg: unless it lay so", note)
    one, true = found["trajectory"], log["reference"]
    for t_ns in (start - 1_000_000_000, start + 1_000_000_000, start + 3_000_000_000):
        row, same = (int(np.searchsorted(time_ns(table), t_ns)) for table in (one, true))
        at = int(np.searchsorted(time_ns(log["imu"]), t_ns))
        off = angle(matrix(one, "q")[row], multiply(matrix(true, "q")[same], q_rolled[at]))
        sigma = np.linalg.norm([vector(one, f"att_std_{name}")[row] for name in ("roll", "pitch", "yaw")])
        assert off < 3.0 * sigma
        assert np.linalg.norm(matrix(one, "vel")[row] - matrix(true, "vel")[same]) < 0.15


def test_an_impact_right_at_the_beginning_has_sigmas_without_a_fault() -> None:
    """It begins between the first knot and the next, where rounding puts a share of the interval beyond one."""
    log = drive(seed=1, duration=90.0, imu_rate=200.0)
    struck = pulse(seconds(log["imu"]), 0.025, 0.1)[:, None] * np.array([4.0, 0.0, 0.0])
    imu = replace(log["imu"], accel=matrix(log["imu"], "accel") + struck)
    events = crash(imu=imu, params=CrashParams())["events"]
    assert spans(events, "crash")
    assert np.isfinite(matrix(fused({**log, "imu": imu, "events": events})["trajectory"], "vel_std")).all()


@pytest.mark.parametrize("seed", [0, 4, 6, 23])
def test_a_box_that_the_crash_flings_out_of_its_mount_still_tells_the_speed_before(seed: int) -> None:
    """It turns by 90 deg about any axis while it is struck, and the vehicle seems to lie on its side from then on.

    The last time a fix lies at the edge of the impact: which side of it depends on the delay that is believed.
    """
    log = wreck(seed, speed=12.0, rest=20.0)
    ((start, _),) = spans(log["events"], "crash")
    about = np.random.default_rng(seed).standard_normal(3)
    q_flung = from_rotvec(0.5 * np.pi * about / np.linalg.norm(about))
    found = fused({**log, "imu": flung(log, q_flung, (start - time_ns(log["imu"])[0]) * 1e-9)})
    error, sigma = speed_error(log, found, start)
    assert abs(error) < 3.0 * sigma
    (note,) = warnings_of(found["metrics"])
    assert "the box left its mount" in note
    assert not any("the box left its mount" in note for note in warnings_of(fused(log)["metrics"]))


@pytest.mark.parametrize("seed", range(8))
def test_while_it_spins_the_trajectory_is_as_good_between_knots_as_at_them(seed: int) -> None:
    """What scale errors and biases do in a spin is not shared out evenly over the time from knot to knot."""
    log = wreck(seed, direction=1.4, delta_v=6.0, spin=2.5, accel_bias=0.4, gyro_scale=0.006, accel_full_scale=1e4)
    ((_, end),) = spans(log["events"], "crash")
    found = fused(log)["trajectory"]
    rows = slice(*np.searchsorted(time_ns(found), [end, end + 3_000_000_000]))
    same = np.searchsorted(time_ns(log["reference"]), time_ns(found)[rows])
    off = matrix(found, "vel")[rows] - matrix(log["reference"], "vel")[same]
    q_true, q = matrix(log["reference"], "q")[same], matrix(found, "q")[rows]
    heading = 2.0 * (multiply(q, conjugate(q_true)) * np.sign((q * q_true).sum(axis=1))[:, None])[:, 3]
    # Beyond 4.5 sigmas lie 7e-6 of errors; the rows of three seconds are nearly one.
    assert np.abs(off / matrix(found, "vel_std")[rows]).max() < 4.5
    assert np.abs(heading / vector(found, "att_std_yaw")[rows]).max() < 4.5


@pytest.mark.parametrize(("since_s", "jolted"), [(0.05, True), (3.0, False)])
def test_a_crash_in_a_silence_of_the_imu_is_a_doubt(since_s: float, jolted: bool) -> None:
    """A logger whose power fails in the impact, and one that failed before it, where nothing happened."""
    log = wreck(11, delta_v=7.0)
    ((start, _),) = spans(log["events"], "crash")
    t_ns = time_ns(log["imu"])
    since = start - round(since_s * 1e9)
    imu = select_rows(log["imu"], (t_ns < since) | (t_ns > since + 300_000_000))
    notes = warnings_of(fused({**log, "imu": imu, "events": crash(imu=imu, params=CrashParams())["events"]})["metrics"])
    assert any("a crash or a jolt may lie in one of them" in note for note in notes) == jolted
