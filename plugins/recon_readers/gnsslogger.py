"""Text logs of Google's GnssLogger on Android: fixes and sensors; raw observations stay where they are.

    # Fix,Provider,LatitudeDegrees,LongitudeDegrees,...   a comment names the columns of each kind of line
    Fix,GPS,37.4265,-122.1737,23.7,0.0,4.2,,1699400582000,...
    Accel,utcTimeMillis,elapsedRealtimeNanos,x,y,z        m/s^2; Gyro in rad/s, Mag in uT
    UncalAccel,...,x,y,z,bias x,bias y,bias z             the same without the phone's corrections

Of sensors that are logged both ways the corrected one is taken, else what is measured less its bias. Their times are
those of the phone's clock, elapsedRealtimeNanos, set to UTC by utcTimeMillis of the first row, which counts
milliseconds. Fixes come from the receiver (GPS), the fused provider (FLP) and the network (NLP); `provider` chooses.

Reference: github.com/google/gps-measurement-tools, GnssLogger; Android, SensorEvent and Location.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import setting
from recon.rows import Metric, metrics, warning
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, vector
from recon_readers._columns import kept
from recon_readers._lines import Form, Lines, read_lines
from recon_readers._phone_streams import CIRCLE, WRITES, PhoneParams, Sensor, streams_of
from recon_readers._text_blocks import Text, load, plain

SENSORS: Final = {"accel": ("Accel", 1.0), "gyro": ("Gyro", 1.0), "mag": ("Mag", 1e-6)}
PROVIDERS: Final = ("GPS", "FLP", "NLP")
_FIX: Final = {
    "lat": ("LatitudeDegrees", "Latitude"),
    "lon": ("LongitudeDegrees", "Longitude"),
    "height": ("AltitudeMeters", "Altitude"),
    "speed": ("SpeedMps", "Speed"),
    "wide": ("AccuracyMeters", "Accuracy"),
    "course": ("BearingDegrees",),
    "time": ("UnixTimeMillis", "(UTC)TimeInMs"),
    "fast": ("SpeedAccuracyMps",),
    "high": ("VerticalAccuracyMeters",),
}
_ACCURACIES: Final = ("wide", "fast", "high")
_CLOCKS: Final = ("utcTimeMillis", "elapsedRealtimeNanos")
_LATEST_NS: Final = 4e18


class GnssloggerParams(PhoneParams):
    """Parameters of reader.gnsslogger."""

    provider: Literal["auto", "GPS", "FLP", "NLP"] = setting(
        "auto", doc="Whose fixes: receiver, fused or network; auto takes the first of these that there is."
    )


def read(path: Path, params: GnssloggerParams) -> Streams:
    """The streams imu, gnss and mag. Raises ReadFailed where the log holds none of them."""
    text = load(path)
    titles, raw_rows = _titles(text)
    sensors: dict[str, Sensor] = {}
    unnamed: list[Metric] = []
    for key, (name, unit) in SENSORS.items():
        found = _sensor(text, titles, name, key, unit)
        if found is not None:
            sensors[key] = found
        elif _has_lines(text, name, f"Uncal{name}"):
            unnamed.append(warning(f"no comment names the columns of {name}: its lines are left out"))
    place, learnt = _fixes(text, titles, params.provider)
    learnt = [*unnamed, *learnt]
    if place is not None:
        sensors["gnss"] = place
    facts = {"time_scale": "UTC", "clock": "absolute", "format": "GnssLogger"}
    made, told = streams_of(path, sensors, "specific_force", facts, params)
    if not made:
        hint = "switch on Location and Sensors in the app's settings; raw observations alone are not read"
        raise ReadFailed(path, "it holds neither fixes nor sensors", hint=hint)
    if raw_rows:
        learnt.append(Metric("raw_observations", float(raw_rows), note="lines, which are not read"))
    return {**made, "metrics": metrics([*learnt, *told])}


def _titles(text: Text) -> tuple[dict[str, tuple[str, ...]], int]:
    """The names of the columns by the kind of line, as comments tell them; and how many raw observations there are."""
    titles: dict[str, tuple[str, ...]] = {}
    raw_rows = 0
    for block in text.blocks():
        raw_rows += len(re.findall(rb"(?m)^Raw,", block))
        for kind, names in re.findall(rb"(?m)^#\s*(\w{1,30}),([^\n]*)$", block):
            titles.setdefault(kind.decode(), tuple(names.decode("utf-8", "replace").strip().split(",")))
    return titles, raw_rows


def _has_lines(text: Text, *kinds: str) -> bool:
    """Are there lines of any of these kinds?"""
    line = re.compile(rb"(?m)^(?:" + "|".join(kinds).encode() + rb"),")
    return any(line.search(block) for block in text.blocks())


def _lines(
    text: Text,
    kind: str,
    names: tuple[str, ...],
    wanted: tuple[str, ...],
    made: Callable[[pa.Table], Mapping[Any, NDArray[Any]]],
) -> Lines | None:
    """What is made of the wanted columns of a kind of line, the first of which is the kind itself."""
    if not set(wanted) <= set(names):
        return None
    rows = text.lines_like(re.compile(rb"(?m)^" + kind.encode() + rb",[^\n]*\n"))
    columns = (kind, *(n if names.index(n) == i else f"{n}#{i}" for i, n in enumerate(names)))
    kinds = {name: pa.string() if name == "Provider" else pa.float64() for name in wanted}
    return read_lines(text.path, rows, Form(columns, kinds, b","), made) if rows.size else None


def _sensor(text: Text, titles: Mapping[str, tuple[str, ...]], name: str, key: str, unit: float) -> Sensor | None:
    """A sensor, as the phone corrects it where that is logged."""
    for kind in (name, f"Uncal{name}"):
        names = titles.get(kind, ())
        if len(names) < 5 or names[:2] != _CLOCKS:
            continue
        biases = names[5:8] if kind != name and len(names) >= 8 else ()

        lines = _lines(text, kind, names, (*_CLOCKS, *names[2:5], *biases), _Felt(names, biases, key, unit))
        if lines is not None:
            return Sensor(kind, lines, lines.columns, numbered=False)
    return None


@dataclass
class _Felt:
    """Makes columns of a stream of those of a sensor; its clock is set to UTC by the first row that has both times.

    A double holds the some 1e13 ns since the phone was switched on to the nanosecond up to a hundred days.
    """

    names: tuple[str, ...]
    biases: tuple[str, ...]
    key: str
    unit: float
    zero_ns: int | None = None

    def __call__(self, table: pa.Table) -> dict[str, NDArray[Any]]:
        utc_ms, elapsed_ns = (vector(table, name, gaps=True) for name in _CLOCKS)
        missing = ~((utc_ms > 0.0) & (utc_ms < 1e-6 * _LATEST_NS) & (elapsed_ns >= 0.0) & (elapsed_ns < _LATEST_NS))
        elapsed = np.where(missing, 0.0, elapsed_ns).astype(np.int64)
        if self.zero_ns is None and not missing.all():
            first = int(missing.argmin())
            self.zero_ns = int(utc_ms[first]) * 1_000_000 - int(elapsed[first])
        found: dict[str, NDArray[Any]] = {"time": elapsed + (self.zero_ns or 0), "missing": missing}
        for at, axis in enumerate("xyz"):
            values = vector(table, self.names[2 + at], gaps=True)
            bias = np.nan_to_num(vector(table, self.biases[at], gaps=True)) if self.biases else 0.0
            found[f"{self.key}_{axis}"] = self.unit * (values - bias)
        return found


def _fixes(text: Text, titles: Mapping[str, tuple[str, ...]], provider: str) -> tuple[Sensor | None, list[Metric]]:
    names = titles.get("Fix", ())
    found = {key: next((name for name in choice if name in names), None) for key, choice in _FIX.items()}
    present = {key: name for key, name in found.items() if name is not None}
    if "Provider" not in names or not {"lat", "lon", "time"} <= present.keys():
        unnamed = warning("no comment names the columns of the fixes: they are left out")
        return None, [unnamed] * _has_lines(text, "Fix")

    def made(table: pa.Table) -> dict[str, NDArray[Any]]:
        from pyarrow import compute

        source = compute.index_in(compute.utf8_upper(table["Provider"]), value_set=pa.array(PROVIDERS))
        values = {key: vector(table, name, gaps=True) for key, name in present.items()}
        time_ms = values.pop("time")
        missing = ~((time_ms > 0.0) & (time_ms < 1e-6 * _LATEST_NS))
        t_ns = np.where(missing, 0.0, time_ms).astype(np.int64) * 1_000_000
        sources = np.asarray(source.fill_null(-1)).astype(np.int8)
        return {"time": t_ns, "missing": missing, "source": sources, **_place(values)}

    lines = _lines(text, "Fix", names, ("Provider", *present.values()), made)
    if lines is None:
        return None, []
    source = lines.columns.pop("source")
    counts = {name: int((source == n).sum()) for n, name in enumerate(PROVIDERS)}
    chosen = provider if provider != "auto" else next((name for name in PROVIDERS if counts[name]), "GPS")
    told = ", ".join(f"{count} of {name}" for name, count in counts.items())
    learnt = [Metric("fixes", float(counts[chosen]), method=chosen, note=f"in the log: {told}")]
    if chosen == "NLP":
        learnt.append(warning("the only fixes are of the network, some 20 m to km off"))
    rows = source == PROVIDERS.index(chosen)
    columns = {name: kept(lines.columns.pop(name), rows) for name in list(lines.columns)}
    return Sensor(f"fixes of {chosen}", lines, columns, numbered=False), learnt


def _place(values: Mapping[str, Array]) -> dict[str, Array]:
    """Columns of gnss; accuracies are those of 68 %."""
    columns = {name: values[name] for name in ("lat", "lon", "height", "speed") if name in values}
    if "course" in values:
        columns["course"] = np.radians(values["course"])
    wide, fast, high = (np.where(values[k] > 0.0, values[k], np.nan) if k in values else None for k in _ACCURACIES)
    none = np.full(len(values["lat"]), np.nan)
    if wide is not None:
        columns |= {"pos_std_e": wide / CIRCLE, "pos_std_n": wide / CIRCLE, "pos_std_u": none if high is None else high}
    if fast is not None:
        columns |= {"vel_std_e": fast, "vel_std_n": fast, "vel_std_u": none}
    return columns


def sniff(path: Path, head: bytes) -> Sniff:
    """The comments that name the columns of raw observations and fixes."""
    start = plain(head).lstrip()
    if start.startswith(b"#") and re.search(
        rb"(?m)^#\s*(Fix,Provider|Raw,(utcTimeMillis|ElapsedRealtimeMillis)),", start
    ):
        return Sniff(0.95, "comments that name the columns of GnssLogger")
    return Sniff(0.0, "no log of GnssLogger")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of GnssLogger."""
    yield Reader(
        name="gnsslogger",
        summary="Text logs of Google's GnssLogger: fixes, accelerometer, gyroscope, magnetometer.",
        params=GnssloggerParams,
        run=read,
        sniff=sniff,
        self_describing=True,
        writes=WRITES,
        references=("github.com/google/gps-measurement-tools",),
    )
