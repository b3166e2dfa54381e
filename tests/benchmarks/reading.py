"""Memory and time of reading large logs, each in a process of its own, against the size of what was read.

    python tests/benchmarks/reading.py mcap --size 2e9       ROS 2 in MCAP, IMU at 200 Hz
    python tests/benchmarks/reading.py bag --size 2e9        the same as a ROS 1 bag
    python tests/benchmarks/reading.py csv --size 2e9        the IMU as text
    python tests/benchmarks/reading.py camera --size 1e10    a ROS 1 bag with a camera; the images are holes in the file

Peak is what the process holds at most beyond what it holds after its imports.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

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
    from rosbags.typesys import Stores, get_typestore

    definition = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)[0]
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition.encode())
        channel = writer.register_channel("/imu", "cdr", schema)
        written = 0
        while file.tell() < size:
            t_ns, rows = imu_messages(100_000)
            t_ns = t_ns + written * 5_000_000
            seconds = rows[:, 4:12].view("<u4")
            seconds[:, 0], seconds[:, 1] = t_ns // 10**9, t_ns % 10**9
            for at, row in zip(t_ns.tolist(), rows, strict=True):
                writer.add_message(channel, at, row.tobytes(), at)
            written += len(rows)
        writer.finish()


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


CSV = {
    "imu": {
        "time": {"column": "t", "format": "unix", "unit": "ns"},
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }
}
WRITERS = {
    "mcap": (write_mcap, "drive.mcap"),
    "bag": (write_bag, "drive.bag"),
    "camera": (lambda path, size: write_bag(path, size, image=50_000_000), "drive.bag"),
    "csv": (write_csv, "drive.csv"),
}


def measure(path: Path) -> dict[str, float]:
    """Read a log in this process. POSIX systems only tell what it took."""
    import resource

    import recon

    recon.Registry.installed()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    recording = recon.read(path, **({"reader.csv.columns": CSV} if path.suffix == ".csv" else {}))
    took = time.process_time() - start
    peak = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    arrow = sum(table.nbytes for table in recording.values())
    rows = {name: table.num_rows for name, table in recording.items() if name != "metrics"}
    return {"peak": peak, "arrow": arrow, "seconds": took, "rows": rows, "whole": before * 1024 + peak}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=[*WRITERS, "read"])
    parser.add_argument("--size", type=float, default=2e8, help="bytes of the log")
    parser.add_argument("--path", type=Path, help="a log to read")
    chosen = parser.parse_args()
    if chosen.kind == "read":
        print(json.dumps(measure(chosen.path)))
        return
    with tempfile.TemporaryDirectory() as scratch:
        write, name = WRITERS[chosen.kind]
        path = Path(scratch, name)
        write(path, chosen.size)
        command = [sys.executable, __file__, "read", "--path", str(path)]
        found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        size = path.stat().st_size
    print(
        f"{chosen.kind}: {size / 1e9:.2f} GB, {found['rows']}; Arrow {found['arrow'] / 1e6:.0f} MB, "
        f"peak {found['peak'] / 1e6:.0f} MB ({found['peak'] / found['arrow']:.2f} times), with imports "
        f"{found['whole'] / 1e6:.0f} MB; {found['seconds']:.1f} s of one core"
    )


if __name__ == "__main__":
    main()
