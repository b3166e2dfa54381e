"""The crash pipeline on real logs: what others measured on them must come out."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import yaml

import recon
from recon.numerics import severity
from recon.numerics.channel_class import channel_class
from recon.numerics.geodesy import STANDARD_GRAVITY as G
from recon.numerics.integration import cumulative
from recon.numerics.moving_window import moving_average
from recon.numerics.rotation import rotate
from recon.parameters import bind
from recon.problems import Where
from recon.rows import spans, warnings_of
from recon.schema import IMU, Change
from recon.tables import Array, Streams, build, matrix, replace, seconds, time_ns
from recon.yaml_nodes import Node
from recon_analyzers.crash import CrashParams, analyze_crash
from recon_detectors.crash import CrashParams as DetectorParams
from recon_detectors.crash import crash as detect
from recon_exporters._crash_pulse import _panels
from recon_readers.csv import CsvParams
from recon_readers.csv import read as read_csv

VEHICLE = Change({"accel": "vehicle", "gyro": "vehicle"}, {"accel": "acceleration"}).apply(IMU)
KM_H = 1.0 / 3.6


@pytest.fixture(scope="module")
def logs() -> Path:
    if "RECON_TEST_DATA" not in os.environ:
        pytest.skip("RECON_TEST_DATA does not name the folder of real logs")
    return Path(os.environ["RECON_TEST_DATA"])


@pytest.fixture(scope="module")
def imu(logs: Path) -> pa.Table:
    """The box of the real crash."""
    return recon.read(logs / "physycom_crash" / "crash_01.txt")["imu"]


@pytest.fixture(scope="module")
def run(logs: Path) -> recon.Run:
    """The whole pipeline on the real crash."""
    return recon.run("crash", logs / "physycom_crash" / "crash_01.txt")


@pytest.fixture(scope="module")
def car(run: recon.Run) -> dict[str, Any]:
    """Its rows of metrics by name."""
    assert run.metrics is not None
    return {row["name"]: row for row in run.metrics.to_pylist()}


def analyzed(imu: Any, params: CrashParams | None = None) -> Streams:
    events = detect(imu=imu, params=DetectorParams())["events"]
    params = params or CrashParams()
    return analyze_crash(trajectory=None, imu=imu, knots=None, events=events, metrics=None, params=params)


def largest_across(t_s: Array, accel: Array, zero_s: float) -> float:
    """Largest change of velocity along y within 300 ms of time zero, km/h."""
    near = (t_s > zero_s - 1e-3) & (t_s < zero_s + 0.3)
    return float(np.abs(cumulative(t_s[near], accel[near], "trapezoid")[:, 1]).max()) / KM_H


def turned(accel: Array, yaw_deg: float) -> Array:
    yaw = np.radians(yaw_deg) / 2.0
    return rotate(np.array([np.cos(yaw), 0.0, 0.0, np.sin(yaw)]), accel)


def test_the_numbers_measured_on_the_logged_axes_come_out_on_them(imu: pa.Table) -> None:
    """The measurement takes every step for 2.4 ms, which are 2.435 on average, and the mean at rest for zero."""
    t_s, accel = seconds(imu), matrix(imu, "accel")
    step_s, zero = 2.4e-3, int(np.searchsorted(t_s, 60.271))
    still = accel[t_s < 40.0].mean(axis=0)  # offset and gravity
    near = slice(zero - 208, zero + 600)
    seen = accel[near]
    gained = severity.integral(seen[208:] - still, step_s) / KM_H
    # Half of the last digit that is told.
    assert np.abs(channel_class(seen, 60, 1 / step_s)[:, 0]).max() / G == pytest.approx(5.87, abs=0.01)
    assert gained[104, 0] == pytest.approx(11.87, abs=0.01)
    assert np.abs(gained[:126, 0]).max() == pytest.approx(12.25, abs=0.01)
    assert np.abs(gained[:126, 1]).max() == pytest.approx(0.83, abs=0.005)
    assert severity.asi(seen - [0.0, 0.0, G], step_s, "1998").max() == pytest.approx(0.381, rel=0.02)


def test_seconds_count_from_the_first_line_of_the_log(imu: pa.Table, run: recon.Run) -> None:
    """No event begins before it: a standstill is told in blocks, whose edges lie between two lines."""
    assert run.recording.span_ns() == (int(time_ns(imu)[0]), int(time_ns(imu)[-1]))
    assert run.events is not None
    first = min(row["time"] for row in run.events.to_pylist() if row["kind"] == "standstill")
    assert first == imu["time"][0].as_py()


def test_the_pipeline_gives_the_same_in_the_axes_of_the_vehicle(car: dict[str, Any]) -> None:
    """Box x points to the rear, so the sign is another."""
    for name, wanted in (("delta_v_long_max", -12.25), ("accel_peak_cfc60", -5.87), ("asi_1998", 0.381)):
        assert car[name]["value"] == pytest.approx(wanted, rel=0.08)
        assert car[name]["low"] < car[name]["value"] < car[name]["high"]
    assert abs(car["pdof"]["value"]) < 5.0


def test_across_the_two_differ_by_the_yaw_of_the_mounting_alone(
    imu: pa.Table, run: recon.Run, car: dict[str, Any]
) -> None:
    """Across, 1.5 deg take a share of 8.6 km/h out of 0.83; in one pair of axes both agree, whichever that is."""
    table, told, yaw = run.recording["trajectory"], car["delta_v_lat_max"], car["mount_yaw"]["value"]
    zero_s = (spans(run.events, "crash")[0][0] - int(time_ns(imu)[0])) * 1e-9
    t_s = (time_ns(table) - time_ns(imu)[0]) * 1e-9
    assert largest_across(t_s, turned(matrix(table, "accel"), -yaw), zero_s) == pytest.approx(0.83, rel=0.08)
    raw = matrix(imu, "accel") - matrix(imu, "accel")[seconds(imu) < 40.0].mean(axis=0)
    logged = largest_across(seconds(imu), turned(raw, yaw), zero_s)
    assert told["value"] == pytest.approx(logged, rel=0.08)
    assert told["low"] < logged < told["high"]


def test_the_car_itself_shows_that_the_box_sits_askew(imu: pa.Table, car: dict[str, Any]) -> None:
    """Pulling away straight ahead, a car accelerates along its own x: what the box feels across tells its yaw."""
    t_s, accel, gyro = seconds(imu), matrix(imu, "accel"), matrix(imu, "gyro")
    still, away = t_s < 40.0, (t_s > 52.6) & (t_s < 60.2)
    felt, turn = (y[away] - y[still].mean(axis=0) for y in (accel, gyro))
    assert abs(np.degrees(cumulative(t_s[away], turn, "trapezoid")[-1, 2])) < 1.0
    speed = cumulative(t_s[away], -felt, "trapezoid")[:, 0]
    across = felt[:, 1] + speed * turn[:, 2]  # y of the box points right, so bends push it to negative
    quiet = moving_average(np.column_stack([felt[:, 0], across]), 101)  # the engine shakes both axes at once
    slope, _ = np.polyfit(*quiet.T, 1)
    askew = car["mount_yaw"]["value"] + 180.0
    assert np.degrees(np.arctan(-slope)) == pytest.approx(askew, abs=2.0 * car["mount_yaw"]["sigma"])


def test_the_speed_before_agrees_with_gnss_once_its_lag_is_off(car: dict[str, Any]) -> None:
    # GNSS of this log is noisy by 0.8 km/h at rest, with errors of a second: 0.5 km/h over two seconds.
    assert abs(car["speed_before_less_gnss"]["value"]) < 1.0
    assert car["gnss_delay"]["value"] + car["gnss_velocity_delay"]["value"] == pytest.approx(0.3, abs=0.1)
    assert 22.0 < car["speed_before"]["value"] < 26.0


def test_the_speed_before_lies_between_those_summed_up_from_either_standstill(
    imu: pa.Table, car: dict[str, Any]
) -> None:
    """Forward integration from rest and backward from rest after, with the pitch that the gyroscope felt and without.

    A car that squats and dives feels gravity along its x: as if it stayed level it would be 1.4 km/h fast at rest.
    """
    t_s, accel, gyro = seconds(imu), matrix(imu, "accel"), matrix(imu, "gyro")
    still, way, after = (t_s > 45.0) & (t_s < 50.0), (t_s > 50.0) & (t_s < 64.4), (t_s > 63.9) & (t_s < 64.4)
    forward = -(accel[:, 0] - accel[still, 0].mean())
    nose_down = cumulative(t_s[way], gyro[way, 1] - gyro[still, 1].mean(), "trapezoid")
    begins, at_rest = int(np.searchsorted(t_s[way], 60.273)), after[way]
    # Where it stands in the end, the gyroscope and gravity tell the same slope.
    slope = -(accel[after, 0].mean() - accel[still, 0].mean()) / G
    assert np.degrees(nose_down[at_rest].mean() - slope) == pytest.approx(0.0, abs=0.1)
    found = []
    for felt in (forward[way], forward[way] - G * nose_down):
        speed = cumulative(t_s[way], felt, "trapezoid") / KM_H
        found.append((speed[begins], speed[begins] - speed[at_rest].mean()))
    (level, level_back), (pitched, pitched_back) = found
    assert (level, level_back) == pytest.approx((24.7, 26.1), abs=0.1)
    assert (pitched, pitched_back) == pytest.approx((23.5, 24.0), abs=0.1)
    told = car["speed_before"]
    assert pitched < told["value"] < pitched_back
    assert told["low"] < (pitched + pitched_back) / 2.0 < told["high"]
    assert level > told["high"]


# --- a car against a wall: NHTSA test 10146, 57.09 km/h -------------------------------------------------------------

REAR = ["imu", "imu_2", "imu_4", "imu_5"]
"""Under the rear seats; imu_3 is the engine's."""


@pytest.fixture(scope="module")
def barrier(logs: Path) -> recon.Recording:
    return recon.read(logs / "nhtsa_v10146_camry")


@pytest.mark.parametrize("name", REAR)
def test_the_barrier_test_changes_the_velocity_by_impact_and_rebound(barrier: recon.Recording, name: str) -> None:
    """With the speed that the file tells: rear seats of cars come back with 10 to 20 % of it."""
    rows = {row["name"]: row for row in analyzed(barrier[name])["metrics"].to_pylist()}
    impact = next(row["value"] for row in barrier["metrics"].to_pylist() if row["name"] == "closing_speed") / KM_H
    assert impact == pytest.approx(57.09)
    assert 0.1 < -rows["delta_v_long_max"]["value"] / impact - 1.0 < 0.2
    for across in ("pdof", "delta_v_lat_max", "oiv_lat"):  # no channel measured it
        assert rows[across]["value"] is None
        assert "not measured" in rows[across]["note"]
    assert -50.0 < rows["accel_peak_cfc60"]["value"] < -35.0
    assert rows["speed_before"]["value"] is None
    for whole in ("delta_v_resultant_max", "accel_peak_cfc60_magnitude", "asi_2010", "thiv", "time_of_max"):
        assert rows[whole]["note"].startswith("accel_y"), whole
        assert "not measured and counted as zero" in rows[whole]["note"]
    for upright in ("accel_peak_cfc60_magnitude", "thiv"):
        assert ("accel_z" in rows[upright]["note"]) == (upright != "thiv" and name in ("imu_4", "imu_5"))
    assert "not measured" not in rows["delta_v_long_max"]["note"]


def test_sensors_under_the_rear_seats_differ_by_more_than_their_intervals_tell(barrier: recon.Recording) -> None:
    """As the page says: by 2 % in delta-V, which the intervals about hold, by 18 % in the peak, which they do not."""
    found = [{row["name"]: row for row in analyzed(barrier[name])["metrics"].to_pylist()} for name in REAR]
    for metric, apart in (("delta_v_long_max", 0.02), ("accel_peak_cfc60", 0.18)):
        values = np.array([rows[metric]["value"] for rows in found])
        assert np.ptp(values) / abs(values.mean()) == pytest.approx(apart, abs=0.005)


def test_the_pipeline_for_accelerations_alone_tells_the_test_by_name(logs: Path) -> None:
    run = recon.run("crash_pulse", logs / "nhtsa_v10146_camry")
    assert run.metrics is not None
    rows = {row["name"]: row for row in run.metrics.to_pylist()}
    assert rows["delta_v_long_max"]["value"] == pytest.approx(-66.1, abs=0.1)
    assert rows["edr_maximum_delta_v_longitudinal"]["value"] == pytest.approx(-66.1, abs=0.1)
    assert "edr_maximum_delta_v_resultant" not in rows


def test_an_axis_that_was_not_measured_is_named(barrier: recon.Recording) -> None:
    learnt = detect(imu=barrier["imu"], params=DetectorParams())["metrics"]
    assert ["accel_y" in text for text in warnings_of(learnt)] == [True]


@pytest.mark.parametrize("name", REAR)
def test_the_speed_into_a_wall_follows_from_the_pulse_and_a_restitution(barrier: recon.Recording, name: str) -> None:
    """Cars come back from rigid walls at 50 to 60 km/h with 0.15 of their speed, give or take 0.05."""
    found = analyzed(barrier[name], CrashParams(restitution=0.15, restitution_sigma=0.05))
    row = next(row for row in found["metrics"].to_pylist() if row["name"] == "speed_before")
    assert row["low"] < 57.09 < row["high"]
    assert row["value"] == pytest.approx(57.09, rel=0.05 / 1.15)
    # Nearly all of its sigma is that of the restitution.
    assert row["sigma"] == pytest.approx(row["value"] * 0.05 / 1.15, rel=0.1)


def test_all_places_under_the_rear_seats_stand_still_at_the_same_time_and_crush(barrier: recon.Recording) -> None:
    """The integral of the pulse meets the impact speed where the crush is largest."""
    stop_s, crush_m = [], []
    for name in REAR:
        t_s, accel = time_ns(barrier[name]) * 1e-9, matrix(barrier[name], "accel", gaps=True)[:, 0]
        after = t_s >= 0.0
        speed = 57.09 * KM_H + cumulative(t_s[after], accel[after], "trapezoid")
        row = int((speed < 0.0).argmax())
        stop_s.append(t_s[after][row])
        crush_m.append(cumulative(t_s[after], speed, "trapezoid")[row])
        assert accel[after][row] / G < -10.0  # the wall still pushes: what follows is rebound
    # Two sides of a car and two sensors a side, each with 1 % of scale: 0.6 km/h, which 25 g make up in 0.7 ms.
    assert np.ptp(stop_s) < 2e-3
    assert np.ptp(crush_m) < 0.03


def test_the_scooters_sensor_is_seen_to_clip_and_its_crash_has_bounds(logs: Path) -> None:
    text = (Path(__file__).parent / "csv_mappings" / "scooter.yaml").read_text(encoding="utf-8")
    params, problems = bind(CsvParams, Node.of({"columns": yaml.safe_load(text)}, Where("test")), "reader.csv")
    assert params is not None, problems
    imu = read_csv(path=logs / "accidetec_scooter" / "Step&crash.tsv", params=params)["imu"]
    events = detect(imu=imu, params=DetectorParams())["events"]
    (clip, *_) = [row for row in events.to_pylist() if row["kind"] == "saturation"]
    assert clip["value"] == pytest.approx(78.5, abs=0.1)
    found = analyzed(imu)
    assert any("clipped" in text for text in warnings_of(found["metrics"]))
    size = next(row for row in found["metrics"].to_pylist() if row["name"] == "accel_peak_cfc60_magnitude")
    assert size["high"] > size["value"] + 1.0
    lows = [float(re.findall(r"95 %: (\S+) to", row["note"])[0]) for row in found["events"].to_pylist()]
    assert len(lows) == 4
    assert min(lows) == 0.0  # noise and what was cut off reach further down, but no size is negative
    assert any("there is no gyro" in text for text in warnings_of(found["metrics"]))


@pytest.mark.parametrize("drive", ["comma2k19_example/seg40", "navego_canada/data"])
def test_ordinary_drives_have_no_crash(logs: Path, drive: str) -> None:
    events = detect(imu=recon.read(logs / drive)["imu"], params=DetectorParams())["events"]
    assert spans(events, "crash") == []


def test_a_hundred_thousand_samples_are_analysed_in_half_a_second(logs: Path) -> None:
    log = np.loadtxt(logs / "nhtsa_v10146_camry" / "v10146.093")
    accel = np.zeros((100_000, 3))
    accel[50_000:53_500, 0] = log[:3500, 1] * G
    imu = build(VEHICLE.only("accel"), time=np.arange(100_000) * 100_000, accel=accel)
    analyzed(imu)  # imports
    begin = time.process_time()
    analyzed(imu)
    assert time.process_time() - begin < 0.5


def test_the_chart_of_delta_v_tells_what_the_numbers_below_it_do(run: recon.Run, car: dict[str, Any]) -> None:
    """And no other doubt: the smoother's sigma is another road than the analysis', and may be twice as large."""
    ((zero_ns, _),) = spans(run.events, "impact")
    _, drawn = _panels(run.recording["trajectory"], zero_ns, run.recording)
    (size,) = [curve for curve in drawn.curves if curve.name == "horizontal"]
    at = int(np.searchsorted(size.t_ns, zero_ns + 300_000_000))
    told = car["delta_v_resultant_max"]
    assert abs(size.values[at] - told["value"]) < 2.0 * told["sigma"]
    assert all(curve.sigma is None for curve in drawn.curves)


@pytest.mark.parametrize("limit_g", [3.0, 4.0])
def test_what_the_real_crash_would_have_lost_at_the_end_of_a_range_is_told(
    logs: Path, car: dict[str, Any], limit_g: float
) -> None:
    """The box reached 5.8 g. Cut off at 3 g it records a quarter less of delta-V, and the late GNSS knows no better."""
    log = recon.read(logs / "physycom_crash" / "crash_01.txt")
    accel = np.clip(matrix(log["imu"], "accel"), -limit_g * G, limit_g * G)
    cut = recon.run("crash", log.updated({"imu": replace(log["imu"], accel=accel)}))
    found = {row["name"]: row for row in cut.metrics.to_pylist() if row["step"] == "analyzer.crash"}
    for name in ("delta_v_long_max", "delta_v_resultant_max", "pdof", "accel_peak_cfc60", "asi_2010", "thiv"):
        assert found[name]["low"] < car[name]["value"] < found[name]["high"], name
    told = found["delta_v_resultant_max"]
    assert "told by the speed before and after" in told["note"]
    assert told["high"] - told["low"] < 1.5
    assert abs(told["value"] - car["delta_v_resultant_max"]["value"]) < 0.75
