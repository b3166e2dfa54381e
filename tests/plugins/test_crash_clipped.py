"""What a clipped accelerometer lost in a crash, told by the speed before and after it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from map_drives import fused

from recon.clipping import lost
from recon.rows import spans, warnings_of
from recon.tables import Streams, matrix, replace, select_rows, time_ns
from recon_analyzers.crash import CrashParams, analyze_crash
from recon_detectors.crash import CrashParams as DetectorParams
from recon_detectors.crash import crash
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

LIMIT = 8 * 9.80665
DELTA_V = 11.0


def wreck(edit: Callable[[Streams], Streams] = dict, full_scale: float | None = None, **params: Any) -> Streams:
    """A crash at 54 km/h of 11 m/s from ahead, whose peak of 22 g the sensor of 8 g does not see.

    full_scale : m/s^2, what detector.crash is told
    """
    usual = {"motion": "crash", "sensors": "consumer_mems", "speed": 15.0, "delta_v": DELTA_V, "pulse": 0.1, "seed": 3}
    log = simulate_drive(DriveParams(**{**usual, "imu_rate": 200.0, "accel_full_scale": LIMIT, **params}))
    log = edit(log)
    log["events"] = crash(imu=log["imu"], params=DetectorParams(full_scale=full_scale))["events"]
    return {**log, **fused(log), "events": log["events"]}


def numbers(log: Streams, *without: str) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Rows by name, and warnings, of what analyzer.crash says without some streams."""
    names = ("trajectory", "imu", "knots", "events", "metrics")
    given = {name: log[name] if name not in without else None for name in names}
    found = analyze_crash(**given, params=CrashParams())["metrics"]
    return {row["name"]: row for row in found.to_pylist()}, warnings_of(found)


def true_delta_v(log: Streams) -> float:
    """Of the truth at 0.3 s after time zero, km/h; largest there, for after the impact the car is still slowed."""
    ((zero_ns, _),) = spans(log["events"], "crash")
    rows = np.searchsorted(time_ns(log["reference"]), [zero_ns, zero_ns + 300_000_000])
    before, after = matrix(log["reference"], "vel")[rows]
    return 3.6 * float(np.linalg.norm(after - before))


@pytest.fixture(scope="module")
def ahead() -> Streams:
    return wreck()


def test_the_change_of_velocity_is_told_as_if_nothing_had_been_clipped(ahead: Streams) -> None:
    rows, warnings = numbers(ahead)
    true = true_delta_v(ahead)
    for name, value in (("delta_v_long_max", -true), ("delta_v_lat_max", 0.0), ("pdof", 0.0)):
        assert rows[name]["low"] < value < rows[name]["high"], name
    told = rows["delta_v_resultant_max"]
    assert told["low"] < true < told["high"]
    assert told["high"] - told["low"] < 3.0
    assert "told by the speed before and after" in told["note"]
    assert any("what it lost is told by the speed before and after" in text for text in warnings)


def test_the_peak_lies_between_a_flat_and_a_pointed_top(ahead: Streams) -> None:
    """The pulse is a haversine of 22.4 g, which CFC 60 hardly lowers."""
    rows, _ = numbers(ahead)
    true = DELTA_V * 2.0 / 0.1 / 9.80665
    assert -rows["accel_peak_cfc60"]["high"] < true < -rows["accel_peak_cfc60"]["low"]
    assert -rows["accel_peak_cfc60"]["value"] == pytest.approx(true, rel=0.15)


def test_from_aside_on_two_axes_of_a_turned_box() -> None:
    log = wreck(direction=np.radians(60.0), mount_yaw=np.radians(40.0), seed=4)
    told = numbers(log)[0]["delta_v_resultant_max"]
    assert told["low"] < true_delta_v(log) < told["high"]
    assert told["high"] - told["low"] < 4.0
    assert "told by the speed before and after" in told["note"]


def test_without_a_trajectory_it_is_as_recorded_with_bounds(ahead: Streams) -> None:
    with_all, _ = numbers(ahead)
    rows, warnings = numbers(ahead, "knots")
    told = rows["delta_v_resultant_max"]
    assert told["value"] < with_all["delta_v_resultant_max"]["value"] - 5.0
    assert "as recorded" in told["note"]
    assert any("as recorded, read the intervals" in text for text in warnings)


def test_where_gnss_ends_with_the_crash_it_is_as_recorded() -> None:
    log = wreck(seed=5)
    ((start_ns, _),) = spans(log["events"], "crash")
    for name in ("gnss", "imu"):  # torn off half a second later
        log[name] = select_rows(log[name], time_ns(log[name]) < start_ns + (500_000_000 if name == "imu" else 0))
    rows, _ = numbers({**log, **fused(log), "events": log["events"]})
    assert "as recorded" in rows["delta_v_resultant_max"]["note"]


def test_what_was_recorded_is_not_changed(ahead: Streams) -> None:
    ((start_ns, stop_ns),) = spans(ahead["events"], "crash")
    t_ns = time_ns(ahead["trajectory"])
    near = (t_ns > start_ns - 500_000_000) & (t_ns < stop_ns + 500_000_000)
    accel = matrix(ahead["trajectory"], "accel")[near]
    cut = lost(t_ns[near], accel, ahead["imu"], ahead["events"], ahead["trajectory"], ahead["knots"])
    assert cut is not None
    rows = np.abs(matrix(ahead["imu"], "accel"))[np.searchsorted(time_ns(ahead["imu"]), t_ns[near])].max(axis=1)
    assert not cut.likely[rows < LIMIT * 0.999].any()
    assert (np.linalg.norm(cut.likely[rows >= LIMIT * 0.999], axis=1) > 1.0).all()
    assert lost(t_ns[near], accel, ahead["imu"], None) is None


def test_a_pulse_that_was_recorded_closes_with_the_speed_before_and_after() -> None:
    rows, warnings = numbers(wreck(accel_full_scale=100 * 9.80665))
    assert rows["delta_v_not_recorded"]["value"] < 3.0 * rows["delta_v_not_recorded"]["sigma"] < 3.0
    assert not any("not in the accelerations" in text for text in warnings)


def test_a_sensor_that_reads_too_little_of_an_impact_is_told_by_the_speed_before_and_after() -> None:
    """Nothing is clipped: towards 30 g it falls behind, by a tenth at the peak of this pulse."""

    def lazy(log: Streams) -> Streams:
        accel = matrix(log["imu"], "accel")
        share = np.linalg.norm(accel, axis=1, keepdims=True) / (30 * 9.80665)
        return {**log, "imu": replace(log["imu"], accel=accel * np.tanh(share) / share)}

    rows, warnings = numbers(wreck(lazy, accel_full_scale=100 * 9.80665))
    assert rows["delta_v_not_recorded"]["value"] > 4.0 * rows["delta_v_not_recorded"]["sigma"]
    assert any("of delta-V are not in the accelerations" in text for text in warnings)


def test_the_range_that_is_told_counts_where_a_single_sample_is_at_its_end() -> None:
    limit = 18 * 9.80665
    told = numbers(wreck(imu_rate=50.0, accel_full_scale=limit, pulse=0.08, full_scale=limit))[0]["delta_v_long_max"]
    alone = numbers(wreck(imu_rate=50.0, accel_full_scale=limit, pulse=0.08))[0]["delta_v_long_max"]
    assert "told by the speed before and after" in told["note"]
    assert "clipped" not in alone["note"]
    assert told["value"] < alone["value"] - 1.0


@pytest.mark.parametrize("limit_g", [8, 16, 100])
def test_inside_the_impact_the_speed_is_as_well_known_as_its_sigma_says(limit_g: int) -> None:
    """What a clipped sensor missed came about at some time inside: up to 5 m/s are not known there, 0.03 m/s beside."""
    log = wreck(accel_full_scale=limit_g * 9.80665)
    ((start_ns, stop_ns),) = spans(log["events"], "crash")
    one, true = log["trajectory"], log["reference"]
    t_ns = time_ns(one)
    inside = (t_ns >= start_ns) & (t_ns <= stop_ns)
    same = np.searchsorted(time_ns(true), t_ns[inside])
    error = matrix(one, "vel")[inside] - matrix(true, "vel")[same]
    ratio = error / matrix(one, "vel_std")[inside]
    assert np.sqrt((ratio**2).mean()) < 1.5
    assert np.abs(ratio).max() < 4.5
