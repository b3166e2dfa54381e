"""Whole samples of texts: logs, tables, YAML, apps of phones, reports."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from recon.pipeline import shipped

sys.path.insert(0, str(Path(__file__).parents[1]))
import phone_logs

Sample: TypeAlias = Mapping[str, bytes]
"""Files by their path in a folder; a single one is used as it is, several as the folder."""


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


COLUMNS: Final = {
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
