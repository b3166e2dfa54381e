"""Logs of NovAtel receivers, ASCII (BESTPOSA and so on) and binary, also inside a capture of packets.

    gnss       BESTPOS and BESTVEL, else BESTGNSSPOS and BESTGNSSVEL, where the solution is computed
    reference  INSPVAX, else INSPVA, INSPVAS: the receiver's solution of GNSS and IMU, where INS is aligned
    imu        CORRIMUDATA, CORRIMUDATAS: increments, divided by their step and given at its middle

Times of the headers are GPS time. Heights of BESTPOS and INSPVAX are above mean sea level and come with the undulation:
they are given above the ellipsoid. A velocity is older than its log by its latency, which is taken off. Roll, pitch and
azimuth are right side down, nose up, clockwise from north. CORRIMUDATA is in the axes of the vehicle (right, forward,
up; given as forward, left, up), without gravity, Earth's rotation and estimated biases: its accelerations are no
specific forces. RAWIMU counts in units of each IMU and is not read.

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
from recon.numerics.gnss_time import NS, gps_to_utc
from recon.numerics.rotation import from_euler, yaw_from_heading
from recon.parameters import NoParams
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU, REFERENCE, Change
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._arrays import interleave
from recon_readers._novatel_logs import LOGS, Found, find_logs, read_logs
from recon_readers._streams import Source, reference_groups, stream
from recon_readers._time_order import Times, in_order, repeating

ALIGNED: Final = (2.0, 3.0, 6.0, 7.0)
"""Statuses of INS with a solution: high variance, good, free, alignment complete."""
LONGEST_STEP_S: Final = 0.2
"""Between logs of an IMU; behind a longer one an increment has no rate."""
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
            "let the receiver log BESTPOS and BESTVEL, or INSPVAX; RANGE needs a program that computes positions first"
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
    pos_ns, pos = found.rows("BESTPOS", "BESTGNSSPOS")
    vel_ns, vel = found.rows("BESTVEL", "BESTGNSSVEL")
    if not len(pos) and not len(vel):
        return None, []
    parts: dict[str, tuple[Times, Array]] = {}
    if len(pos):
        status, lat, lon, msl, undulation, sn, se, su, satellites = pos.T
        columns = np.column_stack([lat, lon, msl + undulation, se, sn, su, satellites])
        parts["place"] = _rising(gps_to_utc(pos_ns), columns, status == 0.0)
    if len(vel):
        status, latency, speed, course_deg, _ = vel.T
        delay_us = np.round(np.where(np.abs(latency) < 10.0, latency, 0.0) * 1e6)  # a float of 24 bits
        times = gps_to_utc(vel_ns) - delay_us.astype(np.int64) * 1000
        parts["motion"] = _rising(times, np.column_stack([speed, np.radians(course_deg)]), status == 0.0)
    t_ns, spread = interleave(parts)
    groups: dict[str, Array] = {}
    if "place" in spread:
        groups.update(zip(("lat", "lon", "height"), spread["place"][:, :3].T, strict=True))
        groups |= {"pos_std": spread["place"][:, 3:6], "satellites": spread["place"][:, 6]}
    if "motion" in spread:
        groups |= {"speed": spread["motion"][:, 0], "course": spread["motion"][:, 1]}
    made, learnt = stream(Source(path, "gnss"), GNSS, t_ns, np.zeros(len(t_ns), dtype=bool), groups)
    facts: dict[str, Any] = {"height_datum": "ellipsoid", "heading_kind": "course_true"}
    return (None if made is None else with_meta(made, **facts)), learnt


def _rising(t_ns: Times, values: Array, valid: Array) -> tuple[Times, Array]:
    """Rows with a solution, at times that rise."""
    usable = in_order(t_ns, ~valid.astype(bool))
    usable &= ~repeating(t_ns, [usable])
    return t_ns[usable], values[usable]


def _reference(path: Path, found: Found) -> _Made:
    gps_ns, rows = found.rows("INSPVAX")
    if len(rows):
        status, place, undulation, vel_neu, angles = np.split(rows, (1, 4, 5, 8), axis=1)
        place = place + undulation * (0.0, 0.0, 1.0)
    else:
        gps_ns, rows = found.rows("INSPVA", "INSPVAS")
        place, vel_neu, angles, status = np.split(rows, (3, 6, 9), axis=1)
    if not len(rows):
        return None, []
    with np.errstate(invalid="ignore"):
        roll, pitch, azimuth = np.radians(np.where(np.abs(angles) < 1e4, angles, np.nan)).T
    q = from_euler(yaw_from_heading(azimuth), -pitch, roll)
    groups, facts = reference_groups(place, vel_neu[:, (1, 0, 2)], q)
    if not groups:
        return None, []
    made, learnt = stream(
        Source(path, "reference"), REFERENCE, gps_to_utc(gps_ns), ~np.isin(status[:, 0], ALIGNED), groups
    )
    return (None if made is None else with_meta(made, **facts)), learnt


def _imu(path: Path, found: Found) -> _Made:
    """Mean rates over the steps of CORRIMUDATA, at their middle; the first log has none and is left out."""
    gps_ns, rows = found.rows("CORRIMUDATA", "CORRIMUDATAS")
    if len(rows) < 2:
        return None, []
    t_ns, rows = _rising(gps_to_utc(gps_ns), rows, np.ones(len(rows)))
    step_ns = np.diff(t_ns)
    good = step_ns <= LONGEST_STEP_S * NS
    rate = rows[1:][good] / (step_ns[good] * 1e-9)[:, None]
    groups = {name: rate[:, at : at + 3][:, (1, 0, 2)] * (1.0, -1.0, 1.0) for name, at in (("gyro", 0), ("accel", 3))}
    times = t_ns[1:][good] - step_ns[good] // 2
    made, learnt = stream(Source(path, "imu"), _IMU, times, np.zeros(len(times), dtype=bool), groups)
    note = "imu: CORRIMUDATA, right, forward, up of the vehicle, given as forward, left, up; without gravity and biases"
    return made, [Metric("axes", note=note), *learnt]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of NovAtel's logs."""
    yield Reader(
        name="novatel",
        summary="NovAtel logs, ASCII and binary: BESTPOS, BESTVEL, INSPVAX, CORRIMUDATA.",
        run=read,
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "pos_std", "satellites").possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
            "imu": _IMU.possible(),
        },
        references=("NovAtel, OEM7 Commands and Logs Reference Manual",),
    )
