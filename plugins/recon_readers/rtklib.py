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
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import ecef_to_geodetic
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc
from recon.parameters import NoParams
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, vector, with_meta
from recon_readers._lines import COPIED, Form, read_lines
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import Text
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import TIME_TYPE, moments, whole_ns

HEADER: Final = 8192
"""Bytes in which the comments are that tell what the columns are."""
JST_NS: Final = 9 * 3600 * NS
QUALITY: Final = ("", "fix", "float", "SBAS", "DGPS", "single", "PPP")
_GROUPS: Final = {
    "vel": ("ve", "vn", "vu"),
    "pos_std": ("sde", "sdn", "sdu"),
    "vel_std": ("sdve", "sdvn", "sdvu"),
}
_TIMES: Final = ("date", "clock", "week", "tow")
_DATE: Final = re.compile(rb"\d{4}/\d\d/\d\d")


@dataclass(frozen=True)
class _Layout:
    """Names of the columns, the time scale, and where heights count from."""

    names: list[str]
    scale: str
    datum: str


def read(path: Path, params: NoParams) -> Streams:
    """The stream gnss. Raises ReadFailed."""
    text = Text.open(path)
    first, header = _rows_begin(path, text.head)
    layout = _layout(path, header, text.head[first : first + 4096], len(header) + 1)
    kinds = {name: _kind(name) for name in layout.names if name in _NAMES}
    form = Form(layout.names, kinds, _separator(text.head[first : first + 4096]), b"%")
    lines = read_lines(path, text, form, _columns, start=first, first_line=len(header) + 1)
    rows = lines.columns
    t_ns = _utc(rows.pop("time"), rows["missing"], layout)
    quality = _quality(rows.pop("Q", np.zeros(0)))
    missing = rows.pop("missing")
    facts: dict[str, str] = {"height_datum": layout.datum} if "lat" in rows else {"origin": "base station"}
    gnss, told = stream(Source(path, "gnss", lines.line), GNSS, t_ns, missing, rows)
    if gnss is None:
        raise ReadFailed(path, "no row holds a time and a position", line=lines.first_line, hint=COPIED)
    learnt = [*lines.learnt(), *quality, Metric("time_scale", note=f"{layout.scale} in the file"), *told]
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


def _columns(table: pa.Table) -> dict[str, NDArray[Any]]:
    """Of some rows: times in the scale of the file and whether they are missing, columns of the stream, and Q."""
    t_ns, missing = _times(table)
    told = {name: vector(table, name, gaps=True) for name in table.column_names if name not in _TIMES}
    columns: dict[str, NDArray[Any]] = {"time": t_ns, "missing": missing, **_place(told)}
    for group, names in _GROUPS.items():
        if told.keys() >= set(names) and "x-ecef" not in told:
            columns |= {f"{group}_{axis}": told[name] for axis, name in zip("enu", names, strict=True)}
    named = {"ns": "satellites", "Q": "Q"}
    return columns | {named[name]: told[name] for name in named.keys() & told.keys()}


def _times(table: pa.Table) -> tuple[Times, Mask]:
    from pyarrow import compute

    if "date" in table.column_names:
        t_ns, good = moments(compute.binary_join_element_wise(table["date"], table["clock"], " "))
        return t_ns, ~good
    week, no_week = whole_ns(table["week"], 0)
    tow_ns, no_tow = whole_ns(table["tow"])
    missing = no_week | no_tow | (week < 0) | (week > 10_000) | (tow_ns < 0) | (tow_ns > WEEK_NS)
    return GPS_EPOCH_NS + np.where(missing, 0, week) * WEEK_NS + np.where(missing, 0, tow_ns), missing


def _utc(t_ns: Times, missing: Mask, layout: _Layout) -> Times:
    """Times in UTC of times in the scale of the file, both (n,) ns."""
    if layout.scale == "JST":
        return t_ns - JST_NS
    if layout.scale == "GPST" and not missing.all():
        first = int(np.argmin(missing))
        return t_ns - (t_ns[first : first + 1] - gps_to_utc(t_ns[first : first + 1]))
    return t_ns


def _place(told: Mapping[str, Array]) -> dict[str, Array]:
    """lat, lon and height, or the baseline as pos_e, pos_n, pos_u."""
    if told.keys() >= set(_PLACES[2]):
        pos_e = np.column_stack([told[name] for name in _PLACES[2]])
        pos_e[~(np.abs(pos_e) < 1e9).all(axis=1)] = np.nan
        return dict(zip(("lat", "lon", "height"), ecef_to_geodetic(pos_e), strict=True))
    if told.keys() >= set(_PLACES[3]):
        return {f"pos_{axis}": told[name] for axis, name in zip("enu", _PLACES[3], strict=True)}
    return {"lat": _angle(told, "latitude"), "lon": _angle(told, "longitude"), "height": told["height"]}


def _angle(columns: Mapping[str, Array], name: str) -> Array:
    if name in columns:
        return columns[name]
    degrees, minutes, seconds = (columns[f"{name}_{part}"] for part in "dms")
    size = np.abs(degrees) + minutes / 60.0 + seconds / 3600.0
    return np.where(np.signbit(degrees), -size, size)


def _quality(kinds: Array) -> list[Metric]:
    """How many rows there are of each kind of solution."""
    counts = {kind: int((kinds == kind).sum()) for kind in range(1, len(QUALITY))}
    told = {kind: count for kind, count in counts.items() if count}
    if not len(kinds):
        return []
    note = ", ".join(f"{count} {QUALITY[kind]}" for kind, count in told.items())
    fixed = counts[1] / len(kinds)
    learnt = [Metric("fixed", fixed, "1", note=f"share of rows with integer ambiguities: {note}")]
    if 5 in told and len(told) > 1:
        learnt.append(warning(f"{told[5]} of {len(kinds)} rows are single solutions, metres worse than the others"))
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
