"""DataFlash logs of ArduPilot to streams: each instance of a sensor, and the on-board estimate.

References: ArduPilot, AP_Logger/LogStructure.h; IS-GPS-200, 20.3.3.5.2.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from recon.errors import ReadFailed
from recon.numerics.geodesy import Anchor
from recon.numerics.gnss_time import GPS_EPOCH_NS, WEEK_NS, gps_to_utc
from recon.rows import Metric, warning
from recon.tables import Array, Streams
from recon_readers import _dataflash
from recon_readers._autopilot import (
    GAUSS,
    GNSS_FACTS,
    Log,
    account,
    angle,
    attitude_of,
    boot_ns,
    fixed,
    pose,
    positive,
    sigmas_of,
)
from recon_readers._time_order import Times, median_ns

_KINDS: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("IMU", "IMU2", "IMU3"),
    "gnss": ("GPS", "GPS2", "GPA", "GPA2"),
    "mag": ("MAG", "MAG2", "MAG3"),
    "baro": ("BARO", "BAR2", "BAR3"),
    "reference": ("XKF1", "NKF1", "EKF1", "ORGN"),
}
AGAIN: Final = "copy the log from the autopilot or the ground station again"


def from_flash(log: Log) -> Streams:
    """The streams of a DataFlash log that are wanted. Raises ReadFailed, NothingUsable where it holds none."""
    names = {name for stream, kinds in _KINDS.items() if log.wants(stream) for name in kinds}
    found = _dataflash.walk(log.path, {*names, "GPS"})
    tables = found.tables()
    if len(found.kinds) < 2:
        raise ReadFailed(log.path, "it holds no FMT message, so no other can be read", hint=AGAIN)
    account(log, found.damaged, "bytes that are no message")
    if found.declared_anew:
        text = f"{found.declared_anew} messages are left out, for the log declares their kinds anew, with other fields"
        log.learnt.append(warning(f"{text}: were several logs joined? Read each by itself"))
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
            log.add("gnss", source, _boot_ns(table), {**_flash_gnss(table), **sigmas}, **GNSS_FACTS)
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
    return boot_ns(table.integers(name), factor)


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
    offset = median_ns(gps_to_utc(gps_ns) - _boot_ns(gps)[known])
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
    status, speed, course = table.numbers("Status"), table.numbers("Spd"), angle(np.radians(table.numbers("GCrs")))
    columns = {"lat": table.numbers("Lat"), "lon": table.numbers("Lng"), "height": table.numbers("Alt")}
    columns |= {"vel_e": speed * np.sin(course), "vel_n": speed * np.cos(course), "vel_u": -table.numbers("VZ")}
    return fixed(columns, status, table.numbers("NSats"), speed, course)


def _accuracy(gps: _dataflash.Table, accuracy: _dataflash.Table | None) -> dict[str, Array]:
    """Sigmas that the receiver gives in a message of their own at the same time."""
    if accuracy is None or not len(accuracy.rows):
        return {}
    own, order = np.unique(_boot_ns(accuracy), return_index=True)
    at = np.searchsorted(own, _boot_ns(gps)).clip(max=len(own) - 1)
    same = own[at] == _boot_ns(gps)
    sigmas = [np.where(same, positive(accuracy.numbers(name))[order][at], np.nan) for name in ("HAcc", "VAcc", "SAcc")]
    return sigmas_of(*sigmas)


def _flash_reference(tables: Mapping[str, _dataflash.Table], log: Log) -> None:
    name = next((name for name in _KINDS["reference"][:3] if name in tables), None)
    if name is None:
        return
    table = tables[name]
    if "C" in table:
        table = table.only(table.integers("C") == 0)
    t_ns = _boot_ns(table)
    pos, vel = (np.column_stack([table.numbers(start + axis) for axis in "NED"]) for start in "PV")
    q = attitude_of(*(np.radians(table.numbers(name)) for name in ("Roll", "Pitch", "Yaw")))
    t_ns, columns, facts = pose((t_ns, pos, vel), (t_ns, q), _origin(tables.get("ORGN")))
    log.add("reference", f"on-board estimate {name}", t_ns, columns, **facts)


def _origin(table: _dataflash.Table | None) -> Anchor | None:
    """Where the estimate's positions count from; None where it is not logged or moved."""
    if table is None:
        return None
    own = table.only(table.integers("Type") == 0) if "Type" in table else table
    places = np.column_stack([own.numbers(name) for name in ("Lat", "Lng", "Alt")])
    known = bool(len(places)) and np.isfinite(places).all() and (places == places[0]).all()
    return Anchor(*places[0].tolist()) if known and abs(places[0, 0]) <= 90.0 else None
