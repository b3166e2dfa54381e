"""Texts of KF-GINS and the awesome-gins datasets: increments of an IMU, GNSS positions, a reference.

    IMU        7 columns   s of week, angles dx dy dz rad, velocities dx dy dz m/s, since the row before
    GNSS       7 columns   s of week, lat lon deg, height m, sigmas north east down m
              13 columns   the same, and velocities north east down m/s with their sigmas behind the positions' sigmas
    reference 11 columns   GPS week, s of week, lat lon deg, height m, velocity north east down m/s,
                           roll pitch heading deg

Columns are parted by blanks. Body axes are forward, right, down: vectors are given along forward, left, up. An
increment divided by its step is the mean rate over it: it is given at the middle of the step. Heights are above the
ellipsoid.

Only a reference names the week. It dates all files of the folder that holds it; a file alone needs `week`, without
which times count from the beginning of the week. The input is a file or a folder.

Reference: Niu, Wu, Chen, Yang, Li, Zhang et al., i2Nav group, "awesome-gins-datasets", README (formats).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.joining import combine
from recon.numerics.gnss_time import GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc
from recon.numerics.rotation import yaw_from_heading
from recon.parameters import Params, setting
from recon.recording import Recording
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU, REFERENCE
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._lines import Form, Lines, read_lines
from recon_readers._reference import reference_columns
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import HEAD_BYTES, Text, not_text, plain
from recon_readers._time_order import Mask, Times, in_order
from recon_readers._time_text import TIME_TYPE

LOOK_AT: Final = 50
MOST_FILES: Final = 50
"""Of a folder are looked at: a log of KF-GINS has three or four."""
LONGEST_STEP_S: Final = 0.2
"""Between rows of an IMU; behind a longer one an increment has no rate."""
GRAVITY: Final = (7.0, 13.0)
"""m/s^2, median of what a vehicle feels."""
LAYOUTS: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("tow", "gx", "gy", "gz", "ax", "ay", "az"),
    "gnss": ("tow", "lat", "lon", "height", "sn", "se", "sd"),
    "gnss with velocity": ("tow", "lat", "lon", "height", "sn", "se", "sd", "vn", "ve", "vd", "svn", "sve", "svd"),
    "reference": ("week", "tow", "lat", "lon", "height", "vn", "ve", "vd", "roll", "pitch", "heading"),
}
WEEK_S: Final = 604_800.0
_SUFFIXES: Final = (".txt", ".imu", ".pos", ".nav", ".gnss", ".csv", "")


class KfGinsParams(Params):
    """What the files do not tell."""

    week: int | None = setting(None, ge=0, le=10_000, doc="GPS week in which the log begins.")


def read(path: Path, params: KfGinsParams) -> Streams:
    """The streams imu, gnss and reference of a file, or of all files of a folder.

    Raises ReadFailed, and DataError where two files contradict each other.
    """
    found = {file: _kind(_top(_head(file))) for file in _files(path)}
    kinds = {file: kind for file, kind in found.items() if kind}
    if not kinds:
        raise ReadFailed(path, "it holds no table of KF-GINS", line=1, hint="7, 11 or 13 columns parted by blanks")
    tables = {file: _table(file, LAYOUTS[kind]) for file, kind in kinds.items()}
    week = params.week if params.week is not None else _week(tables)
    parts, told = [], [_not_read(file) for file, kind in found.items() if not kind and _is_of_numbers(_head(file))]
    for file, lines in tables.items():
        name = kinds[file].split()[0]
        made, learnt = _MAKERS[name](lines, *_times(lines, week))
        told += [*lines.learnt(), *learnt]
        if made is not None:
            clock, scale = ("relative", None) if week is None else ("absolute", "UTC")
            facts = {"format": "KF-GINS", "clock": clock, "time_scale": scale}
            parts.append(Recording({name: with_meta(made, **facts)}, {"sources": [file.name]}))
    if not parts:
        raise ReadFailed(path, "no row holds a measurement", line=1, hint="check that the log was copied completely")
    if week is None:
        told.append(warning("no file names the week: times count from its beginning; set reader.kf_gins.week"))
    recording, learnt = combine(parts)
    return {**recording, "metrics": metrics([*told, *learnt])}


def sniff(path: Path, head: bytes) -> Sniff:
    """Rows of 7, 11 or 13 numbers that can be what they should."""
    if path.is_dir():
        found = sorted({kind.split()[0] for file in _files(path) if (kind := _kind(_top(_head(file))))})
        return Sniff(0.85, f"folder with {', '.join(found)} of KF-GINS") if len(found) > 1 else Sniff(0.0, "no tables")
    if not_text(head):
        return Sniff(0.0, "no text")
    kind = _kind(_top(head))
    return Sniff(0.85, f"columns of KF-GINS: {kind}") if kind else Sniff(0.0, "not 7, 11 or 13 columns of KF-GINS")


# --- files ----------------------------------------------------------------------------------------------------------


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES and file.is_file())
    return found[:MOST_FILES]


def _head(file: Path) -> bytes:
    with file.open("rb") as opened:
        return opened.read(HEAD_BYTES)


def _top(head: bytes) -> Array:
    """The first rows as numbers, (n, width); (0, 0) where they are none, or of different widths."""
    if not_text(head):
        return np.zeros((0, 0))
    rows = [line.split() for line in plain(head).split(b"\n")[: LOOK_AT + 1] if line.strip()][:LOOK_AT]
    rows = rows[:-1] if len(rows) > 1 else rows
    widths = [len(row) for row in rows]
    width = max(set(widths), key=widths.count, default=0)
    number = re.compile(rb"[+-]?\d{1,18}(?:\.\d{0,18})?(?:[eE][+-]?\d{1,2})?")
    good = [row for row in rows if len(row) == width and all(map(number.fullmatch, row))]
    if not good or len(good) < 0.8 * len(rows):
        return np.zeros((0, 0))
    return np.array([[float(part) for part in row] for row in good])


def _is_of_numbers(head: bytes) -> bool:
    """Is it empty, or do most of its lines begin with a number, in whatever code and layout? Then it is no prose."""
    lines = head.replace(b"\0", b"").lstrip(b"\xff\xfe\xef\xbb\xbf").splitlines()
    starts = [line.strip(b'" \t+-')[:1] for line in lines if line.strip()][:LOOK_AT]
    return sum(map(bytes.isdigit, starts)) >= 0.5 * len(starts)


def _not_read(file: Path) -> Metric:
    what = "is no table of KF-GINS: 7, 11 or 13 numbers in each line, parted by blanks, their times rising"
    return warning(f"{file.name} is not read, for it {what}")


def _kind(top: Array) -> str:
    """What the rows are by what they hold, "" where they are none of KF-GINS."""
    kind = next((name for name, layout in LAYOUTS.items() if len(layout) == top.shape[1] and name != "imu"), "")
    if not kind:
        return ""
    column = dict(zip(LAYOUTS[kind], top.T, strict=True))
    step_s = np.diff(column["tow"])
    timed = (
        len(top) > 1 and (step_s > 0).mean() >= 0.5 and (column["tow"] >= 0).all() and (column["tow"] <= WEEK_S).all()
    )
    if not timed:
        return ""
    place = top[:, 1:4] if kind != "reference" else top[:, 2:5]
    placed = (np.abs(place) <= (90.0, 360.0, 1e5)).all() and (np.ptp(place[:, :2], axis=0) < 0.5).all()
    placed &= (place[:, :2] != np.round(place[:, :2])).any(axis=1).all()
    if kind == "reference":
        week = column["week"]
        return kind if placed and ((week == np.round(week)) & (week >= 0) & (week < 10_000)).all() else ""
    if placed and ((top[:, 4:7] > 0) & (top[:, 4:7] < 1e3)).all():
        return kind
    return "imu" if len(LAYOUTS[kind]) == 7 and _feels_gravity(top) else ""


def _feels_gravity(top: Array) -> bool:
    """Are the last three columns, by the step of time, what a vehicle feels, and the others slower than a turn?"""
    step_s = np.diff(top[:, 0])
    good = (step_s > 0) & (step_s <= LONGEST_STEP_S)
    if not good.any():
        return False
    felt = np.median(np.linalg.norm(top[1:, 4:7][good], axis=1) / step_s[good])
    return bool(GRAVITY[0] < felt < GRAVITY[1] and (np.abs(top[1:, 1:4][good]).max(axis=1) / step_s[good] < 20.0).all())


def _table(path: Path, names: tuple[str, ...]) -> Lines:
    kinds = {name: TIME_TYPE if name == "tow" else pa.float64() for name in names}
    return read_lines(path, Text.open(path), Form(names, kinds))


def _week(tables: Mapping[Path, Lines]) -> int | None:
    """The week in which the references begin; None where there is none."""
    for lines in tables.values():
        if "week" in lines.columns:
            weeks = lines.columns["week"]
            known = weeks[(weeks >= 0) & (weeks < 10_000)]
            if len(known):
                return int(np.median(known[:LOOK_AT]))
    return None


def _times(lines: Lines, week: int | None) -> tuple[Times, Mask]:
    """UTC where the week is known, else since its beginning: (n,) ns; and which rows have none, (n,) bool."""
    tow_ns, missing = lines.columns.pop("tow"), lines.columns.pop("no_tow")
    missing = missing | (tow_ns < 0) | (tow_ns > 10 * WEEK_NS)
    weeks = np.zeros(len(tow_ns), dtype=np.int64)
    told = lines.columns.pop("week", None)
    if told is not None and week is not None:
        known = (told >= 0) & (told < 10_000)
        weeks[known], missing = told[known].astype(np.int64) - week, missing | ~known
    else:
        weeks = np.cumsum(np.diff(tow_ns, prepend=tow_ns[:1]) < -WEEK_NS // 2)
    t_ns = tow_ns + weeks * WEEK_NS
    if week is None or missing.all():
        return t_ns, missing
    first = (GPS_EPOCH_NS + week * WEEK_NS + t_ns[np.argmin(missing)])[None]
    return t_ns + GPS_EPOCH_NS + week * WEEK_NS - (first - gps_to_utc(first)), missing


# --- streams --------------------------------------------------------------------------------------------------------


def _imu(lines: Lines, t_ns: Times, missing: Mask) -> tuple[pa.Table | None, list[Metric]]:
    """Mean rates over the steps, at their middle; the first row, whose step is not known, is left out."""
    usable = in_order(t_ns, missing)
    rows = np.flatnonzero(usable)
    step_ns = np.diff(t_ns[rows])
    good = (step_ns > 0) & (step_ns <= LONGEST_STEP_S * NS)
    rows, step_ns = rows[1:][good], step_ns[good]
    groups = {}
    for name, logged in zip(IMU.only("accel", "gyro").names[1:], ("ax", "ay", "az", "gx", "gy", "gz"), strict=True):
        groups[name] = lines.columns.pop(logged)[rows] / (step_ns * (-1e-9 if name[-1] in "yz" else 1e-9))
    times = t_ns[rows] - step_ns // 2
    left_out = lines.rows - len(rows) - 1
    source = Source(lines.path, "imu", lambda row: lines.line(int(rows[row])))
    made, told = stream(source, IMU, times, np.zeros(len(rows), dtype=bool), groups)
    learnt = [
        Metric("axes", note="imu: logged along forward, right, down; given along forward, left, up"),
        Metric("increments", float(len(rows)), note="divided by their steps, given at the middle of each step"),
    ]
    if left_out > 0:
        note = f"of imu: no row at most {LONGEST_STEP_S:g} s before, or a time out of order"
        learnt.append(Metric("rows_left_out", float(left_out), note=note))
    return (None if made is None else with_meta(made, axes="FRD")), [*learnt, *told]


def _gnss(lines: Lines, t_ns: Times, missing: Mask) -> tuple[pa.Table | None, list[Metric]]:
    columns = {name: lines.columns.pop(name) for name in ("lat", "lon", "height")}
    columns |= {f"pos_std_{axis}": lines.columns.pop(f"s{logged}") for axis, logged in zip("enu", "end", strict=True)}
    if "vn" in lines.columns:
        columns |= dict(zip(("vel_e", "vel_n", "vel_u"), _velocity(lines), strict=True))
        columns |= {f"vel_std_{axis}": lines.columns.pop(f"sv{way}") for axis, way in zip("enu", "end", strict=True)}
    made, told = stream(Source(lines.path, "gnss", lines.line), GNSS, t_ns, missing, columns)
    return (None if made is None else with_meta(made, height_datum="ellipsoid")), told


def _velocity(lines: Lines) -> list[Array]:
    """East, north, up."""
    return [lines.columns.pop("ve"), lines.columns.pop("vn"), -lines.columns.pop("vd")]


def _reference(lines: Lines, t_ns: Times, missing: Mask) -> tuple[pa.Table | None, list[Metric]]:
    place = [lines.columns.pop(name) for name in ("lat", "lon", "height")]
    roll, pitch, heading = (np.radians(lines.columns.pop(name)) for name in ("roll", "pitch", "heading"))
    columns, facts = reference_columns(place, _velocity(lines), (yaw_from_heading(heading), -pitch, roll))
    if not columns:
        return None, []
    made, told = stream(Source(lines.path, "reference", lines.line), REFERENCE, t_ns, missing, columns)
    return (None if made is None else with_meta(made, **facts)), told


_MAKERS: Final = {"imu": _imu, "gnss": _gnss, "reference": _reference}


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of the texts of KF-GINS."""
    yield Reader(
        name="kf_gins",
        summary="Texts of KF-GINS and awesome-gins: increments of an IMU, GNSS positions, a reference.",
        params=KfGinsParams,
        run=read,
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "pos_std", "vel", "vel_std").possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
        },
        references=("i2Nav group, awesome-gins-datasets, README",),
    )
