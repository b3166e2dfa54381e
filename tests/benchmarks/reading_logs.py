"""Large logs for `reading.py`, made as loggers write them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

IMAGE = 50_000_000
"""Bytes of an image, of which the file holds a hole."""
START_NS = 1_700_000_000_000_000_000


def imu_messages(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(count,) ns and (count, 316) bytes of sensor_msgs/Imu in CDR, as a 200 Hz driver sends them."""
    rng = np.random.default_rng(1)
    stamp = [("head", "u1", 4), ("sec", "<i4"), ("nanosec", "<u4")]
    kind = np.dtype([*stamp, ("length", "<u4"), ("frame", "S4"), ("numbers", "<f8", 37)])
    rows = np.zeros(count, dtype=kind)
    t_ns = START_NS + np.arange(count) * 5_000_000
    rows["head"] = (0, 1, 0, 0)
    rows["sec"], rows["nanosec"] = t_ns // 10**9, t_ns % 10**9
    rows["length"], rows["frame"] = 4, b"imu\0"
    values = rng.normal(size=(count, 6)) * 0.1
    rows["numbers"][:, 13:16] = values[:, 3:]
    rows["numbers"][:, 25:28] = values[:, :3] + (0.0, 0.0, 9.8)
    return t_ns, rows.view(np.uint8).reshape(count, -1)


def write_mcap(path: Path, size: float) -> None:
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", _definition("sensor_msgs/msg/Imu"))
        channel = writer.register_channel("/imu", "cdr", schema)
        written = 0
        while file.tell() < size:
            for at, row in _stamped(written, 100_000):
                writer.add_message(channel, at, row, at)
            written += 100_000
        writer.finish()


def write_bag_with_camera(path: Path, size: float) -> None:
    write_bag(path, size, IMAGE)


def write_bag(path: Path, size: float, image: int = 0) -> None:
    """A ROS 1 bag without an index; with `image` bytes of each message of a camera left as a hole."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    topics = {0: ("/imu", "sensor_msgs/msg/Imu"), 1: ("/camera", "sensor_msgs/msg/Image")}
    with path.open("wb") as file:
        file.write(b"#ROSBAG V2.0\n" + _record({"op": b"\x03", "index_pos": bytes(8)}, b" " * 4000))
        connections = b""
        for number, (topic, name) in topics.items():
            text, md5 = types.generate_msgdef(name)[:2]
            about = {"topic": topic.encode(), "type": name.replace("/msg/", "/").encode(), "md5sum": md5.encode()}
            about["message_definition"] = text.encode()
            head = {"op": b"\x07", "conn": struct.pack("<I", number), "topic": topic.encode()}
            connections += _record(head, _fields(about))
        written = 0
        while file.tell() < size:
            body, count = connections * (written == 0), 2000
            t_ns, rows = imu_messages(count)
            for at, row in zip((t_ns + written * 5_000_000).tolist(), rows, strict=True):
                stamp = struct.pack("<II", at // 10**9, at % 10**9)
                data = bytes(4) + stamp + b"\3\0\0\0imu" + row[20:].tobytes()
                body += _record({"op": b"\x02", "conn": bytes(4), "time": stamp}, data)
            written += count
            hole = _record({"op": b"\x02", "conn": struct.pack("<I", 1), "time": stamp}, b"")[:-4] if image else b""
            length = len(body) + (len(hole) + 4 + image if image else 0)
            head = _fields({"op": b"\x05", "compression": b"none", "size": struct.pack("<I", length)})
            file.write(struct.pack("<I", len(head)) + head + struct.pack("<I", length) + body)
            if image:
                file.write(hole + struct.pack("<I", image))
                file.seek(image, 1)
        file.truncate()


def _fields(fields: dict[str, bytes]) -> bytes:
    parts = (name.encode() + b"=" + value for name, value in fields.items())
    return b"".join(struct.pack("<I", len(part)) + part for part in parts)


def _record(fields: dict[str, bytes], data: bytes) -> bytes:
    head = _fields(fields)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data


def write_csv(path: Path, size: float) -> None:
    import pyarrow as pa
    from pyarrow import csv

    with path.open("wb") as file:
        written = 0
        while file.tell() < size:
            rng = np.random.default_rng(written)
            values = np.round(rng.normal(size=(200_000, 6)) * 0.1 + (0, 0, 9.8, 0, 0, 0), 6)
            columns = {"t": START_NS + (written + np.arange(200_000)) * 5_000_000}
            columns |= {name: values[:, n] for n, name in enumerate(("ax", "ay", "az", "gx", "gy", "gz"))}
            csv.write_csv(pa.table(columns), file, csv.WriteOptions(include_header=written == 0))
            written += 200_000


def write_mcap_with_camera(path: Path, size: float) -> None:
    """ROS 2 in MCAP, an image after every 2000 messages of the IMU, without chunks."""
    from mcap.opcode import Opcode
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False, enable_crcs=False, enable_data_crcs=False)
        writer.start(profile="ros2")
        imu, camera = (
            writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", _definition(name)))
            for topic, name in (("/imu", "sensor_msgs/msg/Imu"), ("/camera", "sensor_msgs/msg/Image"))
        )
        written = 0
        while file.tell() < size:
            for at, row in _stamped(written, 2000):
                writer.add_message(imu, at, row, at)
            written += 2000
            file.write(struct.pack("<BQHIQQ", Opcode.MESSAGE, 22 + IMAGE, camera, 0, at, at))
            file.seek(IMAGE, 1)
        writer.finish()


def write_sqlite_with_camera(path: Path, size: float) -> None:
    """ROS 2 in SQLite; its blobs are zeros, which take their place on the disk."""
    import sqlite3

    with sqlite3.connect(path) as base:
        base.execute("PRAGMA page_size = 65536")
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.execute("INSERT INTO topics VALUES (1, '/imu', 'sensor_msgs/msg/Imu', 'cdr')")
        base.execute("INSERT INTO topics VALUES (2, '/camera', 'sensor_msgs/msg/Image', 'cdr')")
        add = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"
        written = 0
        while path.stat().st_size < size:
            rows = list(_stamped(written, 2000))
            base.executemany(add, [(1, at, row) for at, row in rows])
            base.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (2, ?, zeroblob(?))", (rows[-1][0], IMAGE)
            )
            base.commit()
            written += 2000


def write_physycom(path: Path, size: float) -> None:
    """The format fullinertial: the IMU at 100 Hz, GNSS once a second and repeated between."""
    import pyarrow as pa
    from pyarrow import csv

    with path.open("wb") as file:
        written, rows = 0, 200_000
        while file.tell() < size:
            rng = np.random.default_rng(written)
            at = written + np.arange(rows)
            gnss = np.sin(at // 100 * 1e-3)[:, None] * (0.01, 0.01, 5.0, 40.0, 9.0) + (44.5, 11.3, 60.0, 120.0, 60.0)
            imu = np.round(rng.normal(size=(rows, 6)) * 0.01 + (0, 0, 1, 0, 0, 0), 4)
            numbers = np.column_stack([np.round(gnss, 7), imu, np.linalg.norm(imu[:, :3], axis=1).round(4)])
            times = np.char.add(np.char.add((400_000_000 + at // 100).astype(str), "."), (at % 100 + 100).astype("U3"))
            times = np.char.replace(times, ".1", ".")
            columns = {"t": times, **{str(n): values for n, values in enumerate(numbers.T)}, "relative": at / 100}
            form = csv.WriteOptions(include_header=False, delimiter="\t", quoting_style="none")
            csv.write_csv(pa.table(columns), file, form)
            written += rows


def write_nmea(path: Path, size: float) -> None:
    """RMC, GGA and GST ten times a second."""
    with path.open("wb") as file:
        written = 0
        while file.tell() < size:
            file.write(b"".join(_sentences(tick) for tick in range(written, written + 10_000)))
            written += 10_000


def _sentences(tick: int) -> bytes:
    seconds, tenth = divmod(tick, 10)
    day, second = divmod(seconds, 86_400)
    clock = f"{second // 3600:02}{second // 60 % 60:02}{second % 60:02}.{tenth}0"
    place = f"44{30 + tick % 600_000 * 1e-5:010.7f},N,01118.0000000,E"
    bodies = (
        f"GNRMC,{clock},A,{place},19.438,90.00,{1 + day % 28:02}0625,,,A",
        f"GNGGA,{clock},{place},4,12,0.7,60.123,M,44.500,M,1.0,0000",
        f"GNGST,{clock},0.05,0.02,0.01,30.0,0.015,0.012,0.030",
    )
    return b"".join(b"$%s*%02X\r\n" % (body.encode(), _exclusive_or(body.encode())) for body in bodies)


def _exclusive_or(body: bytes) -> int:
    return int(np.bitwise_xor.reduce(np.frombuffer(body, dtype=np.uint8)))


def _definition(name: str) -> bytes:
    from rosbags.typesys import Stores, get_typestore

    text: str = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(name, ros_version=2)[0]
    return text.encode()


def _stamped(first: int, count: int) -> Iterator[tuple[int, bytes]]:
    """Times in ns and messages of the IMU in CDR, from a number on."""
    t_ns, rows = imu_messages(count)
    t_ns = t_ns + first * 5_000_000
    seconds = rows[:, 4:12].view("<u4")
    seconds[:, 0], seconds[:, 1] = t_ns // 10**9, t_ns % 10**9
    return ((at, row.tobytes()) for at, row in zip(t_ns.tolist(), rows, strict=True))
