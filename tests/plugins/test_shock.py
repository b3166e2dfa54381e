from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recon.numerics.rotation import from_rotvec, rotate
from recon.rows import spans
from recon.schema import GNSS, IMU
from recon.tables import Array, build, time_ns
from recon_detectors.shock import ShockParams, declare_detectors, shock

G = 9.80665
STEP_NS = 10_000_000


def imu_of(accel: Array) -> Any:
    return build(IMU, time=np.arange(len(accel)) * STEP_NS, accel=accel, gyro=np.zeros_like(accel))


def rest_with(*pulses: tuple[int, int, float]) -> Array:
    """Specific force (500, 3) m/s^2 at rest, with pulses along x given as (first row, last row, m/s^2)."""
    accel = np.tile([0.0, 0.0, G], (500, 1))
    for first, last, size in pulses:
        accel[first : last + 1, 0] = size
    return accel


def crashes(accel: Array, **params: Any) -> list[dict[str, Any]]:
    streams = shock(imu=imu_of(accel), gnss=None, params=ShockParams(**params))
    rows: list[dict[str, Any]] = streams["events"].to_pylist()
    return rows


def test_a_pulse_is_one_crash_from_its_first_to_its_last_exceedance() -> None:
    streams = shock(imu=imu_of(rest_with((100, 104, -50.0))), gnss=None, params=ShockParams())
    assert spans(streams["events"], "crash") == [(100 * STEP_NS, 104 * STEP_NS)]
    (row,) = streams["events"].to_pylist()
    assert row["value"] == pytest.approx(np.hypot(50.0, G) - G, abs=1e-12)
    assert row["unit"] == "m/s^2"


def test_gravity_is_not_part_of_the_threshold() -> None:
    # Upwards, 2.1 g of acceleration make 3.1 g of specific force; 1.9 g make 2.9 g.
    vertical = rest_with()
    vertical[100, 2] = 2.9 * G
    assert crashes(vertical) == []
    vertical[100, 2] = 3.1 * G
    assert len(crashes(vertical)) == 1


def test_free_fall_is_a_deviation_of_one_g() -> None:
    accel = rest_with()
    accel[200:210] = 0.0
    assert crashes(accel) == []
    assert crashes(accel, threshold=0.9 * G)[0]["value"] == pytest.approx(G, abs=1e-12)


def test_a_turned_box_finds_the_same() -> None:
    accel = rest_with((100, 104, -50.0))
    turned = rotate(from_rotvec(np.tile([0.7, -1.1, 2.0], (500, 1))), accel)
    assert [row["time"] for row in crashes(turned)] == [row["time"] for row in crashes(accel)]
    assert crashes(turned)[0]["value"] == pytest.approx(crashes(accel)[0]["value"], abs=1e-12)


def test_exceedances_within_the_merge_time_are_one_crash() -> None:
    # 50 rows are 0.5 s: the pulses end at row 100 and begin at row 150, or 151.
    assert len(crashes(rest_with((100, 100, 50.0), (150, 150, 80.0)))) == 1
    assert len(crashes(rest_with((100, 100, 50.0), (151, 151, 80.0)))) == 2


def test_the_value_is_the_largest_deviation_of_the_group() -> None:
    (row,) = crashes(rest_with((100, 100, 50.0), (120, 120, 80.0)))
    assert row["value"] == pytest.approx(np.hypot(80.0, G) - G, abs=1e-12)
    assert "0.200 s after the start" in row["note"]


def test_missing_values_are_left_out() -> None:
    accel = rest_with((100, 104, 50.0))
    accel[::2] = np.nan
    assert [(row["time"].microsecond, row["end_time"].microsecond) for row in crashes(accel)] == [(10_000, 30_000)]
    assert crashes(np.full((10, 3), np.nan)) == []
    assert crashes(np.zeros((0, 3))) == []


def test_what_follows_a_crash_is_kept() -> None:
    imu = imu_of(rest_with((100, 104, 50.0)))
    gnss = build(GNSS, time=np.arange(50) * 100_000_000, speed=np.zeros(50))
    streams = shock(imu=imu, gnss=gnss, params=ShockParams())
    assert streams["imu"].equals(imu)
    assert streams["gnss"].equals(gnss)


def test_cut_drops_what_follows_the_first_crash_and_counts_it() -> None:
    imu = imu_of(rest_with((100, 104, 50.0), (300, 304, 50.0)))
    gnss = build(GNSS, time=np.arange(50) * 100_000_000, speed=np.zeros(50))
    streams = shock(imu=imu, gnss=gnss, params=ShockParams(cut=True))
    assert time_ns(streams["imu"])[-1] == 104 * STEP_NS
    assert time_ns(streams["gnss"])[-1] == 1_000_000_000
    assert streams["events"].num_rows == 2
    learnt = {row["name"]: row["value"] for row in streams["metrics"].to_pylist()}
    assert (learnt["imu_rows_cut"], learnt["gnss_rows_cut"]) == (395.0, 39.0)


def test_cut_keeps_a_drive_without_a_crash() -> None:
    imu = imu_of(rest_with())
    streams = shock(imu=imu, gnss=None, params=ShockParams(cut=True))
    assert streams["imu"].equals(imu)
    assert "gnss" not in streams


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_detectors()] == [[]]


def test_the_crash_log_has_one_crash() -> None:
    if "RECON_TEST_DATA" not in os.environ:
        pytest.skip("RECON_TEST_DATA does not name the folder of real logs")
    path = Path(os.environ["RECON_TEST_DATA"]) / "physycom_crash" / "crash_01.txt"
    log = np.loadtxt(path, skiprows=1, usecols=(9, 2, 3, 4))
    t_ns, accel = np.rint(log[:, 0] * 1e9).astype(np.int64), log[:, 1:] * 9.81
    streams = shock(imu=build(IMU, time=t_ns, accel=accel), gnss=None, params=ShockParams())
    ((start, end),) = spans(streams["events"], "crash")
    # The largest magnitude of the file, 7.40 g at 60.33 s, is what the README of the log tells.
    assert start * 1e-9 < 60.33 < end * 1e-9
    assert streams["events"]["value"][0].as_py() == pytest.approx(7.40 * 9.81 - G, abs=0.005 * 9.81)
