"""Telemetry of ArduPilot and others (MAVLink) to streams, as far as it tells its units.

Reference: mavlink.io, common.xml.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from recon.numerics.geodesy import STANDARD_GRAVITY, Anchor, geodetic_to_enu
from recon.rows import Metric, warning
from recon.tables import Array, Streams
from recon_readers import _mavlink
from recon_readers._autopilot import (
    GAUSS,
    GNSS_FACTS,
    Log,
    account,
    attitude_of,
    boot_ns,
    fixed,
    pose,
    positive,
    sigmas_of,
)
from recon_readers._time_order import Mask, Times

_SENT: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    "gnss": ("GPS_RAW_INT",),
    "mag": ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"),
    "baro": ("SCALED_PRESSURE",),
    "reference": ("GLOBAL_POSITION_INT", "ATTITUDE"),
}
_ARDUPILOT: Final = 3
"""MAV_AUTOPILOT_ARDUPILOTMEGA."""


def from_telemetry(log: Log) -> Streams:
    names = {name for stream, sent in _SENT.items() if log.wants(stream) for name in sent}
    found = _mavlink.walk(log.path, frozenset({*names, "HEARTBEAT", "SYSTEM_TIME"}))
    tables = found.tables()
    account(log, found.damaged, "bytes that are no message")
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
        log.add("gnss", "GPS_RAW_INT", _sent_ns(gps), _sent_gnss(gps), **GNSS_FACTS)
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
    return boot_ns(table.integers("time_usec"), 1_000) if fine else _sent_ns_of_boot(table)


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
    return boot_ns(table.integers("time_boot_ms"), 1_000_000)


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
    place = fixed(columns, table.numbers("fix_type"), satellites, speed / 100, np.radians(course / 100))
    sigmas = sigmas_of(*(positive(table.numbers(name)) / 1e3 for name in ("h_acc", "v_acc", "vel_acc")))
    return {**place, **sigmas}


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
        q = _sent_ns(turned), attitude_of(*(turned.numbers(name) for name in ("roll", "pitch", "yaw")))
    t_ns, columns, facts = pose((_sent_ns(table)[somewhere], pos_ned, vel_ned), q, anchor)
    log.add("reference", "on-board estimate GLOBAL_POSITION_INT", t_ns, columns, **facts)
