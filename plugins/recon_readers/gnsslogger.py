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
from collections.abc import Iterable
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import setting
from recon.rows import Metric, metrics, warning
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams
from recon_readers._delimited import contents, not_text
from recon_readers._lines import Form, Lines, read_lines
from recon_readers._phone_streams import CIRCLE, WRITES, PhoneParams, Sensor, columns, streams_of
from recon_readers._text_blocks import plain
from recon_readers._time_order import Mask, Times

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
_CLOCKS: Final = ("utcTimeMillis", "elapsedRealtimeNanos")
_LATEST_NS: Final = 4e18


class GnssloggerParams(PhoneParams):
    """Parameters of reader.gnsslogger."""

    provider: Literal["auto", "GPS", "FLP", "NLP"] = setting(
        "auto", doc="Whose fixes: receiver, fused or network; auto takes the first of these that there is."
    )


def read(path: Path, params: GnssloggerParams) -> Streams:
    """The streams imu, gnss and mag. Raises ReadFailed where the log holds none of them."""
    raw = contents(path)
    fault = not_text(raw[:65536])
    if fault:
        raise ReadFailed(path, fault[0], hint=fault[1])
    text = plain(raw)
    sensors: dict[str, Sensor] = {}
    for key, (name, unit) in SENSORS.items():
        found = _sensor(path, text, name, key, unit)
        if found is not None:
            sensors[key] = found
    place, learnt = _fixes(path, text, params.provider)
    if place is not None:
        sensors["gnss"] = place
    facts = {"time_scale": "UTC", "clock": "absolute", "format": "GnssLogger"}
    made, told = streams_of(path, sensors, "specific_force", facts, params)
    if not made:
        hint = "switch on Location and Sensors in the app's settings; raw observations alone are not read"
        raise ReadFailed(path, "it holds neither fixes nor sensors", hint=hint)
    raw_rows = len(re.findall(rb"(?m)^Raw,", text))
    if raw_rows:
        learnt.append(Metric("raw_observations", float(raw_rows), note="lines, which are not read"))
    return {**made, "metrics": metrics([*learnt, *told])}


def _rows(text: bytes, kind: str) -> tuple[tuple[str, ...], bytes]:
    """The names of the columns of a kind of line, () where no comment tells, and its lines."""
    title = re.search(rb"(?m)^#\s*" + kind.encode() + rb",([^\n]*)$", text)
    names = tuple(title[1].decode("utf-8", "replace").strip().split(",")) if title else ()
    return names, b"\n".join(re.findall(rb"(?m)^" + kind.encode() + rb",[^\n]*$", text))


def _table(path: Path, kind: str, names: tuple[str, ...], rows: bytes, wanted: tuple[str, ...]) -> Lines | None:
    """The wanted columns of a kind of line, the first of which is the kind itself."""
    if not rows or not names or not set(wanted) <= set(names):
        return None
    whole = rows if rows.endswith(b"\n") else rows + b"\n"
    form = Form((kind, *(n if names.index(n) == i else f"{n}#{i}" for i, n in enumerate(names))), {}, b",")
    texts = {name: pa.string() if name == "Provider" else pa.float64() for name in wanted}
    return read_lines(path, whole, 1, Form(form.names, texts, b","))


def _sensor(path: Path, text: bytes, name: str, key: str, unit: float) -> Sensor | None:
    """A sensor, as the phone corrects it where that is logged."""
    for kind in (name, f"Uncal{name}"):
        names, rows = _rows(text, kind)
        axes, biases = names[2:5], names[5:8]
        if len(axes) < 3 or names[:2] != _CLOCKS:
            continue
        lines = _table(path, kind, names, rows, (*_CLOCKS, *axes, *(biases if len(biases) == 3 else ())))
        if lines is None:
            continue
        values = columns(lines, axes)
        if kind != name and len(biases) == 3:
            values = values - np.nan_to_num(columns(lines, biases))
        t_ns, missing = _on_utc(*columns(lines, _CLOCKS).T)
        return Sensor(kind, lines, t_ns, missing, {key: unit * values}, numbered=False)
    return None


def _on_utc(utc_ms: Array, elapsed_ns: Array) -> tuple[Times, Mask]:
    """Times of the phone's clock on UTC: (n,) ns, and where there is none.

    A double holds the some 1e13 ns since the phone was switched on to the nanosecond up to a hundred days.
    """
    missing = ~((utc_ms > 0.0) & (utc_ms < 1e-6 * _LATEST_NS) & (elapsed_ns >= 0.0) & (elapsed_ns < _LATEST_NS))
    utc = np.where(missing, 0.0, utc_ms).astype(np.int64) * 1_000_000
    elapsed = np.where(missing, 0.0, elapsed_ns).astype(np.int64)
    if missing.all():
        return elapsed, missing
    return elapsed + (utc - elapsed)[int(missing.argmin())], missing


def _fixes(path: Path, text: bytes, provider: str) -> tuple[Sensor | None, list[Metric]]:
    names, rows = _rows(text, "Fix")
    found = {key: next((name for name in choice if name in names), None) for key, choice in _FIX.items()}
    needed = ("lat", "lon", "time")
    if not rows:
        return None, []
    if "Provider" not in names or any(found[key] is None for key in needed):
        return None, [warning("no comment names the columns of the fixes: they are left out")]
    present = {key: name for key, name in found.items() if name is not None}
    lines = _table(path, "Fix", names, rows, ("Provider", *present.values()))
    if lines is None:
        return None, []
    sources = [str(source or "").upper() for source in lines.table["Provider"].to_pylist()]
    counts = {name: sources.count(name) for name in PROVIDERS}
    chosen = provider if provider != "auto" else next((name for name in PROVIDERS if counts[name]), "GPS")
    told = ", ".join(f"{count} of {name}" for name, count in counts.items())
    learnt = [Metric("fixes", float(counts[chosen]), method=chosen, note=f"in the log: {told}")]
    if chosen == "NLP":
        learnt.append(warning("the only fixes are of the network, some 20 m to km off"))
    values = dict(zip(present, columns(lines, tuple(present.values())).T, strict=True))
    time_ms = values.pop("time")
    missing = ~((time_ms > 0.0) & (time_ms < 1e-6 * _LATEST_NS)) | (np.array(sources) != chosen)
    t_ns = np.where(missing, 0.0, time_ms).astype(np.int64) * 1_000_000
    values = {name: np.where(missing, np.nan, column) for name, column in values.items()}
    return Sensor(f"fixes of {chosen}", lines, t_ns, missing, _place(values), numbered=False), learnt


def _place(values: dict[str, Array]) -> dict[str, Array]:
    """Groups of gnss; accuracies are those of 68 %."""
    none = np.full(len(values["lat"]), np.nan)
    wide, fast, high = (
        np.where(values.get(k, none) > 0.0, values.get(k, none), np.nan) for k in ("wide", "fast", "high")
    )
    groups: dict[str, Array] = {
        **{name: values[name] for name in values if name in ("lat", "lon", "height", "speed")},
        "course": np.radians(values.get("course", none)),
        "pos_std": np.column_stack([wide / CIRCLE, wide / CIRCLE, high]),
        "vel_std": np.column_stack([fast, fast, none]),
    }
    return {name: value for name, value in groups.items() if np.isfinite(value).any()}


def sniff(path: Path, head: bytes) -> Sniff:
    """The comments that name the columns of raw observations and fixes."""
    start = head.lstrip(b"\xef\xbb\xbf\r\n ")
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
