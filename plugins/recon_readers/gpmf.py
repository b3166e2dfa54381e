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

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Final, TypeAlias

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

_Series: TypeAlias = tuple[Times, Array]


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
    series = {key: _timed(path, key, places, parts, params) for key, parts in found.items()}
    zero_ns = _utc_zero(found, series)
    imu, told = _imu(path, found, series, zero_ns)
    gnss, learnt = _gnss(path, found, series, zero_ns)
    streams = {name: table for name, table in (("imu", imu), ("gnss", gnss)) if table is not None}
    if not streams:
        keys = ", ".join(found) or "none"
        raise ReadFailed(path, f"its {len(places)} payloads hold no measurement ({keys})", hint=COPIED)
    facts = {"format": "GPMF", "clock": "relative" if zero_ns is None else "absolute", "time_scale": "UTC"}
    counts = ", ".join(f"{sum(len(part.values) for _, part in parts)} {key}" for key, parts in found.items())
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

_Parts: TypeAlias = list[tuple[int, Data]]
"""Number of the payload and data."""


def _all(path: Path, places: Sequence[Place]) -> dict[str, _Parts]:
    """The data of all payloads by key."""
    found: dict[str, _Parts] = {}
    with path.open("rb") as file:
        for number, place in enumerate(places):
            file.seek(place.offset)
            for key, data in measurements(file.read(place.size)).items():
                if len(data.values) and data.values.shape[1] >= {"GPS5": 5, "GPS9": 9}.get(key, 3):
                    found.setdefault(key, []).append((number, data))
    return {key: found[key] for key in WANTED if key in found}


def _timed(path: Path, key: str, places: Sequence[Place], parts: _Parts, params: GpmfParams) -> _Series:
    """Times (n,) ns after the start of the recording, and values (n, k), of all samples of a stream."""
    starts, lasting = _spans(path, key, places, parts, params)
    times = [
        start + duration * np.arange(len(data.values)) // len(data.values)
        for start, duration, (_, data) in zip(starts, lasting, parts, strict=True)
    ]
    width = min(data.values.shape[1] for _, data in parts)
    return np.concatenate(times), np.concatenate([data.values[:, :width] for _, data in parts])


def _spans(
    path: Path, key: str, places: Sequence[Place], parts: _Parts, params: GpmfParams
) -> tuple[list[int], list[int]]:
    """Start and duration in ns of the samples of each payload."""
    stamps = [data.whole("STMP") for _, data in parts]
    known = [stamp for stamp in stamps if stamp is not None and stamp < 1 << 50]
    if len(known) == len(parts) > 1 and all(b > a for a, b in pairwise(known)):
        starts = [stamp * 1000 for stamp in known]
        counts = np.array([len(data.values) for _, data in parts])
        steps = np.append(np.diff(starts), np.iinfo(np.int64).max)
        usual = np.median(steps[:-1]) / np.median(counts) * counts
        return starts, np.where(steps < LOST * usual, steps, usual).astype(np.int64).tolist()
    if all(places[number].start_ns is not None for number, _ in parts):
        return [places[n].start_ns or 0 for n, _ in parts], [places[n].duration_ns or 0 for n, _ in parts]
    if params.payload is None:
        hint = "read the MP4 that it was taken from, or set reader.gpmf.payload: 1.001 s in most cameras"
        raise ReadFailed(path, f"raw GPMF does not tell how long its {len(places)} payload(s) last", hint=hint)
    length = round(params.payload * NS)
    return [number * length for number, _ in parts], [length] * len(parts)


# --- streams --------------------------------------------------------------------------------------------------------


def _rising(t_ns: Times, values: Array) -> _Series:
    usable = in_order(t_ns, np.zeros(len(t_ns), dtype=bool))
    usable &= ~repeating(t_ns, [usable])
    return t_ns[usable], values[usable]


def _imu(
    path: Path, found: dict[str, _Parts], series: dict[str, _Series], zero_ns: int | None
) -> tuple[pa.Table | None, list[Metric]]:
    parts: dict[str, _Series] = {}
    learnt = []
    for group, key in (("accel", "ACCL"), ("gyro", "GYRO")):
        if key in series:
            letters = found[key][0][1].text("ORIN") or USUAL
            if sorted(letters.upper()) != sorted(AXES):
                learnt.append(warning(f"{key} is left out: its axes '{letters[:10]}' are none"))
                continue
            t_ns, values = series[key]
            columns = {
                letter.upper(): values[:, at] * (1 if letter.isupper() else -1) for at, letter in enumerate(letters)
            }
            parts[group] = _rising(t_ns, np.column_stack([columns["Y"], -columns["X"], columns["Z"]]))
            learnt.append(Metric("axes", method=key, note=f"logged as {letters} (X right, Y forward, Z up)"))
    if not parts:
        return None, learnt
    t_ns, groups = interleave(parts)
    made, told = stream(Source(path, "imu"), IMU, t_ns + (zero_ns or 0), np.zeros(len(t_ns), dtype=bool), groups)
    return (None if made is None else with_meta(made, axes="RFU")), [*learnt, *told]


def _gnss(
    path: Path, found: dict[str, _Parts], series: dict[str, _Series], zero_ns: int | None
) -> tuple[pa.Table | None, list[Metric]]:
    key = next((key for key in ("GPS9", "GPS5") if key in series), "")
    if not key:
        return None, []
    t_ns, values = series[key]
    if key == "GPS9":
        fix = values[:, 8]
    else:
        fix = np.concatenate([np.full(len(data.values), float(data.whole("GPSF") or 0)) for _, data in found[key]])
    fixed = fix >= 2.0
    place = {name: np.where(fixed, values[:, at], np.nan) for at, name in enumerate(("lat", "lon", "height", "speed"))}
    groups = {**place, "fix": np.where(np.isin(fix, (0.0, 2.0, 3.0)), fix, np.nan)}
    if key == "GPS9":
        t_ns = _own_utc(values) if zero_ns is not None else t_ns
        zero_ns = 0
    source = Source(path, "gnss")
    made, learnt = stream(source, GNSS, t_ns + (zero_ns or 0), np.zeros(len(t_ns), dtype=bool), groups)
    datum = "mean_sea_level" if found[key][0][1].text("GPSA") == "MSLV" else "ellipsoid"
    if not fixed.all():
        learnt.append(Metric("rows_without_fix", float((~fixed).sum()), note=f"of {len(fixed)} rows of {key}"))
    return (None if made is None else with_meta(made, height_datum=datum)), learnt


def _own_utc(values: Array) -> Times:
    """UTC of GPS9: (n,) ns; days and ms are whole numbers."""
    with np.errstate(invalid="ignore"):
        days = np.where(np.abs(values[:, 5]) < 1e5, values[:, 5], 0.0).astype(np.int64) + DAYS_2000
        ms = np.round(np.where(np.abs(values[:, 6]) < 1e6, values[:, 6], 0.0) * 1e3).astype(np.int64)
    return days * DAY_NS + ms * 1_000_000


def _utc_zero(found: dict[str, _Parts], series: dict[str, _Series]) -> int | None:
    """UTC at the start of the recording in ns, None where no payload has a fix."""
    if "GPS9" in series:
        t_ns, values = series["GPS9"]
        fixed = values[:, 8] >= 2.0
        return median_ns((_own_utc(values) - t_ns)[fixed]) if fixed.any() else None
    offsets, row = [], 0
    for _, data in found.get("GPS5", []):
        stamp = data.text("GPSU")
        text = f"20{stamp[:2]}-{stamp[2:4]}-{stamp[4:6]} {stamp[6:8]}:{stamp[8:10]}:{stamp[10:]}"
        utc_ns, good = moments(pa.array([text]))
        if (data.whole("GPSF") or 0) >= 2 and good[0]:
            offsets.append(int(utc_ns[0]) - int(series["GPS5"][0][row]))
        row += len(data.values)
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
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "speed", "fix").possible(),
        },
        references=("GoPro, gpmf-parser, README", "ISO/IEC 14496-12"),
    )
