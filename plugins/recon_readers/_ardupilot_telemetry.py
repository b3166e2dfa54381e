"""Telemetry of ArduPilot and others (MAVLink) to streams, as far as it tells its units.

Reference: mavlink.io, common.xml.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import STANDARD_GRAVITY, Anchor, geodetic_to_enu
from recon.rows import Metric, warning
from recon.tables import Array, Streams
from recon_readers import _mavlink
from recon_readers._autopilot import (
    GAUSS,
    GNSS_FACTS,
    RESTARTED_NS,
    Log,
    account,
    attitude_of,
    boot_ns,
    fixed,
    pose,
    positive,
    sigmas_of,
)
from recon_readers._time_order import Mask, Times, median_ns

_IMUS: Final = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
_SENT: Final[Mapping[str, Mapping[str, str]]] = {
    "imu": dict.fromkeys(_IMUS, "xacc yacc zacc xgyro ygyro zgyro"),
    "mag": dict.fromkeys(_IMUS, "xmag ymag zmag"),
    "gnss": {"GPS_RAW_INT": "lat lon alt vel cog fix_type satellites_visible h_acc v_acc vel_acc"},
    "baro": {"SCALED_PRESSURE": "press_abs temperature"},
    "reference": {"GLOBAL_POSITION_INT": "lat lon alt vx vy vz", "ATTITUDE": "roll pitch yaw"},
}
"""Fields of messages, by stream."""
_CLOCKS: Final = {"HEARTBEAT": "autopilot", "SYSTEM_TIME": "time_unix_usec"}
_ARDUPILOT: Final = 3
"""MAV_AUTOPILOT_ARDUPILOTMEGA."""


def from_telemetry(log: Log) -> Streams:
    """The streams of a telemetry log that are wanted. Raises NothingUsable where it holds none."""
    wanted = {name: fields.split() for name, fields in _CLOCKS.items()}
    for stream, sent in _SENT.items():
        for name, fields in sent.items() if log.wants(stream) else ():
            wanted[name] = [*wanted.get(name, ()), *fields.split()]
    found = _mavlink.walk(log.path, wanted)
    tables, others = found.tables()
    account(log, found.damaged, "bytes that are no message")
    if found.wrong:
        log.learnt.append(Metric("checksums_wrong", float(found.wrong), note=f"of {found.frames} messages"))
    if others:
        note = "of other vehicles, or of other components of this one, than the one that sent most"
        log.learnt.append(Metric("messages_left_out", float(others), note=note))
    clock = _clock(tables, log)
    log.offset_ns = clock.utc_ns[0] if clock else None
    for source, table, unit in _inertial(tables, log):
        t_ns = _sent_ns(table, clock)
        if log.wants("imu"):
            felt = {**_sent(table, "accel", "acc", unit), **_sent(table, "gyro", "gyro", unit)}
            log.add_frd("imu", source, t_ns, felt)
        if log.wants("mag"):
            log.add_frd("mag", source, t_ns, _sent(table, "mag", "mag", unit))
    if log.wants("gnss") and "GPS_RAW_INT" in tables:
        gps = tables["GPS_RAW_INT"]
        log.add("gnss", "GPS_RAW_INT", _sent_ns(gps, clock), _sent_gnss(gps), **GNSS_FACTS)
    if log.wants("baro") and "SCALED_PRESSURE" in tables:
        air = tables["SCALED_PRESSURE"]
        celsius = air.numbers("temperature") / 100.0
        columns = {"pressure": air.numbers("press_abs") * 100.0, "temperature": celsius + 273.15}
        log.add("baro", "SCALED_PRESSURE", _sent_ns(air, clock), columns)
    if log.wants("reference"):
        _sent_reference(tables, clock, log)
    return log.streams(f"{found.frames} messages of MAVLink")


@dataclass(frozen=True)
class _Clock:
    """The boot clock of each start of the autopilot, in their order.

    utc_ns : UTC minus it; received_ns : clock of the ground station minus it
    """

    utc_ns: list[int]
    received_ns: list[int]

    def start(self, ahead_ns: Times) -> NDArray[np.intp]:
        """In which start messages were sent, (n,): by how far the ground station's clock is ahead, (n,) ns."""
        order = np.argsort(self.received_ns)
        known = np.array(self.received_ns)[order]
        return np.asarray(order[np.searchsorted(known[:-1] + np.diff(known) // 2, ahead_ns)])


def _sent_ns(table: _mavlink.Table, clock: _Clock | None) -> Times:
    """(n,) ns of the log's clock, which counts from the first boot; -1 where that cannot be.

    What is stamped in us may be so since boot or since 1970; the size tells which (common.xml).
    """
    boot, utc = _stamps(table)
    if clock is None:
        return np.where(utc >= 0, utc, boot)
    if len(clock.utc_ns) > 1:
        own = np.array(clock.utc_ns)[clock.start(table.received_ns - boot)]
        boot = np.where(boot >= 0, boot + own - clock.utc_ns[0], -1)
    return np.where(utc >= 0, utc - clock.utc_ns[0], boot)


def _stamps(table: _mavlink.Table) -> tuple[Times, Times]:
    """(n,) ns since boot and (n,) ns since 1970; -1 where a message tells the other."""
    if "time_usec" not in table:
        boot = boot_ns(table.integers("time_boot_ms"), 1_000_000)
        return boot, np.full(len(boot), -1)
    counts = table.integers("time_usec")
    dated = (counts > _mavlink.EARLIEST_US) & (counts < _mavlink.LATEST_US)
    return boot_ns(counts, 1_000), np.where(dated, counts * 1_000, -1)


def _clock(tables: Mapping[str, _mavlink.Table], log: Log) -> _Clock | None:
    """UTC minus boot at each start of the autopilot, by itself, else by the ground station's clock.

    Where no message counts from boot, the log's clock begins with its first message.
    """
    stamps = {name: _stamps(table) for name, table in tables.items() if name != "HEARTBEAT"}
    booted = {name: int(np.count_nonzero(boot >= 0)) for name, (boot, _) in stamps.items()}
    often = max(booted, key=lambda name: booted[name], default="")
    if not booted.get(often, 0):
        first = min((int(utc[utc >= 0].min()) for _, utc in stamps.values() if (utc >= 0).any()), default=None)
        return None if first is None else _Clock([first], [first])
    known = stamps[often][0] >= 0
    boot, ahead = stamps[often][0][known], (tables[often].received_ns - stamps[often][0])[known]
    starts = np.flatnonzero((np.diff(boot) < -RESTARTED_NS) & (np.diff(ahead) > RESTARTED_NS)) + 1
    received = [median_ns(part) for part in np.split(ahead, starts)]
    clock = _Clock(received, received)
    if len(starts):
        log.learnt.append(warning(f"the autopilot started {len(received)} times: each has its own boot clock"))
    if "SYSTEM_TIME" in tables:
        utc_us, boot = tables["SYSTEM_TIME"].integers("time_unix_usec"), stamps["SYSTEM_TIME"][0]
        known = (utc_us > _mavlink.EARLIEST_US) & (utc_us < _mavlink.LATEST_US) & (boot > 0)
        if known.any():
            difference, ahead = utc_us[known] * 1_000 - boot[known], (tables["SYSTEM_TIME"].received_ns - boot)[known]
            _told(log, difference, "SYSTEM_TIME")
            return _Clock(_by_start(clock, difference, ahead), received)
    _told(log, ahead, f"{often}, by the clock of the ground station")
    return clock


def _by_start(clock: _Clock, difference: Times, ahead: Times) -> list[int]:
    """UTC minus boot at each start, ns; where SYSTEM_TIME does not tell it, by the ground station's clock, set right.

    difference, ahead : (n,) ns; UTC and the ground station's clock minus boot, of each SYSTEM_TIME
    """
    start, fast_ns = clock.start(ahead), median_ns(ahead - difference)
    told = [difference[start == number] for number in range(len(clock.received_ns))]
    return [median_ns(own) if len(own) else known - fast_ns for own, known in zip(told, clock.received_ns, strict=True)]


def _told(log: Log, difference: Times, source: str) -> int:
    offset = median_ns(difference)
    log.learnt.append(Metric("utc_minus_boot", offset * 1e-9, "s", note=f"by {len(difference)} rows of {source}"))
    return offset


def _inertial(tables: Mapping[str, _mavlink.Table], log: Log) -> Any:
    """(name, messages, is it in SI?) of each IMU. RAW_IMU is scaled as SCALED_IMU by ArduPilot alone."""
    fine = [(name, table, True) for name, table in tables.items() if name.startswith("HIGHRES_IMU")]
    if fine:
        yield from fine
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
    for column in values.values() if silent.any() else ():
        column[silent] = np.nan
    return values


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


def _sent_reference(tables: Mapping[str, _mavlink.Table], clock: _Clock | None, log: Log) -> None:
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
        q = _sent_ns(turned, clock), attitude_of(*(turned.numbers(name) for name in ("roll", "pitch", "yaw")))
    t_ns, columns, facts = pose((_sent_ns(table, clock)[somewhere], pos_ned, vel_ned), q, anchor)
    log.add("reference", "on-board estimate GLOBAL_POSITION_INT", t_ns, columns, **facts)
