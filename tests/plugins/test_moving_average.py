from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from recon.errors import DataError
from recon.rows import warnings_of
from recon.schema import IMU
from recon.tables import Array, build, matrix, time_ns
from recon_filters.moving_average import MovingAverageParams, declare_filters, moving_average

STEP_NS = 10_000_000  # 100 Hz: the default window of 0.05 s is 5 samples


def imu_of(accel: Array, t_ns: Any = None) -> Any:
    t_ns = np.arange(len(accel)) * STEP_NS if t_ns is None else t_ns
    return build(IMU, time=t_ns, accel=accel, gyro=0.1 * accel)


def smooth(imu: Any, **params: Any) -> Any:
    return moving_average(imu=imu, params=MovingAverageParams(**params))


def test_a_sample_is_the_mean_of_the_window_around_it() -> None:
    accel = np.random.default_rng(4).normal(size=(50, 3))
    result = smooth(imu_of(accel))["imu"]
    assert matrix(result, "accel")[20] == pytest.approx(accel[18:23].mean(axis=0), abs=1e-15)
    assert matrix(result, "gyro")[20] == pytest.approx(0.1 * accel[18:23].mean(axis=0), abs=1e-15)


def test_a_straight_line_passes_unchanged_and_no_sample_is_dropped() -> None:
    line = np.arange(40.0)[:, None] * np.array([1.0, -0.5, 0.25]) + 9.81
    imu = imu_of(line)
    result = smooth(imu)["imu"]
    assert (time_ns(result) == time_ns(imu)).all()
    assert matrix(result, "accel") == pytest.approx(line, abs=1e-13)  # some roundings of numbers below 50


def test_the_ends_are_kept() -> None:
    accel = np.random.default_rng(5).normal(size=(20, 3))
    result = matrix(smooth(imu_of(accel))["imu"], "accel")
    assert (result[[0, -1]] == accel[[0, -1]]).all()
    assert result[1] == pytest.approx(accel[:3].mean(axis=0), abs=1e-15)


def test_a_gap_is_not_averaged_across() -> None:
    accel = np.repeat([[0.0], [10.0]], 20, axis=0) * np.ones(3)
    t_ns = np.arange(40) * STEP_NS
    t_ns[20:] += 1_000_000_000
    streams = smooth(imu_of(accel, t_ns))
    assert (matrix(streams["imu"], "accel") == accel).all()
    assert (matrix(smooth(imu_of(accel, t_ns), max_gap=2.0)["imu"], "accel")[19] > 0).all()


def test_the_window_is_the_odd_number_of_samples_closest_to_the_time() -> None:
    imu = imu_of(np.zeros((50, 3)))
    for window, samples in ((0.05, 5.0), (0.069, 7.0), (0.041, 5.0), (0.039, 3.0), (1e-6, 1.0)):
        rows = smooth(imu, window=window)["metrics"].to_pylist()
        assert {row["name"]: row["value"] for row in rows}["window"] == samples


def test_a_wide_window_flattens_a_half_sine_to_two_over_pi() -> None:
    pulse = np.zeros(1001)
    pulse[400:601] = np.sin(np.pi * np.arange(201) / 200)
    result = matrix(smooth(imu_of(pulse[:, None] * np.ones(3)), window=2.01)["imu"], "accel")
    # Trapezoid rule over 200 steps: error (pi / 200)^2 / 12 = 2e-5; divisor 201 in place of 200: 5e-3.
    assert result.max() == pytest.approx(2 / np.pi, rel=5.1e-3)


def test_a_window_of_one_sample_changes_nothing_and_is_said() -> None:
    imu = imu_of(np.random.default_rng(6).normal(size=(20, 3)))
    streams = smooth(imu, window=0.005)
    assert streams["imu"].equals(imu)
    assert len(warnings_of(streams["metrics"])) == 1


def test_missing_values_are_refused() -> None:
    accel = np.zeros((20, 3))
    accel[7] = np.nan
    with pytest.raises(DataError, match="accel_x"):
        smooth(imu_of(accel))


@pytest.mark.parametrize("rows", [0, 1])
def test_a_stream_too_short_to_average_passes(rows: int) -> None:
    imu = imu_of(np.ones((rows, 3)))
    assert smooth(imu)["imu"].equals(imu)


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]
