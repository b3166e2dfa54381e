from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from recon.numerics.signals import changes
from recon.parameters import bind
from recon.rows import spans, warnings_of
from recon.schema import GNSS, IMU
from recon.tables import Array, build
from recon.yaml_nodes import load
from recon_detectors.standstill_speed import StandstillSpeedParams, declare_detectors, standstill_speed

KMH = 1 / 3.6
RATE_HZ = 10.0


def stop_and_go(*pieces: tuple[float, float]) -> Array:
    """Speed (n,) m/s at 10 Hz of pieces given as (duration in s, speed in km/h)."""
    return np.concatenate([np.full(round(duration * RATE_HZ), speed * KMH) for duration, speed in pieces])


def gnss_of(speed: Array, t_s: Array | None = None) -> Any:
    t_s = np.arange(len(speed)) / RATE_HZ if t_s is None else t_s
    return build(GNSS, time=np.rint(t_s * 1e9).astype(np.int64), speed=speed)


def found(gnss: Any, **params: Any) -> list[tuple[float, float]]:
    """Standstills in s after 1970."""
    streams = standstill_speed(gnss=gnss, imu=None, params=StandstillSpeedParams(**params))
    return [(start * 1e-9, end * 1e-9) for start, end in spans(streams["events"], "standstill")]


def numbers(gnss: Any, **params: Any) -> dict[str, float]:
    streams = standstill_speed(gnss=gnss, imu=None, params=StandstillSpeedParams(**params))
    return {row["name"]: row["value"] for row in streams["metrics"].to_pylist()}


def test_stops_are_shortened_by_the_margin_but_not_at_the_ends_of_the_record() -> None:
    gnss = gnss_of(stop_and_go((5, 0), (5, 30), (5, 0), (5, 30), (5, 0)))
    # Slow samples: 0 to 4.9 s, 10 to 14.9 s, 20 to 24.9 s (the last).
    assert np.array(found(gnss)) == pytest.approx(np.array([(0.0, 4.4), (10.5, 14.4), (20.5, 24.9)]), abs=1e-9)


def test_the_threshold_grows_until_there_is_a_stop() -> None:
    gnss = gnss_of(stop_and_go((5, 30), (5, 0.95), (5, 30)))
    assert len(found(gnss)) == 1
    # Thresholds are 0.5, 0.6, ... km/h: the first that is not under 0.95 is 1.0.
    assert numbers(gnss)["threshold"] == pytest.approx(1.0 * KMH)


def test_the_threshold_does_not_grow_further_than_needed() -> None:
    gnss = gnss_of(stop_and_go((5, 0.1), (5, 30), (5, 0.95), (5, 30)))
    assert len(found(gnss)) == 1
    assert numbers(gnss)["threshold"] == pytest.approx(0.5 * KMH)
    assert len(found(gnss, enough=2)) == 2


def test_where_there_are_fewer_stops_than_asked_for_the_lowest_threshold_is_kept_and_it_is_said() -> None:
    gnss = gnss_of(stop_and_go((5, 30), (5, 0.1), (5, 30)))
    streams = standstill_speed(gnss=gnss, imu=None, params=StandstillSpeedParams(enough=2))
    assert streams["events"].num_rows == 1
    assert numbers(gnss, enough=2)["threshold"] == pytest.approx(0.5 * KMH)
    assert warnings_of(streams["metrics"]) == ["1 of 2 standstills found under 2 km/h"]


@pytest.mark.parametrize("speed", [2.1, 5.0, 130.0])
def test_motion_is_never_called_a_stop(speed: float) -> None:
    streams = standstill_speed(gnss=gnss_of(stop_and_go((60, speed))), imu=None, params=StandstillSpeedParams())
    assert streams["events"].num_rows == 0
    assert warnings_of(streams["metrics"]) == ["no standstill: no 1 s of gnss speed under 2 km/h"]


def test_a_start_above_the_cap_is_refused_at_its_place() -> None:
    node = load("start: 5 km/h", "x.yaml")
    params, more = bind(StandstillSpeedParams, node, "detector.standstill_speed")
    assert params is None
    assert [problem.text for problem in more] == [
        "detector.standstill_speed: start (5 km/h) must not be above cap (2 km/h)"
    ]
    assert more[0].where == node.where


@pytest.mark.parametrize("name", ["min_duration", "margin", "bridge", "max_gap", "cap", "start", "step"])
def test_values_beyond_all_sense_are_refused(name: str) -> None:
    with pytest.raises(ValidationError):
        StandstillSpeedParams(**{name: 1e300})


def imu_of(t_s: Array) -> Any:
    return build(IMU, time=np.rint(t_s * 1e9).astype(np.int64), accel=np.zeros((len(t_s), 3)))


def test_a_parked_vehicle_that_is_reported_once_stands_as_long_as_the_imu_runs() -> None:
    gnss, imu = gnss_of(np.zeros(1), np.array([2.0])), imu_of(np.arange(0.0, 60.1, 0.1))
    streams = standstill_speed(gnss=gnss, imu=imu, params=StandstillSpeedParams())
    assert spans(streams["events"], "standstill") == [(0, 60_000_000_000)]
    assert warnings_of(streams["metrics"]) == [
        "no gnss speed exceeds 0.5 km/h, but 1 in all leave gaps of up to 58.0 s: the vehicle is taken to stand all "
        "the time"
    ]


def test_a_parked_vehicle_that_is_reported_throughout_needs_no_warning() -> None:
    imu = imu_of(np.arange(0.0, 10.0, 0.1))
    streams = standstill_speed(gnss=gnss_of(np.zeros(100)), imu=imu, params=StandstillSpeedParams())
    assert spans(streams["events"], "standstill") == [(0, 9_900_000_000)]
    assert warnings_of(streams["metrics"]) == []


def test_a_parked_vehicle_at_another_time_than_the_imu_does_not_stand_in_between() -> None:
    imu = imu_of(np.arange(3600.0, 3660.0, 0.1))
    streams = standstill_speed(gnss=gnss_of(np.zeros(100)), imu=imu, params=StandstillSpeedParams())
    assert spans(streams["events"], "standstill") == [(0, 9_900_000_000)]


@pytest.mark.parametrize(
    "speed",
    [np.full(100, np.nan), np.zeros(5), np.zeros(1), np.zeros(0)],
    ids=["nan", "half a second", "one row", "none"],
)
def test_a_log_without_enough_speed_ends_with_a_warning(speed: Array) -> None:
    streams = standstill_speed(gnss=gnss_of(speed), imu=None, params=StandstillSpeedParams())
    assert streams["events"].num_rows == 0
    assert any(note.startswith("no standstill") for note in warnings_of(streams["metrics"]))


def test_a_standstill_shorter_than_asked_for_after_the_margins_does_not_count() -> None:
    # 21 slow samples span 2.0 s and leave 1.0 s; 20 samples leave 0.9 s.
    assert len(found(gnss_of(stop_and_go((5, 30), (2.1, 0), (5, 30))))) == 1
    assert found(gnss_of(stop_and_go((5, 30), (2.0, 0), (5, 30)))) == []


def test_a_stop_does_not_bridge_a_gap() -> None:
    t_s = np.concatenate((np.arange(0, 5, 0.1), np.arange(60, 75, 0.1)))
    # Neither end beside the gap is shortened: it is the record that ends there, and not the standstill.
    expected = np.array([(0.0, 4.9), (60.0, 64.4)])
    speed = stop_and_go((5, 0), (5, 0), (10, 30))
    assert np.array(found(gnss_of(speed, t_s))) == pytest.approx(expected, abs=1e-9)


def test_missing_speeds_are_left_out_and_a_long_row_of_them_ends_the_stop() -> None:
    speed = stop_and_go((20, 0), (10, 30))
    speed[50:55] = np.nan  # 4.9 to 5.5 s: shorter than max_gap
    speed[100:150] = np.nan  # 9.9 to 15 s
    assert np.array(found(gnss_of(speed))) == pytest.approx(np.array([(0.0, 9.9), (15.0, 19.4)]), abs=1e-9)


def test_a_short_spell_of_noise_does_not_end_a_stop() -> None:
    gnss = gnss_of(stop_and_go((10, 0.1), (0.4, 0.84), (10, 0.1)))
    assert len(found(gnss)) == 1
    assert len(found(gnss, bridge=0.0)) == 2


def test_a_single_fix_of_noise_does_not_end_a_stop_at_any_rate() -> None:
    speed = np.full(20, 0.02)
    speed[8] = 0.2  # m/s, between the first threshold and the cap
    assert len(found(gnss_of(speed, np.arange(20.0)))) == 1
    speed[9] = 0.2
    assert len(found(gnss_of(speed, np.arange(20.0)))) == 2


def test_a_spell_longer_than_the_bridge_or_faster_than_the_cap_ends_a_stop() -> None:
    assert len(found(gnss_of(stop_and_go((10, 0.1), (0.5, 0.84), (10, 0.1))))) == 2
    assert len(found(gnss_of(stop_and_go((10, 0.1), (0.2, 2.1), (10, 0.1))))) == 2


def test_derived_speed_is_the_horizontal_part_of_vel() -> None:
    vel = np.zeros((100, 3))
    vel[:50, 1], vel[:, 2] = 5.0, 1.0
    gnss = build(GNSS, time=np.arange(100) * 100_000_000, speed=np.full(100, 9.0), vel=vel)
    assert np.array(found(gnss, speed="derived")) == pytest.approx(np.array([(5.5, 9.9)]), abs=1e-9)


def test_the_other_speed_is_used_where_the_one_asked_for_is_missing_and_it_is_said() -> None:
    gnss = gnss_of(stop_and_go((5, 0)))
    streams = standstill_speed(gnss=gnss, imu=None, params=StandstillSpeedParams(speed="derived"))
    assert streams["events"].num_rows == 1
    assert warnings_of(streams["metrics"]) == ["gnss has no derived speed: the reported one is used"]


def test_metrics_tell_number_and_time() -> None:
    learnt = numbers(gnss_of(stop_and_go((5, 0), (5, 30), (5, 0), (5, 30), (5, 0))))
    assert learnt["standstills"] == 3.0
    assert learnt["still_time"] == pytest.approx(4.4 + 3.9 + 4.4)


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_detectors()] == [[]]


def test_the_crash_log_stands_before_the_pull_away_and_after_the_crash() -> None:
    if "RECON_TEST_DATA" not in os.environ:
        pytest.skip("RECON_TEST_DATA does not name the folder of real logs")
    path = Path(os.environ["RECON_TEST_DATA"]) / "physycom_crash" / "crash_01.txt"
    log = np.loadtxt(path, skiprows=1, usecols=(1, 9))
    log = log[changes(log[:, 0])]
    stops = found(gnss_of(log[:, 0] * KMH, log[:, 1]))
    # By its accelerometer the car starts at 54.3 s, hits at 60.3 s and comes to rest at about 63 s; the time column is
    # given in steps of 0.1 ms.
    assert len(stops) == 3
    assert stops[0][0] == pytest.approx(log[0, 1], abs=1e-9)
    assert 52.0 < stops[0][1] < 54.3
    assert 63.0 < stops[1][0] < 65.0
    assert stops[2][1] == pytest.approx(log[-1, 1], abs=1e-9)
