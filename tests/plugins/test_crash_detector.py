from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import crash_pulses as pulses
import numpy as np
import pytest

import recon
from recon.numerics.geodesy import STANDARD_GRAVITY as G
from recon.numerics.rotation import from_euler, rotate
from recon.rows import spans, warnings_of
from recon.schema import IMU, Change
from recon.tables import Array, Streams
from recon_detectors.crash import CrashParams, crash, declare_detectors

KM_H = 1.0 / 3.6
VEHICLE = Change({"accel": "vehicle", "gyro": "vehicle"}, {"accel": "acceleration"}).apply(IMU)


def detected(t_s: Array, accel: Array, **params: Any) -> Streams:
    return crash(imu=pulses.imu_of(t_s, accel), params=CrashParams(**params))


def kinds(found: Streams) -> list[str]:
    return [row["kind"] for row in found["events"].to_pylist()]


def test_time_zero_is_where_the_first_08_km_h_in_20_ms_begin() -> None:
    t_s = pulses.times()
    accel = pulses.at_rest(t_s)
    accel[t_s >= pulses.ZERO_S, 0] -= 50.0
    accel[t_s >= pulses.ZERO_S + 0.1, 0] += 50.0
    ((start, end),) = spans(detected(t_s, accel)["events"], "crash")
    # 0.8 km/h at 50 m/s^2 take 4.4 ms; the interval of 20 ms that ends there begins 15.6 ms before the step. At the end
    # 0.8 km/h remain in the window until 20 - 4.4 ms after it. A sample is 2.5 ms, the step itself half a one.
    assert start * 1e-9 == pytest.approx(pulses.ZERO_S - 0.0156, abs=0.004)
    assert end * 1e-9 == pytest.approx(pulses.ZERO_S + 0.1 + 0.0156, abs=0.004)


@pytest.mark.parametrize("turned", [False, True])
def test_a_crash_that_the_range_of_the_sensor_hides_is_warned_of(turned: bool) -> None:
    """2 g for 60 ms are 4 km/h however hard it was: too little for the trigger. Upright or aslant."""
    t_s = pulses.times()
    accel = pulses.noisy(pulses.crash(t_s, (-30.0 / 3.6, 0.0), 0.06))
    if turned:
        accel = accel @ np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    found = detected(t_s, np.clip(accel, -2.0 * G, 2.0 * G))
    assert not spans(found["events"], "crash")
    (told,) = warnings_of(found["metrics"])
    assert "this may be a crash of which too little was recorded" in told
    advised = float(re.findall(r"trigger='([0-9.]+) km/h'", told)[0])
    assert spans(detected(t_s, np.clip(accel, -2.0 * G, 2.0 * G), trigger=advised * KM_H)["events"], "crash")


@pytest.mark.parametrize(("part", "how"), [(slice(None, 0.05), "the log ends"), (slice(0.08, None), "the log begins")])
def test_a_log_that_ends_or_begins_in_a_crash_says_that_it_may_be_one(part: slice, how: str) -> None:
    """Power may be lost, or come, in the impact: of 20 km/h in 120 ms some 6 are recorded."""
    t_s = pulses.times()
    since, until = (end if end is None else pulses.ZERO_S + end for end in (part.start, part.stop))
    kept = (t_s >= (since or 0.0)) & (t_s < (until or np.inf))
    accel = pulses.noisy(pulses.crash(t_s, (-20.0 / 3.6, 0.0)))[kept]
    found = detected(t_s[kept], accel)
    assert not spans(found["events"], "crash")
    (told,) = warnings_of(found["metrics"])
    assert how in told


@pytest.mark.parametrize("bump", [pulses.pothole, pulses.speed_bump, pulses.railway_crossing, pulses.door_slam])
def test_a_bump_beyond_the_range_of_the_sensor_is_no_hidden_crash(bump: Any) -> None:
    t_s = pulses.times()
    found = detected(t_s, np.clip(pulses.noisy(bump(t_s)), -2.0 * G, 2.0 * G))
    assert not warnings_of(found["metrics"])


@pytest.mark.parametrize(("since_s", "length_ms"), [(0.03, 40), (-0.2, 250)])
def test_a_silence_of_the_imu_in_a_crash_is_told(since_s: float, length_ms: int) -> None:
    """Also one in which the crash begins: time zero is then the first sample after it."""
    t_s = pulses.times()
    accel = pulses.crash(t_s, (-12.0, 0.0), 0.1)
    since_s += pulses.ZERO_S
    silent = (t_s > since_s) & (t_s < since_s + 1e-3 * length_ms)
    (told,) = warnings_of(detected(t_s[~silent], accel[~silent])["metrics"])
    assert f"in 1 of 1 crashes the imu is silent for up to {length_ms} ms" in told
    before = (t_s > pulses.ZERO_S - 0.5) & (t_s < pulses.ZERO_S - 0.4)
    for kept in (~before, np.full(len(t_s), True)):
        assert warnings_of(detected(t_s[kept], accel[kept])["metrics"]) == []


def test_time_zero_is_not_late_on_average_where_samples_are_few() -> None:
    """The crossing lies anywhere between two samples; the nearer one is told, half of a sample off at most."""
    step_s = 0.0025
    off = []
    for phase in np.arange(20) / 20:
        t_s = (np.arange(8000) + phase) * step_s
        accel = pulses.crash(t_s, (-12.0, 0.0), 0.1)
        ((start, _),) = spans(detected(t_s, accel)["events"], "crash")
        off.append(start * 1e-9)
    fine = np.arange(80_000) / 4000.0
    ((start, _),) = spans(detected(fine, pulses.crash(fine, (-12.0, 0.0), 0.1))["events"], "crash")
    error = np.array(off) - start * 1e-9
    # The first sample awake would be half a step late. A line between two samples meets a curve that bends upwards a
    # little early, here by less than a tenth of a step.
    assert abs(error.mean()) < 0.1 * step_s
    assert np.abs(error).max() < 0.65 * step_s


@pytest.mark.parametrize("delta_v", [(-10 * KM_H, 0.0), (0.0, 10 * KM_H), (10 * KM_H, 0.0), (-7 * KM_H, -7 * KM_H)])
def test_a_change_of_10_km_h_triggers_in_every_direction(delta_v: tuple[float, float]) -> None:
    t_s = pulses.times()
    accel = pulses.crash(t_s, delta_v)
    (row,) = detected(t_s, accel)["events"].to_pylist()
    # Time zero lies at the beginning of an interval in which hardly anything has happened yet.
    assert row["value"] == pytest.approx(np.hypot(*delta_v) / KM_H, rel=0.01)
    assert row["unit"] == "km/h"


def test_7_km_h_do_not_trigger() -> None:
    t_s = pulses.times()
    assert kinds(detected(t_s, pulses.crash(t_s, (-7 * KM_H, 0.0)))) == []


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (2.5, 0.3, -1.2)])
@pytest.mark.parametrize(
    "motion",
    [
        pulses.hard_braking,
        pulses.pothole,
        pulses.kerb,
        pulses.door_slam,
        pulses.speed_bump,
        pulses.railway_crossing,
        pulses.gravel,
        pulses.phone_drop,
    ],
)
def test_what_is_no_crash_does_not_trigger(motion: Callable[[Array], Array], mount: tuple[float, float, float]) -> None:
    t_s = pulses.times()
    accel = rotate(from_euler(*mount), pulses.noisy(motion(t_s), 0.3))
    assert "crash" not in kinds(detected(t_s, accel))


def test_a_fall_is_told_and_counts_as_a_crash_only_if_asked() -> None:
    t_s = pulses.times()
    found = detected(t_s, pulses.phone_drop(t_s))
    assert "fall" in kinds(found)
    assert "the box fell" in warnings_of(found["metrics"])[0]
    assert "crash" in kinds(detected(t_s, pulses.phone_drop(t_s), fall=None))


def test_two_impacts_are_two_events_and_nothing_is_dropped() -> None:
    t_s = pulses.times()
    accel = pulses.crash(t_s, (-5.0, 0.0))
    accel[:, 0] -= pulses.pulse(t_s, pulses.ZERO_S + 0.8, 0.1) * 4.0
    found = detected(t_s, accel)
    assert len(spans(found["events"], "crash")) == 2
    assert "largest change of velocity within 150 ms;" in found["events"]["note"][0].as_py()
    assert set(found) == {"events", "metrics"}  # imu is not touched


def test_a_mounted_box_finds_what_a_level_one_finds() -> None:
    t_s = pulses.times()
    accel = pulses.noisy(pulses.crash(t_s, (-8.0, 2.0)))
    plain = detected(t_s, accel)["events"]
    turned = detected(t_s, rotate(from_euler(-3.0, 0.4, 2.0), accel))["events"]
    level = crash(imu=pulses.imu_of(t_s, accel - [0, 0, G], schema=VEHICLE), params=CrashParams())["events"]
    for other in (turned, level):
        # Up is known from ten seconds in which the crash itself leans it by 8 / 10 / g: 0.08 rad, 0.3 % of the size.
        assert other["value"][0].as_py() == pytest.approx(plain["value"][0].as_py(), rel=0.01)
        assert abs(spans(other, "crash")[0][0] - spans(plain, "crash")[0][0]) <= 5_000_000


def test_a_clipped_pulse_is_found() -> None:
    t_s = pulses.times()
    accel = pulses.noisy(pulses.crash(t_s, (-15.0, 0.0)))  # peak 250 m/s^2
    found = detected(t_s, np.clip(accel, -8 * G, 8 * G))
    (row,) = [row for row in found["events"].to_pylist() if row["kind"] == "saturation"]
    assert row["value"] == pytest.approx(8 * G)
    assert "accel x" in row["note"]
    assert "was not recorded" in warnings_of(found["metrics"])[0]
    assert "saturation" not in kinds(detected(t_s, accel))


def test_quantisation_is_no_clipping() -> None:
    t_s = pulses.times(10_000.0)
    accel = pulses.crash(t_s, (-15.0, 0.0))
    coarse = np.round(accel / 0.5) * 0.5  # the smooth top repeats its value
    assert "saturation" not in kinds(detected(t_s, coarse))


def test_a_gap_is_no_crash() -> None:
    t_s = pulses.times()
    accel = pulses.hard_braking(t_s)
    kept = (t_s < pulses.ZERO_S + 0.3) | (t_s > pulses.ZERO_S + 1.2)
    assert kinds(crash(imu=pulses.imu_of(t_s[kept], accel[kept]), params=CrashParams())) == []


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_detectors()] == [[]]


def real(*parts: str) -> Path:
    if "RECON_TEST_DATA" not in os.environ:
        pytest.skip("RECON_TEST_DATA does not name the folder of real logs")
    return Path(os.environ["RECON_TEST_DATA"]).joinpath(*parts)


def test_the_real_crash_is_one_event() -> None:
    imu = recon.read(real("physycom_crash", "crash_01.txt"))["imu"]
    found = crash(imu=imu, params=CrashParams())
    ((start, end),) = spans(found["events"], "crash")
    zero = imu["time"].cast("int64")[0].as_py()
    # Time zero on the logged longitudinal axis is 60.276 s; here gravity is taken off first. A sample is 2.4 ms.
    assert (start - zero) * 1e-9 == pytest.approx(60.276, abs=0.005)
    assert 0.1 < (end - start) * 1e-9 < 0.3
    assert "saturation" not in kinds(found)
