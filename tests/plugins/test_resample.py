from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from metric_rows import values_by_name

from recon.errors import DataError
from recon.numerics.rotation import from_euler, to_euler
from recon.rows import warnings_of
from recon.schema import ATTITUDE, FRAMES, GNSS, IMU, MAG, STREAMS, TRAJECTORY
from recon.tables import Array, build, conform, matrix, meta, time_ns, vector, with_meta
from recon_filters.resample import ResampleParams, declare_filters, resample

SLOPE_ACCEL, SLOPE_GYRO = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, -0.3])
# Values stay below 100 and times are whole nanoseconds: a few roundings of 1e-14.
ROUNDING = 1e-12


def ns(t_s: Any) -> Any:
    return np.rint(np.asarray(t_s) * 1e9).astype(np.int64)


def alternating(t_s: Array) -> Any:
    """An imu whose even rows hold accel and whose odd rows hold gyro, both straight lines over time."""
    accel, gyro = SLOPE_ACCEL * t_s[:, None], SLOPE_GYRO * t_s[:, None]
    accel[1::2], gyro[0::2] = np.nan, np.nan
    return build(IMU, time=ns(t_s), accel=accel, gyro=gyro)


def run(imu: Any, gnss: Any = None, /, *, streams: Any = None, **params: Any) -> Any:
    """streams : further ones by port."""
    others = {"mag": None, "attitude": None, "trajectory": None, "clock": None, **(streams or {})}
    return resample(imu=imu, gnss=gnss, **others, params=ResampleParams(**params))


def test_each_group_is_completed_from_its_own_samples() -> None:
    t_s = np.array([0.0, 0.010, 0.021, 0.030, 0.043, 0.050])
    streams = run(alternating(t_s))
    # gyro begins in row 1 and accel ends in row 4: the first and the last row would need extrapolation.
    assert time_ns(streams["imu"]).tolist() == ns(t_s[1:5]).tolist()
    assert matrix(streams["imu"], "accel") == pytest.approx(SLOPE_ACCEL * t_s[1:5, None], abs=ROUNDING)
    assert matrix(streams["imu"], "gyro") == pytest.approx(SLOPE_GYRO * t_s[1:5, None], abs=ROUNDING)
    assert values_by_name(streams)["rows_dropped"] == 2.0


def test_a_complete_imu_passes_bit_for_bit() -> None:
    rng = np.random.default_rng(1)
    t_ns = ns(np.cumsum(rng.uniform(0.002, 0.003, 50)))
    imu = build(IMU, time=t_ns, accel=rng.normal(size=(50, 3)), gyro=rng.normal(size=(50, 3)))
    assert run(imu)["imu"].equals(imu)


def test_a_regular_grid_has_exact_times_and_values_of_the_line() -> None:
    t_ns = ns(np.sort(np.random.default_rng(2).uniform(0.0, 2.0, 400)))
    imu = build(IMU, time=t_ns, accel=SLOPE_ACCEL * t_ns[:, None] * 1e-9, gyro=SLOPE_GYRO * t_ns[:, None] * 1e-9)
    result = run(imu, rate=300.0)["imu"]
    count = np.arange(result.num_rows)
    # 300 Hz is no whole number of nanoseconds: each time is right to half of one, without drift.
    assert np.abs(time_ns(result) - t_ns[0] - count * 1e9 / 300.0).max() <= 0.5
    assert t_ns[-1] - time_ns(result)[-1] < 1e9 / 300.0
    assert matrix(result, "accel") == pytest.approx(SLOPE_ACCEL * time_ns(result)[:, None] * 1e-9, abs=ROUNDING)


@pytest.mark.parametrize("rate", [None, 10.0])
def test_nothing_is_invented_in_a_long_gap(rate: float | None) -> None:
    t_s = np.concatenate((np.arange(0, 2, 0.1), np.arange(100, 102, 0.1)))
    result = run(alternating(t_s), rate=rate)["imu"]
    inside = (time_ns(result) > ns(1.95)) & (time_ns(result) < ns(99.95))
    assert result.num_rows > 30
    assert not inside.any()


def test_rows_in_a_long_gap_of_one_group_are_dropped_and_counted() -> None:
    t_s = np.arange(0, 10, 0.1)
    gyro = np.ones((100, 3))
    gyro[20:60] = np.nan
    streams = run(build(IMU, time=ns(t_s), accel=np.ones((100, 3)), gyro=gyro))
    assert streams["imu"].num_rows == 60
    assert values_by_name(streams)["rows_dropped"] == 40.0


def test_a_group_without_any_value_stays_empty_and_drops_nothing() -> None:
    streams = run(build(IMU, time=ns([0.0, 0.1, 0.2]), accel=np.ones((3, 3))))
    assert streams["imu"].num_rows == 3
    assert streams["imu"]["gyro_x"].null_count == 3
    assert warnings_of(streams["metrics"]) == ["imu has no gyro: it stays empty"]


def test_an_axis_without_any_value_is_named() -> None:
    accel = np.ones((3, 3))
    accel[:, 1] = np.nan
    streams = run(build(IMU, time=ns([0.0, 0.1, 0.2]), accel=accel, gyro=np.ones((3, 3))))
    assert streams["imu"].num_rows == 3
    assert warnings_of(streams["metrics"]) == ["imu.accel_y holds no number: accel stays incomplete"]


def test_values_of_one_axis_that_are_filled_in_are_counted() -> None:
    accel = np.ones((9, 3))
    accel[3:5, 1] = np.nan
    streams = run(build(IMU, time=ns(np.arange(9) * 0.01), accel=accel, gyro=np.ones((9, 3))))
    assert matrix(streams["imu"], "accel").tolist() == np.ones((9, 3)).tolist()
    assert values_by_name(streams)["accel_y_filled"] == 2.0
    assert "accel_x_filled" not in values_by_name(streams)


def test_a_lower_rate_holds_no_alias_and_the_same_integral() -> None:
    t_s = np.arange(0.0, 10.0, 0.0025)
    accel = 1.0 + np.sin(2.0 * np.pi * 10.5 * t_s)[:, None] * np.ones(3)
    streams = run(build(IMU, time=ns(t_s), accel=accel, gyro=np.ones((len(t_s), 3))), rate=10.0)
    averaged = vector(streams["imu"], "accel_x")[1:-1]  # the first and last one keep their value
    # Samples of 10.5 Hz taken at 10 Hz look like 0.5 Hz of amplitude 1. The mean over 0.1 s has a gain of
    # |sinc(1.05)| = 0.047, which the line between samples lowers further.
    assert np.abs(averaged - 1.0).max() < 0.048
    # 98 whole periods of the grid are the integral from 0.05 to 9.85 s; that of the sine over any span is at most
    # 2 / (2 pi 10.5) = 0.03, of which the exact value is known: cos at both ends.
    phase = 2.0 * np.pi * 10.5
    exact = 9.8 + (np.cos(phase * 0.05) - np.cos(phase * 9.85)) / phase
    # The line between samples of a sine is low by (phase h)^2 / 12 = 0.2 % of the sine's part.
    assert averaged[:98].sum() * 0.1 == pytest.approx(exact, abs=0.002 * 0.03)


def test_a_grid_that_would_fill_the_memory_is_refused() -> None:
    with pytest.raises(DataError, match=r"a grid of 10000 Hz would have 90,001 rows where imu has 10"):
        run(alternating(np.arange(10) * 1.0), rate=10_000.0, max_gap=2.0)


def test_gnss_is_left_alone_unless_asked_for() -> None:
    gnss = build(GNSS, time=ns([0.0, 1.0]), speed=np.array([1.0, 2.0]))
    assert run(alternating(np.arange(0, 1, 0.01)), gnss)["gnss"].equals(gnss)


def on_imu_times(**columns: Any) -> Any:
    """gnss at 0, 1 and 5 s, brought onto an imu that has a row every 0.25 s from -0.5 to 5.5 s."""
    t_s = np.arange(-0.5, 5.6, 0.25)
    imu = build(IMU, time=ns(t_s + 10), accel=np.ones((len(t_s), 3)), gyro=np.ones((len(t_s), 3)))
    gnss = with_meta(build(GNSS, time=ns([10.0, 11.0, 15.0]), **columns), heading_kind="true")
    result = run(imu, gnss, gnss=True)["gnss"]
    assert time_ns(result).tolist() == time_ns(imu).tolist()
    return result


def test_gnss_is_interpolated_and_null_outside_its_span_and_in_long_gaps() -> None:
    result = on_imu_times(speed=np.array([1.0, 3.0, 7.0]))
    expected = np.full(25, np.nan)
    expected[2:7], expected[22] = [1.0, 1.5, 2.0, 2.5, 3.0], 7.0
    assert vector(result, "speed", gaps=True) == pytest.approx(expected, abs=ROUNDING, nan_ok=True)
    assert meta(result) == {"heading_kind": "true"}


def test_course_takes_the_short_way_through_north() -> None:
    course = np.degrees(vector(on_imu_times(course=np.radians([350.0, 10.0, 10.0])), "course", gaps=True))
    # North itself may come out a rounding to the west of it, just under 360 degrees.
    assert (course[2:7] + 180.0) % 360.0 == pytest.approx([170.0, 175.0, 180.0, 185.0, 190.0], abs=ROUNDING)
    known = course[np.isfinite(course)]
    assert ((known >= 0.0) & (known < 360.0)).all()


def test_longitude_takes_the_short_way_across_the_date_line() -> None:
    lon = vector(on_imu_times(lon=np.array([179.9, -179.9, -179.9])), "lon", gaps=True)
    assert np.abs(lon[2:7]) == pytest.approx([179.9, 179.95, 180.0, 179.95, 179.9], abs=ROUNDING)
    assert np.sign(lon[[3, 5]]).tolist() == [1.0, -1.0]


def test_codes_hold_their_last_value() -> None:
    result = on_imu_times(fix=pa.array([3, 2, 3], pa.int32()), satellites=pa.array([None, 7, 8], pa.int32()))
    fix = result["fix"].to_pylist()
    assert fix[:8] == [None, None, 3, 3, 3, 3, 2, None]
    assert fix[21:] == [None, 3, None, None]
    assert result["satellites"].to_pylist()[:8] == [None] * 6 + [7, None]
    assert result["fix"].type == pa.int32()


def turning(t_s: Array, rate: float = 0.5) -> Any:
    """Attitudes that turn to the left at a steady rate, with a sign that jumps."""
    q = from_euler(rate * t_s, np.zeros(len(t_s)), np.zeros(len(t_s)))
    q[::3] *= -1.0
    return build(ATTITUDE, time=ns(t_s), q=q)


def test_attitudes_turn_at_a_steady_rate_between_their_samples() -> None:
    slow = np.arange(0.0, 3.01, 0.25)
    streams = run(alternating(np.arange(0.0, 3.0, 0.01)), streams={"attitude": turning(slow)})
    t_s = time_ns(streams["imu"]) * 1e-9
    np.testing.assert_array_equal(time_ns(streams["attitude"]), time_ns(streams["imu"]))
    assert to_euler(matrix(streams["attitude"], "q"))[0] == pytest.approx(0.5 * t_s, abs=ROUNDING)


def test_attitudes_are_not_invented_in_gaps_and_beyond_their_ends() -> None:
    known = np.array([0.5, 0.6, 2.0, 2.1])
    streams = run(alternating(np.arange(0.0, 3.0, 0.01)), streams={"attitude": turning(known)}, rate=20.0)
    found = (time_ns(streams["attitude"]) - 10_000_000) * 1e-9  # the grid begins with the first complete row
    assert ((found >= 0.48) & (found <= 0.61) | (found >= 1.98) & (found <= 2.11)).all()
    assert len(found) > 3


def test_a_clock_gives_the_times_and_faster_sensors_are_averaged() -> None:
    """Step 2 of many a small robot: everything at the times of GNSS."""
    t_s = np.arange(0.0, 10.0, 0.01)
    accel = 1.0 + np.sin(2.0 * np.pi * 10.0 * t_s)[:, None] * np.ones(3)
    imu = build(IMU, time=ns(t_s), accel=accel, gyro=np.ones((len(t_s), 3)))
    mag = build(MAG, time=ns(t_s), mag=accel * 1e-5)
    gnss = build(GNSS, time=ns([-1.0, 1.025, 2.025, 4.025, 5.025, 12.0]), speed=np.ones(6))
    streams = run(imu, gnss, streams={"clock": gnss, "mag": mag, "attitude": turning(t_s)}, mag=True)
    for name in ("imu", "mag", "attitude"):
        np.testing.assert_array_equal(time_ns(streams[name]), ns([1.025, 2.025, 4.025, 5.025]))
    assert streams["gnss"].equals(gnss)
    # Ten whole periods of the vibration are averaged away; at its crest, where it is taken, it would add 1.
    assert vector(streams["imu"], "accel_x") == pytest.approx(1.0, abs=1e-3)
    assert vector(streams["mag"], "mag_x") == pytest.approx(1e-5, abs=1e-8)
    (rows,) = (row for row in streams["metrics"].to_pylist() if row["name"] == "rows")
    assert (rows["value"], rows["method"]) == (4.0, "times of another stream")


def test_a_trajectory_comes_onto_the_times_of_images() -> None:
    t_s = np.arange(0.0, 3.0, 0.01)
    pos, zero = np.column_stack([t_s, 2.0 * t_s, 0.0 * t_s]), np.zeros(len(t_s))
    table = build(TRAJECTORY, time=ns(t_s), pos=pos, vel=pos, q=from_euler(t_s, zero, zero), lon=179.9 + 0.1 * t_s)
    clock = build(FRAMES, time=ns([0.3333, 1.7777]), index=np.arange(2), file=pa.array(["a", "b"]))
    found = run(alternating(t_s), streams={"trajectory": table, "clock": clock})["trajectory"]
    np.testing.assert_array_equal(time_ns(found), ns([0.3333, 1.7777]))
    assert matrix(found, "pos")[:, 1] == pytest.approx([0.6666, 3.5554])
    assert to_euler(matrix(found, "q"))[0] == pytest.approx([0.3333, 1.7777])
    assert conform(found, TRAJECTORY, stream="trajectory", step="test").num_rows == 2


def test_a_rate_and_a_clock_are_one_too_many() -> None:
    gnss = build(GNSS, time=ns([0.0, 1.0]), speed=np.ones(2))
    with pytest.raises(DataError, match="both a rate and a clock"):
        run(alternating(np.arange(0, 1, 0.01)), streams={"clock": gnss}, rate=10.0)


def test_the_result_keeps_the_schema() -> None:
    streams = run(alternating(np.arange(0, 1, 0.01)), build(GNSS, time=ns([0.0, 1.0]), speed=np.ones(2)), gnss=True)
    for name in ("imu", "gnss"):
        planned = STREAMS[name]
        assert conform(streams[name], planned, stream=name, step="test").num_rows == streams[name].num_rows


def test_an_empty_imu_passes() -> None:
    assert run(alternating(np.zeros(0)))["imu"].num_rows == 0
    assert run(alternating(np.zeros(0)), rate=100.0)["imu"].num_rows == 0


def test_the_declaration_has_no_fault() -> None:
    assert [stage.faults() for stage in declare_filters()] == [[]]


def test_sensors_that_are_never_known_together_are_refused() -> None:
    with pytest.raises(DataError, match=r"accel and gyro within 0\.5 s at none of 6 times"):
        run(alternating(10.0 * np.arange(6)))
