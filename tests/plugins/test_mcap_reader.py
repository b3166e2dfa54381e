"""reader.mcap on logs of other programs: ROS 1, ROS 2, Foxglove in Protobuf and JSON, whole, cut and never closed."""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import ros_logs
from mcap.writer import CompressionType, Writer
from metric_rows import rows_named

import recon
import recon_readers.mcap
from recon import Streams
from recon.errors import NothingUsable, ReadFailed
from recon.recording import Recording
from recon.rows import warnings_of
from recon.tables import matrix, meta, time_ns, vector
from recon.testing.drives import drive
from recon_readers._topics import TopicParams

T_NS = ros_logs.START_NS + np.arange(50) * 20_000_000


def read(path: Path, **params: object) -> Streams:
    return recon_readers.mcap.read(path, TopicParams(**params))


def ros1_mcap(path: Path, *, closed: bool = True, chunked: bool = True) -> Path:
    """ROS 1 messages as `mcap convert` writes them."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    out = BytesIO()
    writer = Writer(out, chunk_size=10_000, compression=CompressionType.ZSTD, use_chunking=chunked)
    writer.start(profile="ros1")
    channels: dict[str, int] = {}
    for topic, name, t_ns, message in sorted(ros_logs.messages(types, ros1=True), key=lambda each: each[2]):
        if topic not in channels:
            definition = types.generate_msgdef(name)[0].encode()
            schema = writer.register_schema(name.replace("/msg/", "/"), "ros1msg", definition)
            channels[topic] = writer.register_channel(topic, "ros1", schema)
        data = bytes(types.serialize_ros1(message, name))
        writer.add_message(channels[topic], t_ns + ros_logs.LATE_NS, data, t_ns)
    if closed:
        writer.finish()
    path.write_bytes(out.getvalue())
    return path


def json_mcap(path: Path, schema: str, rows: list[dict[str, object]], **metadata: str) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_schema(schema, "jsonschema", b"{}")
        channel = writer.register_channel("/fix", "json", number, metadata)
        for t_ns, row in zip(T_NS.tolist(), rows, strict=False):
            stamp = {"timestamp": {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}}
            writer.add_message(channel, t_ns, json.dumps({**stamp, **row}).encode(), t_ns)
        writer.finish()
    return path


def test_ros_1_in_mcap_gives_what_was_measured(tmp_path: Path) -> None:
    streams = read(ros1_mcap(tmp_path / "drive.mcap"))
    np.testing.assert_array_equal(matrix(streams["imu"], "accel"), np.tile(ros_logs.ACCEL, (200, 1)))
    np.testing.assert_array_equal(time_ns(streams["imu"]), ros_logs.START_NS + np.arange(200) * 10_000_000)
    assert vector(streams["gnss"], "height").tolist() == [ros_logs.HEIGHT] * 10
    assert warnings_of(streams["metrics"]) == []


@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_that_was_never_closed_is_read_to_its_end(tmp_path: Path, chunked: bool) -> None:
    whole = read(ros1_mcap(tmp_path / "whole.mcap"))["imu"]
    streams = read(ros1_mcap(tmp_path / "open.mcap", closed=False, chunked=chunked))
    # messages of the last chunk were still in memory
    assert (1.0 if not chunked else 0.9) * whole.num_rows <= streams["imu"].num_rows
    assert streams["imu"].equals(whole.slice(0, streams["imu"].num_rows))
    (text,) = warnings_of(streams["metrics"])
    assert "open.mcap is cut short or damaged" in text


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_file_cut_short_gives_every_whole_message(tmp_path: Path, share: float) -> None:
    path = ros1_mcap(tmp_path / "drive.mcap", chunked=False)
    whole, data = read(path)["imu"], path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    streams = read(path)
    assert streams["imu"].num_rows == pytest.approx(share * 200, abs=20)  # the images are not spread evenly
    assert streams["imu"].equals(whole.slice(0, streams["imu"].num_rows))


def test_foxglove_places_in_json_need_to_be_told_their_datum(tmp_path: Path) -> None:
    covariance = [1.0, 0, 0, 0, 4.0, 0, 0, 0, 9.0]
    row = {"latitude": 44.5, "longitude": 11.3, "altitude": 54.0, "position_covariance": covariance}
    path = json_mcap(tmp_path / "a.mcap", "foxglove.LocationFix", [{**row, "position_covariance_type": 2}] * 50)
    streams = read(path)
    assert "height" not in streams["gnss"].column_names
    (text,) = warnings_of(streams["metrics"])
    assert "give --set reader.mcap.height_datum=ellipsoid or =mean_sea_level" in text
    gnss = read(path, height_datum="ellipsoid")["gnss"]
    assert vector(gnss, "height").tolist() == [54.0] * 50
    assert matrix(gnss, "pos_std")[0].tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(time_ns(gnss), T_NS)
    unknown = json_mcap(tmp_path / "b.mcap", "foxglove.LocationFix", [{**row, "position_covariance_type": 0}] * 50)
    assert "pos_std_e" not in read(unknown)["gnss"].column_names


def test_what_recon_exports_for_viewers_is_read_back(tmp_path: Path) -> None:
    """Foxglove's Protobuf messages, written by another road than this reader's."""
    made = drive()
    recording = Recording({"trajectory": made["trajectory"].slice(0, 300), "gnss": made["gnss"].slice(0, 60)})
    recon.run(recon.Pipeline.of("keep"), recording, tmp_path / "run", exports=["mcap"])
    path = tmp_path / "run" / "exports" / "mcap" / "recording.mcap"
    streams = read(path, gnss=("/gnss/fix",), reference=("/trajectory/pose",))
    np.testing.assert_array_equal(vector(streams["gnss"], "lat"), vector(recording["gnss"], "lat"))
    np.testing.assert_array_equal(time_ns(streams["gnss"]), time_ns(recording["gnss"]))
    assert meta(streams["gnss"])["height_datum"] == "ellipsoid"
    np.testing.assert_array_equal(matrix(streams["reference"], "pos"), matrix(recording["trajectory"], "pos"))
    # unit quaternions are made of unit length once more
    np.testing.assert_allclose(matrix(streams["reference"], "q"), matrix(recording["trajectory"], "q"), atol=1e-15)
    odometry = read(path, gnss=("/gnss/fix",), reference=("/trajectory/odometry",))["reference"]
    # turned into the frame of the body and back: rounding of 20 m/s
    np.testing.assert_allclose(matrix(odometry, "vel"), matrix(recording["trajectory"], "vel"), atol=1e-12)


def test_messages_that_are_not_whole_are_counted(tmp_path: Path) -> None:
    row = {"latitude": 44.5, "longitude": 11.3}
    path = json_mcap(tmp_path / "a.mcap", "foxglove.LocationFix", [row] * 50)
    data = path.read_bytes()
    content = BytesIO()
    writer = Writer(content)
    writer.start()
    schema = writer.register_schema("foxglove.LocationFix", "jsonschema", b"{}")
    channel = writer.register_channel("/fix", "json", schema)
    writer.add_message(channel, 10**18, b"{no json", 10**18)
    writer.add_message(channel, 10**18 + 1, json.dumps(row).encode(), 10**18 + 1)
    writer.finish()
    path.write_bytes(content.getvalue())
    assert data
    streams = read(path)
    assert streams["gnss"].num_rows == 1
    assert [entry["value"] for entry in rows_named(streams, "messages_broken")] == [1.0]


def test_a_place_of_zero_zero_is_no_fix(tmp_path: Path) -> None:
    rows = [{"latitude": 0.0, "longitude": 0.0}] * 10 + [{"latitude": 44.5, "longitude": 11.3}] * 40
    gnss = read(json_mcap(tmp_path / "a.mcap", "foxglove.LocationFix", rows))["gnss"]
    assert (gnss["lat"].null_count, gnss["lon"].null_count) == (10, 10)


def test_a_file_without_a_known_type_names_what_it_holds(tmp_path: Path) -> None:
    path = json_mcap(tmp_path / "a.mcap", "foxglove.Log", [{"message": "hello"}])
    with pytest.raises(NothingUsable, match=r"no topic holds a type of message that is read: /fix \(foxglove.Log\)"):
        read(path)
    with pytest.raises(NothingUsable, match="none of its topics is read unless it is named") as caught:
        read(json_mcap(tmp_path / "b.mcap", "foxglove.PoseInFrame", [{"pose": {}}]))
    assert "--set reader.mcap.reference=/fix" in caught.value.hint


def test_a_file_without_anything_whole_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n\x01\xff\xff")
    with pytest.raises(ReadFailed):
        read(path)
