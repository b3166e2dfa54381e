"""Recordings of the app Sensor Logger on iPhones and Android phones: its folder, its zip, or a table of it.

    Metadata.csv                                    platform, whether units and frames are standardised
    TotalAcceleration.csv                           z, y, x  m/s^2, gravity in it
    Accelerometer.csv, Gravity.csv                  z, y, x  m/s^2; without gravity, and gravity alone
    AccelerometerUncalibrated.csv                   z, y, x  m/s^2, in g on iPhones
    Gyroscope.csv, Magnetometer.csv, Barometer.csv  rad/s; uT; mbar, of watches kPa
    Location.csv, LocationGps.csv                   deg, m above the ellipsoid, m/s, deg from true north, accuracies

Each table begins with `time` in ns since 1970 and `seconds_elapsed`. Accelerations of iPhones have the opposite sign of
those of Android: at rest with the screen up an iPhone reads -g along z. They are turned, unless the recording was made
with standardised units and frames. Negative accuracies, speeds and bearings mean that there is none; horizontal
accuracy is the radius of 68 %.

Tables that were merged and resampled to one row a second by others (acc_x, gyro_x, mag_x, latitude, ... beside a time
in words) are read as well; they count gravity and have the signs of Android.

Reference: Sensor Logger, "Coordinate systems and units", github.com/tszheichoi/awesome-sensor-logger.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.parameters import setting
from recon.rows import Metric, metrics, warning
from recon.schema import STREAMS
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams
from recon_readers._phone_files import Files, files_of, header_of, is_zip, sheet_of
from recon_readers._phone_streams import WRITES, PhoneParams, Sensor, streams_of
from recon_readers._sensor_logger_columns import ACCURACY, PLACE, XYZ, Made, pascals, place, timed, whole_ns, xyz
from recon_readers._text_blocks import plain
from recon_readers._time_text import moments

MERGED: Final = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")
FIELD: Final = ("mag_x", "mag_y", "mag_z")
_BOTH: Final = ("latitude", "longitude")
"""Of a table that has one of them, the other is needed."""
_MERGED_SENSORS: Final = (
    ("accel", "acc", "accel_x"), ("gyro", "gyro", "gyro_x"), ("mag", "mag", "mag_x"), ("baro", "pressure", "pressure"),
    ("gnss", "location", "lat"),
)  # fmt: skip
"""Of a merged table: sensor, its title, and a column that it needs."""


class SensorLoggerParams(PhoneParams):
    """What Metadata.csv tells, where it is not there or wrong."""

    platform: Literal["auto", "ios", "android"] = setting("auto", doc="Phone; auto: as Metadata.csv says.")
    standardised: Literal["auto", "yes", "no"] = setting(
        "auto", doc="Was 'Standardise Units & Frames' on? Then iPhones have the signs and units of Android."
    )


class _Phone(NamedTuple):
    ios: bool | None
    standardised: bool

    @property
    def sign(self) -> float:
        """Factor that makes specific force of what the phone counts as acceleration with gravity."""
        return -1.0 if self.ios and not self.standardised else 1.0


def read(path: Path, params: SensorLoggerParams) -> Streams:
    """The streams imu, gnss, mag and baro of the tables there are. Raises ReadFailed where none holds a measurement."""
    files = files_of(path)
    tables = _tables(files)
    phone, learnt = _phone(files, params)
    felt: Literal["specific_force", "acceleration"] = "specific_force"
    if not tables and len(files.names) == 1 and _is_merged(files.head(files.names[0])):
        sensors = _merged(files)
    else:
        sensors = _plain_sensors(files, tables)
        accel, felt, told = _accel(files, tables, phone)
        learnt += told
        if accel is not None:
            sensors = {"accel": accel, **sensors}
    facts = {"time_scale": "UTC", "clock": "absolute", "format": "Sensor Logger"}
    made, told = streams_of(path, sensors, felt, facts, params)
    if not made and len(files.names) == 1 and _is_metadata(files.head(files.names[0])):
        what = "it tells of the phone and of what it recorded, and holds no measurement"
        raise ReadFailed(path, what, hint="name the folder that it is in, or one of the tables beside it")
    if not made:
        asked = [row.note for row in learnt if row.name == "warning"]
        hint = "\n  ".join(asked) or "it should hold Accelerometer.csv, Gyroscope.csv, Location.csv, ... with rows"
        raise ReadFailed(path, "no table of Sensor Logger in it holds a measurement", hint=hint)
    return {**made, "metrics": metrics([*learnt, *told])}


def _tables(files: Files) -> dict[str, str]:
    """Names of the files by the name of their sensor; an ending after it, as in Location_1.csv, is borne."""
    found: dict[str, str] = {}
    for name in files.names:
        pure = PurePosixPath(name)
        if pure.suffix.lower() == ".csv" and len(pure.parts) == 1:
            found.setdefault(pure.stem.split("_")[0].split("-")[0], name)
    known = {"Accelerometer", "Gravity", "TotalAcceleration", "AccelerometerUncalibrated", "Gyroscope", "Magnetometer"}
    known |= {"GyroscopeUncalibrated", "MagnetometerUncalibrated", "Barometer", "Location", "LocationGps"}
    return {sensor: name for sensor, name in found.items() if sensor in known}


def _phone(files: Files, params: SensorLoggerParams) -> tuple[_Phone, list[Metric]]:
    told = _metadata(files)
    platform = params.platform if params.platform != "auto" else told.get("platform", "").lower()
    said = next((value.lower() for key, value in told.items() if key.lower().startswith("standardi")), "")
    standardised = params.standardised == "yes" or (params.standardised == "auto" and said in ("true", "1", "yes"))
    ios = True if platform == "ios" else False if platform == "android" else None
    learnt = [Metric("phone", method=platform or "unknown", note=told.get("device name", "")[:100])]
    return _Phone(ios, standardised), learnt


def _metadata(files: Files) -> dict[str, str]:
    raw = files.optional("Metadata.csv")
    if raw is None:
        return {}
    lines = raw.decode("utf-8", "replace").replace("\0", "").split("\n")
    try:
        rows = list(csv.reader(lines[:2]))
    except csv.Error:
        return {}
    return dict(zip(rows[0], rows[1], strict=False)) if len(rows) > 1 else {}


def _sensor(
    files: Files,
    tables: dict[str, str],
    sensor: str,
    names: tuple[str, ...],
    made: Made,
    maybe: bool = False,
) -> Sensor | None:
    """What is made of the columns of a table, None where it is not there or empty."""
    if sensor not in tables:
        return None
    sheet = sheet_of(files, tables[sensor])
    needed = ("time", *(() if maybe else names), *(_BOTH if set(_BOTH) & set(sheet.names) else ()))
    missing = [name for name in needed if name not in sheet.names]
    if missing:
        raise ReadFailed(sheet.path, f"it has no column '{missing[0]}'", line=1, hint="is it a table of Sensor Logger?")
    there = tuple(name for name in names if name in sheet.names)
    kinds = {"time": pa.string(), **dict.fromkeys(there, pa.float64())}
    lines = sheet.lines(kinds, lambda table: timed(table, whole_ns, made))
    return Sensor(sensor, lines, lines.columns) if lines is not None else None


def _plain_sensors(files: Files, tables: dict[str, str]) -> dict[str, Sensor]:
    """Gyroscope, magnetometer, barometer and receiver, whose units and signs are the same everywhere."""
    found: dict[str, Sensor | None] = {}
    for key, name, factor in (("gyro", "Gyroscope", 1.0), ("mag", "Magnetometer", 1e-6)):
        found[key] = _sensor(files, tables, name, XYZ, xyz(key, factor))
        found[key] = found[key] or _sensor(files, tables, f"{name}Uncalibrated", XYZ, xyz(key, factor))
    found["baro"] = _sensor(files, tables, "Barometer", ("pressure",), dict)
    if found["baro"]:
        found["baro"].columns["pressure"] = pascals(found["baro"].columns["pressure"])
    for name in ("LocationGps", "Location"):
        found["gnss"] = found.get("gnss") or _sensor(files, tables, name, (*PLACE, *ACCURACY), place, maybe=True)
    return {key: sensor for key, sensor in found.items() if sensor is not None}


def _accel(
    files: Files, tables: dict[str, str], phone: _Phone
) -> tuple[Sensor | None, Literal["specific_force", "acceleration"], list[Metric]]:
    """Specific force where any tables give it, else acceleration without gravity; and what had to be assumed."""
    total, felt, raw = "TotalAcceleration", "Accelerometer", "AccelerometerUncalibrated"
    if phone.ios is None and {total, felt, raw} & tables.keys():
        note = (
            "the accelerometer is left out, for nothing tells its sign: set reader.sensor_logger.platform to ios or "
            "android (Metadata.csv, which belongs to the recording, would tell)"
        )
        return None, "specific_force", [warning(note)]
    signed = xyz("accel", phone.sign)
    found = _sensor(files, tables, total, XYZ, signed)
    if found is not None:
        return found, "specific_force", []
    found, gravity = _sensor(files, tables, felt, XYZ, signed), _sensor(files, tables, "Gravity", XYZ, signed)
    if found is not None and gravity is not None:
        return found, "specific_force", _add_gravity(found, gravity)
    unit = STANDARD_GRAVITY if phone.ios and not phone.standardised else 1.0
    whole = _sensor(files, tables, raw, XYZ, xyz("accel", unit * phone.sign))
    if whole is not None or found is None:
        return whole, "specific_force", []
    note = "only Accelerometer.csv is there, which is without gravity: record Total Acceleration or Gravity as well"
    return found, "acceleration", [warning(note)]


def _add_gravity(felt: Sensor, gravity: Sensor) -> list[Metric]:
    """Add gravity, which the phone has smoothed, along straight lines between its rows."""
    names = [f"accel_{axis}" for axis in XYZ]
    known = [np.isfinite(gravity.columns[name]) for name in names]
    good = np.flatnonzero(np.logical_and.reduce([~gravity.columns["missing"], *known]))
    t_ns, first = np.unique(gravity.columns["time"][good], return_index=True)
    if not len(t_ns):
        felt.columns.update((name, np.full(len(felt.columns["time"]), np.nan)) for name in names)
        return [warning("Gravity.csv holds no measurement")]
    since_s, at_s = (t_ns - t_ns[0]) * 1e-9, (felt.columns["time"] - t_ns[0]) * 1e-9
    for name in names:
        down = gravity.columns.pop(name)[good[first]]
        felt.columns[name] = felt.columns[name] + np.interp(at_s, since_s, down, np.nan, np.nan)
    return [Metric("specific_force", method="Accelerometer.csv + Gravity.csv")]


def _is_merged(head: bytes) -> bool:
    names, _ = header_of(plain(head).partition(b"\n")[0])
    return {"time", *MERGED} <= set(names)


def _merged(files: Files) -> dict[str, Sensor]:
    """The sensors of a table that was merged by others."""
    name = files.names[0]
    sheet = sheet_of(files, name)
    wanted = [each for each in (*MERGED, *FIELD, "pressure", *PLACE, *ACCURACY) if each in sheet.names]
    kinds = {"time": pa.string(), **dict.fromkeys(wanted, pa.float64())}
    lines = sheet.lines(kinds, lambda table: timed(table, moments, _merged_columns))
    if lines is None:
        return {}
    found = {}
    for key, title, column in _MERGED_SENSORS:
        if column in lines.columns:
            names = [
                each for each in STREAMS["imu" if key in ("accel", "gyro") else key].names if each in lines.columns
            ]
            own = [each for each in names if key not in ("accel", "gyro") or each.startswith(key)]
            times = {each: lines.columns[each] for each in ("time", "missing")}
            found[key] = Sensor(
                title, lines, {**times, **{each: lines.columns.pop(each) for each in own if each != "time"}}
            )
    if "baro" in found:
        found["baro"].columns["pressure"] = pascals(found["baro"].columns["pressure"])
    return found


def _merged_columns(values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns of all streams."""
    inertial = (f"{group}_{axis}" for group in ("accel", "gyro") for axis in XYZ)
    found = {column: values[name] for column, name in zip(inertial, MERGED, strict=True)}
    if values.keys() >= set(FIELD):
        found |= {name: 1e-6 * values[name] for name in FIELD}
    if "pressure" in values:
        found["pressure"] = values["pressure"]
    return {**found, **place(values)} if values.keys() >= {"latitude", "longitude"} else found


def sniff(path: Path, head: bytes) -> Sniff:
    """The columns `time` and `seconds_elapsed`; in a folder or zip its tables and Metadata.csv."""
    if path.is_dir() or is_zip(path):
        try:
            files = files_of(path)
        except ReadFailed:
            return Sniff(0.0, "no whole zip")
        tables = _tables(files)
        if "Metadata.csv" in files.names and tables:
            return Sniff(0.95, "tables of Sensor Logger and its Metadata.csv")
        name = next(iter(tables.values()), "")
        if name and _is_table(files.head(name)):
            return Sniff(0.9, f"tables of Sensor Logger, {name} among them")
        return Sniff(0.0, "no tables of Sensor Logger")
    if _is_table(head):
        return Sniff(0.9, "columns time and seconds_elapsed of Sensor Logger")
    if _is_metadata(head):
        return Sniff(0.9, "Metadata.csv of Sensor Logger")
    if _is_merged(head) and b"horizontalAccuracy" in head[:4096]:
        return Sniff(0.85, "columns of a merged table of Sensor Logger")
    return Sniff(0.0, "no table of Sensor Logger")


def _is_table(head: bytes) -> bool:
    names, _ = header_of(plain(head).partition(b"\n")[0])
    return {"time", "seconds_elapsed"} <= set(names)


def _is_metadata(head: bytes) -> bool:
    names, _ = header_of(plain(head).partition(b"\n")[0])
    return {"device name", "recording epoch time", "platform"} <= set(names)


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of Sensor Logger."""
    yield Reader(
        name="sensor_logger",
        summary="Recordings of the app Sensor Logger: folder, zip or single tables, of iPhones and Android phones.",
        params=SensorLoggerParams,
        run=read,
        sniff=sniff,
        self_describing=True,
        writes=WRITES,
        references=("github.com/tszheichoi/awesome-sensor-logger",),
    )
