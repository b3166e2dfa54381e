"""Logs of NovAtel receivers, ASCII (BESTPOSA and so on) and binary, also inside a capture of packets.

    gnss       BESTPOS and BESTVEL, else BESTGNSSPOS and BESTGNSSVEL, where the solution is computed
    reference  INSPVAX, else INSPVA, INSPVAS: the receiver's solution of GNSS and IMU, where INS is aligned
    imu        IMURATECORRIMUS, else CORRIMUS, CORRIMUDATA, CORRIMUDATAS: increments, as rates at the middle of the time
               that they were gathered in

Times of the headers are GPS time. Heights of BESTPOS and INSPVAX are above mean sea level and come with the
undulation: they are given above the ellipsoid. A velocity is older than its log by its latency, which is taken off.
Roll, pitch and azimuth are right side down, nose up, clockwise from north. The corrected increments are in the axes of
the vehicle (right, forward, up; given as forward, left, up), in rad and m/s, without gravity, Earth's rotation and
estimated biases, so that they tell accelerations and no specific forces. They are gathered over the interval between
two logs, also where a log before is lost; CORRIMUS says over how many samples of the IMU. RAWIMU, RAWIMUX and their
short forms count in units of each IMU and are not read.

Reference: NovAtel, OEM7 Commands and Logs Reference Manual; SPAN logs.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc
from recon.numerics.rotation import yaw_from_heading
from recon.parameters import NoParams
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU, REFERENCE, Change
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._arrays import interleave
from recon_readers._columns import Columns, kept
from recon_readers._novatel_logs import LOGS, RAW, Found, find_logs, read_logs
from recon_readers._reference import reference_columns
from recon_readers._streams import Source, stream
from recon_readers._time_order import Mask, Times, in_order, repeating

ALIGNED: Final = (2.0, 3.0, 6.0, 7.0)
"""Statuses of INS with a solution: high variance, good, free, alignment complete."""
LONGEST_STEP_S: Final = 0.2
"""That increments of an IMU are gathered in: over a longer one they tell no rate."""
_LOST: Final = 1.5
"""Usual steps from which on a log between two is lost."""
_CORRECTED: Final = ("IMURATECORRIMUS", "CORRIMUS", "CORRIMUDATA", "CORRIMUDATAS")
"""Logs of corrected increments; the first one that is there is read."""
_IMU: Final = Change(frames={"accel": "vehicle", "gyro": "vehicle"}, quantities={"accel": "acceleration"}).apply(
    IMU.only("accel", "gyro")
)

_Made: TypeAlias = tuple[pa.Table | None, list[Metric]]


def read(path: Path, params: NoParams) -> Streams:
    """The streams gnss, reference and imu, whichever the file holds. Raises ReadFailed where it holds none of them."""
    found = read_logs(path)
    made = {"gnss": _gnss(path, found), "reference": _reference(path, found), "imu": _imu(path, found)}
    streams = {name: table for name, (table, _) in made.items() if table is not None}
    if not streams:
        hint = (
            "let the receiver log BESTPOS and BESTVEL, or INSPVAX and CORRIMUS; RANGE needs a program that computes "
            "positions first"
        )
        raise ReadFailed(path, f"none of its logs holds a solution: {_about(found)}", line=1, hint=hint)
    learnt = [Metric("logs", float(found.counts.total()), note=_about(found))]
    if found.damaged:
        learnt.append(Metric("damaged_logs", float(found.damaged), note="wrong checksum or cut off: left out"))
        learnt.append(warning(f"left out of {path.name}: {found.damaged} logs with a wrong checksum or cut off"))
    learnt += [row for _, rows in made.values() for row in rows]
    facts = {"format": "NovAtel", "clock": "absolute", "time_scale": "UTC"}
    return {**{name: with_meta(table, **facts) for name, table in streams.items()}, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """Logs with right checksums."""
    counts = find_logs(head).counts
    if not counts:
        return Sniff(0.0, "no log of NovAtel")
    known = counts.keys() & LOGS.keys()
    return Sniff(0.95 if known else 0.55, f"{counts.total()} logs of NovAtel")


def _about(found: Found) -> str:
    return ", ".join(f"{count} {name}" for name, count in found.counts.most_common(8)) or "no whole log"


def _gnss(path: Path, found: Found) -> _Made:
    """Positions and velocities at their own times, as one stream."""
    pos, vel = found.columns("BESTPOS", "BESTGNSSPOS"), found.columns("BESTVEL", "BESTGNSSVEL")
    parts: dict[str, tuple[Times, Array]] = {}
    if pos:
        pos["height"] = pos["height"] + pos.pop("undulation")
        parts |= _rising(gps_to_utc(pos.pop("time")), pos, pos.pop("status") == 0.0)
    if vel:
        del vel["vertical_speed"]
        latency = vel.pop("latency")
        delay_us = np.round(np.where(np.abs(latency) < 10.0, latency, 0.0) * 1e6)  # a float of 24 bits
        vel["course"] = np.radians(vel["course"])
        times = gps_to_utc(vel.pop("time")) - delay_us.astype(np.int64) * 1000
        parts |= _rising(times, vel, vel.pop("status") == 0.0)
    if not parts:
        return None, []
    t_ns, columns = interleave(parts)
    made, learnt = stream(Source(path, "gnss"), GNSS, t_ns, np.zeros(len(t_ns), dtype=bool), columns)
    facts: dict[str, Any] = {"height_datum": "ellipsoid", "heading_kind": "course_true"}
    return (None if made is None else with_meta(made, **facts)), learnt


def _rising(t_ns: Times, columns: Columns, valid: Mask) -> dict[str, tuple[Times, Array]]:
    """The columns, which are emptied, in rows with a solution, at times that rise."""
    usable = in_order(t_ns, ~valid)
    usable &= ~repeating(t_ns, [usable])
    times = kept(t_ns, usable)
    return {name: (times, kept(columns.pop(name), usable)) for name in list(columns)}


def _reference(path: Path, found: Found) -> _Made:
    rows = found.columns("INSPVAX", "INSPVA", "INSPVAS")
    if not rows:
        return None, []
    if "undulation" in rows:
        rows["height"] = rows["height"] + rows.pop("undulation")
    t_ns, status = gps_to_utc(rows.pop("time")), rows.pop("status")
    with np.errstate(invalid="ignore"):
        angles = [np.radians(np.where(np.abs(a) < 1e4, a, np.nan)) for a in _popped(rows, "azimuth", "pitch", "roll")]
    yaw_pitch_roll = (yaw_from_heading(angles[0]), -angles[1], angles[2])
    place, vel_n = _popped(rows, "lat", "lon", "height"), _popped(rows, "vel_e", "vel_n", "vel_u")
    columns, facts = reference_columns(place, vel_n, yaw_pitch_roll)
    if not columns:
        return None, []
    made, learnt = stream(Source(path, "reference"), REFERENCE, t_ns, ~np.isin(status, ALIGNED), columns)
    return (None if made is None else with_meta(made, **facts)), learnt


def _popped(columns: Columns, *names: str) -> list[Array]:
    return [columns.pop(name) for name in names]


def _imu(path: Path, found: Found) -> _Made:
    """Mean rates in the time that corrected increments were gathered in, at its middle."""
    name = next((name for name in _CORRECTED if name in found.logs), "")
    raw = [log for log in RAW if found.counts[log]]
    if raw and not name:
        what = f"{raw[0]} counts in units of its IMU: no imu is read of it"
        return None, [warning(f"{path.name}: {what}; log CORRIMUS or IMURATECORRIMUS beside it")]
    rows = found.columns(name) if name else Columns({})
    if not rows or len(rows["time"]) < 2:
        return None, []
    gps_ns = rows.pop("time")
    t_ns = gps_to_utc(gps_ns + _finer(gps_ns, rows.pop("seconds")) if "seconds" in rows else gps_ns)
    parts = _rising(t_ns, rows, np.ones(len(t_ns), dtype=bool))
    t_ns = next(iter(parts.values()))[0]
    span_ns = _gathered(t_ns, parts.pop("samples")[1] if "samples" in parts else None)
    good = (span_ns > 0) & (span_ns <= LONGEST_STEP_S * NS)
    columns = {
        column: parts.pop(logged)[1][good] / (span_ns[good] * (sign * 1e-9))
        for column, (logged, sign) in _INCREMENTS.items()
    }
    times = t_ns[good] - span_ns[good] // 2
    made, learnt = stream(Source(path, "imu"), _IMU, times, np.zeros(len(times), dtype=bool), columns)
    note = f"imu: {name}, right, forward, up of the vehicle, given as forward, left, up; without gravity and biases"
    others = [log for log in (*_CORRECTED, *raw) if found.counts[log] and log != name]
    note += f"; {', '.join(others)} not read" if others else ""
    return None if made is None else with_meta(made, axes="RFU"), [Metric("axes", note=note), *learnt]


def _finer(gps_ns: Times, seconds: Array) -> Times:
    """What is added to times of headers, whole milliseconds, to be those that the logs hold: (n,) int64 ns.

    seconds : (n,) of the week, as the logs hold them; one that is not the header's is not believed
    """
    of_week_s = (gps_ns - GPS_EPOCH_NS) % WEEK_NS * 1e-9
    with np.errstate(invalid="ignore"):
        apart = seconds - of_week_s
        return np.round(np.where(np.abs(apart) < 1.5e-3, apart, 0.0) * 1e9).astype(np.int64)


def _gathered(t_ns: Times, samples: Array | None) -> Times:
    """How long the increments of each log were gathered: (n,) int64 ns, 0 where that is not known.

    samples : (n,) of the IMU that each log holds, where it tells; else it holds what came since the log before, or in
        the usual step where that one is lost
    """
    step_ns = np.diff(t_ns)
    told = samples[1:] > 0 if samples is not None else np.ones(len(step_ns), dtype=bool)
    if not told.any():
        return np.zeros(len(t_ns), dtype=np.int64)
    if samples is not None:
        return np.round(samples * np.median(step_ns[told] / samples[1:][told])).astype(np.int64)
    usual_ns = int(np.median(step_ns))
    return np.concatenate([[usual_ns], np.where(step_ns > _LOST * usual_ns, usual_ns, step_ns)])


_INCREMENTS: Final = {
    "accel_x": ("longitudinal", 1.0),
    "accel_y": ("lateral", -1.0),
    "accel_z": ("vertical", 1.0),
    "gyro_x": ("roll_rate", 1.0),
    "gyro_y": ("pitch_rate", -1.0),
    "gyro_z": ("yaw_rate", 1.0),
}
"""Corrected increments about and along right, forward, up by columns along forward, left, up; and their sense."""


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of NovAtel's logs."""
    yield Reader(
        name="novatel",
        summary="NovAtel logs, ASCII and binary: BESTPOS, BESTVEL, INSPVAX, CORRIMUS.",
        run=read,
        sniff=sniff,
        version=3,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "pos_std", "satellites").possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
            "imu": _IMU.possible(),
        },
        references=("NovAtel, OEM7 Commands and Logs Reference Manual",),
    )
