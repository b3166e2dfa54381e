"""Solutions of RTKLIB (.pos): gnss with the sigmas that RTKLIB computed.

A text whose comments begin with %; the last of them names the columns. Read are

    time      yyyy/mm/dd HH:MM:SS.sss, or GPS week and seconds; in GPST, UTC or JST as the header tells
    position  latitude, longitude in deg (or in deg, min, s), height in m; or x, y, z of ECEF in m
    velocity  vn, ve, vu in m/s;  sigmas sdn, sde, sdu and sdvn, sdve, sdvu;  Q and ns

Heights are ellipsoidal unless the header says geodetic. A solution relative to a base (e-baseline) has no place on the
Earth: it becomes pos_e, pos_n, pos_u about the base. Q is kept as the stream's metric: how many rows are fix (1),
float (2), SBAS (3), DGPS (4), single (5), PPP (6).

Reference: T. Takasu, RTKLIB ver. 2.4.2 manual, B.1 (solution format).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import ecef_to_geodetic
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc
from recon.parameters import NoParams
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, vector, with_meta
from recon_readers._delimited import TIME_TYPE, contents, whole_ns
from recon_readers._lines import COPIED, Form, Lines, read_lines
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import plain
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import moments

HEADER: Final = 8192
"""Bytes in which the comments are that tell what the columns are."""
JST_NS: Final = 9 * 3600 * NS
QUALITY: Final = ("", "fix", "float", "SBAS", "DGPS", "single", "PPP")
_GROUPS: Final = {
    "vel": ("ve", "vn", "vu"),
    "pos_std": ("sde", "sdn", "sdu"),
    "vel_std": ("sdve", "sdvn", "sdvu"),
}
_DATE: Final = re.compile(rb"\d{4}/\d\d/\d\d")


@dataclass(frozen=True)
class _Layout:
    """Names of the columns, the time scale, and where heights count from."""

    names: list[str]
    scale: str
    datum: str


def read(path: Path, params: NoParams) -> Streams:
    """The stream gnss. Raises ReadFailed."""
    text = plain(contents(path))
    first, header = _rows_begin(path, text)
    layout = _layout(path, header, text[first:], 1 + text.count(b"\n", 0, first))
    wanted = [name for name in layout.names if name in _NAMES]
    kinds = {name: _kind(name) for name in wanted}
    separator = _separator(text[first : first + 4096])
    form = Form(layout.names, kinds, separator, b"%")
    lines = read_lines(path, text[first:], 1 + text.count(b"\n", 0, first), form)
    t_ns, missing = _times(lines, layout)
    groups, facts = _groups(lines)
    source = Source(path, "gnss", lines.line)
    facts |= {"height_datum": layout.datum} if "lat" in groups else {}
    gnss, told = stream(source, GNSS, t_ns, missing, groups)
    if gnss is None:
        raise ReadFailed(path, "no row holds a time and a position", line=lines.first_line, hint=COPIED)
    learnt = [*lines.learnt(), *_quality(lines), Metric("time_scale", note=f"{layout.scale} in the file"), *told]
    table = with_meta(gnss, clock="absolute", time_scale="UTC", format="RTKLIB", **facts)
    return {"gnss": table, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """Comments with %, one of which names columns."""
    if not head.startswith(b"%"):
        return Sniff(0.0, "no comments of RTKLIB")
    known = any(word in head[:HEADER] for word in (b"sdn(m)", b"x-ecef(m)", b"e-baseline(m)", b"latitude("))
    return Sniff(0.95, "columns of an RTKLIB solution") if known else Sniff(0.2, "comments with %, as of RTKLIB")


def _rows_begin(path: Path, text: bytes) -> tuple[int, list[str]]:
    """Offset of the first row, and the comments above it."""
    start = 0
    header: list[str] = []
    while start < len(text):
        stop = text.find(b"\n", start)
        stop = len(text) if stop < 0 else stop
        line = text[start:stop].strip()
        if line and not line.startswith(b"%"):
            return start, header
        header.append(line.decode("ascii", "replace"))
        start = stop + 1
    raise ReadFailed(path, "it holds no rows", line=max(len(header), 1), hint=COPIED)


def _layout(path: Path, header: list[str], rows: bytes, line: int) -> _Layout:
    """Names of the columns by the last comment. Raises ReadFailed where no comment names them."""
    titles = next((text for text in reversed(header) if re.search(r"latitude|x-ecef|e-baseline", text)), "")
    if not titles:
        raise ReadFailed(
            path, "no comment names its columns", line=line, hint="let RTKLIB write the header (out-outhead=on)"
        )
    words = [word for word in re.split(r"[\s,;]+", titles.lstrip("%").strip()) if word]
    scale = next((word for word in words if word in ("GPST", "UTC", "JST")), "GPST")
    words = [word for word in words if word not in ("GPST", "UTC", "JST")]
    first = re.split(rb"[\s,;]+", rows.lstrip()[:4096].split(b"\n")[0].strip())
    names = ["date", "clock"] if _DATE.match(first[0]) else ["week", "tow"]
    for word in words:
        name, unit = re.match(r"([^(]*)(\(.*\))?", word).groups()  # type: ignore[union-attr]
        names += [f"{name}_{part}" for part in "dms"] if unit == "(d'\")" else [name]
    if not any(set(names).issuperset(place) for place in _PLACES):
        what = f"the columns that its header names, {' '.join(words)[:80]}, are no place"
        raise ReadFailed(
            path, what, line=line, hint="latitude, longitude and height, or x, y, z, or a baseline are needed"
        )
    geodetic = any("geodetic" in text for text in header)
    return _Layout(_known(names), scale, "mean_sea_level" if geodetic else "ellipsoid")


_NAMES: Final = {
    *("date", "clock", "week", "tow", "latitude", "longitude", "height", "Q", "ns"),
    *(f"{angle}_{part}" for angle in ("latitude", "longitude") for part in "dms"),
    *("x-ecef", "y-ecef", "z-ecef", "e-baseline", "n-baseline", "u-baseline"),
    *(name for names in _GROUPS.values() for name in names),
}


_PLACES: Final = (
    ("latitude", "longitude", "height"),
    (*(f"{angle}_{part}" for angle in ("latitude", "longitude") for part in "dms"), "height"),
    ("x-ecef", "y-ecef", "z-ecef"),
    ("e-baseline", "n-baseline", "u-baseline"),
)


def _known(names: list[str]) -> list[str]:
    """The names, those that are not read as # and their place, for several may be equal."""
    return [name if name in _NAMES and name not in names[:at] else f"#{at}" for at, name in enumerate(names)]


def _kind(name: str) -> pa.DataType:
    if name in ("date", "clock"):
        return pa.string()
    return TIME_TYPE if name in ("tow", "week") else pa.float64()


def _separator(rows: bytes) -> bytes:
    line = rows.split(b"\n")[0]
    return next((mark for mark in (b",", b";") if line.count(mark) > 3), b" ")


def _times(lines: Lines, layout: _Layout) -> tuple[Times, Mask]:
    from pyarrow import compute

    table = lines.table
    if "date" in table.column_names:
        t_ns, good = moments(compute.binary_join_element_wise(table["date"], table["clock"], " "))
        missing = ~good
    else:
        week, no_week = whole_ns(table["week"], 0)
        tow_ns, no_tow = whole_ns(table["tow"])
        missing = no_week | no_tow | (week < 0) | (week > 10_000) | (tow_ns < 0) | (tow_ns > WEEK_NS)
        t_ns = GPS_EPOCH_NS + np.where(missing, 0, week) * WEEK_NS + np.where(missing, 0, tow_ns)
    if layout.scale == "JST":
        return t_ns - JST_NS, missing
    if layout.scale == "GPST" and not missing.all():
        known = np.flatnonzero(~missing)
        return t_ns - (t_ns[known[0]] - gps_to_utc(t_ns[known[:1]])[0]), missing
    return t_ns, missing


def _groups(lines: Lines) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns of the stream, and facts that they bring."""
    there = set(lines.table.column_names)
    read_column = {name: vector(lines.table, name, gaps=True) for name in there - {"date", "clock", "week", "tow"}}
    groups: dict[str, Array] = {}
    facts: dict[str, Any] = {}
    if there.issuperset(_PLACES[2]):
        pos_e = np.column_stack([read_column[name] for name in _PLACES[2]])
        pos_e[~(np.abs(pos_e) < 1e9).all(axis=1)] = np.nan
        groups["lat"], groups["lon"], groups["height"] = ecef_to_geodetic(pos_e)
    elif there.issuperset(_PLACES[3]):
        groups["pos"] = np.column_stack([read_column[name] for name in _PLACES[3]])
        facts["origin"] = "base station"
    else:
        groups["lat"], groups["lon"] = _angle(read_column, "latitude"), _angle(read_column, "longitude")
        groups["height"] = read_column["height"]
    for group, names in _GROUPS.items():
        if there.issuperset(names) and "x-ecef" not in there:
            groups[group] = np.column_stack([read_column[name] for name in names])
    if "ns" in there:
        groups["satellites"] = read_column["ns"]
    return groups, facts


def _angle(columns: Mapping[str, Array], name: str) -> Array:
    if name in columns:
        return columns[name]
    degrees, minutes, seconds = (columns[f"{name}_{part}"] for part in "dms")
    size = np.abs(degrees) + minutes / 60.0 + seconds / 3600.0
    return np.where(np.signbit(degrees), -size, size)


def _quality(lines: Lines) -> list[Metric]:
    """How many rows there are of each kind of solution."""
    if "Q" not in lines.table.column_names:
        return []
    kinds, counts = np.unique(vector(lines.table, "Q", gaps=True), return_counts=True)
    told = {int(kind): int(count) for kind, count in zip(kinds, counts, strict=True) if kind in range(1, len(QUALITY))}
    note = ", ".join(f"{count} {QUALITY[kind]}" for kind, count in told.items())
    fixed = told.get(1, 0) / max(lines.table.num_rows, 1)
    learnt = [Metric("fixed", fixed, "1", note=f"share of rows with integer ambiguities: {note}")]
    if 5 in told and len(told) > 1:
        learnt.append(
            warning(f"{told[5]} of {lines.table.num_rows} rows are single solutions, metres worse than the others")
        )
    return learnt


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of RTKLIB's solutions."""
    yield Reader(
        name="rtklib",
        summary="Solutions of RTKLIB (.pos): positions, velocities and their sigmas.",
        run=read,
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "pos", "vel", "pos_std", "vel_std", "satellites").possible(),
        },
        references=("T. Takasu, RTKLIB ver. 2.4.2 manual, B.1",),
    )
