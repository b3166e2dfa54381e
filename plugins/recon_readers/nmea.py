"""NMEA 0183 logs: GNSS from RMC, GGA, GST, VTG, ZDA, GNS, GLL and GSA.

Sentences of one time of day make one row; VTG and GSA, which have no time, belong to the sentence before them. The
date comes from RMC or ZDA, counts on where times of day fall by more than half a day, and reaches back to the first
sentences; without one the times count from midnight. Where two sentences tell the same, RMC goes before VTG, GGA before
GNS before RMC before GLL. Height is above mean sea level, course is from true north.

A sentence whose checksum is wrong or missing is left out and counted. Receivers with old firmware give dates that are
1024 weeks (19.6 years) early: `rollovers` puts them right.

Decoding sentences columnar, and not by a library one at a time, makes reading a day at 10 Hz a matter of seconds.

Reference: NMEA 0183, version 4.11.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import DAY_NS, WEEK_NS
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
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


class NmeaParams(Params):
    """What the sentences do not tell."""

    rollovers: int = setting(0, ge=0, le=3, doc="How many times 1024 weeks the receiver's dates are early.")


def read(path: Path, params: NmeaParams) -> Streams:
    """The stream gnss. Raises ReadFailed where no sentence holds a position or a speed."""
    found, counts = read_sentences(path)
    if not found:
        raise ReadFailed(path, "no sentence of NMEA 0183 has a right checksum", line=1, hint=COPIED)
    places = np.concatenate([part.place for part in found.values()])
    order = np.argsort(places, kind="stable")
    epochs = _Epochs.of(found, order)
    t_ns, missing, facts, learnt = _times(epochs, params)
    gnss, told = stream(Source(path, "gnss"), GNSS, t_ns, missing, _groups(found, epochs))
    if gnss is None:
        raise ReadFailed(path, f"none of its sentences holds a position: {_about(counts)}", line=1, hint=_NO_FIX)
    table = with_meta(
        gnss, **facts, time_scale="UTC", format="NMEA 0183", height_datum="mean_sea_level", heading_kind="course_true"
    )
    return {"gnss": table, "metrics": metrics([*_counted(path, counts), *learnt, *_separation(found), *told])}


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


class _Epochs:
    """Rows of one time each: for each sentence, by type, the row that it belongs to; for each row its time and day."""

    def __init__(self, row: Mapping[str, NDArray[np.intp]], clock_ns: Times, day: Times) -> None:
        self.row, self.clock_ns, self.day = row, clock_ns, day

    @classmethod
    def of(cls, found: Mapping[str, Sentences], order: NDArray[np.intp]) -> _Epochs:
        """Sentences in the order of the file; those without a time belong to the one before."""
        clock_ns = np.concatenate([part.clock_ns for part in found.values()])[order]
        day = np.concatenate([part.day for part in found.values()])[order]
        timed = np.flatnonzero(clock_ns >= 0)
        before = np.maximum(np.cumsum(clock_ns >= 0) - 1, 0)
        clock_ns = clock_ns[timed][before] if len(timed) else clock_ns
        row = np.cumsum(np.diff(clock_ns, prepend=clock_ns[:1]) != 0)
        first = np.flatnonzero(np.diff(row, prepend=-1))
        days = np.full(len(first), -1, dtype=np.int64)
        days[row[day >= 0]] = day[day >= 0]
        unsorted = np.empty_like(row)
        unsorted[order] = row
        ends = np.cumsum([len(part.place) for part in found.values()])[:-1]
        return cls(dict(zip(found, np.split(unsorted, ends), strict=True)), clock_ns[first], days)


def _times(epochs: _Epochs, params: NmeaParams) -> tuple[Times, Mask, dict[str, str], list[Metric]]:
    """Times of the rows, (n,) ns; which have none, (n,) bool; facts and what is to be told."""
    missing = epochs.clock_ns < 0
    clock_ns = np.where(missing, 0, epochs.clock_ns)
    passed = np.cumsum(np.diff(clock_ns, prepend=clock_ns[:1]) < -DAY_NS // 2)
    dated = np.flatnonzero((epochs.day >= 0) & ~missing)
    if not len(dated):
        note = "no sentence tells the date (RMC and ZDA do): times count from midnight"
        return passed * DAY_NS + clock_ns, missing, {"clock": "relative"}, [warning(note)]
    last = np.maximum.accumulate(np.where(epochs.day >= 0, np.arange(len(clock_ns)), -1))
    base = np.where(last >= 0, last, dated[0])
    day = epochs.day[base] + passed - passed[base]
    t_ns = day * DAY_NS + clock_ns + params.rollovers * 1024 * WEEK_NS
    learnt = []
    if epochs.day[dated[0]] < OLDEST_DAY and not params.rollovers:
        date = str(np.datetime64(int(epochs.day[dated[0]]), "D"))
        note = f"the receiver says {date}: if its week number has rolled over, set reader.nmea.rollovers to 1"
        learnt.append(warning(note))
    return t_ns, missing, {"clock": "absolute"}, learnt


def _groups(found: Mapping[str, Sentences], epochs: _Epochs) -> dict[str, Array]:
    """Values of the rows, NaN where no sentence tells."""
    columns = {}
    for name, types in FROM.items():
        told = [kind for kind in types if kind in found]
        if not told or name == "separation":
            continue
        column = np.full(len(epochs.clock_ns), np.nan)
        for kind in reversed(told):
            values = found[kind].values[name]
            known = np.isfinite(values)
            column[epochs.row[kind][known]] = values[known]
        columns[name] = column
    quality = columns.pop("quality", None)
    if quality is not None and "fix" in columns:
        columns["fix"] = np.where(quality == 0.0, 0.0, columns["fix"])
    sigmas = [columns.pop(f"pos_std_{axis}", None) for axis in "enu"]
    if sigmas[0] is not None:
        columns["pos_std"] = np.column_stack([part for part in sigmas if part is not None])
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


def _separation(found: Mapping[str, Sentences]) -> list[Metric]:
    told = [found[kind].values["separation"] for kind in FROM["separation"] if kind in found]
    known = np.concatenate(told)[np.isfinite(np.concatenate(told))] if told else np.zeros(0)
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
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "pos_std", "fix", "satellites").possible(),
        },
        references=("NMEA 0183, version 4.11",),
    )
