from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from helpers import START_NS, STEP_NS, clock, gnss_table, imu_table

from recon.errors import DataError
from recon.joining import combine
from recon.recording import Recording
from recon.rows import Event, events
from recon.schema import IMU
from recon.tables import build, matrix, meta, select_rows, time_ns, vector, with_meta

SECOND = 10**9


def part(name, table, source=""):
    return Recording({name: table}, {"sources": [source]} if source else {})


def accel_only(rows, start_ns=START_NS, *, first=0.0):
    accel = first + np.arange(3.0 * rows).reshape(rows, 3)
    return build(IMU.only("accel"), time=clock(rows, start_ns), accel=accel)


def gyro_only(rows, start_ns=START_NS):
    return build(IMU.only("gyro"), time=clock(rows, start_ns), gyro=np.ones((rows, 3)))


def joined(parts):
    return combine(parts)[0]


def test_accelerometer_and_gyroscope_of_the_same_times_become_one_imu():
    recording = joined([part("imu", gyro_only(3), "g.txt"), part("imu", accel_only(3), "a.txt")])
    assert list(recording) == ["imu"]
    assert matrix(recording["imu"], "accel").tolist() == np.arange(9.0).reshape(3, 3).tolist()
    assert matrix(recording["imu"], "gyro").tolist() == np.ones((3, 3)).tolist()
    assert recording.meta == {"sources": ["g.txt", "a.txt"]}


def test_complementing_columns_of_other_times_are_null_where_the_other_has_a_row():
    recording = joined([part("imu", accel_only(2)), part("imu", gyro_only(2, START_NS + STEP_NS // 2))])
    table = recording["imu"]
    assert (time_ns(table) - START_NS).tolist() == [0, STEP_NS // 2, STEP_NS, 3 * STEP_NS // 2]
    assert table["accel_x"].to_pylist() == [0.0, None, 3.0, None]
    assert table["gyro_x"].to_pylist() == [None, 1.0, None, 1.0]


def test_complementing_columns_keep_what_was_null():
    holed = build(IMU.only("accel"), time=clock(2), accel=np.full((2, 3), np.nan))
    assert joined([part("imu", holed), part("imu", gyro_only(2))])["imu"]["accel_x"].null_count == 2


def test_a_file_without_rows_complements_with_nulls():
    table = joined([part("imu", accel_only(2)), part("imu", gyro_only(0))])["imu"]
    assert table["gyro_x"].to_pylist() == [None, None]
    assert table["accel_x"].to_pylist() == [0.0, 3.0]


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_pieces_that_follow_each_other_become_one_in_the_order_of_time(order):
    pieces = [imu_table(3), imu_table(2, START_NS + SECOND)]
    recording = joined([part("imu", pieces[index]) for index in order])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "gyro_x").tolist() == [0.0, 3.0, 6.0, 0.0, 3.0]


def test_pieces_that_overlap_are_joined_though_a_column_holds_lists():
    times = clock(6)
    lists = pa.table({"time": times, "covariance": [[1.0 * i, None] for i in range(5)] + [None]})
    whole = joined([part("knots", lists.slice(0, 4)), part("knots", lists.slice(2))])
    assert whole["knots"]["covariance"].to_pylist() == lists["covariance"].to_pylist()
    other = lists.set_column(1, "covariance", pa.array([[9.0, None]] * 6))
    with pytest.raises(DataError, match="differ there"):
        joined([part("knots", lists.slice(0, 4)), part("knots", other.slice(2))])


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 2, 1, 3], [3, 0, 2, 1]])
def test_two_sensors_logged_in_two_pieces_become_one_imu(order):
    late = START_NS + SECOND
    files = [accel_only(2), gyro_only(2), accel_only(2, late), gyro_only(2, late)]
    recording = joined([part("imu", files[index]) for index in order])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "accel_x").tolist() == [0.0, 3.0, 0.0, 3.0]
    assert vector(recording["imu"], "gyro_x").tolist() == [1.0] * 4


def test_a_whole_piece_follows_one_that_was_logged_as_two_files():
    late = imu_table(2, START_NS + SECOND)
    recording = joined([part("imu", gyro_only(2)), part("imu", accel_only(2)), part("imu", late)])
    assert list(recording) == ["imu"]
    assert vector(recording["imu"], "gyro_x").tolist() == [1.0, 1.0, 0.0, 3.0]


def test_streams_of_one_time_are_kept_side_by_side_in_the_order_given():
    recording = joined([part("imu", accel_only(2)), part("imu", accel_only(2, first=100.0))])
    assert list(recording) == ["imu", "imu_2"]
    assert vector(recording["imu"], "accel_x")[0] == 0.0
    assert vector(recording["imu_2"], "accel_x")[0] == 100.0


def test_the_sensor_with_more_columns_comes_first():
    recording = joined([part("imu", accel_only(4)), part("imu", imu_table(4))])
    assert "gyro_x" in recording["imu"].column_names
    assert "gyro_x" not in recording["imu_2"].column_names


def log(rows=slice(None)):
    """A part of a log of 100 rows, as one file."""
    whole = imu_table(100)
    return part("imu", select_rows(whole, np.arange(100)[rows]), f"{rows}")


def notes(parts):
    return [(row.name, row.note) for row in combine(parts)[1]]


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
@pytest.mark.parametrize("cut", [1, 5, 40, 60])
def test_rows_that_two_pieces_hold_are_taken_once_and_counted(order, cut):
    pieces = [log(slice(0, 60)), log(slice(60 - cut, 100))]
    recording, learnt = combine([pieces[index] for index in order])
    assert list(recording) == ["imu"]
    assert recording["imu"].equals(imu_table(100))
    assert [(row.name, row.value) for row in learnt] == [("rows_joined", cut)]


def test_a_piece_that_another_holds_whole_adds_nothing():
    recording, learnt = combine([log(), log(slice(20, 50))])
    assert recording["imu"].equals(imu_table(100))
    assert learnt[0].value == 30


def test_other_streams_of_a_piece_are_cut_with_the_one_that_has_most_rows():
    # A receiver's value that is held at the beginning of a piece looks like a report of that time.
    first = Recording({"imu": imu_table(60), "gnss": gnss_table(3, START_NS)})
    late = imu_table(100).slice(50)
    held = gnss_table(2, int(time_ns(late)[0]))
    second = Recording({"imu": late, "gnss": held})
    joined_gnss = combine([first, second])[0]["gnss"]
    assert (np.diff(time_ns(joined_gnss)) > 0).all()
    assert time_ns(joined_gnss)[:3].tolist() == time_ns(first["gnss"]).tolist()


def test_pieces_that_differ_where_they_overlap_are_refused():
    with pytest.raises(DataError, match=r"a\.txt and b\.txt overlap by 0\.02 s \(3 rows\) and differ there"):
        combine([part("imu", imu_table(60), "a.txt"), part("imu", imu_table(60, START_NS + 57 * STEP_NS), "b.txt")])


def test_the_same_file_twice_is_refused():
    with pytest.raises(DataError, match=r"a\.txt and copy\.txt hold the same rows"):
        combine([part("imu", imu_table(), "a.txt"), part("imu", imu_table(), "copy.txt")])


@pytest.mark.parametrize("days", [-3, 3])
def test_files_of_two_drives_are_refused(days):
    other = imu_table(4, START_NS + days * 86_400 * SECOND)
    with pytest.raises(DataError, match=r"are two drives: they are 3 days apart") as caught:
        combine([part("imu", imu_table(), "a.txt"), part("imu", other, "b.txt")])
    assert caught.value.hint == "run them one by one"


def test_a_pause_of_ten_minutes_is_one_drive():
    end = START_NS + 3 * STEP_NS
    assert list(joined([part("imu", imu_table()), part("imu", imu_table(4, end + 600 * SECOND))])) == ["imu"]
    with pytest.raises(DataError, match="two drives"):
        combine([part("imu", imu_table()), part("imu", imu_table(4, end + 601 * SECOND))])


def test_files_between_bridge_a_pause():
    starts = [START_NS, START_NS + 500 * SECOND, START_NS + 1000 * SECOND]
    assert joined([part("imu", imu_table(4, start)) for start in starts])["imu"].num_rows == 12


def test_a_second_sensor_is_told_with_its_file():
    told = notes([part("imu", imu_table(), "box.txt"), part("imu", accel_only(4, first=7.0), "acc.txt")])
    assert told == [
        ("warning", "imu_2 (acc.txt) is a further sensor beside imu (box.txt); steps read imu unless told otherwise")
    ]


def test_what_is_joined_without_doubt_is_not_told():
    assert notes([part("imu", accel_only(3)), part("imu", gyro_only(3))]) == []
    assert notes([part("imu", imu_table(3)), part("imu", imu_table(2, START_NS + SECOND))]) == []


def test_pieces_with_other_facts_are_not_joined():
    early = with_meta(imu_table(2), time_scale="GPS")
    late = with_meta(imu_table(2, START_NS + SECOND), time_scale="UTC")
    assert list(joined([part("imu", early), part("imu", late)])) == ["imu", "imu_2"]


def test_facts_of_a_stream_survive_joining():
    facts = {"time_scale": "GPS"}
    pieces = [with_meta(imu_table(2), **facts), with_meta(imu_table(2, START_NS + SECOND), **facts)]
    assert meta(joined([part("imu", piece) for piece in pieces])["imu"]) == facts
    sensors = [with_meta(accel_only(2), **facts), gyro_only(2)]
    assert meta(joined([part("imu", sensor) for sensor in sensors])["imu"]) == facts


def test_events_of_several_files_are_appended():
    recording = joined([part("events", events([Event(5, 6, "stop")])), part("events", events([Event(1, 2, "stop")]))])
    assert list(recording) == ["events"]
    assert recording["events"].num_rows == 2


def test_streams_without_time_are_never_joined():
    table = pa.table({"key": ["a"]})
    assert list(joined([part("notes", table), part("notes", pa.table({"word": ["b"]}))])) == ["notes", "notes_2"]


def test_one_recording_stays_as_it_is():
    recording = Recording({"imu": imu_table(), "gnss": gnss_table()}, {"sources": ["a"]})
    assert joined([recording]) == recording
