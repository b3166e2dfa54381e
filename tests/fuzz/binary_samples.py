"""Whole samples of recon's own files, bags, flights, arrays and images, and of the formats of loggers (log_files)."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Final

import log_files
import numpy as np
import pyarrow as pa
import pyarrow.parquet

import recon
from recon import GNSS, IMU, Metric, Pipeline, Recording, build, events, metrics
from recon.rows import Event
from recon.storage import mcap, write_recording

sys.path.insert(0, str(Path(__file__).parents[1]))
import array_logs
import autopilot_logs
import measurement_logs
import ros_logs
from text_samples import Sample

START_NS: Final = 1_501_762_930_123_456_789


def recording() -> Recording:
    """Every kind of column, nulls and no rows among them."""
    rng = np.random.default_rng(1)
    t_ns = START_NS + np.arange(50) * 10_000_000
    gyro = rng.normal(size=(50, 3))
    gyro[::7, 1] = np.nan
    fix = pa.array([3, None, 0, 1, 3], pa.int32())
    streams = {
        "imu": build(IMU, time=t_ns, accel=rng.normal(size=(50, 3)), gyro=gyro),
        "gnss": build(GNSS, time=t_ns[:5], lat=np.full(5, 44.5), lon=np.full(5, 11.3), fix=fix),
        "events": events([Event(START_NS, START_NS + 1, "crash", 12.5, "m/s", 'said "stop"')]),
        "metrics": metrics([Metric("yaw", 1.25, "deg"), Metric("warning", note="na\u00efve")]),
        "imu_2": build(IMU, time=t_ns[:0], accel=np.zeros((0, 3)), gyro=np.zeros((0, 3))),
    }
    return Recording(streams, {"sources": ["drive.txt"]})


def parquet_samples() -> list[Sample]:
    """Folders with streams and of a run, and single files: of recon, and of another program without checksums."""
    with tempfile.TemporaryDirectory() as scratch:
        write_recording(recording(), Path(scratch), "parquet")
        recon.run(Pipeline.of("keep"), recording(), Path(scratch, "run"))
        own, run = files_below(Path(scratch, "streams")), files_below(Path(scratch, "run"))
    sink = BytesIO()
    plain = recording()["imu"].replace_schema_metadata()
    pyarrow.parquet.write_table(plain, sink, compression="none", row_group_size=20, store_schema=False)
    return [
        own,
        run,
        *({name: own[name]} for name in ("imu.parquet", "events.parquet", "gnss.parquet")),
        {"imu.parquet": sink.getvalue()},
    ]


def mcap_samples() -> list[Sample]:
    """A file of recon, a run's folder, and the file once more without checksums and compression."""
    with tempfile.TemporaryDirectory() as scratch:
        recon.run(Pipeline.of("keep"), recording(), Path(scratch, "run"), store="mcap")
        run = files_below(Path(scratch, "run"))
    file = run["streams.mcap"]
    return [{"drive.mcap": file}, run, {"drive.mcap": _unguarded(file)}, {"drive.mcap": _unguarded(file)}]


def rosbag_samples() -> list[Sample]:
    """A bag of ROS 1, folders of ROS 2 in SQLite and in MCAP, a single SQLite file."""
    with tempfile.TemporaryDirectory() as scratch:
        one = ros_logs.write(Path(scratch, "one.bag"), "bag", 0.3).read_bytes()
        two, three = (files_below(ros_logs.write(Path(scratch, form), form, 0.3)) for form in ("sqlite3", "mcap"))
    alone = {name: content for name, content in two.items() if name.endswith(".db3")}
    return [{"drive.bag": one}, two, three, alone, {"drive.bag": one}]


def ulog_samples() -> list[Sample]:
    return [{"flight.ulg": autopilot_logs.ulog(0.5)}]


def ardupilot_samples() -> list[Sample]:
    """DataFlash, and telemetry of both versions of MAVLink."""
    return [
        {"flight.bin": autopilot_logs.dataflash(0.5)},
        {"flight.tlog": autopilot_logs.tlog(0.5)},
        {"flight.tlog": autopilot_logs.tlog(0.5, version=1)},
    ]


def mf4_samples() -> list[Sample]:
    with tempfile.TemporaryDirectory() as scratch:
        return [{"drive.mf4": measurement_logs.mf4(Path(scratch, "drive.mf4"), 0.4).read_bytes()}]


def foreign_mcap_samples() -> list[Sample]:
    """Logs of ROS 2, whole and without checksums, and of Foxglove's messages."""
    with tempfile.TemporaryDirectory() as scratch:
        (ros,) = files_below(ros_logs.write(Path(scratch, "ros"), "mcap", 0.3), ".mcap").values()
        few = Recording({"gnss": build(GNSS, time=START_NS + np.arange(9), lat=np.full(9, 44.5), lon=np.full(9, 11.3))})
        recon.run(Pipeline.of("keep"), few, Path(scratch, "run"), exports=["mcap"])
        (viewers,) = files_below(Path(scratch, "run", "exports"), ".mcap").values()
    return [{"drive.mcap": ros}, {"drive.mcap": _unguarded(ros, "ros2")}, {"drive.mcap": _unguarded(viewers, "")}]


def _unguarded(file: bytes, profile: str = mcap.PROFILE) -> bytes:
    """The same records without checksums and compression, so that damage reaches what lies behind them."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    sink = BytesIO()
    writer = Writer(sink, compression=CompressionType.NONE, enable_crcs=False, use_chunking=False)
    writer.start(profile=profile)
    reader = make_reader(BytesIO(file))
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        if channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return sink.getvalue()


def files_below(folder: Path, ending: str = "") -> Sample:
    found = [path for path in sorted(folder.rglob(f"*{ending}")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


LOGS: Final[Mapping[str, Callable[[], list[Sample]]]] = {
    "nmea": lambda: [{"drive.nmea": log_files.nmea(20)}],
    "ubx": lambda: [{"drive.ubx": log_files.ubx(10)}],
    "vbox": lambda: [{"drive.vbo": log_files.vbo(20)}],
    "gpx": lambda: [{"drive.gpx": log_files.gpx(20)}],
    "kml": lambda: [{"drive.kml": log_files.kml(20)}],
    "rtklib": lambda: [{"drive.pos": log_files.rtklib(20)}],
    "sbet": lambda: [{"sbet.out": log_files.sbet(30)}],
    "kf_gins": lambda: [(files := log_files.kf_gins(6)), *({name: content} for name, content in files.items())],
    "kitti": lambda: [log_files.kitti(6)],
    "novatel": lambda: [{"logs.asc": log_files.novatel_ascii(8)}, {"logs.pcap": log_files.novatel_packets(6)}],
    "nhtsa": lambda: [log_files.nhtsa(40)],
    "gpmf": lambda: [
        {"GX01.MP4": log_files.mp4(log_files.gpmf_payloads(3))},
        {"GX02.MP4": log_files.mp4(log_files.gpmf_payloads(3, stamps_us=False))},
        {"payloads.raw": b"".join(log_files.gpmf_payloads(3))},
    ],
}
"""By reader, short logs as its format says."""


def comma2k19_samples() -> list[Sample]:
    """A segment of seven sensors, positions of a camera and their times."""
    with tempfile.TemporaryDirectory() as scratch:
        return [files_below(array_logs.segment(Path(scratch, "seg")))]


def navego_samples() -> list[Sample]:
    """Structures of an IMU, a receiver and a reference: in a file, compressed and not, and in files of their own."""
    made = {"imu1": array_logs.navego_imu(20.0), "gnss": array_logs.navego_gnss(), "ref": array_logs.navego_ref()}
    with tempfile.TemporaryDirectory() as scratch:
        for name, structure in made.items():
            array_logs.save_mat(Path(scratch, "drive", f"{name}.mat"), compressed=False, **{name: structure})
        whole = [
            {"drive.mat": array_logs.save_mat(Path(scratch, "drive.mat"), packed, **made).read_bytes()}
            for packed in (False, True)
        ]
        return [files_below(Path(scratch, "drive")), *whole]


def frames_samples() -> list[Sample]:
    """Images whose names tell the time, lists of times and files, a video."""
    import av

    names = [f"{1_574_762_400_000 + 40 * n}" for n in range(20)]
    listed = "".join(f"{name[:-3]}.{name[-3:]} images/{name}.png\n" for name in names)
    sink = BytesIO()
    with av.open(sink, "w", format="mp4", options={"movflags": "use_metadata_tags"}) as video:
        video.metadata["creation_time"] = "2023-11-14T22:13:20Z"
        stream = video.add_stream("mpeg4", rate=25)
        stream.width, stream.height = 32, 32
        for shade in range(10):
            picture = av.VideoFrame.from_ndarray(np.full((32, 32, 3), 20 * shade, dtype=np.uint8), format="rgb24")
            video.mux(stream.encode(picture))
        video.mux(stream.encode())
    return [
        {**{f"{name}.png": b"" for name in names}, "times.txt": "\n".join(names).encode()},
        {"rgb.txt": f"# timestamp filename\n{listed}".encode(), **{f"images/{name}.png": b"" for name in names}},
        {"data.csv": ("#timestamp [ns],filename\n" + "".join(f"{n}000000,{n}.png\n" for n in names)).encode()},
        {"drive.mp4": sink.getvalue()},
        {"drive.mp4": sink.getvalue()},
    ]
