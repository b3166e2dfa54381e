"""SBET, "smoothed best estimate of trajectory": the solution of POSPac and of others, as `reference`.

A file without a head, of records of 17 doubles, little-endian:

     1     time             s of the GPS week; counts on where the next week begins
     2, 3  latitude, longitude                rad;   4  altitude above the ellipsoid, m
     5..7  velocity         m/s, along the axes of the wander frame, up
     8..10 roll, pitch, heading of the platform               rad; right side down, nose up, clockwise are positive
    11     wander angle     rad
    12..14 acceleration     m/s^2, 15..17 angular rate rad/s, body axes: not read

The wander frame is turned from north by the wander angle; in which sense, and whether x or y is its axis to the north,
programs see differently. Let a be the azimuth of its axis to the north, plus or minus the wander angle, and v', u' the
velocities along that axis and to the right of it. Then

    true heading = heading + a,    v_n = v' cos a - u' sin a,    v_e = v' sin a + u' cos a,

and of the four possibilities that one is taken whose velocities lead from position to position; where the vehicle does
not move, x is to the east and a is minus the wander angle. The file names no week: `week` does, without it times count
from the beginning of the week. The times of some programs are in UTC: `time_scale`.

Reference: Applanix, POSPac MMS User Guide, "SBET format"; readers.sbet of PDAL (pdal.io).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import WGS84
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc
from recon.numerics.rotation import yaw_from_heading
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import REFERENCE
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._columns import Columns
from recon_readers._lines import COPIED
from recon_readers._reference import reference_columns
from recon_readers._streams import Source, stream
from recon_readers._time_order import Mask, Times

RECORD: Final = 136
DOUBLES: Final = 17
LOOK_AT: Final = 50
LONGEST_S: Final = 4.0 * 604_800
LONGEST_STEP_S: Final = 2.0
AT_ONCE: Final = 1 << 16
"""Records that are read at a time."""
STRETCHES: Final = 64
_PLACE: Final = ("lat", "lon", "height")
_VELOCITY: Final = ("vel_e", "vel_n", "vel_u")
_ANGLES: Final = ("yaw", "pitch", "roll")
STANDING: Final = 0.5
"""m/s; below, velocities and positions do not tell the axes."""


class SbetParams(Params):
    """What the file does not tell."""

    week: int | None = setting(None, ge=0, le=10_000, doc="GPS week in which the file begins.")
    time_scale: Literal["GPS", "UTC"] = setting("GPS", doc="Scale of its times; POSPac writes either.")


def read(path: Path, params: SbetParams) -> Streams:
    """The stream reference. Raises ReadFailed."""
    size = path.stat().st_size
    count = size // RECORD
    sample = np.concatenate([np.zeros((0, DOUBLES)), *_some(path, count)])
    north_first, sense, frame = _wander_frame(np.where(_possible(sample)[:, None], sample, np.nan))
    rows = Columns.of((at / count, _columns(part, north_first, sense)) for at, part in _stretches(path, count))
    good = rows.pop("good", np.zeros(0, dtype=bool))
    if good.sum() <= 0.5 * count or not count:
        raise ReadFailed(path, f"only {int(good.sum())} of {count} records hold what SBET does", hint=COPIED)
    t_ns, facts, learnt = _times(rows.pop("time"), good, params)
    place, vel_n, angles = ([rows.pop(name) for name in names] for names in (_PLACE, _VELOCITY, _ANGLES))
    columns, anchored = reference_columns(place, vel_n, angles)
    table, told = stream(Source(path, "reference"), REFERENCE, t_ns, ~good, columns)
    if table is None:
        raise ReadFailed(path, "no record holds a place", hint=COPIED)
    counted = [Metric("rows_read", float(count)), *_damage(path, int((~good).sum()), size % RECORD)]
    facts |= {"format": "SBET", **anchored}
    return {"reference": with_meta(table, **facts), "metrics": metrics([*counted, *learnt, *frame, *told])}


def sniff(path: Path, head: bytes) -> Sniff:
    """Records whose numbers can be times, places and angles."""
    if len(head) < RECORD or path.is_dir():
        return Sniff(0.0, "no records of SBET")
    records = np.frombuffer(head[: len(head) // RECORD * RECORD], dtype="<f8").reshape(-1, DOUBLES)[:LOOK_AT]
    times = records[:, 0]
    with np.errstate(invalid="ignore"):
        rising = np.diff(times) > 0
    sure = _possible(records).mean() > 0.8 and (len(times) < 2 or rising.mean() > 0.8)
    return Sniff(0.8, "records of 17 doubles as of SBET") if sure else Sniff(0.0, "no records of SBET")


def _possible(records: Array) -> Mask:
    """Can the numbers of a record be those of SBET? (n,) bool"""
    time, lat, lon, height = records[:, :4].T
    angles = np.abs(records[:, 7:11]).max(axis=1, initial=0.0)
    with np.errstate(invalid="ignore"):
        good = (time >= 0.0) & (time < LONGEST_S) & (np.abs(lat) <= np.pi / 2) & (np.abs(lon) <= 2.0 * np.pi)
        good &= ((np.abs(lat) > 1e-9) | (np.abs(lon) > 1e-9)) & (np.abs(height) < 1e5) & (angles <= 4.0 * np.pi)
        good &= (np.abs(records[:, 4:7]) < 1e3).all(axis=1)
    return np.asarray(good)


def _stretches(path: Path, count: int) -> Iterator[tuple[int, Array]]:
    """All records, (k, 17), some at a time, with how many there were up to their end."""
    with path.open("rb") as file:
        for first in range(0, count, AT_ONCE):
            part = np.fromfile(file, dtype="<f8", count=min(AT_ONCE, count - first) * DOUBLES).reshape(-1, DOUBLES)
            yield first + len(part), part


def _some(path: Path, count: int) -> Iterator[Array]:
    """Stretches of records all over the file, or all of it: what tells the axes."""
    length = AT_ONCE // STRETCHES
    if count <= AT_ONCE:
        yield from (part for _, part in _stretches(path, count))
        return
    with path.open("rb") as file:
        for first in np.linspace(0, count - length, STRETCHES).astype(np.int64).tolist():
            file.seek(first * RECORD)
            yield np.fromfile(file, dtype="<f8", count=length * DOUBLES).reshape(-1, DOUBLES)


def _columns(records: Array, north_first: bool, sense: float) -> dict[str, NDArray[Any]]:
    """Time in ns, place, velocity and angles of some records, and which of them are good; NaN where they are not.

    A double holds s of a week to 0.1 ns.
    """
    good = _possible(records)
    time, lat, lon, height, x, y, up, roll, pitch, heading, wander = np.where(good[:, None], records, np.nan)[:, :11].T
    t_ns = np.round(np.where(good, time, 0.0) * NS).astype(np.int64)
    ahead, aside = (x, y) if north_first else (y, x)
    a = sense * wander
    vel_e, vel_n = ahead * np.sin(a) + aside * np.cos(a), ahead * np.cos(a) - aside * np.sin(a)
    found: dict[str, NDArray[Any]] = {"time": t_ns, "good": good}
    found |= dict(zip(_PLACE, (np.degrees(lat), np.degrees(lon), height), strict=True))
    found |= dict(zip(_VELOCITY, (vel_e, vel_n, up), strict=True))
    return found | dict(zip(_ANGLES, (yaw_from_heading(heading + a), -pitch, roll), strict=True))


def _times(t_ns: Times, good: Mask, params: SbetParams) -> tuple[Times, dict[str, Any], list[Metric]]:
    """Times of the records in UTC, where the week is known."""
    if params.week is None:
        note = "the file names no week: times count from the beginning of its week; set reader.sbet.week"
        return t_ns, {"clock": "relative"}, [warning(note)]
    t_ns = t_ns + GPS_EPOCH_NS + params.week * WEEK_NS
    if params.time_scale == "GPS":
        first = t_ns[np.argmax(good)][None]
        t_ns = t_ns - (first - gps_to_utc(first))
    learnt = [Metric("assumed_time_scale", note=f"times of the week are in {params.time_scale}")]
    return t_ns, {"clock": "absolute", "time_scale": "UTC"}, learnt


def _wander_frame(records: Array) -> tuple[bool, float, list[Metric]]:
    """Is x the axis to the north, and is the azimuth of that axis plus or minus the wander angle? What settled it."""
    records = records[:, :11]
    steps = np.diff(records[:, :3], axis=0)
    seconds = steps[:, 0]
    with np.errstate(invalid="ignore"):
        known = (seconds > 0.0) & (seconds < LONGEST_STEP_S)
    mean, steps, seconds = 0.5 * (records[1:] + records[:-1])[known], steps[known], seconds[known]
    rate_n = steps[:, 1] * WGS84.a / seconds
    rate_e = steps[:, 2] * WGS84.a * np.cos(mean[:, 1]) / seconds
    errors = {}
    for north_first in (False, True):
        ahead, aside = (mean[:, 4], mean[:, 5]) if north_first else (mean[:, 5], mean[:, 4])
        for sense in (-1.0, 1.0):
            a = sense * mean[:, 10]
            off_n, off_e = (
                ahead * np.cos(a) - aside * np.sin(a) - rate_n,
                ahead * np.sin(a) + aside * np.cos(a) - rate_e,
            )
            errors[north_first, sense] = float(np.nanmedian(np.hypot(off_n, off_e))) if len(a) else 0.0
    usual = (False, -1.0)
    best = min(errors, key=lambda key: (errors[key], key != usual))
    chosen = best if errors[best] < 0.5 * errors[usual] else usual
    settled = max(errors.values()) > 2.0 * errors[chosen] and max(errors.values()) > STANDING
    axes = (
        f"x to the {'north' if chosen[0] else 'east'}, azimuth of north {'plus' if chosen[1] > 0 else 'minus'} wander"
    )
    how = "velocities agree with positions" if settled else "assumed: the vehicle hardly moves"
    return *chosen, [Metric("wander_frame", errors[chosen], "m/s", method=axes, note=how)]


def _damage(path: Path, wrong: int, rest: int) -> list[Metric]:
    found = []
    if wrong:
        found.append(Metric("records_left_out", float(wrong), note="their numbers are no times, places or angles"))
        found.append(warning(f"left out of {path.name}: {wrong} records whose numbers are no times, places or angles"))
    if rest:
        found.append(Metric("bytes_left_out", float(rest), note="the last record was cut off"))
        found.append(warning(f"the last record of {path.name} was cut off"))
    return found


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of SBET."""
    yield Reader(
        name="sbet",
        summary="SBET trajectories of POSPac and others, as reference.",
        params=SbetParams,
        run=read,
        sniff=sniff,
        writes={"reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible()},
        references=("Applanix, POSPac MMS User Guide", "PDAL, readers.sbet"),
    )
