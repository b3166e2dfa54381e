"""Logs of ArduPilot: DataFlash from the autopilot (.bin), MAVLink telemetry from a ground station (.tlog).

    .bin    IMU GPS GPA MAG BARO                        each instance; m/s^2, rad/s, mgauss, Pa
            XKF1 or NKF1 or EKF1, ORGN                  the on-board estimate as reference, core 0
    .tlog   HIGHRES_IMU; RAW_IMU of ArduPilot, SCALED_IMU, 2, 3     m/s^2 or mg, rad/s or mrad/s, gauss or mgauss
            GPS_RAW_INT, SCALED_PRESSURE; GLOBAL_POSITION_INT and ATTITUDE as reference

Vectors are logged along forward, right, down and given along forward, left, up; heights are above mean sea level.
Times count from the boot of the autopilot. UTC of a .bin is what the receiver says, GPS week and time less the leap
seconds of that day; of a .tlog what SYSTEM_TIME says, else the clock of the ground station. In both it is the median of
the differences to the boot clock, so that the receiver's or the radio's delay remains in it.

pymavlink makes an object of every message and ends at the first kind that it does not know; here both formats are read
as columns, and a damaged place is passed over.

References: ArduPilot, AP_Logger/LogStructure.h; mavlink.io, common.xml; IS-GPS-200, 20.3.3.5.2.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import STANDARD_GRAVITY, Anchor, geodetic_to_enu
from recon.numerics.gnss_time import GPS_EPOCH_NS, WEEK_NS, gps_to_utc
from recon.numerics.rotation import from_euler, yaw_from_heading
from recon.parameters import NoParams
from recon.rows import Metric, warning
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.tables import Array, Streams
from recon_readers import _dataflash, _mavlink
from recon_readers._autopilot import GAUSS, LONGEST_NS, WRITES, Log, pose
from recon_readers._time_order import Mask, Times

_KINDS: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("IMU", "IMU2", "IMU3"),
    "gnss": ("GPS", "GPS2", "GPA", "GPA2"),
    "mag": ("MAG", "MAG2", "MAG3"),
    "baro": ("BARO", "BAR2", "BAR3"),
    "reference": ("XKF1", "NKF1", "EKF1", "ORGN"),
}
_SENT: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    "gnss": ("GPS_RAW_INT",),
    "mag": ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    "baro": ("SCALED_PRESSURE",),
    "reference": ("GLOBAL_POSITION_INT", "ATTITUDE"),
}
_ARDUPILOT: Final = 3
"""MAV_AUTOPILOT_ARDUPILOTMEGA."""
_GNSS_FACTS: Final = {"height_datum": "mean_sea_level", "heading_kind": "course_true"}
_AGAIN: Final = "copy the log from the autopilot or the ground station again"


def read(path: Path, params: NoParams, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams imu, gnss, mag, baro and reference, each sensor's own, as far as they are there and wanted.

    Raises ReadFailed, NothingUsable where the log holds none.
    """
    with path.open("rb") as file:
        flash = file.read(2) == _dataflash.HEAD
    log = Log(path, wanted, {"format": "ArduPilot DataFlash" if flash else "MAVLink tlog"})
    return _from_flash(log) if flash else _from_telemetry(log)


def _account(log: Log, damaged: int, what: str) -> None:
    if damaged:
        text = f"{log.path.name} is cut short or damaged ({damaged} times): every whole message is used"
        log.learnt += [Metric("damaged_places", float(damaged), note=what), warning(text)]


# --- DataFlash ------------------------------------------------------------------------------------------------------


def _from_flash(log: Log) -> Streams:
    names = {name for stream, kinds in _KINDS.items() if log.wants(stream) for name in kinds}
    found = _dataflash.walk(log.path, {*names, "GPS"})
    tables = found.tables()
    if len(found.kinds) < 2:
        raise ReadFailed(log.path, "it holds no FMT message, so no other can be read", hint=_AGAIN)
    _account(log, found.damaged, "bytes that are no message")
    log.offset_ns = _flash_utc(tables.get("GPS"), log)
    sensors = [("imu", "IMU", _flash_imu), ("mag", "MAG", _flash_mag), ("baro", "BAR", _flash_baro)]
    for stream, start, made in sensors:
        if log.wants(stream):
            for source, table in _instances(tables, start, _KINDS[stream]):
                add = log.add if stream == "baro" else log.add_frd
                add(stream, source, _boot_ns(table), made(table))
    if log.wants("gnss"):
        accuracies = dict(_instances(tables, "GPA", _KINDS["gnss"]))
        for source, table in _instances(tables, "GPS", _KINDS["gnss"]):
            sigmas = _accuracy(table, accuracies.get(source.replace("GPS", "GPA")))
            log.add("gnss", source, _boot_ns(table), {**_flash_gnss(table), **sigmas}, **_GNSS_FACTS)
    if log.wants("reference"):
        _flash_reference(tables, log)
    return log.streams(", ".join(sorted({kind.name for kind in found.kinds.values()})))


def _instances(tables: Mapping[str, _dataflash.Table], start: str, names: Iterable[str]) -> Any:
    """(name, table) of each sensor of a kind: by the field I, in older logs IMU, IMU2, ..."""
    for name in names:
        table = tables.get(name)
        if table is None or not name.startswith(start):
            continue
        if "I" not in table:
            yield name, table
            continue
        numbers = table.integers("I")
        for number in np.unique(numbers).tolist():
            yield f"{name}[{number}]", table.only(numbers == number)


def _boot_ns(table: _dataflash.Table) -> Times:
    """(n,) ns since boot, below 0 where there is none. In older logs TimeMS of GPS counts from its week."""
    name = next((name for name in ("TimeUS", "T", "TimeMS") if name in table), None)
    if name is None:
        return np.full(len(table.rows), -1)
    factor = 1_000 if name == "TimeUS" else 1_000_000
    return _scaled(table.integers(name), factor)


def _scaled(counts: Times, factor: int) -> Times:
    """Counts of a boot clock as ns, -1 where that cannot be."""
    return np.where((counts >= 0) & (counts < LONGEST_NS // factor), counts * factor, -1)


def _flash_utc(gps: _dataflash.Table | None, log: Log) -> int | None:
    """UTC minus boot, ns."""
    if gps is None:
        return None
    week, ms = ("GWk", "GMS") if "GWk" in gps else ("Week", "TimeMS")
    if week not in gps or ms not in gps:
        return None
    known = (gps.numbers("Status") >= 3.0) & (gps.integers(week) > 0) & (_boot_ns(gps) >= 0)
    if not known.any():
        return None
    gps_ns = GPS_EPOCH_NS + gps.integers(week)[known] * WEEK_NS + gps.integers(ms)[known] * 1_000_000
    offset = int(np.median(gps_to_utc(gps_ns) - _boot_ns(gps)[known]))
    log.learnt.append(Metric("utc_minus_boot", offset * 1e-9, "s", note=f"by {int(known.sum())} rows of GPS"))
    return offset


def _flash_imu(table: _dataflash.Table) -> dict[str, Array]:
    names = {"accel": "Acc", "gyro": "Gyr"}
    return {f"{group}_{axis.lower()}": table.numbers(start + axis) for group, start in names.items() for axis in "XYZ"}


def _flash_mag(table: _dataflash.Table) -> dict[str, Array]:
    return {f"mag_{axis.lower()}": table.numbers(f"Mag{axis}") * 1e-3 * GAUSS for axis in "XYZ"}


def _flash_baro(table: _dataflash.Table) -> dict[str, Array]:
    return {"pressure": table.numbers("Press"), "temperature": table.numbers("Temp") + 273.15}


def _flash_gnss(table: _dataflash.Table) -> dict[str, Array]:
    status, speed, course = table.numbers("Status"), table.numbers("Spd"), np.radians(table.numbers("GCrs"))
    columns = {"lat": table.numbers("Lat"), "lon": table.numbers("Lng"), "height": table.numbers("Alt")}
    columns |= {"vel_e": speed * np.sin(course), "vel_n": speed * np.cos(course), "vel_u": -table.numbers("VZ")}
    return _fixed(columns, status, table.numbers("NSats"), speed, course)


def _fixed(
    columns: dict[str, Array], status: Array, satellites: Array, speed: Array, course: Array
) -> dict[str, Array]:
    """Columns of gnss where there is a fix. status : 0, 1 none, 2 two-dimensional, above three-dimensional."""
    lost = status < 2.0
    moving = {"speed": speed, "course": np.mod(course, 2.0 * np.pi)}
    known = {name: np.where(lost, np.nan, values) for name, values in {**columns, **moving}.items()}
    return {**known, "fix": np.clip(np.where(lost, 0.0, status), 0.0, 3.0), "satellites": satellites}


def _accuracy(gps: _dataflash.Table, accuracy: _dataflash.Table | None) -> dict[str, Array]:
    """Sigmas that the receiver gives in a message of their own at the same time."""
    if accuracy is None or not len(accuracy.rows):
        return {}
    own, order = np.unique(_boot_ns(accuracy), return_index=True)
    at = np.searchsorted(own, _boot_ns(gps)).clip(max=len(own) - 1)
    same = own[at] == _boot_ns(gps)
    sigmas = [np.where(same, _positive(accuracy.numbers(name))[order][at], np.nan) for name in ("HAcc", "VAcc", "SAcc")]
    return _sigmas(*sigmas)


def _sigmas(horizontal: Array, vertical: Array, speed: Array) -> dict[str, Array]:
    position = {"pos_std_e": horizontal, "pos_std_n": horizontal, "pos_std_u": vertical}
    return {**position, **dict.fromkeys(("vel_std_e", "vel_std_n", "vel_std_u"), speed)}


def _positive(values: Array) -> Array:
    return np.where(values > 0.0, values, np.nan)


def _flash_reference(tables: Mapping[str, _dataflash.Table], log: Log) -> None:
    name = next((name for name in _KINDS["reference"][:3] if name in tables), None)
    if name is None:
        return
    table = tables[name]
    if "C" in table:
        table = table.only(table.integers("C") == 0)
    t_ns = _boot_ns(table)
    pos, vel = (np.column_stack([table.numbers(start + axis) for axis in "NED"]) for start in "PV")
    q = _attitude(*(np.radians(table.numbers(name)) for name in ("Roll", "Pitch", "Yaw")))
    t_ns, columns, facts = pose((t_ns, pos, vel), (t_ns, q), _origin(tables.get("ORGN")))
    log.add("reference", f"on-board estimate {name}", t_ns, columns, **facts)


def _attitude(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Forward, left, up in east, north, up, from angles of forward, right, down in north, east, down, rad."""
    return np.asarray(from_euler(yaw_from_heading(yaw), -pitch, roll))


def _origin(table: _dataflash.Table | None) -> Anchor | None:
    """Where the estimate's positions count from; None where it is not logged or moved."""
    if table is None:
        return None
    own = table.only(table.integers("Type") == 0) if "Type" in table else table
    places = np.column_stack([own.numbers(name) for name in ("Lat", "Lng", "Alt")])
    known = bool(len(places)) and np.isfinite(places).all() and (places == places[0]).all()
    return Anchor(*places[0].tolist()) if known and abs(places[0, 0]) <= 90.0 else None


# --- telemetry ------------------------------------------------------------------------------------------------------


def _from_telemetry(log: Log) -> Streams:
    names = {name for stream, sent in _SENT.items() if log.wants(stream) for name in sent}
    found = _mavlink.walk(log.path, frozenset({*names, "HEARTBEAT", "SYSTEM_TIME"}))
    tables = found.tables()
    _account(log, found.damaged, "bytes that are no message")
    if found.wrong:
        log.learnt.append(Metric("checksums_wrong", float(found.wrong), note=f"of {found.frames} messages"))
    log.offset_ns = _telemetry_utc(tables, log)
    for source, table, unit in _inertial(tables, log):
        t_ns = _sent_ns(table)
        if log.wants("imu"):
            felt = {**_sent(table, "accel", "acc", unit), **_sent(table, "gyro", "gyro", unit)}
            log.add_frd("imu", source, t_ns, felt)
        if log.wants("mag"):
            log.add_frd("mag", source, t_ns, _sent(table, "mag", "mag", unit))
    if log.wants("gnss") and "GPS_RAW_INT" in tables:
        gps = tables["GPS_RAW_INT"]
        log.add("gnss", "GPS_RAW_INT", _sent_ns(gps), _sent_gnss(gps), **_GNSS_FACTS)
    if log.wants("baro") and "SCALED_PRESSURE" in tables:
        air = tables["SCALED_PRESSURE"]
        celsius = air.numbers("temperature") / 100.0
        columns = {"pressure": air.numbers("press_abs") * 100.0, "temperature": celsius + 273.15}
        log.add("baro", "SCALED_PRESSURE", _sent_ns(air), columns)
    if log.wants("reference"):
        _sent_reference(tables, log)
    return log.streams(f"{found.frames} messages of MAVLink")


def _sent_ns(table: _mavlink.Table) -> Times:
    """(n,) ns since boot."""
    fine = "time_usec" in (table.rows.dtype.names or ())
    return _scaled(table.integers("time_usec"), 1_000) if fine else _sent_ns_of_boot(table)


def _telemetry_utc(tables: Mapping[str, _mavlink.Table], log: Log) -> int | None:
    """UTC minus boot, ns, by the autopilot, else by the ground station's clock."""
    told = tables.get("SYSTEM_TIME")
    if told is not None:
        utc_us = told.integers("time_unix_usec")
        known = (utc_us > _mavlink.EARLIEST_US) & (utc_us < _mavlink.LATEST_US) & (_sent_ns_of_boot(told) > 0)
        if known.any():
            return _told(log, (utc_us * 1_000 - _sent_ns_of_boot(told))[known], "SYSTEM_TIME")
    for name in ("ATTITUDE", "RAW_IMU", "SCALED_IMU", "GPS_RAW_INT", "SYSTEM_TIME"):
        table = tables.get(name)
        if table is not None:
            boot = _sent_ns_of_boot(table) if name == "SYSTEM_TIME" else _sent_ns(table)
            if (boot >= 0).any():
                difference = (table.received_ns - boot)[boot >= 0]
                return _told(log, difference, f"{name}, by the clock of the ground station")
    return None


def _sent_ns_of_boot(table: _mavlink.Table) -> Times:
    return _scaled(table.integers("time_boot_ms"), 1_000_000)


def _told(log: Log, difference: Times, source: str) -> int:
    offset = int(np.median(difference))
    log.learnt.append(Metric("utc_minus_boot", offset * 1e-9, "s", note=f"by {len(difference)} rows of {source}"))
    return offset


def _inertial(tables: Mapping[str, _mavlink.Table], log: Log) -> Any:
    """(name, messages, is it in SI?) of each IMU. RAW_IMU is scaled as SCALED_IMU by ArduPilot alone."""
    if "HIGHRES_IMU" in tables:
        yield "HIGHRES_IMU", tables["HIGHRES_IMU"], True
        return
    heart = tables.get("HEARTBEAT")
    is_ardupilot = heart is not None and bool((heart.integers("autopilot") == _ARDUPILOT).any())
    if "RAW_IMU" in tables and is_ardupilot and "SCALED_IMU" not in tables:
        yield "RAW_IMU", tables["RAW_IMU"], False
    elif "RAW_IMU" in tables and "SCALED_IMU" not in tables:
        log.learnt.append(warning("RAW_IMU is left out: only ArduPilot says in which unit it counts"))
    for name in ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"):
        if name in tables:
            yield name, tables[name], False


_FACTORS: Final = {"acc": 1e-3 * STANDARD_GRAVITY, "gyro": 1e-3, "mag": 1e-3 * GAUSS}


def _sent(table: _mavlink.Table, group: str, name: str, si: bool) -> dict[str, Array]:
    factor = (GAUSS if name == "mag" else 1.0) if si else _FACTORS[name]
    values = {f"{group}_{axis}": table.numbers(f"{axis}{name}") * factor for axis in "xyz"}
    silent = np.logical_and.reduce([column == 0.0 for column in values.values()])  # a sensor that is not there
    return {key: np.where(silent, np.nan, column) for key, column in values.items()}


def _sent_gnss(table: _mavlink.Table) -> dict[str, Array]:
    columns = {name: table.numbers(sent) / scale for name, sent, scale in _SENT_PLACE}
    unknown = {"vel": 65535.0, "cog": 65535.0, "satellites_visible": 255.0}
    speed, course, satellites = (_known(table.numbers(name), value) for name, value in unknown.items())
    fixed = _fixed(columns, table.numbers("fix_type"), satellites, speed / 100, np.radians(course / 100))
    sigmas = _sigmas(*(_positive(table.numbers(name)) / 1e3 for name in ("h_acc", "v_acc", "vel_acc")))
    return {**fixed, **sigmas}


_SENT_PLACE: Final = (("lat", "lat", 1e7), ("lon", "lon", 1e7), ("height", "alt", 1e3))


def _known(values: Array, unknown: float) -> Array:
    return np.where(values == unknown, np.nan, values)


def _sent_reference(tables: Mapping[str, _mavlink.Table], log: Log) -> None:
    table, turned = tables.get("GLOBAL_POSITION_INT"), tables.get("ATTITUDE")
    if table is None:
        return
    place = np.column_stack([table.numbers(sent) / scale for _, sent, scale in _SENT_PLACE])
    somewhere: Mask = (place[:, :2] != 0.0).any(axis=1) & (np.abs(place[:, 0]) <= 90.0)
    if not somewhere.any():
        return
    place = place[somewhere]
    anchor = Anchor(*place[0].tolist())
    pos_ned = geodetic_to_enu(place[:, 0], place[:, 1], place[:, 2], anchor)[:, [1, 0, 2]] * (1.0, 1.0, -1.0)
    vel_ned = np.column_stack([table.numbers(name)[somewhere] / 100 for name in ("vx", "vy", "vz")])
    q = None
    if turned is not None:
        q = _sent_ns(turned), _attitude(*(turned.numbers(name) for name in ("roll", "pitch", "yaw")))
    t_ns, columns, facts = pose((_sent_ns(table)[somewhere], pos_ned, vel_ned), q, anchor)
    log.add("reference", "on-board estimate GLOBAL_POSITION_INT", t_ns, columns, **facts)


# --- which file -----------------------------------------------------------------------------------------------------


def sniff(path: Path, head: bytes) -> Sniff:
    """A FMT message at the start, or times of reception with frames of MAVLink behind them."""
    if head.startswith(_dataflash.HEAD):
        known = head[2:3] == bytes([_dataflash.FMT])
        return Sniff(0.95 if known else 0.6, "DataFlash log of ArduPilot")
    if head.startswith(b"FMT, 128, 89"):
        return Sniff(0.3, "DataFlash log as text: give the .bin that it was made from")
    at = 0
    for _ in range(3):
        frame = _mavlink.frame_at(head, at)
        if frame is None:
            return Sniff(0.0, "neither DataFlash nor MAVLink")
        at = _mavlink.end_of(head, at, *frame[2:])
    return Sniff(0.95, "MAVLink telemetry log")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of logs of ArduPilot."""
    yield Reader(
        name="ardupilot",
        summary="Logs of ArduPilot, DataFlash and telemetry: IMU, GNSS, magnetometer, barometer, on-board estimate.",
        run=read,
        sniff=sniff,
        selective=True,
        writes=WRITES,
        references=("ArduPilot, AP_Logger/LogStructure.h", "mavlink.io, common.xml", "IS-GPS-200, 20.3.3.5.2.4"),
    )
