from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.errors import DataError
from recon.rows import Event, events, warnings_of
from recon.schema import IMU
from recon.tables import Array, build, matrix
from recon_filters.gyro_offset import GyroOffsetParams, gyro_offset
from recon_filters.gyro_temperature import REFERENCE_K, GyroTemperatureParams, declare_filters, gyro_temperature

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from gyro_temperature import case

T_S = np.arange(0.0, 600.0, 0.1)
CELSIUS = 10.0 + 0.05 * T_S
SLOPE, BEND = np.radians([0.02, -0.03, 0.01]), np.radians([0.0003, 0.0002, -0.0004])
ABOVE = (CELSIUS + 273.15 - REFERENCE_K)[:, None]
STOPS = [(0.0, 10.0), (200.0, 210.0), (400.0, 410.0), (590.0, 600.0)]


def imu_of(gyro: Array, temperature: Array | None = CELSIUS + 273.15, late_s: float = 0.0) -> Any:
    more = {} if temperature is None else {"temperature": temperature}
    time = np.rint((T_S + late_s) * 1e9).astype(np.int64)
    return build(IMU, time=time, accel=np.zeros_like(gyro), gyro=gyro, **more)


def stops(spans: Any = STOPS, late_s: float = 0.0) -> Any:
    return events(Event(round((a + late_s) * 1e9), round((b + late_s) * 1e9), "standstill") for a, b in spans)


def warm(linear: bool = False) -> Array:
    return np.radians([0.5, -1.0, 0.2]) + SLOPE * ABOVE + (0.0 if linear else 1.0) * BEND * ABOVE**2


def left(gyro: Array, spans: Any = STOPS, temperature: Array | None = CELSIUS + 273.15, **params: Any) -> Array:
    given = {"imu": imu_of(gyro, temperature), "events": stops(spans)}
    return np.degrees(matrix(gyro_temperature(**given, params=GyroTemperatureParams(**params))["imu"], "gyro"))


@pytest.mark.parametrize("model", ["linear", "quadratic"])
def test_an_offset_that_follows_the_model_is_taken_off(model: str) -> None:
    # Four stops of sigma 0.01 deg/s and 30 K apart against priors of 0.05 deg/s/K and 0.001 deg/s/K^2: the slope is
    # drawn to zero by less than (0.01 / 0.05 / 20)^2, the square by (0.01 / 0.001 / 100)^2 = 1 %, of up to 0.1 deg/s.
    assert np.abs(left(warm(linear=model == "linear"), model=model)).max() < 2e-3


def test_the_straight_line_alone_leaves_the_curvature() -> None:
    assert np.abs(left(warm(), model="linear")).max() > np.abs(left(warm(), model="quadratic")).max()


def test_it_does_better_than_an_offset_that_is_held() -> None:
    held = gyro_offset(imu=imu_of(warm()), events=stops(), params=GyroOffsetParams())["imu"]
    assert np.abs(left(warm())).max() < 0.05 * np.degrees(np.abs(matrix(held, "gyro")).max())


@pytest.mark.parametrize("temperature", [None, np.full(len(T_S), np.nan), np.full(len(T_S), 300.0)])
@pytest.mark.parametrize("between", ["hold", "linear"])
def test_without_changes_of_temperature_it_is_gyro_offset(temperature: Array | None, between: Any) -> None:
    expected = gyro_offset(imu=imu_of(warm()), events=stops(), params=GyroOffsetParams(between=between))["imu"]
    found = left(warm(), temperature=temperature, between=between)
    assert found == pytest.approx(np.degrees(matrix(expected, "gyro")), abs=1e-12)


def test_the_constant_that_a_fuser_wants_leaves_no_steps_at_stops() -> None:
    rng = np.random.default_rng(3)
    jumps = np.radians(0.02) * rng.standard_normal((len(STOPS), 3))
    at_stops = np.searchsorted([start for start, _ in STOPS], T_S, side="right") - 1
    gyro = warm() + jumps[at_stops]
    held, constant = (np.radians(left(gyro, between=how)) - gyro for how in ("hold", "constant"))
    assert np.abs(np.diff(held, axis=0)).max() > np.radians(0.01)
    assert np.abs(np.diff(constant, axis=0)).max() < np.radians(0.001)  # 0.005 K from row to row
    assert np.abs((gyro + constant).mean(axis=0)).max() < np.radians(0.02)


def test_a_missing_temperature_is_said() -> None:
    made = gyro_temperature(imu=imu_of(warm(), None), events=stops(), params=GyroTemperatureParams())
    assert warnings_of(made["metrics"]) == ["imu tells no temperature: only what the stops show is taken off"]


def test_a_later_drive_with_one_stop_uses_what_earlier_ones_learnt(tmp_path: Path) -> None:
    params = GyroTemperatureParams(calibration=str(tmp_path / "device.json"))
    gyro_temperature(imu=imu_of(warm()), events=stops(), params=params)
    late = {"imu": imu_of(warm() + 0.01, late_s=86_400.0), "events": stops(STOPS[:1], late_s=86_400.0)}
    remembered = np.degrees(matrix(gyro_temperature(**late, params=params)["imu"], "gyro"))
    alone = np.degrees(matrix(gyro_temperature(**late, params=GyroTemperatureParams())["imu"], "gyro"))
    assert np.abs(remembered).max() < 0.05 * np.abs(alone).max()
    assert len(json.loads((tmp_path / "device.json").read_text(encoding="utf-8"))["drives"]) == 2


def test_a_drive_that_is_run_again_changes_neither_the_result_nor_the_file(tmp_path: Path) -> None:
    file = tmp_path / "device.json"
    first, second = [(left(warm(), calibration=str(file)), file.read_bytes()) for _ in range(2)]
    assert (first[0] == second[0]).all()
    assert first[1] == second[1]


OTHER = '{"recon_gyro_calibration": 1, "drives": {}}'
BROKEN = '{"recon_gyro_calibration": 2, "drives": {"0": {"terms": [[1]], "offsets": []}}}'


@pytest.mark.parametrize("text", ["", "[]", "{}", OTHER, BROKEN])
def test_a_file_of_another_kind_is_refused_and_kept(tmp_path: Path, text: str) -> None:
    file = tmp_path / "device.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=r"device.json is no calibration of gyroscopes"):
        left(warm(), calibration=str(file))
    assert file.read_text(encoding="utf-8") == text


def test_without_a_stop_the_imu_is_unchanged_and_it_is_said() -> None:
    made = gyro_temperature(imu=imu_of(warm()), events=None, params=GyroTemperatureParams())
    assert made["imu"].equals(imu_of(warm()))
    assert warnings_of(made["metrics"]) == ["no standstill: gyro offset is kept"]


def test_slopes_are_told_with_sigmas_that_hold() -> None:
    made = gyro_temperature(imu=imu_of(warm()), events=stops(), params=GyroTemperatureParams())
    told = {row["name"]: row for row in made["metrics"].to_pylist()}
    for axis, slope, bend in zip("xyz", np.degrees(SLOPE), np.degrees(BEND), strict=True):
        assert abs(told[f"gyro_per_kelvin_{axis}"]["value"] - slope) < told[f"gyro_per_kelvin_{axis}"]["sigma"]
        squared = told[f"gyro_per_kelvin_squared_{axis}"]
        assert abs(squared["value"] - bend) < squared["sigma"]


def test_on_a_simulated_drive_less_of_the_bias_is_left() -> None:
    errors = case(1, 600.0)
    assert errors["quadratic"] < errors["gyro_offset"]
    assert errors["remembered"] < errors["first stop"]


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]


def test_hysteresis_is_met_where_the_sensor_follows_its_thermometer_late() -> None:
    kelvin = 12.0 * np.sin(2.0 * np.pi * T_S / 400.0)
    rate, lag_s = 2.0 * np.pi / 400.0, 120.0  # what follows a sine, and how it settles, in closed form
    size, late = 1.0 / np.hypot(1.0, rate * lag_s), np.arctan(rate * lag_s)
    follows = 12.0 * size * (np.sin(rate * T_S - late) + np.sin(late) * np.exp(-T_S / lag_s))
    gyro = np.radians(0.3) + SLOPE * follows[:, None]
    spans = [(at, at + 10.0) for at in np.arange(0.0, 590.0, 40.0).tolist()]
    errors = {
        model: np.abs(left(gyro, spans, kelvin + REFERENCE_K, model=model, thermal_lag=lag_s, between="constant")).max()
        for model in ("quadratic", "hysteresis")
    }
    # the thermometer is averaged over 10 s, in which the sine bends by 12 (rate 10)^2 / 24 K: 0.01 K times 0.03 deg/s/K
    assert errors["hysteresis"] < 0.01
    assert errors["hysteresis"] < 0.1 * errors["quadratic"]
