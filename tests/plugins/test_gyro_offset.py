from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.rows import Event, events, warnings_of
from recon.schema import IMU
from recon.tables import Array, build, matrix
from recon_filters.gyro_offset import GyroOffsetParams, declare_filters, gyro_offset

T_S = np.arange(0.0, 100.0, 0.1)
FIRST, SECOND = np.array([0.01, -0.02, 0.03]), np.array([0.02, -0.01, 0.05])
# Means of some hundred equal numbers below 0.1.
ROUNDING = 1e-15


def imu_of(gyro: Array) -> Any:
    return build(IMU, time=np.rint(T_S * 1e9).astype(np.int64), accel=np.zeros_like(gyro), gyro=gyro)


def stops(*pairs: tuple[float, float], kind: str = "standstill") -> Any:
    return events(Event(round(start * 1e9), round(end * 1e9), kind) for start, end in pairs)


def corrected(gyro: Array, found: Any, **params: Any) -> Array:
    streams = gyro_offset(imu=imu_of(gyro), events=found, params=GyroOffsetParams(**params))
    return matrix(streams["imu"], "gyro", gaps=True)


def stepwise() -> Array:
    """Rate (1000, 3) rad/s of a still box whose offset jumps at 50 s, when the second stop begins."""
    return np.where(T_S[:, None] < 49.95, FIRST, SECOND)


def test_each_stop_gives_the_offset_from_there_on_and_the_first_one_also_before() -> None:
    assert np.abs(corrected(stepwise(), stops((10, 20), (50, 60)))).max() <= ROUNDING


def test_the_rate_in_motion_is_kept() -> None:
    turning = stepwise()
    turning[300:400, 2] += 0.5
    result = corrected(turning, stops((10, 20), (50, 60)))
    assert result[300:400, 2] == pytest.approx(np.full(100, 0.5), abs=1e-15)


def test_hold_changes_the_offset_at_the_start_of_a_stop() -> None:
    gyro = np.where(T_S[:, None] < 69.95, FIRST, SECOND)
    removed = gyro - corrected(gyro, stops((10, 20), (70, 80)))
    assert removed[699] == pytest.approx(FIRST, abs=ROUNDING)
    assert removed[700] == pytest.approx(SECOND, abs=ROUNDING)


def test_linear_takes_off_a_steady_drift_between_stops() -> None:
    inside = np.clip((T_S - 20.0) / 30.0, 0.0, 1.0)[:, None]
    drifting = FIRST + inside * (SECOND - FIRST)
    linear = corrected(drifting, stops((10, 20), (50, 60)), between="linear")
    assert np.abs(linear).max() <= 1e-14  # times in seconds up to 100 round by 1e-14
    # What hold leaves at the end of the drift is the whole of it.
    hold = corrected(drifting, stops((10, 20), (50, 60)))
    assert hold[499] == pytest.approx(SECOND - FIRST, rel=1 / 299)


def test_noise_is_averaged_and_sigma_is_honest() -> None:
    noise, runs = 0.01, 400
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(runs):
        gyro = FIRST + rng.normal(0.0, noise, (len(T_S), 3))
        rows = gyro_offset(imu=imu_of(gyro), events=stops((10, 20)), params=GyroOffsetParams())["metrics"].to_pylist()
        ratios += [
            (np.radians(row["value"]) - FIRST["xyz".index(row["name"][-1])]) / np.radians(row["sigma"])
            for row in rows
            if row["name"].startswith("gyro_offset_")
        ]
    # Root mean square of 1200 ratios of sigma one: itself one with a sigma of 1 / sqrt(2 * 1200) = 0.02; 4 sigma.
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.08)


def test_metrics_are_in_degrees_per_second_for_each_stop_and_axis() -> None:
    streams = gyro_offset(imu=imu_of(stepwise()), events=stops((10, 20), (50, 60)), params=GyroOffsetParams())
    rows = streams["metrics"].to_pylist()
    assert rows[0]["name"] == "stops"
    assert rows[0]["value"] == 2.0
    assert [row["name"] for row in rows[1:]] == [f"gyro_offset_{axis}" for axis in "xyzxyz"]
    assert {row["unit"] for row in rows[1:]} == {"deg/s"}
    expected = np.degrees(np.concatenate((FIRST, SECOND)))
    assert [row["value"] for row in rows[1:]] == pytest.approx(expected, abs=1e-13)


@pytest.mark.parametrize("found", [None, stops(), stops((10, 20), kind="crash"), stops((500, 600))])
def test_without_a_stop_the_imu_is_unchanged_and_it_is_said(found: Any) -> None:
    imu = imu_of(stepwise())
    streams = gyro_offset(imu=imu, events=found, params=GyroOffsetParams())
    assert streams["imu"].equals(imu)
    assert warnings_of(streams["metrics"]) == ["no standstill: gyro offset is kept"]


def test_a_stop_in_which_nothing_was_sampled_is_passed_over() -> None:
    result = corrected(stepwise(), stops((10, 20), (30.01, 30.05), (50, 60)), between="linear")
    assert result[300] == pytest.approx((FIRST - SECOND) / 3, abs=1e-14)  # 10 s of the 30 s between the stops


@pytest.mark.parametrize("between", ["hold", "linear"])
def test_stops_that_overlap_count_as_one(between: str) -> None:
    together = corrected(stepwise(), stops((10, 15), (12, 20), (50, 60), (51, 59)), between=between)
    assert (together == corrected(stepwise(), stops((10, 20), (50, 60)), between=between)).all()


def test_missing_values_are_left_out_of_the_mean_and_stay_missing() -> None:
    gyro = stepwise()
    gyro[::2] = np.nan
    result = corrected(gyro, stops((10, 20), (50, 60)))
    assert np.isnan(result[::2]).all()
    assert np.abs(result[1::2]).max() <= ROUNDING


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]
