"""Recordings of the app phyphox: its folder, its zip, or a table of it, as CSV with any separator and decimal mark.

    <sensor>.csv     "Time (s)", then columns with their units: "Acceleration x (m/s^2)", "X (rad/s)", "Latitude (°)"
    meta/time.csv    "event", "experiment time", "system time": when it was started and paused, s since 1970

What a column is follows from its unit, and of m/s^2 from its name or that of its file: a linear acceleration is without
gravity, the other kind is specific force; phyphox turns those of iPhones to the signs of Android. Times of an
experiment stand still while it is paused; each start gives them a new place in UTC. Without meta/time.csv they
count from the start.

Reference: phyphox.org/wiki, "Data export" and "Time reference".
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path, PurePosixPath
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import setting
from recon.rows import Metric, metrics, warning
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, vector, with_meta
from recon_readers._phone_files import Files, Sheet, files_of, header_of, is_zip, sheet_of
from recon_readers._phone_streams import CIRCLE, WRITES, PhoneParams, Sensor, streams_of
from recon_readers._text_blocks import plain
from recon_readers._time_order import Mask, Times

TIMES: Final = "meta/time.csv"
_TITLE: Final = re.compile(r"^(?P<name>.*?)\s*\((?P<unit>[^()]*)\)$")
_UNITS: Final[Mapping[str, str]] = {
    "m/s^2": "accel", "m/s²": "accel", "m/s2": "accel", "rad/s": "gyro", "µt": "mag", "μt": "mag", "ut": "mag",
}  # fmt: skip
_PLACE: Final[Mapping[str, str]] = {
    "latitude": "lat", "longitude": "lon", "height": "height", "altitude": "height", "velocity": "speed",
    "speed": "speed", "direction": "course", "bearing": "course", "horizontal accuracy": "wide",
    "vertical accuracy": "high",
}  # fmt: skip
_LATEST_S: Final = 4_000_000_000


class PhyphoxParams(PhoneParams):
    """What the tables do not tell."""

    height_datum: Literal["mean_sea_level", "ellipsoid"] = setting(
        "mean_sea_level", doc="What heights of Location.csv count from; phones differ."
    )


class _Known(NamedTuple):
    """A table whose columns are known: what it holds, the column of time, and the others by what they are."""

    kind: str
    time: str
    columns: dict[str, str]


class _Clock(NamedTuple):
    """Experiment times (k,) s at which the experiment was started, and when that was, (k,) ns since 1970."""

    start_s: Array
    start_ns: Times


def read(path: Path, params: PhyphoxParams) -> Streams:
    """The streams imu, gnss, mag and baro of the tables there are. Raises ReadFailed where none holds a measurement."""
    files = files_of(path)
    clock = _clock(files)
    sensors: dict[str, Sensor] = {}
    for name in _csv_names(files):
        sheet = sheet_of(files, name)
        known = _known(sheet.names, name)
        sensor = _sensor(sheet, known, clock) if known else None
        if known and sensor:
            sensors.setdefault(known.kind, sensor)
    linear = sensors.pop("linear", None)
    felt: Literal["specific_force", "acceleration"] = "specific_force"
    learnt: list[Metric] = []
    if "accel" not in sensors and linear is not None:
        sensors, felt = {"accel": linear, **sensors}, "acceleration"
        learnt.append(
            warning("the acceleration is without gravity: the sensor 'Acceleration (with g)' would tell more")
        )
    facts = {"format": "phyphox", "clock": "absolute" if clock else "relative", "time_scale": "UTC" if clock else None}
    made, told = streams_of(path, sensors, felt, facts, params)
    if not made:
        raise ReadFailed(path, "no table of phyphox in it holds a measurement", hint="was anything recorded?")
    if clock is None:
        learnt.append(warning(f"there is no {TIMES}: times count from the start of the experiment"))
    if "gnss" in made:
        made["gnss"] = with_meta(made["gnss"], height_datum=params.height_datum)
        learnt.append(Metric("assumed_height_datum", note=params.height_datum))
    return {**made, "metrics": metrics([*learnt, *told])}


def _csv_names(files: Files) -> list[str]:
    return [name for name in files.names if name.lower().endswith(".csv") and not name.lower().startswith("meta/")]


def _known(names: tuple[str, ...], file: str) -> _Known | None:
    """What a table with these columns holds; None where it is no sensor's."""
    titles = {name: match for name in names if (match := _TITLE.match(name))}
    time = next((n for n, m in titles.items() if m["name"].lower() in ("time", "t") and m["unit"] == "s"), None)
    if time is None:
        return None
    found: dict[str, dict[str, str]] = {}
    for name, match in titles.items():
        word, unit = match["name"].lower(), match["unit"].lower()
        if unit in _UNITS and word[-1:] in ("x", "y", "z") and word[:-1].strip() in ("", *_WORDS):
            kind = _UNITS[unit]
            if kind == "accel" and ("linear" in word or (len(word) == 1 and _is_linear(file))):
                kind = "linear"
            found.setdefault(kind, {}).setdefault(word[-1], name)
        elif word in _PLACE:
            found.setdefault("gnss", {}).setdefault(_PLACE[word], name)
        elif unit == "hpa":
            found.setdefault("baro", {}).setdefault("pressure", name)
    for kind, columns_ in found.items():
        whole = {"lat", "lon"} <= columns_.keys() if kind == "gnss" else kind == "baro" or len(columns_) == 3
        if whole:
            return _Known(kind, time, columns_)
    return None


_WORDS: Final = (
    "acceleration", "linear acceleration", "accelerometer", "gyroscope", "angular velocity", "rotation rate",
    "rotation", "magnetic field", "magnetometer",
)  # fmt: skip


def _is_linear(file: str) -> bool:
    stem = PurePosixPath(file).stem.lower()
    return "linear" in stem or "without g" in stem


def _sensor(sheet: Sheet, known: _Known, clock: _Clock | None) -> Sensor | None:
    def made(table: pa.Table) -> dict[Any, NDArray[Any]]:
        t_ns, missing = _times(vector(table, known.time, gaps=True), clock)
        values = {what: vector(table, name, gaps=True) for what, name in known.columns.items()}
        return {"time": t_ns, "missing": missing, **_columns(known.kind, values)}

    lines = sheet.lines(dict.fromkeys((known.time, *known.columns.values()), pa.float64()), made)
    return Sensor(PurePosixPath(sheet.path.name).stem, lines, lines.columns) if lines is not None else None


def _columns(kind: str, values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns of a stream in its units."""
    if kind == "gnss":
        return _place(values)
    if kind == "baro":
        return {"pressure": 100.0 * values["pressure"]}
    group, unit = {"linear": ("accel", 1.0), "mag": ("mag", 1e-6)}.get(kind, (kind, 1.0))
    return {f"{group}_{axis}": unit * values[axis] for axis in "xyz"}


def _place(values: Mapping[str, Array]) -> dict[str, Array]:
    found: dict[str, Array] = {name: values[name] for name in values if name in ("lat", "lon", "height")}
    if "speed" in values:
        found["speed"] = np.where(values["speed"] < 0.0, np.nan, values["speed"])
    if "course" in values:
        found["course"] = np.where(values["course"] < 0.0, np.nan, np.radians(values["course"]))
    if "wide" in values:
        wide = np.where(values["wide"] > 0.0, values["wide"] / CIRCLE, np.nan)
        found |= {"pos_std_e": wide, "pos_std_n": wide, "pos_std_u": values.get("high", np.full(len(wide), np.nan))}
    return found


def _times(t_s: Array, clock: _Clock | None) -> tuple[Times, Mask]:
    """Experiment times as ns since 1970, or since the start; and where there is none."""
    missing = ~(np.abs(t_s) < _LATEST_S)
    kept = np.where(missing, 0.0, t_s)
    if clock is None:
        return np.rint(kept * 1e9).astype(np.int64), missing
    part = np.clip(np.searchsorted(clock.start_s, kept, side="right") - 1, 0, None)
    return clock.start_ns[part] + np.rint((kept - clock.start_s[part]) * 1e9).astype(np.int64), missing


def _clock(files: Files) -> _Clock | None:
    """When the experiment was started; None where meta/time.csv is not there or tells nothing."""
    raw = files.optional(TIMES)
    if raw is None:
        return None
    names, separator = header_of(raw.partition(b"\n")[0])
    text = raw.decode("utf-8", "replace").replace("\0", "")
    starts = []
    try:
        for row in csv.DictReader(text.split("\n")[1:], fieldnames=list(names), delimiter=separator.decode()):
            since, at = (Decimal((row.get(key) or "").replace(",", ".")) for key in ("experiment time", "system time"))
            if row.get("event") == "START" and abs(since) < _LATEST_S and 0 < at < _LATEST_S:
                starts.append((float(since), int(at * 1_000_000_000)))
    except (csv.Error, InvalidOperation):
        return None
    starts.sort()
    if not starts:
        return None
    return _Clock(np.array([s for s, _ in starts]), np.array([ns for _, ns in starts], dtype=np.int64))


def sniff(path: Path, head: bytes) -> Sniff:
    """A header with "Time (s)" and columns that name their units as phyphox does."""
    if path.is_dir() or is_zip(path):
        try:
            files = files_of(path)
            tables = [name for name in _csv_names(files)[:20] if _is_known(files.head(name), name)]
        except ReadFailed:
            return Sniff(0.0, "no whole zip")
        if not tables:
            return Sniff(0.0, "no tables of phyphox")
        with_times = TIMES in files.names
        return Sniff(0.95 if with_times else 0.8, f"tables of phyphox{' and their ' + TIMES if with_times else ''}")
    return Sniff(0.85, "columns of phyphox") if _is_known(head, path.name) else Sniff(0.0, "no table of phyphox")


def _is_known(head: bytes, name: str) -> bool:
    names, _ = header_of(plain(head).partition(b"\n")[0])
    return _known(names, name) is not None


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of phyphox."""
    yield Reader(
        name="phyphox",
        summary="Recordings of the app phyphox: folder, zip or single tables, with any separator and decimal mark.",
        params=PhyphoxParams,
        run=read,
        sniff=sniff,
        self_describing=True,
        writes=WRITES,
        references=("phyphox.org/wiki, Data export",),
    )
