from __future__ import annotations

import pickle

import numpy as np
import pyarrow as pa
import pytest
from helpers import START_NS, STEP_NS, clock, gnss_table, imu_table

from recon.recording import Recording, combine
from recon.rows import Event, events
from recon.schema import IMU
from recon.tables import build, matrix, meta, time_ns, vector, with_meta

SECOND = 10**9


def part(name, table, source=""):
    return Recording({name: table}, {"sources": [source]} if source else {})


def accel_only(rows, start_ns=START_NS, *, first=0.0):
    accel = first + np.arange(3.0 * rows).reshape(rows, 3)
    return build(IMU.only("accel"), time=clock(rows, start_ns), accel=accel)


def gyro_only(rows, start_ns=START_NS):
    return build(IMU.only("gyro"), time=clock(rows, start_ns), gyro=np.ones((rows, 3)))


def test_a_recording_is_a_mapping_that_nobody_changes():
    streams = {"imu": imu_table()}
    recording = Recording(streams, {"sources": ["a.txt"]})
    streams["gnss"] = gnss_table()
    assert list(recording) == ["imu"]
    with pytest.raises(TypeError):
        recording.streams["gnss"] = gnss_table()
    updated = recording.updated({"imu": imu_table(2), "gnss": gnss_table()})
    assert (recording["imu"].num_rows, updated["imu"].num_rows, list(updated)) == (4, 2, ["imu", "gnss"])
    assert updated.meta == recording.meta


def test_a_recording_pickles_with_all_metadata():
    recording = Recording({"imu": with_meta(imu_table(), anchor={"lat": 44.5})}, {"sources": ["a.txt"]})
    again = pickle.loads(pickle.dumps(recording))
    assert again == recording
    assert again["imu"].schema.equals(recording["imu"].schema, check_metadata=True)
    assert again.meta == recording.meta


def test_the_span_covers_all_streams_and_is_none_without_rows():
    recording = Recording({"imu": imu_table(2, START_NS + SECOND), "gnss": gnss_table(2), "mag": imu_table(0)})
    assert recording.span_ns() == (START_NS, START_NS + SECOND + STEP_NS)
    assert Recording({"imu": imu_table(0)}).span_ns() is None


def test_html_escapes_names():
    assert "&lt;b&gt;" in Recording({"<b>": imu_table()})._repr_html_()


def test_accelerometer_and_gyroscope_of_the_same_times_become_one_imu():
    recording = combine([part("imu", gyro_only(3), "g.txt"), part("imu", accel_only(3), "a.txt")])
    assert list(recording) == ["imu"]
    assert matrix(recording["imu"], "accel").tolist() == np.arange(9.0).reshape(3, 3).tolist()
    assert matrix(recording["imu"], "gyro").tolist() == np.ones((3, 3)).tolist()
    assert recording.meta == {"sources": ["g.txt", "a.txt"]}


def test_complementing_columns_of_other_times_are_null_where_the_other_has_a_row():
    recording = combine([part("imu", accel_only(2)), part("imu", gyro_only(2, START_NS + STEP_NS // 2))])
    table = recording["imu"]
    assert (time_ns(table) - START_NS).tolist() == [0, STEP_NS // 2, STEP_NS, 3 * STEP_NS // 2]
    assert table["accel_x"].to_pylist() == [0.0, None, 3.0, None]
    assert table["gyro_x"].to_pylist() == [None, 1.0, None, 1.0]


def test_complementing_columns_keep_what_was_null():
    holed = build(IMU.only("accel"), time=clock(2), accel=np.full((2, 3), np.nan))
    assert combine([part("imu", holed), part("imu", gyro_only(2))])["imu"]["accel_x"].null_count == 2


def test_a_file_without_rows_complements_with_nulls():
    table = combine([part("imu", accel_only(2)), part("imu", gyro_only(0))])["imu"]
    assert table["gyro_x"].to_pylist() == [None, None]
    assert table["accel_x"].to_pylist() == [0.0, 3.0]


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_pieces_that_follow_each_other_become_one_in_the_order_of_time(order):
    pieces = [imu_table(3), imu_table(2, START_NS + SECOND)]
    recording = combine([part("imu", pieces[index]) for index in order])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "gyro_x").tolist() == [0.0, 3.0, 6.0, 0.0, 3.0]


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 2, 1, 3], [3, 0, 2, 1]])
def test_two_sensors_logged_in_two_pieces_become_one_imu(order):
    late = START_NS + SECOND
    files = [accel_only(2), gyro_only(2), accel_only(2, late), gyro_only(2, late)]
    recording = combine([part("imu", files[index]) for index in order])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "accel_x").tolist() == [0.0, 3.0, 0.0, 3.0]
    assert vector(recording["imu"], "gyro_x").tolist() == [1.0] * 4


def test_a_whole_piece_follows_one_that_was_logged_as_two_files():
    late = imu_table(2, START_NS + SECOND)
    recording = combine([part("imu", gyro_only(2)), part("imu", accel_only(2)), part("imu", late)])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "gyro_x").tolist() == [1.0, 1.0, 0.0, 3.0]


def test_streams_of_one_time_are_kept_side_by_side_in_the_order_given():
    recording = combine([part("imu", accel_only(2)), part("imu", accel_only(2, first=100.0))])
    assert list(recording) == ["imu", "imu_2"]
    assert vector(recording["imu"], "accel_x")[0] == 0.0
    assert vector(recording["imu_2"], "accel_x")[0] == 100.0


def test_the_sensor_with_more_columns_comes_first():
    recording = combine([part("imu", accel_only(4)), part("imu", imu_table(4))])
    assert "gyro_x" in recording["imu"].column_names
    assert "gyro_x" not in recording["imu_2"].column_names


def test_pieces_that_touch_are_separate_sensors():
    assert list(combine([part("imu", imu_table(3)), part("imu", imu_table(3, START_NS + 2 * STEP_NS))])) == [
        "imu",
        "imu_2",
    ]


def test_pieces_with_other_facts_are_not_joined():
    early = with_meta(imu_table(2), time_scale="GPS")
    late = with_meta(imu_table(2, START_NS + SECOND), time_scale="UTC")
    assert list(combine([part("imu", early), part("imu", late)])) == ["imu", "imu_2"]


def test_facts_of_a_stream_survive_joining():
    facts = {"time_scale": "GPS"}
    pieces = [with_meta(imu_table(2), **facts), with_meta(imu_table(2, START_NS + SECOND), **facts)]
    assert meta(combine([part("imu", piece) for piece in pieces])["imu"]) == facts
    sensors = [with_meta(accel_only(2), **facts), gyro_only(2)]
    assert meta(combine([part("imu", sensor) for sensor in sensors])["imu"]) == facts


def test_events_of_several_files_are_appended():
    recording = combine([part("events", events([Event(5, 6, "stop")])), part("events", events([Event(1, 2, "stop")]))])
    assert list(recording) == ["events"]
    assert recording["events"].num_rows == 2


def test_streams_without_time_are_never_joined():
    table = pa.table({"key": ["a"]})
    assert list(combine([part("notes", table), part("notes", pa.table({"word": ["b"]}))])) == ["notes", "notes_2"]


def test_one_recording_stays_as_it_is():
    recording = Recording({"imu": imu_table(), "gnss": gnss_table()}, {"sources": ["a"]})
    assert combine([recording]) == recording
