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
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.parameters import setting
from recon.rows import Metric, metrics, warning
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams
from recon_readers._lines import Lines
from recon_readers._phone_files import Files, files_of, header_of, is_zip, sheet_of
from recon_readers._phone_streams import CIRCLE, WRITES, PhoneParams, Sensor, columns, streams_of
from recon_readers._text_blocks import plain
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import moments

XYZ: Final = ("x", "y", "z")
PLACE: Final = ("latitude", "longitude", "altitude", "speed", "bearing")
ACCURACY: Final = ("horizontalAccuracy", "verticalAccuracy", "speedAccuracy", "bearingAccuracy")
MERGED: Final = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")
_KPA: Final = 200.0
"""Below this a pressure cannot be in mbar where people drive."""


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
    if not tables and len(files.names) == 1 and _is_merged(files.read(files.names[0])):
        sensors = _merged(files)
    else:
        sensors = {key: sensor for key, sensor in _plain_sensors(files, tables).items() if sensor is not None}
        accel, felt, told = _accel(files, tables, phone)
        learnt += told
        if accel is not None:
            sensors = {"accel": accel, **sensors}
    facts = {"time_scale": "UTC", "clock": "absolute", "format": "Sensor Logger"}
    made, told = streams_of(path, sensors, felt, facts, params)
    if not made:
        hint = "it should hold Accelerometer.csv, Gyroscope.csv, Location.csv, ... with rows"
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
    lines = plain(raw)[:65536].decode("utf-8", "replace").replace("\0", "").split("\n")
    try:
        rows = list(csv.reader(lines[:2]))
    except csv.Error:
        return {}
    return dict(zip(rows[0], rows[1], strict=False)) if len(rows) > 1 else {}


def _sensor(
    files: Files, tables: dict[str, str], sensor: str, names: tuple[str, ...], maybe: bool = False
) -> _Raw | None:
    """The times and columns of a table, None where it is not there or empty."""
    if sensor not in tables:
        return None
    label = files.label(tables[sensor])
    sheet = sheet_of(label, files.read(tables[sensor]))
    missing = [name for name in ("time", *(() if maybe else names)) if name not in sheet.names]
    if missing:
        raise ReadFailed(label, f"it has no column '{missing[0]}'", line=1, hint="is it a table of Sensor Logger?")
    there = tuple(name for name in names if name in sheet.names)
    lines = sheet.lines({"time": pa.string(), **dict.fromkeys(there, pa.float64())})
    if lines is None:
        return None
    t_ns, good = whole_ns(lines.table["time"])
    return _Raw(sensor, lines, t_ns, ~good, dict(zip(there, columns(lines, there).T, strict=True)) if there else {})


class _Raw(NamedTuple):
    name: str
    lines: Lines
    t_ns: Times
    missing: Mask
    values: dict[str, Array]

    @property
    def xyz(self) -> Array:
        """(n, 3) of the columns x, y, z."""
        return np.column_stack([self.values[axis] for axis in XYZ])

    def as_sensor(self, **groups: Array) -> Sensor:
        return Sensor(self.name, self.lines, self.t_ns, self.missing, groups)


def whole_ns(texts: pa.ChunkedArray) -> tuple[Times, Mask]:
    """Whole nanoseconds since 1970 of texts of digits, (n,), and which are such, (n,) bool."""
    from pyarrow import compute

    plain_texts = compute.fill_null(texts, "")
    good = compute.match_substring_regex(plain_texts, r"^\d{1,18}$|^[1-8]\d{18}$")
    t_ns = compute.if_else(good, plain_texts, "0").cast(pa.int64())
    return np.asarray(t_ns.combine_chunks()), np.asarray(good.combine_chunks())


def _plain_sensors(files: Files, tables: dict[str, str]) -> dict[str, Sensor | None]:
    """Gyroscope, magnetometer, barometer and receiver, whose units and signs are the same everywhere."""
    found: dict[str, Sensor | None] = {}
    gyro = _sensor(files, tables, "Gyroscope", XYZ) or _sensor(files, tables, "GyroscopeUncalibrated", XYZ)
    found["gyro"] = gyro.as_sensor(gyro=gyro.xyz) if gyro else None
    mag = _sensor(files, tables, "Magnetometer", XYZ) or _sensor(files, tables, "MagnetometerUncalibrated", XYZ)
    found["mag"] = mag.as_sensor(mag=1e-6 * mag.xyz) if mag else None
    baro = _sensor(files, tables, "Barometer", ("pressure",))
    found["baro"] = baro.as_sensor(pressure=_pascals(baro.values["pressure"])) if baro else None
    place = _sensor(files, tables, "LocationGps", (*PLACE, *ACCURACY), maybe=True)
    place = place or _sensor(files, tables, "Location", (*PLACE, *ACCURACY), maybe=True)
    found["gnss"] = place.as_sensor(**_place(place.values)) if place else None
    return found


def _pascals(pressure: Array) -> Array:
    known = pressure[np.isfinite(pressure)]
    return np.asarray(pressure * (1000.0 if len(known) and np.median(known) < _KPA else 100.0))


def _place(values: dict[str, Array]) -> dict[str, Array]:
    """Groups of gnss; what is negative where it cannot be is missing."""
    rows = len(next(iter(values.values()))) if values else 0
    none = np.full(rows, np.nan)
    column = {name: values.get(name, none) for name in (*PLACE, *ACCURACY)}
    wide, high, fast, way = (np.where(column[name] > 0.0, column[name], np.nan) for name in ACCURACY)
    with np.errstate(invalid="ignore"):
        height = np.where(column["verticalAccuracy"] < 0.0, np.nan, column["altitude"])
        speed = np.where(column["speed"] < 0.0, np.nan, column["speed"])
        told = column["bearing"] >= 0.0
    if "bearingAccuracy" in values:
        told &= np.isfinite(way)
    found = {
        "lat": column["latitude"],
        "lon": column["longitude"],
        "height": height,
        "speed": speed,
        "course": np.where(told, np.radians(column["bearing"]), np.nan),
        "pos_std": np.column_stack([wide / CIRCLE, wide / CIRCLE, high]),
        "vel_std": np.column_stack([fast, fast, none]),
    }
    return {name: value for name, value in found.items() if np.isfinite(value).any()}


def _accel(
    files: Files, tables: dict[str, str], phone: _Phone
) -> tuple[Sensor | None, Literal["specific_force", "acceleration"], list[Metric]]:
    """Specific force where any tables give it, else acceleration without gravity; and what had to be assumed."""
    total = _sensor(files, tables, "TotalAcceleration", XYZ)
    felt, gravity = _sensor(files, tables, "Accelerometer", XYZ), _sensor(files, tables, "Gravity", XYZ)
    raw = _sensor(files, tables, "AccelerometerUncalibrated", XYZ)
    if not (total or felt or raw):
        return None, "specific_force", []
    if phone.ios is None:
        note = (
            "the accelerometer is left out, for nothing tells its sign: set reader.sensor_logger.platform to ios or "
            "android (Metadata.csv, which belongs to the recording, would tell)"
        )
        return None, "specific_force", [warning(note)]
    if total is not None:
        return total.as_sensor(accel=phone.sign * total.xyz), "specific_force", []
    if felt is not None and gravity is not None:
        both, late = _with_gravity(felt, gravity)
        return felt.as_sensor(accel=phone.sign * both), "specific_force", late
    if raw is not None:
        unit = STANDARD_GRAVITY if phone.ios and not phone.standardised else 1.0
        return raw.as_sensor(accel=phone.sign * unit * raw.xyz), "specific_force", []
    assert felt is not None
    note = "only Accelerometer.csv is there, which is without gravity: record Total Acceleration or Gravity as well"
    return felt.as_sensor(accel=phone.sign * felt.xyz), "acceleration", [warning(note)]


def _with_gravity(felt: _Raw, gravity: _Raw) -> tuple[Array, list[Metric]]:
    """Acceleration and gravity together, (n, 3) m/s^2; gravity, which the phone has smoothed, along straight lines."""
    good = np.flatnonzero(~gravity.missing & np.isfinite(gravity.xyz).all(axis=1))
    t_ns, first = np.unique(gravity.t_ns[good], return_index=True)
    if not len(t_ns):
        return np.full((len(felt.t_ns), 3), np.nan), [warning("Gravity.csv holds no measurement")]
    since_s, at_s = (t_ns - t_ns[0]) * 1e-9, (felt.t_ns - t_ns[0]) * 1e-9
    down = gravity.xyz[good[first]]
    added = np.column_stack([np.interp(at_s, since_s, axis, np.nan, np.nan) for axis in down.T])
    return felt.xyz + added, [Metric("specific_force", method="Accelerometer.csv + Gravity.csv")]


def _is_merged(raw: bytes) -> bool:
    names, _ = header_of(plain(raw[:65536]).partition(b"\n")[0])
    return {"time", *MERGED} <= set(names)


def _merged(files: Files) -> dict[str, Sensor]:
    """The sensors of a table that was merged by others."""
    name = files.names[0]
    sheet = sheet_of(files.label(name), files.read(name))
    field = ("mag_x", "mag_y", "mag_z")
    wanted = [each for each in (*MERGED, *field, "pressure", *PLACE, *ACCURACY) if each in sheet.names]
    lines = sheet.lines({"time": pa.string(), **dict.fromkeys(wanted, pa.float64())})
    if lines is None:
        return {}
    t_ns, good = moments(lines.table["time"])
    values = dict(zip(wanted, columns(lines, tuple(wanted)).T, strict=True))

    def sensor(title: str, **groups: Array) -> Sensor:
        return Sensor(title, lines, t_ns, ~good, groups)

    found = {
        "accel": sensor("acc", accel=np.column_stack([values[each] for each in MERGED[:3]])),
        "gyro": sensor("gyro", gyro=np.column_stack([values[each] for each in MERGED[3:]])),
    }
    if set(field) <= values.keys():
        found["mag"] = sensor("mag", mag=1e-6 * np.column_stack([values[each] for each in field]))
    if "pressure" in values:
        found["baro"] = sensor("pressure", pressure=_pascals(values["pressure"]))
    if {"latitude", "longitude"} <= values.keys():
        found["gnss"] = sensor("location", **_place(values))
    return found


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
        if name and _is_table(files.read(name)):
            return Sniff(0.9, f"tables of Sensor Logger, {name} among them")
        return Sniff(0.0, "no tables of Sensor Logger")
    if _is_table(head):
        return Sniff(0.9, "columns time and seconds_elapsed of Sensor Logger")
    if _is_merged(head) and b"horizontalAccuracy" in head[:4096]:
        return Sniff(0.85, "columns of a merged table of Sensor Logger")
    return Sniff(0.0, "no table of Sensor Logger")


def _is_table(head: bytes) -> bool:
    names, _ = header_of(plain(head[:65536]).partition(b"\n")[0])
    return {"time", "seconds_elapsed"} <= set(names)


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
