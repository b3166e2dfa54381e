"""NMEA 0183 logs: GNSS from RMC, GGA, GST, VTG, ZDA, GNS, GLL and GSA.

Sentences of one time of day make one row; VTG and GSA, which have no time, belong to the sentence before them. Some
receivers begin with VTG: where nothing else tells the speed and the places say so, it belongs to the one behind it. The
date comes from RMC or ZDA, counts on where times of day fall by more than half a day, and reaches back to the first
sentences; those of 1980, with which clocks begin before the first fix, do not count where others follow. Without a date
the times count from midnight. Where two sentences tell the same, RMC goes before VTG, GGA before GNS before RMC before
GLL. Height is above mean sea level, course is from true north.

A sentence whose checksum is wrong or missing is left out and counted. Receivers with old firmware give dates that are
1024 weeks (19.6 years) early: `rollovers` puts them right.

Decoding sentences columnar, and not by a library one at a time, makes reading a day at 10 Hz a matter of seconds.

Reference: NMEA 0183, version 4.11.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import WGS84
from recon.numerics.gnss_time import DAY_NS, WEEK_NS
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._columns import Columns
from recon_readers._lines import COPIED
from recon_readers._nmea_sentences import TYPES, Counts, Sentences, count_sentences, read_sentences
from recon_readers._streams import Source, stream
from recon_readers._time_order import Mask, Times

FROM: Final[Mapping[str, tuple[str, ...]]] = {
    "lat": ("GGA", "GNS", "RMC", "GLL"),
    "lon": ("GGA", "GNS", "RMC", "GLL"),
    "height": ("GGA", "GNS"),
    "speed": ("RMC", "VTG"),
    "course": ("RMC", "VTG"),
    "pos_std_e": ("GST",),
    "pos_std_n": ("GST",),
    "pos_std_u": ("GST",),
    "fix": ("GSA",),
    "quality": ("GGA", "GNS"),
    "satellites": ("GGA", "GNS"),
    "separation": ("GGA", "GNS"),
}
"""By value the sentences that tell it, the best first."""
OLDEST_DAY: Final = 12_784
"""2005-01-01; dates before are rather those of a receiver whose week number has rolled over."""
SLOW_NS: Final = 400_000_000
LARGEST_STEP: Final = 20.0
"""m/s; more between two rows, or between two ways to tell a speed, is damage."""
ENOUGH: Final = 10.0
"""(m/s)^2; sum of the squares of the steps of the speed from which on they tell to which rows it belongs."""
UNSET_DAYS: Final = (3_656, 4_018)
"""From 1980-01-05 to the end of that year: where later dates follow, the clock of the receiver was not set yet."""


class NmeaParams(Params):
    """What the sentences do not tell."""

    rollovers: int = setting(0, ge=0, le=3, doc="How many times 1024 weeks the receiver's dates are early.")


def read(path: Path, params: NmeaParams) -> Streams:
    """The stream gnss. Raises ReadFailed where no sentence holds a position or a speed."""
    counts = Counts()
    rows = Columns.of((share, _rows(found)) for share, found in read_sentences(path, counts))
    if not rows:
        raise ReadFailed(path, "no sentence of NMEA 0183 has a right checksum", line=1, hint=COPIED)
    t_ns, missing, facts, learnt = _times(rows.pop("clock_ns"), rows.pop("day"), params)
    learnt += _separation(rows)
    if not counts.used["RMC"] and _comes_first(rows, t_ns):
        for name in ("speed", "course"):
            rows[name] = np.concatenate([[np.nan], rows[name][:-1]])
        learnt.append(
            Metric("order", method="VTG", note="it comes before the other sentences of its time, as places tell")
        )
    gnss, told = stream(Source(path, "gnss"), GNSS, t_ns, missing, _groups(rows))
    if gnss is None:
        raise ReadFailed(path, f"none of its sentences holds a position: {_about(counts)}", line=1, hint=_NO_FIX)
    table = with_meta(
        gnss, **facts, time_scale="UTC", format="NMEA 0183", height_datum="mean_sea_level", heading_kind="course_true"
    )
    return {"gnss": table, "metrics": metrics([*_counted(path, counts), *learnt, *told])}


def sniff(path: Path, head: bytes) -> Sniff:
    """Sentences with right checksums."""
    right, seen = count_sentences(head)
    if not right:
        return Sniff(0.0, "no sentence of NMEA 0183" if not seen else "sentences of NMEA 0183 without any that is read")
    if b"\xb5\x62" in head:
        return Sniff(0.7, f"{right} sentences of NMEA 0183 among binary messages")
    if b',"$' in head:
        return Sniff(0.4, f"{right} sentences of NMEA 0183 in a column of a table, whose other columns may tell more")
    return Sniff(0.9, f"{right} sentences of NMEA 0183")


_NO_FIX: Final = "had the receiver a fix? RMC, GGA, GNS or GLL must be among its sentences"


def _rows(found: Mapping[str, Sentences]) -> dict[str, NDArray[Any]]:
    """Rows of one time each from the sentences of a block: (n,) by name, NaN where no sentence tells.

    clock_ns : ns since midnight, -1 without a time; day : days since 1970, -1 without a date
    """
    ends = np.cumsum([len(part.place) for part in found.values()])[:-1]
    order = np.argsort(np.concatenate([part.place for part in found.values()]), kind="stable")
    clock_ns = np.concatenate([part.clock_ns for part in found.values()])[order]
    day = np.concatenate([part.day for part in found.values()])[order]
    timed = np.flatnonzero(clock_ns >= 0)
    before = np.maximum(np.cumsum(clock_ns >= 0) - 1, 0)  # sentences without a time belong to the one before
    clock_ns = clock_ns[timed][before] if len(timed) else clock_ns
    row = np.cumsum(np.diff(clock_ns, prepend=clock_ns[:1]) != 0)
    first = np.flatnonzero(np.diff(row, prepend=-1))
    days = np.full(len(first), -1, dtype=np.int64)
    days[row[day >= 0]] = day[day >= 0]
    unsorted = np.empty_like(row)
    unsorted[order] = row
    rows = dict(zip(found, np.split(unsorted, ends), strict=True))
    columns: dict[str, NDArray[Any]] = {"clock_ns": clock_ns[first], "day": days}
    for name, types in FROM.items():
        told = [kind for kind in types if kind in found]
        if told:
            columns[name] = np.full(len(first), np.nan)
        for kind in reversed(told):
            values = found[kind].values[name]
            known = np.isfinite(values)
            columns[name][rows[kind][known]] = values[known]
    return columns


def _times(clock_ns: Times, days: Times, params: NmeaParams) -> tuple[Times, Mask, dict[str, str], list[Metric]]:
    """Times of the rows, (n,) ns; which have none, (n,) bool; facts and what is to be told."""
    if (days >= UNSET_DAYS[1]).any():
        days = np.where((days >= UNSET_DAYS[0]) & (days < UNSET_DAYS[1]), -1, days)
    missing = clock_ns < 0
    clock_ns = np.where(missing, 0, clock_ns)
    passed = np.cumsum(np.diff(clock_ns, prepend=clock_ns[:1]) < -DAY_NS // 2)
    dated = np.flatnonzero((days >= 0) & ~missing)
    if not len(dated):
        note = "no sentence tells the date (RMC and ZDA do): times count from midnight"
        return passed * DAY_NS + clock_ns, missing, {"clock": "relative"}, [warning(note)]
    last = np.maximum.accumulate(np.where(days >= 0, np.arange(len(clock_ns)), -1))
    base = np.where(last >= 0, last, dated[0])
    day = days[base] + passed - passed[base]
    t_ns = day * DAY_NS + clock_ns + params.rollovers * 1024 * WEEK_NS
    learnt = []
    if days[dated[0]] < OLDEST_DAY and not params.rollovers:
        date = str(np.datetime64(int(days[dated[0]]), "D"))
        note = f"the receiver says {date}: if its week number has rolled over, set reader.nmea.rollovers to 1"
        learnt.append(warning(note))
    return t_ns, missing, {"clock": "absolute"}, learnt


def _comes_first(rows: Columns, t_ns: Times) -> bool:
    """Are the speeds of VTG those of the next rows?

    They differ from those between the places by as many of their own steps as they are early. Receivers filter places
    and speeds differently, by parts of a second, so that only rows as far apart tell.
    """
    if not {"lat", "lon", "speed"} <= rows.keys() or len(t_ns) < 3:
        return False
    usual_ns = int(np.median(np.diff(t_ns)))
    lat, lon, speed = np.radians(rows["lat"]), np.radians(rows["lon"]), rows["speed"]
    way = WGS84.a * np.hypot(lat[2:] - lat[:-2], (lon[2:] - lon[:-2]) * np.cos(lat[1:-1]))
    early, step = speed[1:-1] - way / (2e-9 * max(usual_ns, 1)), 0.5 * (speed[2:] - speed[:-2])
    with np.errstate(invalid="ignore"):
        good = (np.abs(early) < LARGEST_STEP) & (np.abs(step) < LARGEST_STEP) & (t_ns[2:] - t_ns[:-2] == 2 * usual_ns)
    much = float(np.sum(step[good] ** 2))
    return usual_ns >= SLOW_NS and much > ENOUGH and 0.5 < float(np.sum((early * step)[good])) / much < 1.5


def _groups(rows: Columns) -> dict[str, Array]:
    """The columns of the stream, taken out of the rows."""
    quality = rows.pop("quality", None)
    if quality is not None and "fix" in rows:
        rows["fix"] = np.where(quality == 0.0, 0.0, rows["fix"])
    sigmas = [rows.pop(f"pos_std_{axis}", None) for axis in "enu"]
    columns = {name: rows.pop(name) for name in list(rows)}
    if sigmas[0] is not None:
        columns["pos_std"] = np.array(sigmas).T
    return columns


def _about(counts: Counts) -> str:
    return ", ".join(f"{number} {name}" for name, number in counts.used.items() if number)


def _counted(path: Path, counts: Counts) -> list[Metric]:
    found = [Metric("sentences_used", float(sum(counts.used.values())), note=_about(counts))]
    if counts.others:
        found.append(Metric("sentences_of_other_types", float(counts.others), note=f"not {', '.join(TYPES)}"))
    if counts.bad:
        found.append(Metric("bad_checksums", float(counts.bad), note="sentences left out"))
        found.append(warning(f"left out of {path.name}: {counts.bad} sentences with a wrong checksum or none"))
    return found


def _separation(rows: Columns) -> list[Metric]:
    told = rows.pop("separation", np.zeros(0))
    known = told[np.isfinite(told)]
    if not len(known):
        return []
    note = "height of mean sea level above the ellipsoid, as the receiver has it"
    return [Metric("geoid_separation", float(np.median(known)), "m", note=note)]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of NMEA 0183."""
    yield Reader(
        name="nmea",
        summary="NMEA 0183 logs: GNSS of RMC, GGA, GST, VTG, ZDA, GNS, GLL and GSA.",
        params=NmeaParams,
        run=read,
        version=3,
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "pos_std", "fix", "satellites").possible(),
        },
        references=("NMEA 0183, version 4.11",),
    )
