"""Vehicle crash tests of NHTSA in their ASCII form: accelerations of the vehicle.

    v10146.EV5         what was tested and measured: sections of fields parted by |
    v10146.093, ...    a channel each: time in s after the impact, value

A row of the section INSTRUMENTATION describes a channel: its number, what the sensor measures (AC acceleration, AV
angular velocity), on whom (NA: the vehicle; 01, 02: dummies), where, along which axis, units, and whether it is a
primary or redundant sensor. Sensors of one place make one stream: imu that with most axes, imu_2 the next, and so on;
metrics tell which is which. Axes that were not measured are null.

Axes are those of SAE J211: x forward, y right, z down; vectors are given along forward, left, up of the vehicle. The
sensors are zeroed before the test: the values are accelerations without gravity, not filtered. Times count from the
impact. The input is the .EV5, one channel beside it, or the folder of both.

Reference: NHTSA Test Reference Guide, volume I: vehicle tests, version 5; SAE J211-1.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.rounding import occasions
from recon.rows import Event, Metric, events, metrics, warning
from recon.schema import EVENTS, IMU, Change, spread
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon.units import convert
from recon_readers._arrays import FRONT_RIGHT_DOWN, interleave
from recon_readers._columns import kept
from recon_readers._lines import COPIED, Form, read_lines
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import Text, contents, plain
from recon_readers._time_order import Times, in_order, repeating
from recon_readers._time_text import TIME_TYPE

UNITS: Final = {("AC", "G'S"): ("accel", "g"), ("AV", "DPS"): ("gyro", "deg/s")}
"""By sensor and unit of a channel, the group of the stream and its unit."""
VEHICLE: Final = "NA"
AXES: Final = "XYZ"
CLOSING_SPEED: Final = 14
"""Field of the section TEST, km/h."""
_SECTION: Final = re.compile(r"-{3,} ?([A-Z0-9 ]+?) ?-{3,}")
_ENDING: Final = re.compile(r"\.\d{3}")
_IMU: Final = Change(frames={"accel": "vehicle", "gyro": "vehicle"}, quantities={"accel": "acceleration"}).apply(
    IMU.only("accel", "gyro")
)


_SAME_END: Final = 0.05
"""Share of their length by which channels of one place may end apart."""


@dataclass(frozen=True)
class Channel:
    """A curve: its number, group and unit, place, axis (0 to 2), whether it is redundant, and what is said of it."""

    number: int
    group: str
    unit: str
    place: str
    axis: int
    redundant: bool
    comment: str


def read(path: Path, params: NoParams) -> Streams:
    """The streams imu, imu_2, ... and the event of the impact. Raises ReadFailed."""
    description = _description(path)
    if description is None:
        raise ReadFailed(path, "there is no .EV5 beside it", line=1, hint="name the .EV5, or the folder that holds it")
    sections = _sections(description)
    channels, others = _channels(description, sections)
    wanted = path if path != description and path.is_file() else None
    files = {channel: file for channel in channels if (file := _file(description, channel, wanted)) is not None}
    if not files:
        what = f"of its {len(channels)} channels of the vehicle no file is there"
        hint = f"put {description.stem}.001 and so on beside it"
        raise ReadFailed(description, what, line=1 if description.is_file() else None, hint=hint)
    streams, learnt = _streams(files)
    if not streams:
        raise ReadFailed(path, "no channel holds a value", line=1, hint=COPIED)
    note = f"{len(files)} of {len(channels)} channels of the vehicle are here; {others} of dummies and barrier not read"
    counted = [Metric("channels", float(len(files)), note=note), *_closing_speed(sections)]
    impact = events([Event(0, 0, "impact", note="time zero of the test")])
    return {**streams, "events": impact, "metrics": metrics([*counted, *learnt])}


def sniff(path: Path, head: bytes) -> Sniff:
    """The sections of an .EV5, or a channel or folder beside one."""
    if path.is_dir():
        known = _description(path) is not None
        return Sniff(0.95, "folder of a crash test of NHTSA") if known else Sniff(0.0, "no .EV5 in it")
    if b"-- EV5 --" in head and b"|" in head:
        return Sniff(0.95, "description of a crash test of NHTSA")
    if _ENDING.fullmatch(path.suffix) and _description(path) is not None:
        return Sniff(0.9, "a channel beside the .EV5 of a crash test")
    return Sniff(0.0, "no .EV5 of NHTSA, nor a channel beside one")


# --- files ----------------------------------------------------------------------------------------------------------


def _description(path: Path) -> Path | None:
    """The .EV5 at a path, in a folder, or beside a channel; None where there is none, or several."""
    if path.is_file() and path.suffix.lower() == ".ev5":
        return path
    if path.is_file() and not _ENDING.fullmatch(path.suffix):
        with path.open("rb") as file:
            return path if b"-- EV5 --" in file.read(4096) else None
    found = [part for part in (path if path.is_dir() else path.parent).iterdir() if part.suffix.lower() == ".ev5"]
    named = [part for part in found if path.is_dir() or part.stem == path.stem]
    return named[0] if len(named) == 1 else None


def _file(description: Path, channel: Channel, wanted: Path | None) -> Path | None:
    """The file of a channel, None where it is not there, or another one is wanted alone."""
    file = description.with_suffix(f".{channel.number:03d}")
    return file if file.is_file() and wanted in (None, file) else None


def _sections(path: Path) -> dict[str, list[list[str]]]:
    """Rows of fields by section. Raises ReadFailed where there is no INSTRUMENTATION."""
    found: dict[str, list[list[str]]] = {}
    title = ""
    lines = plain(contents(path)).decode("latin-1").split("\n")
    for line in lines:
        named = _SECTION.fullmatch(line.strip())
        if named:
            title = named[1]
        elif "|" in line and title:
            found.setdefault(title, []).append([part.strip() for part in line.split("|")])
    if "INSTRUMENTATION" not in found:
        raise ReadFailed(path, "it has no section INSTRUMENTATION", line=len(lines), hint=COPIED)
    return found


def _channels(path: Path, sections: Mapping[str, list[list[str]]]) -> tuple[list[Channel], int]:
    """The channels of the vehicle, and how many others there are."""
    found = []
    rows = sections["INSTRUMENTATION"]
    for row in rows:
        if len(row) < 8 or not row[1].isdigit() or len(row[1]) > 6:
            continue
        known = UNITS.get((row[2], row[7].upper()))
        axis = AXES.find(row[5][:1]) if row[5] else -1
        if known is None or row[3] != VEHICLE or axis < 0:
            continue
        comment, redundant = row[-1], len(row) > 2 and row[-2] == "R"
        found.append(Channel(int(row[1]), *known, row[4], axis, redundant, comment))
    if not found:
        what = f"none of its {len(rows)} channels is an acceleration of the vehicle"
        raise ReadFailed(path, what, line=1, hint="sensors of dummies, belts and barriers are not read")
    return found, len(rows) - len(found)


# --- streams --------------------------------------------------------------------------------------------------------


def _streams(files: Mapping[Channel, Path]) -> tuple[Streams, list[Metric]]:
    """A stream for each place, that with most axes first."""
    places: dict[tuple[str, bool], list[Channel]] = {}
    for channel in files:
        places.setdefault((channel.place, channel.redundant), []).append(channel)
    order = sorted(places.values(), key=lambda group: (group[0].redundant, -len(group), group[0].number))
    streams: Streams = {}
    learnt: list[Metric] = []
    for group in order:
        name = f"imu_{len(streams) + 1}" if streams else "imu"
        made, told = _stream(name, group, files)
        learnt += told
        if made is not None:
            streams[name] = made
            said = "; ".join(f"{channel.number} {channel.comment}" for channel in group)
            learnt.append(Metric("place", method=name, note=f"{group[0].place}: {said}"))
    return streams, learnt


def _stream(name: str, group: list[Channel], files: Mapping[Channel, Path]) -> tuple[pa.Table | None, list[Metric]]:
    curves: dict[str, tuple[Times, Array]] = {}
    learnt: list[Metric] = []
    for channel in group:
        column = f"{channel.group}_{AXES[channel.axis].lower()}"
        if column in curves:
            learnt.append(warning(f"channel {channel.number} is a second one of its place and axis: it is not read"))
            continue
        t_ns, values, told = _curve(files[channel])
        t_ns = next((other for other, _ in curves.values() if np.array_equal(other, t_ns)), t_ns)  # held once
        unit = convert(1.0, channel.unit, "m/s^2" if channel.group == "accel" else "rad/s")
        curves[column] = (t_ns, values * (unit * FRONT_RIGHT_DOWN[channel.axis]))
        learnt += told
    learnt += _cut(group[0].place, curves)
    t_ns, columns = interleave(curves)
    source = Source(files[group[0]], name)
    for quantity in sorted({channel.group for channel in group}):  # an axis that was not measured is null
        columns |= {axis: np.full(len(t_ns), np.nan) for axis in spread(quantity, _IMU.names) if axis not in columns}
    made, told = stream(source, _IMU, t_ns, np.zeros(len(t_ns), dtype=bool), columns)
    facts = {"clock": "relative", "format": "NHTSA EV5", "axes": "FRD", "place": group[0].place}
    return (None if made is None else with_meta(made, **facts)), [*learnt, *told]


def _cut(place: str, curves: Mapping[str, tuple[Times, Array]]) -> list[Metric]:
    """What is to be said where the channels of one place end at different times: one of their files is cut."""
    ends = {column: int(t_ns[-1]) if len(t_ns) else None for column, (t_ns, _) in curves.items()}
    known = [end for end in ends.values() if end is not None]
    short = [
        column
        for column, end in ends.items()
        if end is None or max(known) - end > _SAME_END * (max(known) - int(curves[column][0][0]))
    ]
    if not short:
        return []
    return [warning(f"of {place}, {', '.join(short)} ends before the other axes do: copy the files again")]


def _curve(path: Path) -> tuple[Times, Array, list[Metric]]:
    """Times (n,) ns that rise and values (n,) of a channel. Raises ReadFailed."""
    form = Form(("time", "value"), {"time": TIME_TYPE, "value": pa.float64()})
    lines = read_lines(path, Text.open(path), form)
    t_ns, missing = lines.columns.pop("time"), lines.columns.pop("no_time")
    rows = in_order(t_ns, missing)
    rows &= ~repeating(t_ns, [rows])
    learnt = lines.learnt() if lines.skipped else []
    lost = len(rows) - int(rows.sum())
    if lost:
        learnt.append(
            warning(f"left out of {path.name}: time is missing, repeats or is out of order ({occasions(lost)})")
        )
    return kept(t_ns, rows), kept(lines.columns.pop("value"), rows), learnt


def _closing_speed(sections: Mapping[str, list[list[str]]]) -> list[Metric]:
    test = sections.get("TEST", [[]])[0]
    try:
        speed = float(test[CLOSING_SPEED]) / 3.6
    except (IndexError, ValueError):
        return []
    note = "before the impact, as the description of the test says"
    return [Metric("closing_speed", speed, "m/s", note=note)] if np.isfinite(speed) else []


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of NHTSA's crash tests."""
    yield Reader(
        name="nhtsa",
        summary="Crash tests of NHTSA in ASCII (EV5): accelerations of the vehicle.",
        run=read,
        sniff=sniff,
        writes={"imu": _IMU.possible(), "events": EVENTS},
        references=("NHTSA Test Reference Guide, volume I: vehicle tests, version 5", "SAE J211-1"),
    )
