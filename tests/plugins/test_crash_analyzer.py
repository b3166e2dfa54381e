from __future__ import annotations

import re
from typing import Any

import crash_pulses as pulses
import numpy as np
import pytest
from metric_rows import rows_by_name

from recon.knots import SIZE, Knots
from recon.numerics.budget import Uncertain
from recon.numerics.geodesy import STANDARD_GRAVITY as G
from recon.numerics.rotation import from_rotvec, rotate
from recon.rows import warnings_of
from recon.schema import IMU, KNOTS, TRAJECTORY, Change
from recon.tables import Array, Streams, build
from recon_analyzers._impact_state import speed_at
from recon_analyzers._pulse import LINEARITY
from recon_analyzers.crash import CrashParams, _speed_of_impact, analyze_crash, declare_analyzers
from recon_detectors.crash import CrashParams as DetectorParams
from recon_detectors.crash import crash as detect

VEHICLE = Change({"accel": "vehicle", "gyro": "vehicle"}, {"accel": "acceleration"}).apply(IMU)
SENSOR = IMU

NAMES = [
    "delta_v_long_max", "delta_v_lat_max", "delta_v_resultant_max", "time_of_max", "accel_peak_cfc60", "pdof",
    "speed_before", "asi_1998", "asi_2010", "thiv", "phd", "oiv_long", "oiv_lat", "ridedown",
]  # fmt: skip


def analyzed(t_s: Array, accel: Array, gyro: Array | None = None, schema: Any = VEHICLE) -> Streams:
    """Of an imu in the vehicle, gravity taken off unless it is one of the sensor."""
    accel = accel if schema is SENSOR else accel - [0.0, 0.0, G]
    imu = pulses.imu_of(t_s, accel, gyro, schema)
    events = detect(imu=imu, params=DetectorParams())["events"]
    return analyze_crash(trajectory=None, imu=imu, knots=None, events=events, metrics=None, params=CrashParams())


def test_a_haversine_pulse_gives_what_its_formulas_say() -> None:
    t_s = pulses.times(1000.0)
    rows = rows_by_name(analyzed(t_s, pulses.crash(t_s, (-12.0, 0.0), 0.1)))
    # Trapezoids are exact for a haversine; time zero lies 6 ms or so before the pulse does anything.
    assert rows["delta_v_long_max"]["value"] == pytest.approx(-43.2, abs=0.01)
    assert rows["pdof"]["value"] == pytest.approx(0.0, abs=0.01)
    # Mean over the middle 50 ms: (1/2 + 1/pi) of 2 dv / T.
    assert rows["asi_1998"]["value"] == pytest.approx(240.0 * (0.5 + 1 / np.pi) / (12 * G), rel=2e-3)
    # CFC 60 takes little off a haversine of 10 Hz.
    assert rows["accel_peak_cfc60"]["value"] == pytest.approx(-240.0 / G, rel=5e-3)
    # After the pulse the head flies on at dv.
    assert rows["thiv"]["value"] == pytest.approx(43.2, rel=5e-3)
    assert rows["oiv_long"]["value"] == pytest.approx(43.2, rel=5e-3)
    assert rows["phd"]["value"] < 5.0


def test_every_number_of_the_field_has_a_sigma_and_an_interval_that_holds_it() -> None:
    t_s = pulses.times()
    rows = rows_by_name(analyzed(t_s, pulses.noisy(pulses.crash(t_s, (-9.0, 3.0)))))
    assert set(NAMES) <= set(rows)
    for name in set(NAMES) - {"speed_before", "time_of_max"}:
        row = rows[name]
        assert row["low"] <= row["value"] <= row["high"], name
        assert row["sigma"] > 0.0, name
        assert "sigma from" in row["note"], name
        assert row["method"], name


def test_with_several_impacts_the_severest_is_told_and_all_are_listed() -> None:
    t_s = pulses.times()
    accel = pulses.crash(t_s, (-4.0, 0.0))
    accel[:, 0] -= pulses.pulse(t_s, pulses.ZERO_S + 2.0, 0.1) * 9.0
    found = analyzed(t_s, accel)
    impacts = [row for row in found["events"].to_pylist() if row["kind"] == "impact"]
    assert [round(row["value"] / 3.6, 1) for row in impacts] == [4.0, 9.0]
    assert rows_by_name(found)["delta_v_long_max"]["value"] == pytest.approx(-9.0 * 3.6, rel=1e-3)
    assert rows_by_name(found)["impacts"]["value"] == 2.0


@pytest.mark.parametrize("apart_s", [0.4, 1.2])
def test_a_crash_before_is_no_noise_of_the_one_after(apart_s: float) -> None:
    """Half a minute later the second one has the same interval."""

    def interval(seconds: float) -> Array:
        t_s = pulses.times(length_s=60.0)
        accel = pulses.noisy(pulses.crash(t_s, (-6.0, 0.0)))
        accel[:, 0] -= pulses.pulse(t_s, pulses.ZERO_S + seconds, 0.1) * 9.0
        row = rows_by_name(analyzed(t_s, accel))["delta_v_resultant_max"]
        return np.array([row["low"], row["high"]]) - row["value"]

    # the draws of noise have a tenth, and what was drawn on half a second of samples another
    assert interval(apart_s) == pytest.approx(interval(30.0), rel=0.3)


def test_a_peak_is_told_whole_whose_samples_come_a_little_unevenly() -> None:
    """As of a box whose steps are 2.0 to 2.9 ms: what it felt is known at its times, and CFC 60 wants even ones."""
    even_s = pulses.times(2000.0)

    def felt(t_s: Array) -> Array:
        accel = pulses.crash(t_s, (-6.0, 0.0), 0.1)
        accel[:, 2] += 40.0 * pulses.pulse(t_s, pulses.ZERO_S, 0.1) * 0.05 * np.sin(2.0 * np.pi * 65.0 * t_s)
        return accel

    steps_s = np.random.default_rng(1).uniform(2.0e-3, 2.8e-3, round(pulses.LENGTH_S / 2.4e-3))
    uneven_s = np.cumsum(steps_s)
    wanted, told = (
        rows_by_name(analyzed(t_s, felt(t_s)))["accel_peak_cfc60_magnitude"]["value"] for t_s in (even_s, uneven_s)
    )
    assert told == pytest.approx(wanted, rel=2e-3)


def test_a_delta_v_that_still_grows_has_its_largest_at_the_end_of_what_is_looked_at() -> None:
    t_s = pulses.times()
    row = rows_by_name(analyzed(t_s, pulses.noisy(pulses.crash(t_s, (-15.0, 0.0), 0.5))))["time_of_max"]
    assert row["value"] == pytest.approx(0.3, abs=1e-3)
    assert row["low"] < row["value"] <= row["high"] == max(0.3, row["value"])
    assert "perhaps behind the 300 ms looked at" in row["note"]


def test_a_clipped_pulse_has_bounds_that_hold_the_truth() -> None:
    t_s = pulses.times(1000.0)
    accel = pulses.noisy(pulses.crash(t_s, (-15.0, 0.0)))
    found = analyzed(t_s, np.clip(accel, -16 * G, 16 * G))
    row = rows_by_name(found)["delta_v_long_max"]
    assert row["low"] < -15.0 * 3.6 < row["high"]
    assert row["value"] > -15.0 * 3.6 + 1.0
    assert "clipped" in row["note"]
    assert any("clipped" in text for text in warnings_of(found["metrics"]))


def test_a_scale_error_of_the_data_sheet_is_in_the_intervals() -> None:
    t_s = pulses.times()
    imu = pulses.imu_of(t_s, pulses.crash(t_s, (-12.0, 0.0)) - [0.0, 0.0, G], None, VEHICLE)
    events = detect(imu=imu, params=DetectorParams())["events"]
    for told, scale in ((None, 0.004), (0.03, 0.03)):
        params = CrashParams(accel_scale=told)
        found = analyze_crash(trajectory=None, imu=imu, knots=None, events=events, metrics=None, params=params)
        row = rows_by_name(found)["delta_v_long_max"]
        share = float(re.findall(r"scale ([\d.]+)", row["note"])[0])
        assert share == pytest.approx(np.hypot(scale, LINEARITY) * abs(row["value"]), rel=0.02)


def test_without_forward_only_sizes_are_told() -> None:
    t_s = pulses.times()
    found = analyzed(t_s, pulses.noisy(pulses.crash(t_s, (-9.0, 3.0))), schema=SENSOR)
    rows = rows_by_name(found)
    assert rows["delta_v_resultant_max"]["value"] == pytest.approx(np.hypot(9.0, 3.0) * 3.6, rel=0.01)
    assert rows["delta_v_long_max"]["value"] is None
    assert rows["pdof"]["value"] is None
    assert any("which way is forward" in text for text in warnings_of(found["metrics"]))


def test_a_drive_without_a_crash_has_no_impact() -> None:
    t_s = pulses.times()
    rows = rows_by_name(analyzed(t_s, pulses.hard_braking(t_s)))
    assert rows["impacts"]["value"] == 0.0
    assert "delta_v_long_max" not in rows


@pytest.mark.parametrize("lead_s", [0.03, 0.08, 0.12])
def test_an_impact_shortly_after_the_first_row_has_its_numbers(lead_s: float) -> None:
    """However little there is before it to tell noise from."""
    t_s = pulses.times()
    kept = t_s >= pulses.ZERO_S - lead_s
    found = analyzed(t_s[kept], pulses.noisy(pulses.crash(t_s, (-9.0, 0.0)))[kept])
    row = rows_by_name(found)["delta_v_long_max"]
    assert row["low"] <= -9.0 * 3.6 <= row["high"]
    assert not any("begins in the impact" in note for note in warnings_of(found["metrics"]))


def test_a_log_that_begins_in_the_impact_says_that_the_rest_of_it_is_in_no_number() -> None:
    t_s = pulses.times()
    kept = t_s >= pulses.ZERO_S + 0.04
    found = analyzed(t_s[kept], pulses.crash(t_s, (-9.0, 0.0))[kept])
    assert rows_by_name(found)["delta_v_long_max"]["value"] > -8.0 * 3.6
    assert any("begins in the impact" in note for note in warnings_of(found["metrics"]))


@pytest.mark.parametrize(("turn_deg", "told"), [
    ((0.0, 0.0, 0.0), ""), ((3.0, -2.0, 0.0), ""), ((0.0, 0.0, 90.0), ""),
    ((0.0, 12.0, 40.0), "leans by 12 deg"), ((-90.0, 0.0, 0.0), "leans by 90 deg"),
])  # fmt: skip
def test_a_box_that_leans_otherwise_after_the_crash_is_warned_of(turn_deg: tuple[float, ...], told: str) -> None:
    """The vehicle may have tipped; a box that was knocked in its mount feels the same, and its axes are then wrong."""
    leaning = [note for note in _turned(turn_deg, 0.1) if note.startswith("after the crash the box leans")]
    assert len(leaning) == bool(told)
    assert told in " ".join(leaning)


@pytest.mark.parametrize(("turn_deg", "told"), [
    ((0.0, 12.0, 300.0), ""), ((90.0, 0.0, 0.0), "up to 90 deg"), ((-360.0, 0.0, 0.0), "up to 180 deg"),
])  # fmt: skip
def test_a_vehicle_that_rolls_over_is_warned_of_also_where_it_lands_on_its_wheels(
    turn_deg: tuple[float, ...], told: str
) -> None:
    rolling = [note for note in _turned(turn_deg, 3.0) if "rolls over" in note]
    assert len(rolling) == bool(told)
    assert told in " ".join(rolling)


def _turned(turn_deg: tuple[float, ...], lasts_s: float) -> list[str]:
    """Warnings of a vehicle that turns from time zero on."""
    t_s = pulses.times()
    turned = np.clip(t_s - pulses.ZERO_S, 0.0, lasts_s)[:, None] / lasts_s * np.radians(turn_deg)
    accel = pulses.crash(t_s, (-9.0, 0.0)) - [0.0, 0.0, G]
    none = np.zeros_like(accel)
    time = np.rint(t_s * 1e9).astype(np.int64)
    trajectory = build(TRAJECTORY, time=time, pos=none, vel=none, q=from_rotvec(turned), accel=accel, gyro=none)
    events = detect(imu=pulses.imu_of(t_s, accel, None, VEHICLE), params=DetectorParams())["events"]
    found = analyze_crash(
        trajectory=trajectory, imu=None, knots=None, events=events, metrics=None, params=CrashParams()
    )  # fmt: skip
    return warnings_of(found["metrics"])


@pytest.mark.parametrize(("way", "told"), [
    ((9.0, 1.0), "horizontal"), ((0.01, -0.02), "horizontal"),
    ((-9.0, 1.0), "horizontal, backwards"), ((2.0, 9.0), "horizontal, sideways to the left"),
])  # fmt: skip
def test_a_speed_before_that_was_not_ahead_says_so(way: tuple[float, float], told: str) -> None:
    """A crash in reverse would be read as one from behind; what stands goes nowhere."""
    t_s = pulses.times()
    accel = pulses.crash(t_s, (9.0, 0.0)) - [0.0, 0.0, G]
    none = np.zeros_like(accel)
    q = np.tile(from_rotvec(np.array([0.0, 0.0, 2.0])), (len(t_s), 1))
    vel = rotate(q, np.array([*way, 0.0]))
    time = np.rint(t_s * 1e9).astype(np.int64)
    trajectory = build(TRAJECTORY, time=time, pos=none, vel=vel, q=q, accel=accel, gyro=none, vel_std=none + 0.05)
    events = detect(imu=pulses.imu_of(t_s, accel, None, VEHICLE), params=DetectorParams())["events"]
    found = analyze_crash(
        trajectory=trajectory, imu=None, knots=None, events=events, metrics=None, params=CrashParams()
    )  # fmt: skip
    assert rows_by_name(found)["speed_before"]["note"] == told


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_analyzers()] == [[]]


def test_the_speed_before_a_wall_has_the_lopsided_interval_of_a_clipped_delta_v() -> None:
    """Speeds are delta-V over 1 + e; with e known exactly, so are the ends of the interval."""
    gained = Uncertain(30.0, 3.0, 29.0, 38.0, {"clipping": 3.0}, True)
    found = _speed_of_impact(gained, 0.2, 0.0)
    assert (found.value, found.low, found.high) == pytest.approx((25.0, 29.0 / 1.2, 38.0 / 1.2))
    wider = _speed_of_impact(gained, 0.2, 0.05)
    assert wider.note == "if it came against something that did not move, with a restitution of 0.2, sigma 0.05"
    assert wider.low < found.low
    assert wider.high > found.high


@pytest.mark.parametrize("course_deg", [0.0, 20.0, 45.0, 135.0, 250.0])
def test_the_sigma_of_the_speed_before_is_that_along_the_way_in_all_directions(course_deg: float) -> None:
    """0.1 m/s along and 0.5 m/s across, and the other way round, where a sigma without the correlation is too small."""
    east, north = np.sin(np.radians(course_deg)), np.cos(np.radians(course_deg))
    turn = np.array([[east, north], [north, -east]])  # columns: along, across
    time = np.array([0, 5, 10]) * 10**9
    for sigmas in ([0.1, 0.5], [0.5, 0.1]):
        spread = turn @ np.diag(np.square(sigmas)) @ turn.T
        root = np.zeros((3, SIZE, SIZE))
        root[:, 3:5, 3:5] = np.linalg.cholesky(spread)
        none = np.zeros((3, SIZE, 1))
        knots = build(KNOTS, time=time, **Knots(time, root, 0.0 * root[1:], none, np.zeros(3), np.zeros(3)).columns())
        vel_std = np.tile([*np.sqrt(np.diag(spread)), 0.1], (3, 1))
        vel = np.tile([10.0 * east, 10.0 * north, 0.0], (3, 1))
        trajectory = build(TRAJECTORY, time=time, pos=vel, vel=vel, q=np.tile([1.0, 0, 0, 0], (3, 1)), vel_std=vel_std)
        for zero_ns in time.tolist():
            assert speed_at(trajectory, zero_ns, knots) == pytest.approx((10.0, sigmas[0]), rel=1e-5)
