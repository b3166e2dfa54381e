"""What is fuzzed: whole samples, made here, and what is done with each damaged one."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, Final, TypeAlias

import log_files
import numpy as np
import pyarrow as pa
import pyarrow.parquet

import recon
from recon import GNSS, IMU, Metric, Pipeline, Recording, Registry, build, events, metrics
from recon.api import execute
from recon.batch import parse as parse_batch
from recon.batch_plan import check_batch
from recon.errors import ConfigError
from recon.form import is_batch
from recon.overrides import Override
from recon.pipeline import shipped
from recon.rows import Event
from recon.schema import unnumbered
from recon.stages import Reader
from recon.storage import mcap, write_recording
from recon.tables import conform
from recon.validation import validate_pipeline
from recon.yaml_nodes import load_file

sys.path.insert(0, str(Path(__file__).parents[1]))
import array_logs
import autopilot_logs
import measurement_logs
import phone_logs
import ros_logs

Sample: TypeAlias = Mapping[str, bytes]
"""Files by their path in a folder; a single one is used as it is, several as the folder."""

START_NS: Final = 1_501_762_930_123_456_789
HEAD_BYTES: Final = 65536


@dataclass(frozen=True)
class Target:
    """samples : made once; attempt : gives rows or raises a ReconError for the file or folder it is given."""

    samples: Callable[[], Sequence[Sample]]
    attempt: Callable[[Path], None]


@cache
def registry() -> Registry:
    return Registry.installed()


def read_by(key: str, *overrides: Override) -> Callable[[Path], None]:
    """Ask a reader whether a file is its own, and what it makes of it, then read it as a run does.

    Rows must be whole Arrow data.
    """

    def attempt(path: Path) -> None:
        reader = registry().get(key)
        assert isinstance(reader, Reader)
        assert reader.sniff is not None
        reader.sniff(path, b"" if path.is_dir() else path.read_bytes()[:HEAD_BYTES])
        if reader.propose is not None:
            reader.propose([path])
        found = execute(Pipeline.of("read", key), path, None, overrides, registry=registry()).recording
        for table in found.values():
            table.validate(full=True)
        if path.is_dir() and (path / "manifest.json").exists():
            recon.open(path)._repr_html_()

    return attempt


# --- physycom ---------------------------------------------------------------------------------------------------------


def physycom_samples() -> list[Sample]:
    """Every format, with and without header, parted by tabs and by spaces; GNSS as an array and as an object."""
    rng = np.random.default_rng(1)
    t_s = np.arange(60) * 0.01
    time = [f"{518_716_448 + seconds:.4f}" for seconds in t_s]
    accel, gyro = rng.normal([0, 0, 1], 0.02, (60, 3)), rng.normal(size=(60, 3))
    size = np.linalg.norm(accel, axis=1)
    place = np.column_stack([44.5 + 1e-5 * t_s, 11.35 + 1e-5 * t_s, 45 + t_s, 350 + t_s, 36 + t_s])
    place = place[np.arange(60) // 10 * 10]
    inertial = np.column_stack([place[:, 4:], accel, gyro, size, t_s])
    full = np.column_stack([place, accel, gyro, size, t_s])
    texts = [
        _rows(time, full, "\t", "# timestamp lat lon alt heading speed ax ay az gx gy gz |a| timestamp_rel"),
        _rows(time, inertial, " ", ""),
        _rows(time, accel, "\t", "# timestamp ax ay az"),
        _rows(time, gyro, " ", "timestamp gx gy gz"),
    ]
    records = [
        {"lat": lat, "lon": lon, "alt": alt, "heading": course, "fix": 1, "speed": speed, "timestamp": float(at)}
        for at, (lat, lon, alt, course, speed) in zip(time[::10], place[::10].tolist(), strict=True)
    ]
    speeds = [{**record, "speed": {"min": 1.0, "mean": record["speed"], "max": 99.0}} for record in records]
    texts += [json.dumps(records, indent=1), json.dumps({f"gnss_record_{n}": each for n, each in enumerate(speeds)})]
    return [{"log.txt": text.encode()} for text in texts]


def _rows(time: list[str], values: Any, separator: str, header: str) -> str:
    rows = (separator.join([at, *(f"{value:.7f}" for value in row)]) for at, row in zip(time, values, strict=True))
    return "\n".join([*([header.replace(" ", separator)] if header else []), *rows, ""])


# --- delimited text ---------------------------------------------------------------------------------------------------

_COLUMNS: Final = {
    "imu": {
        "time": {"column": "millis", "format": "unix", "unit": "ms"},
        "axes": "FRD",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "g", "at_rest": "down"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "deg/s", "scale": 0.5},
    },
    "gnss": {
        "time": {"column": "utc", "format": "iso", "zone": "+02:00"},
        "valid": {"column": "status", "values": ["A", 'said "D"']},
        "height_datum": "ellipsoid",
        "lat": {"column": "lat"},
        "lon": {"column": "lon"},
        "height": {"column": "alt", "unit": "m", "invalid": [-9999]},
        "speed": {"column": "km/h", "unit": "km/h"},
    },
    "mag": {
        "file": "*.dat",
        "time": {"columns": [1, 2], "format": "gps_week"},
        "mag": {"columns": [3, 4, 5], "unit": "uT"},
    },
    "baro": {
        "time": {"column": "uptime", "format": "relative", "unit": "us", "start": "2026-06-08T14:54:08Z"},
        "pressure": {"column": "hPa", "unit": "hPa"},
    },
    "wheel": {
        "time": {"column": "clock", "format": "time_of_day", "start": "2026-06-08", "scale": "GPS"},
        "same_time": "first",
        "speed": {"column": "wheel", "unit": "mph"},
    },
}
"""One mapping for all samples, of which each holds some of the streams."""


def csv_samples() -> list[Sample]:
    """Each delimiter, both decimal marks, quotes, comments, blanks, UTF-16; with header and without."""
    rng = np.random.default_rng(1)
    step = np.arange(60)
    imu = [
        ["millis", "ax", "ay", "az", "gx", "gy", "gz"],
        *([f"{1_780_930_448_000 + 10 * n}", *(f"{v:.5f}" for v in rng.normal(size=6))] for n in step),
    ]
    gnss = [["utc", "status", "lat", "lon", "alt", "km/h"]]
    for n in step:
        time = f'"2026-06-08 16:54:{8 + n // 10:02d}.{n % 10}"'
        place = [f"{44.5 + 1e-5 * n:.7f}", f"{11.35 + 1e-5 * n:.7f}", f"{45 + n / 8:.2f}" if n % 9 else "-9999"]
        gnss.append([time, "A" if n % 7 else '"said ""D"""', *place, f"{n}"])
    slow = [
        ["uptime", "hPa", "clock", "wheel"],
        *([f"{10_000 * n}", f"{1013 + n / 9:.2f}", f"23:59:{50 + n // 2}", f"{30 + n / 7:.2f}"] for n in step // 3),
    ]
    field = [["2422", f"{140_000 + n / 50:.3f}", *(f"{v:.2f}" for v in rng.normal(0, 40, 3))] for n in step]
    blank = [row if n % 10 == 0 else [""] * len(row) for n, row in enumerate(gnss)]
    together = [[*one, *other] for one, other in zip(imu, blank, strict=True)]
    texts = {
        "imu.csv": _delimited(imu, ";").replace(".", ","),
        "gnss.csv": "# made by hand\n" + _delimited(gnss, "\t"),
        "slow.txt": _delimited(slow, " "),
        "field.dat": _delimited(field, "|"),
        "drive.csv": _delimited(together, ","),
    }
    return [*({name: text.encode()} for name, text in texts.items()), {"wide.csv": texts["drive.csv"].encode("utf-16")}]


def _delimited(rows: list[list[str]], delimiter: str) -> str:
    return "\n".join([*map(delimiter.join, rows), ""])


# --- YAML -------------------------------------------------------------------------------------------------------------

_PIPELINE: Final = b"""\
recon: 1
name: all_there_is
about: "Every key of a pipeline, \\u00fc"
store: mcap
steps:
  - use: reader.auto
    params: {reader.physycom: {gravity: 9.81 m/s^2, sensor: gyroscope}}
  - {use: filter.resample, params: {rate: 100 Hz}}
  - use: filter.moving_average
    id: smooth
    params:
      window: 50 ms
    in: {imu: imu_2}
    out: {imu: imu_2}
  - use: exporter.csv
"""
_BATCH: Final = b"""\
recon: 1
batch: june_fleet
pipeline: thesis
inputs:
  - glob: data/*/2026-06-*/*.txt
    vehicle: parent 2
    drive: 'drive_(?P<drive>[0-9]+)'
  - list: drives.csv
output: results
defaults: {reader.auto: {reader.physycom: {gravity: 9.80665 m/s^2}}}
vehicles:
  A12: {fuser.weighted_average: {weight: 0.05}}
exports: [csv, gpx]
on_error: continue
retries: 1
timeout: 10 min
memory: 2 GB
resume: true
"""


def yaml_samples() -> list[Sample]:
    texts = [path.read_bytes() for path in shipped().values()] + [_PIPELINE, _BATCH, _BATCH]
    return [{"file.yaml": text} for text in texts]


def validate(path: Path) -> None:
    """What `recon validate` does."""
    root = load_file(path)
    if is_batch(root):
        batch, problems = parse_batch(root)
        problems = problems + check_batch(batch, registry())
    else:
        pipeline, problems = validate_pipeline(root, registry())
        if not problems:
            Pipeline.from_text(pipeline.to_yaml())
    if problems:
        raise ConfigError(problems)


# --- storage ----------------------------------------------------------------------------------------------------------


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
        own, run = _files(Path(scratch, "streams")), _files(Path(scratch, "run"))
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
        run = _files(Path(scratch, "run"))
    file = run["streams.mcap"]
    return [{"drive.mcap": file}, run, {"drive.mcap": _unguarded(file)}, {"drive.mcap": _unguarded(file)}]


def rosbag_samples() -> list[Sample]:
    """A bag of ROS 1, folders of ROS 2 in SQLite and in MCAP, a single SQLite file."""
    with tempfile.TemporaryDirectory() as scratch:
        one = ros_logs.write(Path(scratch, "one.bag"), "bag", 0.3).read_bytes()
        two, three = (_files(ros_logs.write(Path(scratch, form), form, 0.3)) for form in ("sqlite3", "mcap"))
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
        (ros,) = _files(ros_logs.write(Path(scratch, "ros"), "mcap", 0.3), ".mcap").values()
        few = Recording({"gnss": build(GNSS, time=START_NS + np.arange(9), lat=np.full(9, 44.5), lon=np.full(9, 11.3))})
        recon.run(Pipeline.of("keep"), few, Path(scratch, "run"), exports=["mcap"])
        (viewers,) = _files(Path(scratch, "run", "exports"), ".mcap").values()
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


def _files(folder: Path, ending: str = "") -> Sample:
    found = [path for path in sorted(folder.rglob(f"*{ending}")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


# --- formats of loggers ----------------------------------------------------------------------------------------------


_LOGS: Final[Mapping[str, Callable[[], list[Sample]]]] = {
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
_GIVEN: Final[Mapping[str, Mapping[str, Any]]] = {"ubx": {"at_rest": "up"}, "vbox": {"axes": "FLU"}}
"""Parameters without which a reader leaves a stream out."""


def logger_target(name: str) -> Target:
    """Ask a reader of one format, then let it read, without the bookkeeping of a run; rows must be as it declares."""
    key = f"reader.{name}"

    def attempt(path: Path) -> None:
        reader = registry().get(key)
        assert isinstance(reader, Reader)
        assert reader.sniff is not None
        reader.sniff(path, b"" if path.is_dir() else path.read_bytes()[:HEAD_BYTES])
        params = reader.params(**_GIVEN.get(name, {}))
        declared = reader.outputs({}, params)
        for stream, table in reader.run(path=path, params=params).items():
            home = stream if stream in declared else unnumbered(stream)
            conform(table, declared[home], stream=stream, step=key).validate(full=True)

    return Target(_LOGS[name], attempt)


# --- apps of phones ---------------------------------------------------------------------------------------------------


def _encoded(files: Mapping[str, str]) -> Sample:
    return {name: text.encode() for name, text in files.items()}


def sensor_logger_samples() -> list[Sample]:
    """Folders of Android and iOS, a zip, single tables."""
    log = phone_logs.logged(40)
    android, ios = phone_logs.sensor_logger(log), phone_logs.sensor_logger(log, "ios", total=False)
    single = [{name: android[name].encode()} for name in ("Location.csv", "Gyroscope.csv")]
    return [_encoded(android), _encoded(ios), {"drive.zip": phone_logs.zipped(ios, "drive")}, *single]


def phyphox_samples() -> list[Sample]:
    """Folders with each separator and decimal mark, a zip, a single table."""
    log = phone_logs.logged(40)
    commas, semicolons = phone_logs.phyphox(log), phone_logs.phyphox(log, ";", ",", named=False)
    tabs = phone_logs.phyphox(log, "\t")
    zipped = {"drive.zip": phone_logs.zipped(commas)}
    return [_encoded(commas), _encoded(semicolons), _encoded(tabs), zipped, {"raw.csv": tabs["Location.csv"].encode()}]


def gnsslogger_samples() -> list[Sample]:
    log = phone_logs.logged(40)
    return [{"log.txt": phone_logs.gnsslogger(log, corrected=corrected).encode()} for corrected in (True, False)]


# --- arrays, reports, frames ------------------------------------------------------------------------------------------


def comma2k19_samples() -> list[Sample]:
    """A segment of seven sensors, positions of a camera and their times."""
    with tempfile.TemporaryDirectory() as scratch:
        return [_files(array_logs.segment(Path(scratch, "seg")))]


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
        return [_files(Path(scratch, "drive")), *whole]


_REPORT: Final = """\
Times (sec),"Speed, Vehicle Indicated (MPH [km/h])","Accelerator (%)","Service Brake (On, Off)"
-5.0,34 [55],20,Off
-0.5,30 [48],0,On
0.0,28 [45],0,On

Time (msec),"Delta-V, longitudinal (MPH [km/h])","Delta-V, lateral (MPH [km/h])","Long. acceleration (g)"
0,0 [0],0 [0],-0.5
10,-1 [-2],0 [0],-12.5
20,-3 [-5],1 [1],-8
"""


def edr_csv_samples() -> list[Sample]:
    """Reports of an event data recorder, parted by commas, semicolons and tabs."""
    plain = _REPORT.replace('"', "").replace("Speed, ", "Speed ").replace("Delta-V, ", "Delta-V ")
    plain = plain.replace("On, Off", "state")
    return [{"edr.csv": text.encode()} for text in (_REPORT, plain.replace(",", ";"), plain.replace(",", "\t"))]


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


_MAPPING: Final = Override.from_data("reader.csv.columns", _COLUMNS)
_CHANNELS: Final = Override.from_data("reader.mf4.channels", measurement_logs.CHANNELS)
_FOUR_COLUMNS: Final = Override.from_data("reader.physycom.sensor", "accelerometer")

TARGETS: Final[dict[str, Target]] = {
    "physycom": Target(physycom_samples, read_by("reader.physycom", _FOUR_COLUMNS)),
    "csv": Target(csv_samples, read_by("reader.csv", _MAPPING)),
    "yaml": Target(yaml_samples, validate),
    "parquet": Target(parquet_samples, read_by("reader.parquet")),
    "mcap": Target(mcap_samples, read_by("reader.mcap")),
    **{name: logger_target(name) for name in _LOGS},
    "sensor_logger": Target(sensor_logger_samples, read_by("reader.sensor_logger")),
    "phyphox": Target(phyphox_samples, read_by("reader.phyphox")),
    "gnsslogger": Target(gnsslogger_samples, read_by("reader.gnsslogger")),
    "foreign_mcap": Target(foreign_mcap_samples, read_by("reader.mcap")),
    "rosbag": Target(rosbag_samples, read_by("reader.rosbag")),
    "mf4": Target(mf4_samples, read_by("reader.mf4", _CHANNELS)),
    "ulog": Target(ulog_samples, read_by("reader.ulog")),
    "ardupilot": Target(ardupilot_samples, read_by("reader.ardupilot")),
    "comma2k19": Target(comma2k19_samples, read_by("reader.comma2k19")),
    "navego": Target(navego_samples, read_by("reader.navego")),
    "edr_csv": Target(edr_csv_samples, read_by("reader.edr_csv")),
    "frames": Target(frames_samples, read_by("reader.frames")),
}
