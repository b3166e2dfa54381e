from __future__ import annotations

import pyarrow as pa
import pytest

from recon.columns import ANY, SAME, Change, Column, Need, Schema, group_of, match, spread
from recon.schema import GNSS, IMU, TRAJECTORY


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
