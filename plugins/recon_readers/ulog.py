"""Logs of PX4 (.ulg), by pyulog.

    sensor_combined; else sensor_accel and sensor_gyro    imu        m/s^2, rad/s, forward, right, down
    vehicle_gps_position; else sensor_gps, each instance   gnss       UTC, deg, m above mean sea level, m/s
    vehicle_magnetometer; else sensor_combined, sensor_mag mag        gauss
    vehicle_air_data; else sensor_baro                     baro       Pa; mbar where the number is below 2000
    vehicle_local_position, vehicle_attitude               reference  the on-board estimate, or the simulator's truth

Vectors are given along forward, left, up, the estimate east, north, up. Topics that are wanted are read, the others are
passed over. Times count from the boot of the autopilot, in whole microseconds; UTC is what the receiver says, by the
median of its differences to the boot clock, so that its delay of some ten milliseconds remains in all of them.

References: PX4 user guide, ULog file format; PX4-Autopilot, msg/*.msg.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import Anchor
from recon.parameters import NoParams
from recon.rounding import occasions
from recon.rows import Metric, warning
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.tables import Array, Streams
from recon_readers._arrays import interleave
from recon_readers._autopilot import GAUSS, GNSS_FACTS, LONGEST_NS, WRITES, Log, angle, attitude, pose, positive
from recon_readers._time_order import Times

MAGIC: Final = b"ULog\x01\x12\x35"
_TRUTH: Final = "_groundtruth"
_TOPICS: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("sensor_combined", "sensor_accel", "sensor_gyro"),
    "gnss": ("vehicle_gps_position", "sensor_gps"),
    "mag": ("vehicle_magnetometer", "sensor_combined", "sensor_mag"),
    "baro": ("vehicle_air_data", "sensor_baro"),
    "reference": tuple(f"vehicle_{name}{end}" for name in ("local_position", "attitude") for end in ("", _TRUTH)),
}
_CLOCK: Final = ("vehicle_gps_position", "sensor_gps")
"""Topics that tell UTC."""
_NEVER: Final = 2**31 - 1
"""A relative time that says that the sensor has not reported."""
_MILLIBAR: Final = 2000.0
"""Below this a pressure is in millibar, not in Pa."""
_PRESENT, _LATEST = 946_684_800_000_000, 4_102_444_800_000_000
"""us; 2000-01-01 and 2100-01-01."""

Data = Any
"""What pyulog gives of one instance of a topic."""


def read(path: Path, params: NoParams, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams imu, gnss, mag, baro and reference, as far as the log holds them and they are wanted.

    Raises ReadFailed, NothingUsable where it holds none, PluginError where pyulog is not installed.
    """
    log = Log(path, wanted, {"format": "ULog"})
    topics = {name for stream, names in _TOPICS.items() if log.wants(stream) for name in names}
    found = _load(path, sorted({*topics, *_CLOCK}), log)
    log.offset_ns = _utc(found, log)
    for stream, make in _MAKERS.items():
        if log.wants(stream):
            make(found, log)
    return log.streams(", ".join(sorted({name for name, _ in found})) or "none of the topics that are read")


def _load(path: Path, topics: Sequence[str], log: Log) -> dict[tuple[str, int], Data]:
    """The topics by name and instance."""
    with needs("reader.ulog", "pyulog", extra="ulog"):
        from pyulog import ULog
    said = io.StringIO()
    try:
        with path.open("rb") as file, redirect_stdout(said):  # it prints what it finds damaged
            ulog = ULog(file, topics, disable_str_exceptions=True)
    except OSError:
        raise
    except Exception as error:  # it raises errors of many kinds at damaged bytes
        raise ReadFailed(path, "the ULog file is damaged in its definitions", hint="copy it again") from error
    if ulog.file_corruption:
        text = f"{path.name} is damaged: what pyulog could make of it is used, how much is lost is not known"
        log.learnt += [Metric("damaged_places", note=said.getvalue().strip()[:200]), warning(text)]
    lost_ms = sum(dropout.duration for dropout in ulog.dropouts)
    if ulog.dropouts:
        note = f"the autopilot could not write as fast as it measured, {occasions(len(ulog.dropouts))}"
        log.learnt.append(Metric("dropouts", lost_ms * 1e-3, "s", note=note))
    return {(data.name, data.multi_id): data for data in ulog.data_list if "timestamp" in data.data}


def _utc(found: Mapping[tuple[str, int], Data], log: Log) -> int | None:
    """UTC minus the time since boot, ns."""
    for topic in _CLOCK:
        data = found.get((topic, 0))
        utc_us = _integers(data, "time_utc_usec")
        if data is None or utc_us is None:
            continue
        known = (utc_us > _PRESENT) & (utc_us < _LATEST) & (_times(data) >= 0)
        if known.any():
            offset = int(np.median(utc_us[known] - _times(data)[known] // 1000))
            note = f"by {int(known.sum())} rows of {topic}"
            log.learnt.append(Metric("utc_minus_boot", offset * 1e-6, "s", note=note))
            return offset * 1000
    return None


def _integers(data: Data, name: str) -> Any:
    """A field of whole numbers as (n,) int64, None where it is not there."""
    return None if data is None or name not in data.data else data.data[name].astype(np.int64)


def _numbers(data: Data, name: str) -> Array:
    """A field as (n,) float64, NaN where it is not there."""
    if name not in data.data:
        return np.full(len(data.data["timestamp"]), np.nan)
    return np.asarray(data.data[name], dtype=np.float64)


def _times(data: Data, relative: str = "") -> Times:
    """(n,) ns since boot, below 0 where that cannot be; `relative` : field of a sensor's time after the row's, us."""
    offset = _integers(data, relative) if relative else None
    later = 0 if offset is None else np.where(offset == _NEVER, 0, offset)
    t_us = _integers(data, "timestamp")
    return np.asarray((np.where((t_us >= 0) & (t_us < LONGEST_NS // 1000), t_us, -1) + later) * 1000)


def _vector(data: Data, group: str, name: str, factor: float = 1.0) -> dict[str, Array]:
    """Three fields name[0], name[1], name[2], or where the name is empty x, y, z."""
    fields = [f"{name}[{n}]" for n in range(3)] if name else list("xyz")
    return {f"{group}_{axis}": _numbers(data, field) * factor for axis, field in zip("xyz", fields, strict=True)}


def _imu(found: Mapping[tuple[str, int], Data], log: Log) -> None:
    data = found.get(("sensor_combined", 0))
    if data is not None:
        columns = {**_vector(data, "accel", "accelerometer_m_s2"), **_vector(data, "gyro", "gyro_rad")}
        absent = _integers(data, "accelerometer_timestamp_relative")
        if absent is not None:
            for axis in "xyz":
                columns[f"accel_{axis}"][absent == _NEVER] = np.nan
        log.add_frd("imu", data.name, _times(data), columns)
        return
    for number in range(4):
        parts: dict[str, tuple[Times, Array]] = {}
        for group, topic in (("accel", "sensor_accel"), ("gyro", "sensor_gyro")):
            data = found.get((topic, number))
            if data is not None:
                t_ns, rows = np.unique(_times(data), return_index=True)
                parts |= {name: (t_ns, values[rows]) for name, values in _vector(data, group, "").items()}
        if parts:
            log.add_frd("imu", f"sensor_accel, sensor_gyro {number}", *interleave(parts))


def _gnss(found: Mapping[tuple[str, int], Data], log: Log) -> None:
    topic = next((topic for topic in _CLOCK if (topic, 0) in found), "")
    for (name, number), data in sorted(found.items()):
        if name == topic:
            columns = _fix(data)
            log.add("gnss", f"{name} {number}", _times(data), columns, **GNSS_FACTS)


def _fix(data: Data) -> dict[str, Array]:
    fix = _numbers(data, "fix_type")
    if "latitude_deg" in data.data:
        place = {name: _numbers(data, field) for name, field in zip(_PLACE, _PLACE_NOW, strict=True)}
    else:
        scales = zip(_PLACE, ("lat", "lon", "alt"), (1e7, 1e7, 1e3), strict=True)
        place = {name: _numbers(data, field) / scale for name, field, scale in scales}
    moving = np.where(_numbers(data, "vel_ned_valid") == 0.0, np.nan, 1.0)
    eph, epv, speed_std = (positive(_numbers(data, name)) for name in ("eph", "epv", "s_variance_m_s"))
    columns = {
        **place,
        "speed": _numbers(data, "vel_m_s"),
        "course": np.mod(angle(_numbers(data, "cog_rad")), 2.0 * np.pi),
        "vel_e": _numbers(data, "vel_e_m_s") * moving,
        "vel_n": _numbers(data, "vel_n_m_s") * moving,
        "vel_u": -_numbers(data, "vel_d_m_s") * moving,
        "pos_std_e": eph,
        "pos_std_n": eph,
        "pos_std_u": epv,
        **dict.fromkeys(("vel_std_e", "vel_std_n", "vel_std_u"), speed_std),
    }
    lost = fix < 2.0
    known = {name: np.where(lost, np.nan, values) for name, values in columns.items()}
    fixed = np.clip(np.where(lost, 0.0, fix), 0.0, 3.0)
    return {**known, "fix": fixed, "satellites": _numbers(data, "satellites_used")}


_PLACE: Final = ("lat", "lon", "height")
_PLACE_NOW: Final = ("latitude_deg", "longitude_deg", "altitude_msl_m")


def _mag(found: Mapping[tuple[str, int], Data], log: Log) -> None:
    for topic, name in (("vehicle_magnetometer", "magnetometer_ga"), ("sensor_combined", "magnetometer_ga")):
        data = found.get((topic, 0))
        if data is None or f"{name}[0]" not in data.data:
            continue
        t_ns, rows = _fresh(data, "magnetometer_timestamp_relative")
        log.add_frd("mag", topic, t_ns, {key: v[rows] for key, v in _vector(data, "mag", name, GAUSS).items()})
        return
    for number in range(4):
        data = found.get(("sensor_mag", number))
        if data is not None:
            log.add_frd("mag", f"sensor_mag {number}", _times(data), _vector(data, "mag", "", GAUSS))


def _fresh(data: Data, relative: str) -> tuple[Times, NDArray[np.intp]]:
    """Times of a sensor and the rows that bring them: those between repeat it."""
    t_ns, offset = _times(data, relative), _integers(data, relative)
    rows = np.arange(len(t_ns)) if offset is None else np.flatnonzero(offset != _NEVER)
    times, first = np.unique(t_ns[rows], return_index=True)
    return times, rows[first]


def _baro(found: Mapping[tuple[str, int], Data], log: Log) -> None:
    for topic, name in (("vehicle_air_data", "baro_pressure_pa"), ("sensor_baro", "pressure")):
        data = found.get((topic, 0))
        if data is None or name not in data.data:
            continue
        pressure = _numbers(data, name)
        if np.nanmedian(pressure) < _MILLIBAR:
            pressure = pressure * 100.0
            log.learnt.append(Metric("assumed_unit", method="baro", note=f"{topic}.{name} is below 2000: millibar"))
        celsius = "baro_temp_celcius" if topic == "vehicle_air_data" else "temperature"
        log.add("baro", topic, _times(data), {"pressure": pressure, "temperature": _numbers(data, celsius) + 273.15})
        return


def _reference(found: Mapping[tuple[str, int], Data], log: Log) -> None:
    """The truth of a simulator where it was logged, else the on-board estimate."""
    end = _TRUTH if (f"vehicle_local_position{_TRUTH}", 0) in found else ""
    moved, anchor = None, None
    data = found.get((f"vehicle_local_position{end}", 0))
    if data is not None:
        usable = (_numbers(data, "xy_valid") != 0.0) & (_numbers(data, "z_valid") != 0.0)
        places = np.column_stack([_numbers(data, name) for name in ("ref_lat", "ref_lon", "ref_alt")])
        placed = usable & (np.isfinite(places) & (places != 0.0)).all(axis=1) & (np.abs(places[:, 0]) < 90.0)
        if placed.any():
            anchor = Anchor(*places[placed][-1].tolist())
            own = (places == places[placed][-1]).all(axis=1)
            if (usable & ~own).any():
                note = f"{data.name}: positions about an origin before the last one, of {len(own)}"
                log.learnt.append(Metric("rows_left_out", float(np.count_nonzero(usable & ~own)), note=note))
            usable &= own
        pos, vel = (np.column_stack([_numbers(data, name) for name in names]) for names in ("xyz", ("vx", "vy", "vz")))
        if usable.any():
            moved = _times(data)[usable], pos[usable], vel[usable]
    data = found.get((f"vehicle_attitude{end}", 0))
    if moved is None:
        return  # attitudes alone are compared with nothing
    turned = None
    if data is not None:
        turned = _times(data), attitude(np.column_stack([_numbers(data, f"q[{n}]") for n in range(4)]))
    t_ns, columns, facts = pose(moved, turned, anchor)
    log.add("reference", "truth of the simulator" if end else "on-board estimate of PX4", t_ns, columns, **facts)


_MAKERS: Final = {"imu": _imu, "gnss": _gnss, "mag": _mag, "baro": _baro, "reference": _reference}


def sniff(path: Path, head: bytes) -> Sniff:
    """The magic number of ULog."""
    return Sniff(0.95, "ULog file") if head.startswith(MAGIC) else Sniff(0.0, "no ULog file")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of logs of PX4."""
    yield Reader(
        name="ulog",
        summary="Logs of PX4: IMU, GNSS, magnetometer, barometer, on-board estimate.",
        run=read,
        sniff=sniff,
        selective=True,
        writes=WRITES,
        references=("PX4 user guide, ULog file format; PX4-Autopilot, msg",),
    )
