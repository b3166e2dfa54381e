"""Logs in the formats of the physycom group: acc, gyro, inertial, fullinertial, and GNSS records as JSON.

    acc          timestamp ax ay az                                                       4 columns
    gyro         timestamp gx gy gz                                                       4 columns
    inertial     timestamp speed ax ay az gx gy gz |a| timestamp_rel                      10 columns
    fullinertial timestamp lat lon alt heading speed ax ay az gx gy gz |a| timestamp_rel  14 columns
    GNSS         JSON records with timestamp lat lon speed, perhaps alt heading fix

Timestamps are seconds since 2000-01-01 UTC+1 without leap seconds, accelerations in g (a still z axis that points up
reads +1), rates in deg/s, speed in km/h, angles in deg. A format is known by its contents: number of columns, header
words where there are any. Header or none, tabs or spaces, interpolated, repeated or blank values are all taken.

The document contradicts itself or practice in places; each choice is a parameter and becomes a row of `metrics`:
speed is in km/h, not m/s (integrated accelerations agree); heading is the course of the receiver, from true north;
g is standard gravity. |a| and timestamp_rel are not kept, but must agree with what they are made of.

Reference: physycom, file_format_specifications, formati_file.md, revision 7 (2016-10-13).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.parameters import Params, quantity, setting
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU
from recon.stages import Reader
from recon.tables import Streams, build, with_meta
from recon.units import convert
from recon_readers._columns import at_rows, kept
from recon_readers._fresh_rows import GnssRows, gnss_rows, imu_rows, see
from recon_readers._physycom_layouts import ACCEL, EARLIEST_S, GYRO, PLACE, sniff
from recon_readers._physycom_log import Log, account, doubts, missing_values, open_log
from recon_readers._time_order import Mask, Times, slots

NS: Final = 1_000_000_000
EPOCH_2000_NS: Final = 946_684_800 * NS
"""2000-01-01T00:00:00Z in ns since 1970."""
STANDING: Final = 1.0 / 3.6
"""m/s; receivers at rest report up to this."""
_AXES: Final = {"accel": ACCEL, "gyro": GYRO}
_COLUMNS: Final = {**_AXES, "gnss": PLACE}


class PhysycomParams(Params):
    """What the files do not tell."""

    sensor: Literal["accelerometer", "gyroscope"] | None = setting(
        None, doc="What a file of four columns holds if its header does not tell."
    )
    speed_unit: Literal["km/h", "m/s"] = setting("km/h", doc="Unit of the speed.")
    heading: Literal["true", "magnetic"] = setting("true", doc="North from which the heading counts.")
    height_datum: Literal["mean_sea_level", "ellipsoid"] = setting(
        "mean_sea_level", doc="Surface above which the altitude counts."
    )
    gravity: float = quantity(STANDARD_GRAVITY, "m/s^2", gt=0, doc="Acceleration that the file writes as 1.")
    clock_offset: float = quantity(1.0, "h", ge=-14, le=14, doc="Clock of the box minus UTC.")


def read(path: Path, params: PhysycomParams) -> Streams:
    """The streams imu and gnss, whichever the file holds, at the rates at which the sensors reported.

    Raises ReadFailed, and DataError where a parameter must tell what the file does not.
    """
    log, left_out = open_log(path, params.sensor, _units(params))
    fresh, fill = _fresh_rows(log, params)
    usable, counts = account(log, fresh)
    kept = {name: np.asarray(mask & usable) for name, mask in fresh.items()}
    if not any(mask.any() for mask in kept.values()):
        raise ReadFailed(path, "no row holds a measurement", hint="check that the log was copied completely")
    learnt = [
        Metric("format", note=f"physycom {log.format}: {log.about}"),
        *counts,
        *left_out,
        *missing_values(log, {name: (mask, _COLUMNS[name]) for name, mask in kept.items()}),
        *fill,
        *_assumptions(log, params),
        *doubts(log, params.gravity),
    ]
    for name in ("abs", "relative"):  # only the doubts wanted them
        log.columns.pop(name, None)
    gnss = _gnss(log, kept, params)
    return {**_imu(log, kept, params), **gnss, "metrics": metrics(learnt)}


def lines(path: Path, params: PhysycomParams, stream: str, t_ns: Times) -> Times:
    """Lines that hold the rows of these times, 0 where none does: (n,). Of several of one time, the first."""
    log, _ = open_log(path, params.sensor, _units(params))
    timed = np.flatnonzero(~log.untimed)
    own = _utc_ns(log.time_ns[timed], params)
    at = np.searchsorted(own, t_ns).clip(max=len(own) - 1)
    places = [log.place(int(row), "time") for row in timed[at]]
    found = np.array([place[0] if place else 0 for place in places], dtype=np.int64)
    return np.asarray(np.where(own[at] == t_ns, found, 0))


def _units(params: PhysycomParams) -> dict[str, float]:
    """Units of the file as the parameters tell them, in those in which its format is defined."""
    return {
        "speed": convert(1.0, params.speed_unit, "km/h"),
        **dict.fromkeys(ACCEL, params.gravity / STANDARD_GRAVITY),
    }


def _fresh_rows(log: Log, params: PhysycomParams) -> tuple[dict[str, Mask], list[Metric]]:
    """By sensor (accel, gyro, gnss) the rows that it reported, (n,) bool; and how the other rows were filled."""
    sensors = {name: see(log.group(axes)) for name, axes in _AXES.items() if log.group(axes)}
    gnss = see(log.group(PLACE)) if log.group(PLACE) else None
    if gnss and not sensors:
        return {"gnss": gnss.known}, []
    fresh, how = imu_rows(sensors, gnss)
    learnt = [Metric("imu_fill", note=how)]
    if gnss:
        standing = convert(log.columns["speed"], params.speed_unit, "m/s") < STANDING
        found = gnss_rows(log.time_ns, gnss, standing)
        learnt += _about_gnss(found)
        fresh["gnss"] = found.fresh
    return fresh, learnt


def _about_gnss(found: GnssRows) -> list[Metric]:
    how = "repeated between reports" if found.held else "not repeated: every row that holds values is kept"
    count = f"{int(found.fresh.sum())} of {len(found.fresh)} rows"
    learnt = [Metric("gnss_fill", note=f"{how}; {count} are GNSS rows")]
    if found.period_ns is not None:
        learnt.append(Metric("gnss_period", found.period_ns / NS, "s", method="median time between reports"))
    elif found.held:
        learnt.append(warning(f"position and speed change too seldom to tell the rate of GNSS: {count} are kept"))
    return learnt


def _assumptions(log: Log, params: PhysycomParams) -> list[Metric]:
    """What was taken for granted."""
    found = [
        Metric("assumed_clock_offset", params.clock_offset, "s", note="clock of the box minus UTC, no leap second")
    ]
    if "ax" in log.columns:
        found.append(Metric("assumed_gravity", params.gravity, "m/s^2", note="acceleration that the file writes as 1"))
    if "speed" in log.columns:
        one = convert(1.0, params.speed_unit, "m/s")
        found.append(
            Metric(
                "assumed_speed_unit", one, "m/s", note=f"speed that the file writes as 1: it is in {params.speed_unit}"
            )
        )
    if "heading" in log.columns:
        found.append(Metric("assumed_heading", note=f"course over ground from {params.heading} north"))
    if "height" in log.columns:
        found.append(Metric("assumed_height_datum", note=params.height_datum))
    return found


def _imu(log: Log, fresh: Mapping[str, Mask], params: PhysycomParams) -> Streams:
    """The stream imu. Rows of one time that update different sensors become one; null where a sensor said nothing.

    Takes the columns out of the log, so that they and those of the stream are not there at once.
    """
    masks = {name: fresh[name] for name in _AXES if name in fresh}
    if not any(mask.any() for mask in masks.values()):
        return {}
    rows = np.logical_or.reduce(list(masks.values()))
    t_ns = log.time_ns[rows]
    begins, slot = slots(t_ns)
    time_ns = _utc_ns(t_ns[begins], params)
    columns = {}
    for name, mask in masks.items():
        at = slot[mask[rows]]
        for axis, column in zip("xyz", _AXES[name], strict=True):
            values = kept(log.columns.pop(column), mask)
            values = values * params.gravity if name == "accel" else convert(values, "deg/s", "rad/s")
            columns[f"{name}_{axis}"] = at_rows(values, at, len(time_ns))
    imu = build(IMU.only(*masks), time=time_ns, **columns)
    return {"imu": with_meta(imu, **_clock(log))}


def _gnss(log: Log, fresh: Mapping[str, Mask], params: PhysycomParams) -> Streams:
    """The stream gnss with the columns that the file has. A position of exactly 0, 0 is no fix and becomes null."""
    if "gnss" not in fresh or not fresh["gnss"].any():
        return {}
    raw = {name: log.columns[name][fresh["gnss"]] for name in (*PLACE, "fix") if name in log.columns}
    columns: dict[str, Any] = {"speed": convert(raw["speed"], params.speed_unit, "m/s")}
    facts: dict[str, str] = {}
    if "lat" in raw:
        no_fix = (raw["lat"] == 0.0) & (raw["lon"] == 0.0)
        columns |= {name: np.where(no_fix, np.nan, raw[name]) for name in ("lat", "lon", "height") if name in raw}
    if "height" in raw:
        facts["height_datum"] = params.height_datum
    if "heading" in raw:
        columns["course"] = np.mod(convert(raw["heading"], "deg", "rad"), 2.0 * np.pi)
        facts["heading_kind"] = "course_true" if params.heading == "true" else "magnetic"
    if "fix" in raw:
        columns["fix"] = pa.array(raw["fix"], from_pandas=True).cast(pa.int32(), safe=False)
    gnss = build(GNSS.only(*columns), time=_utc_ns(log.time_ns[fresh["gnss"]], params), **columns)
    return {"gnss": with_meta(gnss, **_clock(log), **facts)}


def _utc_ns(time_ns: Any, params: PhysycomParams) -> Any:
    return time_ns + (EPOCH_2000_NS - round(params.clock_offset * NS))


def _clock(log: Log) -> dict[str, str | None]:
    clock, scale = ("absolute", "UTC") if log.first_ns >= EARLIEST_S * NS else ("relative", None)
    return {"time_scale": scale, "clock": clock, "format": f"physycom {log.format}"}


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of the formats of the physycom group."""
    yield Reader(
        name="physycom",
        summary="Logs of the physycom group: acc, gyro, inertial, fullinertial and GNSS JSON.",
        params=PhysycomParams,
        run=read,
        sniff=sniff,
        lines=lines,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "fix").possible(),
        },
        references=("physycom, file_format_specifications, formati_file.md, revision 7 (2016-10-13)",),
    )
