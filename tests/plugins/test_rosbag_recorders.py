"""reader.rosbag: what recorders leave behind: packed, killed in the middle of writing, with a clock set late."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import ros_logs

import recon_readers.rosbag
from recon import Streams
from recon.errors import NothingUsable, ReadFailed
from recon.rows import warnings_of
from recon.tables import meta, time_ns
from recon_readers._topics import TopicParams


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ros_logs.write(tmp_path_factory.mktemp("plain") / "drive", "sqlite3")


def read(path: Path) -> Streams:
    return recon_readers.rosbag.read(path, TopicParams())


def equal(found: Streams, expected: Streams) -> bool:
    return all(found[name].equals(expected[name]) for name in ("imu", "gnss", "mag", "baro"))


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_messages_that_are_packed_one_by_one_are_read(tmp_path: Path, plain: Path, form: str) -> None:
    assert equal(read(ros_logs.write(tmp_path / "packed", form, packed="message")), read(plain))


def test_messages_of_which_none_is_whole_are_told_as_that(tmp_path: Path, plain: Path) -> None:
    path = Path(shutil.copytree(plain, tmp_path / "drive"))
    with closing(sqlite3.connect(path / "drive.db3")) as bag, bag:
        bag.execute("UPDATE messages SET data = x'28b52ffd00'")
    with pytest.raises(NothingUsable, match="no message of /baro, /fix, /imu/data, /mag is whole"):
        read(path)


def test_a_file_that_is_packed_as_a_whole_is_named(tmp_path: Path, plain: Path) -> None:
    path = ros_logs.write(tmp_path / "drive", "sqlite3", packed="file")
    with pytest.raises(ReadFailed, match=r"it holds no .db3, .mcap or .bag file") as caught:
        read(path)
    assert caught.value.hint == "unpack its files with 'zstd -d' first"
    shutil.copy(plain / "drive.db3", path / "drive_1.db3")
    assert warnings_of(read(path)["metrics"]) == ["drive.db3.zstd is not read: unpack it with 'zstd -d' first"]
    shutil.copy(plain / "drive.db3", path / "drive.db3")
    assert not warnings_of(read(path)["metrics"])


def test_what_a_killed_recorder_left_in_the_journal_is_read(tmp_path: Path, plain: Path) -> None:
    killed, path = tmp_path / "writing.db3", tmp_path / "killed" / "writing.db3"
    shutil.copy(plain / "drive.db3", killed)
    with closing(sqlite3.connect(killed)) as bag:
        (count,) = bag.execute("SELECT count(*) FROM messages").fetchone()
        rows = bag.execute("SELECT * FROM messages WHERE id > ?", (count // 2,)).fetchall()
        bag.execute("DELETE FROM messages WHERE id > ?", (count // 2,))
        bag.commit()
        bag.execute("PRAGMA journal_mode = wal")
        bag.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        bag.commit()
        path.parent.mkdir()
        for name in ("writing.db3", "writing.db3-wal"):
            shutil.copy(tmp_path / name, path.parent)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    assert equal(read(path), read(plain))
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


def test_messages_from_before_the_clock_was_set_are_left_out(tmp_path: Path) -> None:
    first = ros_logs.START_NS + 300_000_000

    def stamped(t_ns: int) -> int:
        return t_ns if t_ns >= first else 0 if t_ns < first - 100_000_000 else t_ns - ros_logs.START_NS

    streams = read(ros_logs.write(tmp_path / "late", "mcap", stamped=stamped))
    np.testing.assert_array_equal(time_ns(streams["imu"]), first + np.arange(170) * 10_000_000)
    assert (meta(streams["imu"])["clock"], meta(streams["imu"])["time_scale"]) == ("absolute", "UTC")
    text = "30 of 200 messages of /imu/data are stamped by a clock that was not set: they are left out"
    assert text in warnings_of(streams["metrics"])


def test_a_bag_that_is_still_being_written_is_one_of_ros_1(tmp_path: Path) -> None:
    path = ros_logs.write(tmp_path / "drive.bag.active", "bag")
    assert meta(read(path)["imu"])["format"] == "ROS 1 bag"
