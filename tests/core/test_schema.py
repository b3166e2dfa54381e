from __future__ import annotations

import pyarrow as pa
import pytest

from recon.schema import (
    ANY,
    APPENDED,
    GNSS,
    IMU,
    METRICS,
    SAME,
    STREAMS,
    TIME_TYPE,
    TRAJECTORY,
    Change,
    Column,
    Need,
    Schema,
    by_step,
    group_of,
    match,
    spread,
    unnumbered,
)
from recon.units import parse_unit, si_unit


@pytest.mark.parametrize(
    ("column", "group"),
    [
        ("accel_x", "accel"),
        ("pos_u", "pos"),
        ("pos_std_e", "pos_std"),
        ("att_std_yaw", "att_std"),
        ("qz", "q"),
        ("speed", "speed"),
        ("_x", "_x"),
    ],
)
def test_a_column_belongs_to_the_group_before_its_axis(column, group):
    assert group_of(column) == group


def test_a_group_spreads_in_the_order_of_the_columns():
    assert spread("q", TRAJECTORY.names) == ("qw", "qx", "qy", "qz")
    assert spread("pos", TRAJECTORY.names) == ("pos_e", "pos_n", "pos_u")
    assert spread("speed", ("speed", "speed_x")) == ("speed",)
    assert spread("nothing", TRAJECTORY.names) == ()


@pytest.mark.parametrize("stream", STREAMS)
def test_canonical_columns_are_in_si_or_degrees_of_latitude_and_longitude(stream):
    for column in STREAMS[stream].columns:
        if column.unit:
            assert column.unit == si_unit(column.unit) or column.name in ("lat", "lon")
            assert parse_unit(column.unit).scale == 1.0 or column.unit == "deg"


@pytest.mark.parametrize("stream", [name for name in STREAMS if name != "metrics"])
def test_every_stream_but_metrics_begins_with_the_time(stream):
    first = STREAMS[stream].columns[0]
    assert (first.name, first.type, first.optional) == ("time", TIME_TYPE, False)


def test_only_takes_the_time_the_groups_and_the_uncertain_ones():
    schema = IMU.only("accel", maybe=["temperature"])
    assert schema.names == ("time", "accel_x", "accel_y", "accel_z", "temperature")
    assert [c.optional for c in schema.columns] == [False] * 4 + [True]


def test_only_puts_vectors_into_another_frame_and_leaves_scalars():
    schema = IMU.only("accel", maybe=["temperature"], frame="level")
    assert {c.name: c.frame for c in schema.columns} == {
        "time": "",
        "accel_x": "level",
        "accel_y": "level",
        "accel_z": "level",
        "temperature": "",
    }


def test_an_unknown_group_is_a_key_error():
    with pytest.raises(KeyError, match="acel"):
        IMU.need("acel")


def test_a_possible_stream_may_be_absent():
    assert not IMU.uncertain
    assert IMU.possible().uncertain


def test_an_open_ended_stream_serves_every_frame_and_quantity_but_no_other_unit():
    opened = IMU.open_ended()
    assert opened.uncertain
    assert match(IMU.need("accel", frame="vehicle", quantity={"accel": "acceleration"}), opened, "imu") == []
    in_g = Need((Column("accel_x", "1", ANY, ANY),))
    assert [mismatch.text for mismatch in match(in_g, opened, "imu")] == ["imu.accel_x in 1; here it is in m/s^2"]


def test_a_need_is_served_by_the_schema_that_it_was_made_of():
    assert match(IMU.need("accel", "gyro", frame="sensor", maybe=["temperature"]), IMU, "imu") == []


def test_an_absent_group_is_one_mismatch_with_what_is_there():
    (lack,) = match(GNSS.need("pos"), GNSS.only("speed"), "gnss")
    assert lack.missing
    assert lack.columns == ("pos_e", "pos_n", "pos_u")
    assert lack.text == "gnss.pos_e, pos_n, pos_u; columns of 'gnss' here are time, speed"


def test_absent_columns_that_only_may_be_used_are_no_mismatch():
    assert match(GNSS.need("speed", maybe=["pos"]), GNSS.only("speed"), "gnss") == []


@pytest.mark.parametrize(
    ("here", "text"),
    [
        (Column("accel_x", "m/s^2", "sensor", "specific_force"), "in frame 'vehicle'; here it is in frame 'sensor'"),
        (Column("accel_x", "m/s^2", "vehicle", "acceleration"), "as specific_force; here it is acceleration"),
        (Column("accel_x", "", "vehicle", "specific_force"), "in m/s^2; here it is in no unit"),
        (
            Column("accel_x", "m/s^2", "vehicle", "specific_force", type=pa.float32()),
            "as double; here it is float",
        ),
    ],
)
def test_a_column_of_another_kind_says_what_is_asked_and_what_is_here(here, text):
    wanted = IMU.need("accel", frame="vehicle", quantity={"accel": "specific_force"})
    need = type(wanted)(wanted.columns[:1])
    (mismatch,) = match(need, Schema((here,)), "imu")
    assert mismatch.text == f"imu.accel_x {text}"
    assert not mismatch.missing


def test_the_same_fault_of_three_axes_is_told_once():
    (mismatch,) = match(IMU.need("gyro", frame="vehicle"), IMU, "imu")
    assert mismatch.text == "imu.gyro_x, gyro_y, gyro_z in frame 'vehicle'; here it is in frame 'sensor'"


def test_a_change_turns_frames_and_quantities_adds_and_drops():
    change = Change(
        frames={"accel": "vehicle"},
        quantities={"accel": "acceleration"},
        adds=(Column("jerk_x", "m/s^3", "vehicle", "jerk"),),
        drops=("gyro", "temperature"),
    )
    changed = change.apply(IMU)
    assert changed.names == ("time", "accel_x", "accel_y", "accel_z", "jerk_x")
    assert {changed[f"accel_{axis}"].quantity for axis in "xyz"} == {"acceleration"}
    assert {changed[f"accel_{axis}"].frame for axis in "xyz"} == {"vehicle"}
    assert IMU["accel_x"].frame == "sensor"


def test_a_change_that_adds_a_column_of_a_known_name_takes_its_place():
    taken = Column("accel_x", "m/s^2", "local", "acceleration")
    assert Change(adds=(taken,)).apply(IMU).names == IMU.names
    assert Change(adds=(taken,)).apply(IMU)["accel_x"] == taken


def test_no_change_changes_nothing():
    assert SAME.apply(TRAJECTORY) == TRAJECTORY


@pytest.mark.parametrize("stream", APPENDED)
def test_an_appended_stream_is_kept_with_its_step_in_front(stream):
    assert by_step(stream).names == ("step", *STREAMS[stream].names)


def test_metrics_have_no_time():
    assert "time" not in METRICS


@pytest.mark.parametrize(
    ("stream", "name"), [("imu_2", "imu"), ("imu", "imu"), ("imu_x", "imu_x"), ("_2", "_2"), ("a_b_12", "a_b")]
)
def test_the_number_of_a_further_sensor_is_taken_off(stream, name):
    assert unnumbered(stream) == name
