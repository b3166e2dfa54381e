"""GoPro cameras: accelerometer, gyroscope and GPS of the MP4, or of its measurements alone (raw GPMF).

    ACCL  m/s^2   GYRO  rad/s   by ORIN along X right, Y forward, Z up of the camera; without ORIN Z, X, Y
    GPS5  lat, lon deg, height m, speed over ground and in space m/s; with GPSU, UTC, and GPSF, the fix
    GPS9  the same with days since 2000, s of the day, dilution of precision and fix of each sample

An accelerometer that points up reads +9.8 at rest: specific force. Vectors are given along forward, left, up of the
camera. Heights are above the ellipsoid, or above mean sea level where GPSA says MSLV.

A payload holds the samples of about a second, evenly: they begin where STMP says, else where the track of the MP4
does, and last until the next. A raw file without STMP needs `payload`. UTC is that of the payloads with a fix; the GPS
data tell it to a part of a second (aligner.time_offset finds out). Magnetometers name no axes and are not read.

Reference: GoPro, gpmf-parser, README and docs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import DAY_NS, NS
from recon.parameters import Params, quantity
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._arrays import interleave
from recon_readers._columns import Grown, kept
from recon_readers._gpmf_payloads import WANTED, Data, Place, is_mp4, measurements, payloads
from recon_readers._lines import COPIED
from recon_readers._streams import Source, stream
from recon_readers._time_order import Times, in_order, median_ns, repeating
from recon_readers._time_text import moments

AXES: Final = "XYZ"
USUAL: Final = "ZXY"
"""Of cameras that write no ORIN: up/down, right/left, forward/back."""
LOST: Final = 1.5
"""Times the usual time between payloads: then one between is lost."""
DAYS_2000: Final = 10_957
"""2000-01-01 in days since 1970."""


class GpmfParams(Params):
    """What a raw file does not tell."""

    payload: float | None = quantity(None, "s", gt=0, le=60, doc="Length of a payload of a raw file; mostly 1.001 s.")


def read(path: Path, params: GpmfParams) -> Streams:
    """The streams imu and gnss, whichever the file holds. Raises ReadFailed, also where `payload` must tell."""
    with path.open("rb") as file:
        head = file.read(64)
    places = payloads(path, head)
    unclosed = is_mp4(head) and any(place.start_ns is None for place in places)
    found = _all(path, places)
    counts = ", ".join(f"{each.rows} {key}" for key, each in found.items())
    times = {key: _times(path, places, each.parts, params) for key, each in found.items()}
    zero_ns = _utc_zero(found, times)
    imu, told = _imu(path, found, times, zero_ns)
    gnss, learnt = _gnss(path, found, times, zero_ns)
    streams = {name: table for name, table in (("imu", imu), ("gnss", gnss)) if table is not None}
    if not streams:
        keys = ", ".join(found) or "none"
        raise ReadFailed(path, f"its {len(places)} payloads hold no measurement ({keys})", hint=COPIED)
    clock, scale = ("relative", None) if zero_ns is None else ("absolute", "UTC")
    facts = {"format": "GPMF", "clock": clock, "time_scale": scale}
    note = f"the index of {path.name} is missing or damaged: its payloads were searched for"
    doubt = [warning(note)] if unclosed else []
    rows = [*doubt, Metric("payloads", float(len(places)), note=counts), *_clock(zero_ns), *told, *learnt]
    return {**{name: with_meta(table, **facts) for name, table in streams.items()}, "metrics": metrics(rows)}


def sniff(path: Path, head: bytes) -> Sniff:
    """A raw payload, or an MP4 with a track of such."""
    if head.startswith(b"DEVC"):
        return Sniff(0.95, "payloads of GPMF")
    if path.is_dir() or not is_mp4(head):
        return Sniff(0.0, "neither GPMF nor an MP4")
    try:
        return Sniff(0.95, f"an MP4 with {len(payloads(path, head))} payloads of GPMF")
    except ReadFailed as error:
        return Sniff(0.3, f"{error.what}: {error.hint}")


# --- payloads -------------------------------------------------------------------------------------------------------

_WIDTHS: Final = {"ACCL": 3, "GYRO": 3, "GPS5": 5, "GPS9": 9}


class _Part(NamedTuple):
    """A payload's number, how many samples of a stream it holds, and what it says of them."""

    number: int
    rows: int
    stamp_us: int | None
    utc: str
    fix: int


@dataclass
class _Samples:
    """Samples of one kind: their columns (n,), the payloads that they came in, and what the first of these says."""

    columns: list[Grown]
    parts: list[_Part]
    first: Data

    @property
    def rows(self) -> int:
        return sum(part.rows for part in self.parts)

    def column(self, at: int) -> Array:
        """A column, which is given once and then no longer kept."""
        values = self.columns[at].all
        self.columns[at] = Grown(np.float64, 0)
        return values


def _all(path: Path, places: Sequence[Place]) -> dict[str, _Samples]:
    """The samples of all payloads by key."""
    found: dict[str, _Samples] = {}
    with path.open("rb") as file:
        for number, place in enumerate(places):
            file.seek(place.offset)
            for key, data in measurements(file.read(place.size)).items():
                rows, width = data.values.shape
                if not rows or width < _WIDTHS[key]:
                    continue
                if key not in found:
                    room = rows * (len(places) - number)
                    found[key] = _Samples([Grown(np.float64, room) for _ in range(_WIDTHS[key])], [], data)
                for column, values in zip(found[key].columns, data.values.T, strict=False):
                    column.add(values)
                utc, fix = (data.text("GPSU"), data.whole("GPSF") or 0) if key == "GPS5" else ("", 0)
                found[key].parts.append(_Part(number, rows, data.whole("STMP"), utc, fix))
    return {key: found[key] for key in WANTED if key in found}


def _times(path: Path, places: Sequence[Place], parts: Sequence[_Part], params: GpmfParams) -> Times:
    """Times (n,) ns after the start of the recording of all samples of a stream."""
    t_ns = np.empty(sum(part.rows for part in parts), dtype=np.int64)
    end = 0
    for start, duration, part in zip(*_spans(path, places, parts, params), parts, strict=True):
        end += part.rows
        t_ns[end - part.rows : end] = start + duration * np.arange(part.rows) // part.rows
    return t_ns


def _spans(
    path: Path, places: Sequence[Place], parts: Sequence[_Part], params: GpmfParams
) -> tuple[list[int], list[int]]:
    """Start and duration in ns of the samples of each payload."""
    known = [part.stamp_us for part in parts if part.stamp_us is not None and part.stamp_us < 1 << 50]
    if len(known) == len(parts) > 1 and all(b > a for a, b in pairwise(known)):
        starts = [stamp * 1000 for stamp in known]
        counts = np.array([part.rows for part in parts])
        steps = np.append(np.diff(starts), np.iinfo(np.int64).max)
        usual = np.median(steps[:-1]) / np.median(counts) * counts
        return starts, np.where(steps < LOST * usual, steps, usual).astype(np.int64).tolist()
    own = [places[part.number] for part in parts]
    if all(place.start_ns is not None for place in own):
        return [place.start_ns or 0 for place in own], [place.duration_ns or 0 for place in own]
    if params.payload is None:
        hint = "read the MP4 that it was taken from, or set reader.gpmf.payload: 1.001 s in most cameras"
        raise ReadFailed(path, f"raw GPMF does not tell how long its payloads last ({len(places)} in all)", hint=hint)
    length = round(params.payload * NS)
    return [part.number * length for part in parts], [length] * len(parts)


# --- streams --------------------------------------------------------------------------------------------------------


def _imu(
    path: Path, found: Mapping[str, _Samples], times: Mapping[str, Times], zero_ns: int | None
) -> tuple[pa.Table | None, list[Metric]]:
    parts: dict[str, tuple[Times, Array]] = {}
    learnt = []
    for group, key in (("accel", "ACCL"), ("gyro", "GYRO")):
        if key in found:
            letters = found[key].first.text("ORIN") or USUAL
            if sorted(letters.upper()) != sorted(AXES):
                learnt.append(warning(f"{key} is left out: its axes '{letters[:10]}' are none"))
                continue
            usable = in_order(times[key], np.zeros(len(times[key]), dtype=bool))
            usable &= ~repeating(times[key], [usable])
            t_ns = kept(times[key], usable)
            for axis, letter, sign in (("x", "Y", 1), ("y", "X", -1), ("z", "Z", 1)):
                at = letters.upper().index(letter)
                values = kept(found[key].column(at), usable)
                parts[f"{group}_{axis}"] = t_ns, values if letters[at].isupper() == (sign > 0) else -values
            learnt.append(Metric("axes", method=key, note=f"logged as {letters} (X right, Y forward, Z up)"))
    if not parts:
        return None, learnt
    t_ns, groups = interleave(parts)
    made, told = stream(Source(path, "imu"), IMU, t_ns + (zero_ns or 0), np.zeros(len(t_ns), dtype=bool), groups)
    return (None if made is None else with_meta(made, axes="RFU")), [*learnt, *told]


def _gnss(
    path: Path, found: Mapping[str, _Samples], times: Mapping[str, Times], zero_ns: int | None
) -> tuple[pa.Table | None, list[Metric]]:
    key = next((key for key in ("GPS9", "GPS5") if key in found), "")
    if not key:
        return None, []
    samples, t_ns = found[key], times[key]
    if key == "GPS9":
        fix = samples.columns[8].all
        t_ns = _own_utc(samples) if zero_ns is not None else t_ns
        zero_ns = 0
    else:
        fix = np.repeat([float(part.fix) for part in samples.parts], [part.rows for part in samples.parts])
    fixed = fix >= 2.0
    names = enumerate(("lat", "lon", "height", "speed"))
    groups = {name: np.where(fixed, samples.column(at), np.nan) for at, name in names}
    groups["fix"] = np.where(np.isin(fix, (0.0, 2.0, 3.0)), fix, np.nan)
    # without a fix GPS9 tells the camera's own time, which would push out the fixes around it
    untimed = ~fixed if key == "GPS9" else np.zeros(len(t_ns), dtype=bool)
    made, learnt = stream(Source(path, "gnss"), GNSS, t_ns + (zero_ns or 0), untimed, groups)
    datum = "mean_sea_level" if samples.first.text("GPSA") == "MSLV" else "ellipsoid"
    if not fixed.all():
        learnt.append(Metric("rows_without_fix", float((~fixed).sum()), note=f"of {len(fixed)} rows of {key}"))
    return (None if made is None else with_meta(made, height_datum=datum)), learnt


def _own_utc(samples: _Samples) -> Times:
    """UTC of GPS9: (n,) ns; days and ms are whole numbers."""
    day, second = samples.columns[5].all, samples.columns[6].all
    with np.errstate(invalid="ignore"):
        days = np.where(np.abs(day) < 1e5, day, 0.0).astype(np.int64) + DAYS_2000
        ms = np.round(np.where(np.abs(second) < 1e6, second, 0.0) * 1e3).astype(np.int64)
    return days * DAY_NS + ms * 1_000_000


def _utc_zero(found: Mapping[str, _Samples], times: Mapping[str, Times]) -> int | None:
    """UTC at the start of the recording in ns, None where no payload has a fix."""
    if "GPS9" in found:
        fixed = found["GPS9"].columns[8].all >= 2.0
        return median_ns((_own_utc(found["GPS9"]) - times["GPS9"])[fixed]) if fixed.any() else None
    offsets, row = [], 0
    for part in found["GPS5"].parts if "GPS5" in found else ():
        stamp = part.utc
        text = f"20{stamp[:2]}-{stamp[2:4]}-{stamp[4:6]} {stamp[6:8]}:{stamp[8:10]}:{stamp[10:]}"
        utc_ns, good = moments(pa.array([text]))
        if part.fix >= 2 and good[0]:
            offsets.append(int(utc_ns[0]) - int(times["GPS5"][row]))
        row += part.rows
    return median_ns(np.array(offsets)) if offsets else None


def _clock(zero_ns: int | None) -> list[Metric]:
    if zero_ns is None:
        return [warning("GPS had no fix: times count from the start of the recording")]
    note = "UTC at the start of the recording, by GPS; of GPS5 known to a part of a second"
    return [Metric("clock_offset", zero_ns * 1e-9, "s", sigma=0.5, note=note)]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of GoPro's measurements."""
    yield Reader(
        name="gpmf",
        summary="GoPro videos (MP4) and raw GPMF: accelerometer, gyroscope and GPS.",
        params=GpmfParams,
        run=read,
        version=2,
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "speed", "fix").possible(),
        },
        references=("GoPro, gpmf-parser, README", "ISO/IEC 14496-12"),
    )
