from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from helpers import START_NS, clock, gnss_table, imu_table

from recon.errors import ContractError, DataError
from recon.rows import Event, events
from recon.schema import EVENTS, GNSS, IMU, TIME_TYPE, TRAJECTORY, Change, Column, Schema
from recon.tables import (
    append,
    build,
    conform,
    has,
    matrix,
    matrix_or_nan,
    measured_axes,
    meta,
    replace,
    schema_of,
    seconds,
    select_rows,
    time_ns,
    times,
    vector,
    vector_or_nan,
    with_meta,
)


def conformed(table, schema, stream="imu"):
    return conform(table, schema, stream=stream, step="filter.work")


def test_build_stamps_type_unit_frame_and_quantity():
    table = imu_table()
    assert table.schema.field("time").type == TIME_TYPE
    assert schema_of(table)["accel_x"] == Column("accel_x", "m/s^2", "sensor", "specific_force")


def test_build_leaves_optional_columns_out_and_fills_required_ones_with_null():
    table = build(TRAJECTORY, time=clock(2), pos=np.zeros((2, 3)))
    assert "accel_x" not in table.column_names
    assert table["qw"].null_count == 2


def test_build_takes_whole_numbers_and_single_precision_for_doubles():
    table = build(GNSS, time=[1, 2], speed=np.array([3, 4]), lat=np.array([1.5, 2.5], dtype=np.float32), fix=[3, None])
    assert vector(table, "speed").tolist() == [3.0, 4.0]
    assert vector(table, "lat").tolist() == [1.5, 2.5]
    assert table["fix"].to_pylist() == [3, None]


def test_build_casts_an_arrow_array_of_another_type():
    table = build(GNSS, time=pa.array([1, 2]), speed=pa.array([3, 4]))
    table.validate(full=True)
    assert vector(table, "speed").tolist() == [3.0, 4.0]


def test_build_of_nothing_has_no_rows():
    assert build(IMU).num_rows == 0


def test_build_refuses_what_the_schema_does_not_know():
    with pytest.raises(ValueError, match="no column 'acel'"):
        build(IMU, time=[1], acel=[0.0])
    with pytest.raises(ValueError, match="accel has 2 columns"):
        build(IMU, time=[1], accel=np.zeros((1, 2)))


def test_missing_numbers_are_null_in_a_table_and_nan_in_an_array():
    table = build(GNSS, time=[1, 2], speed=np.array([np.nan, 2.0]))
    assert table["speed"].to_pylist() == [None, 2.0]
    assert np.isnan(vector(table, "speed", gaps=True)).tolist() == [True, False]


def test_a_gap_is_refused_with_its_row_and_time():
    table = build(GNSS, time=[10**9, 2 * 10**9, 3 * 10**9], speed=np.array([1.0, np.nan, np.inf]))
    with pytest.raises(DataError, match=r"column speed has no finite number in 2 of 3 rows, first in row 1 \(1970"):
        vector(table, "speed")


def test_matrix_gathers_a_group_in_canonical_order():
    assert matrix(imu_table(2), "gyro").tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    with pytest.raises(KeyError, match="mag"):
        matrix(imu_table(), "mag")


def test_what_is_not_there_is_nan_in_every_row():
    table = imu_table(3)
    np.testing.assert_array_equal(matrix_or_nan(table, "gyro"), matrix(table, "gyro"))
    np.testing.assert_array_equal(vector_or_nan(table, "gyro_x"), vector(table, "gyro_x"))
    np.testing.assert_array_equal(matrix_or_nan(table, "q", 4), np.full((3, 4), np.nan))
    np.testing.assert_array_equal(matrix_or_nan(table.drop_columns(["gyro_x"]), "gyro"), np.full((3, 3), np.nan))
    np.testing.assert_array_equal(vector_or_nan(table, "lat"), np.full(3, np.nan))


def test_axes_that_nobody_measured_count_as_zero_and_are_named():
    table = build(IMU, time=np.array([0, 1]), accel=np.array([[1.0, np.nan, np.nan], [2.0, np.nan, 3.0]]))
    values, names = measured_axes(table, "accel")
    np.testing.assert_array_equal(values, [[1.0, 0.0, np.nan], [2.0, 0.0, 3.0]])
    assert names == ["accel_y"]
    nothing, names = measured_axes(build(IMU, time=np.array([0]), accel=np.full((1, 3), np.nan)), "accel")
    assert np.isnan(nothing).all()
    assert names == []


def test_arrays_do_not_care_how_a_table_is_cut_into_chunks():
    pieces = pa.concat_tables([imu_table(3), imu_table(2, START_NS + 10**9)])
    assert pieces["gyro_x"].num_chunks == 2
    assert vector(pieces, "gyro_x").tolist() == [0.0, 3.0, 6.0, 0.0, 3.0]
    assert len(time_ns(pieces)) == 5


def test_seconds_keep_the_nanoseconds_of_late_times():
    table = build(GNSS, time=START_NS + np.array([0, 1, 1_000_000_001]), speed=np.zeros(3))
    # 1e-9 has one rounding, the product another: relative 2.2e-16 each
    np.testing.assert_allclose(seconds(table), [0.0, 1e-9, 1.000000001], rtol=4.5e-16)
    assert seconds(table, since=START_NS + 1)[0] == -1e-9
    assert seconds(build(IMU)).shape == (0,)


def test_has_asks_for_a_value_in_each_column():
    table = build(TRAJECTORY, time=[1, 2], pos=np.array([[1.0, np.nan, 1.0], [1.0, np.nan, 1.0]]), lat=[None, 1.0])
    assert has(table, "lat")
    assert not has(table, "pos")
    assert not has(table, "mag")
    assert not has(None, "pos")


def test_replace_keeps_place_order_and_metadata():
    table = with_meta(imu_table(), height_datum="msl")
    changed = replace(table, accel=np.ones((4, 3)), gyro_y=np.zeros(4))
    assert changed.schema.equals(table.schema, check_metadata=True)
    assert matrix(changed, "accel").tolist() == np.ones((4, 3)).tolist()
    assert vector(changed, "gyro_x").tolist() == vector(table, "gyro_x").tolist()
    assert vector(table, "accel_x").tolist() == [0.0] * 4


def test_replace_adds_a_group_under_its_canonical_names():
    changed = replace(gnss_table(), vel=np.zeros((3, 3)), odd=np.zeros(3))
    assert changed.column_names == ["time", "speed", "vel_e", "vel_n", "vel_u", "odd"]


def test_replace_refuses_a_group_of_another_width():
    with pytest.raises(ValueError, match="accel has 2 columns; it stands for"):
        replace(imu_table(), accel=np.zeros((4, 2)))
    with pytest.raises(ValueError, match="no known columns"):
        replace(imu_table(), unheard=np.zeros((4, 2)))


def test_replace_with_nan_writes_nulls():
    assert replace(imu_table(1), accel=np.full((1, 3), np.nan))["accel_x"].null_count == 1


def test_rows_are_selected_by_mask_and_by_number_with_metadata():
    table = with_meta(gnss_table(3), anchor={"lat": 44.0})
    by_mask, by_number = select_rows(table, np.array([True, False, True])), select_rows(table, np.array([2, 0]))
    assert vector(by_mask, "speed").tolist() == [0.0, 2.0]
    assert vector(by_number, "speed").tolist() == [2.0, 0.0]
    assert meta(by_mask) == meta(by_number) == {"anchor": {"lat": 44.0}}


def test_facts_are_added_replaced_and_taken_away():
    table = with_meta(with_meta(imu_table(), time_scale="UTC", anchor={"lat": 1.0}), time_scale="GPS", anchor=None)
    assert meta(table) == {"time_scale": "GPS"}
    assert table.schema.metadata[b"recon.schema"] == b"1"


def test_conform_orders_and_stamps_and_keeps_the_facts():
    bare = pa.table({name: imu_table()[name] for name in reversed(imu_table().column_names)})
    result = conformed(with_meta(bare, time_scale="GPS"), IMU)
    assert result.schema.remove_metadata().equals(imu_table().schema.remove_metadata())
    assert schema_of(result) == schema_of(imu_table())
    assert meta(result) == {"time_scale": "GPS"}


def test_conform_stamps_the_planned_frame_and_quantity():
    planned = Change(frames={"accel": "vehicle"}, quantities={"accel": "acceleration"}).apply(IMU)
    assert schema_of(conformed(imu_table(), planned))["accel_z"].quantity == "acceleration"


def test_conform_makes_plain_times_and_single_precision_what_was_planned():
    table = pa.table({"time": pa.array([1, 2]), "speed": pa.array([1.0, 2.0], pa.float32())})
    result = conformed(table, GNSS.only("speed"), "gnss")
    assert result.schema.types == [TIME_TYPE, pa.float64()]


def test_conform_names_undeclared_and_missing_columns_together():
    table = imu_table().drop_columns(["gyro_x"]).append_column("extra", pa.array([0.0] * 4))
    with pytest.raises(ContractError) as caught:
        conformed(table, IMU)
    assert caught.value.message == (
        "step filter.work: stream 'imu': it returned ['extra'], which it does not declare and did not return "
        "['gyro_x'], which it declares"
    )


def test_conform_lets_optional_columns_be_absent():
    assert "temperature" not in conformed(imu_table(), IMU).column_names


@pytest.mark.parametrize("late", [1, 0])
def test_conform_refuses_time_that_falls_or_stands(late):
    table = build(GNSS, time=[1, 2, 1 + late], speed=np.zeros(3))
    with pytest.raises(ContractError, match="stream 'gnss': time does not rise at row 2"):
        conformed(table, GNSS.only("speed"), "gnss")


def test_conform_refuses_a_row_without_time():
    table = build(GNSS, time=pa.array([1, None], TIME_TYPE), speed=np.zeros(2))
    with pytest.raises(ContractError, match="1 rows have no time"):
        conformed(table, GNSS.only("speed"), "gnss")


@pytest.mark.parametrize("column", ["time", "end_time"])
def test_conform_refuses_an_event_without_its_times(column):
    table = events([Event(1, 2, "stop"), Event(3, 4, "stop")])
    without = pa.array([1, None], TIME_TYPE)
    table = table.set_column(table.column_names.index(column), column, without)
    with pytest.raises(ContractError, match=f"stream 'events': 1 rows have no {column}"):
        conformed(table, EVENTS, "events")


@pytest.mark.parametrize("speed", [["fast", "slow"], ["1.5", "2.5"], [[1.0], [2.0]]])
def test_conform_refuses_columns_of_another_type(speed):
    table = pa.table({"time": times([1, 2]), "speed": speed})
    with pytest.raises(ContractError, match=r"column speed is .*, declared as double"):
        conformed(table, GNSS.only("speed"), "gnss")


def test_conform_refuses_numbers_that_do_not_fit():
    planned = Schema((Column("index", type=pa.int32()),))
    with pytest.raises(ContractError, match="column index is double, declared as int32"):
        conformed(pa.table({"index": [1.5]}), planned)


def test_appended_streams_need_not_rise():
    from recon.rows import Event, events
    from recon.schema import EVENTS

    table = events([Event(5, 6, "stop"), Event(5, 7, "crash")])
    assert conformed(table, EVENTS, "events").num_rows == 2


def test_append_puts_the_second_below_with_its_columns_and_nulls_for_what_the_first_lacks():
    first = gnss_table(1)
    second = with_meta(build(GNSS, time=[START_NS * 2], lat=[1.0], speed=[7.0]), time_scale="GPS")
    both = append(first, second)
    assert both.column_names == ["time", "lat", "speed"]
    assert both["lat"].to_pylist() == [None, 1.0]
    assert both["speed"].to_pylist() == [0.0, 7.0]
    assert both.schema.equals(second.schema, check_metadata=True)
    assert append(None, second) is second


def test_times_are_nanoseconds_since_1970():
    assert times([START_NS + 1]).cast(pa.int64()).to_pylist() == [START_NS + 1]
