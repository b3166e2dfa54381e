"""Racelogic VBOX files (.vbo): GNSS at up to 100 Hz, and the IMU where one was connected.

A text of sections: [header] with names and some units, [column names], [data] with rows parted by blanks.

    sats       number of satellites, + 64 while the brake trigger is pressed, + 128 with differential corrections
    time       HHMMSS.sss, UTC; the date is that of the line "File created on"; counts on over midnight
    lat, long  minutes, positive north and WEST
    velocity   km/h or knots, as [header] tells; heading deg clockwise from true north; height m above mean sea level

Of an IMU: X_Accel, Y_Accel, Z_Accel in g; RollRate, PitchRate, YawRate about x, y, z in deg/s. Boxes of Racelogic
differ in the senses of their axes, and the file does not tell: without the parameter `axes` the IMU is left out.

Reference: Racelogic, VBOX file format (.vbo); VBOX 3i user guide; "Signing conventions" (support.racelogic).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.axes import turn
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.gnss_time import DAY_NS, NS, leap_seconds
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, vector, with_meta
from recon.units import convert
from recon_readers._csv_mapping import Axes
from recon_readers._delimited import contents
from recon_readers._lines import COPIED, Form, Lines, read_lines
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import plain
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import clocks, days, over_midnight

PLACE: Final = ("lat", "long", "velocity", "heading", "height", "sats")
ACCEL: Final = ("x_accel", "y_accel", "z_accel")
RATES: Final = ("rollrate", "pitchrate", "yawrate")
FLAGS: Final = 64
"""Satellites are counted below this."""
_CREATED: Final = re.compile(r"File created on (\d\d)/(\d\d)/(\d{4})(?: @ (\d\d):(\d\d))?")
_OFFSET: Final = re.compile(r"GPS Time offset by -(\d+) seconds")
_AXES_HOW: Final = (
    "set reader.vbox.axes to where X, Y and Z point, such as FLU: on a drive, X_Accel grows when the vehicle speeds up "
    "if x points forward, YawRate is positive in a left turn if z points up"
)


class VboxParams(Params):
    """What the file does not tell."""

    axes: Axes = setting("", doc="Where X, Y and Z of the IMU point: FLU, FRD, ... Without it the IMU is left out.")
    at_rest: Literal["up", "down"] = setting("up", doc="Where accelerations at rest point: up is specific force.")
    speed_unit: Literal["km/h", "kn"] | None = setting(None, doc="Unit of the velocity where the header does not tell.")


@dataclass(frozen=True)
class _File:
    """Sections of a file: lines by title; the text above the first under ""; the rows and the number of their first."""

    path: Path
    sections: Mapping[str, list[str]]
    rows: bytes
    first_line: int

    def section(self, title: str) -> list[str]:
        """Lines of a section, none where it is not there."""
        return self.sections.get(title, [])


def read(path: Path, params: VboxParams) -> Streams:
    """The stream gnss, and imu where the file holds one and `axes` is given.

    Raises ReadFailed, also where a parameter must tell, or contradicts the accelerations.
    """
    file = _opened(path)
    names = _names(file)
    wanted = [name for name in (*PLACE, *ACCEL, *RATES) if name in names]
    kinds = {"time": pa.string(), **dict.fromkeys(wanted, pa.float64())}
    lines = read_lines(path, file.rows, file.first_line, Form(names, kinds))
    clock_ns, good = clocks(lines.table["time"])
    t_ns, facts, learnt = _dated(file, clock_ns, good)
    gnss, told = _gnss(lines, t_ns, ~good, _speed_unit(file, params))
    imu, found = _imu(lines, t_ns, ~good, params)
    if gnss is None and imu is None:
        raise ReadFailed(path, "no row holds a measurement", hint=COPIED)
    facts = {**facts, "time_scale": "UTC", "format": "VBOX"}
    streams = {}
    if gnss is not None:
        streams["gnss"] = with_meta(gnss, **facts, height_datum="mean_sea_level", heading_kind="course_true")
    if imu is not None:
        streams["imu"] = with_meta(imu, **facts, axes=params.axes)
    rows = [*lines.learnt(), *learnt, *_offset(file, t_ns), *told, *found]
    return {**streams, "metrics": metrics(rows)}


def sniff(path: Path, head: bytes) -> Sniff:
    """The sections of a .vbo."""
    text = head.lower()
    if b"[header]" in text and (b"[column names]" in text or text.startswith(b"file created on")):
        return Sniff(0.95, "sections [header] and [column names] of a VBOX file")
    return Sniff(0.0, "no sections of a VBOX file")


def _opened(path: Path) -> _File:
    text = plain(contents(path))
    at = re.search(rb"(?im)^\[data\][^\n]*\n?", text)
    if at is None:
        raise ReadFailed(path, "it has no section [data]", line=1 + text.count(b"\n"), hint=COPIED)
    sections: dict[str, list[str]] = {"": []}
    title = ""
    for line in text[: at.start()].decode("latin-1").split("\n"):
        if line.strip().startswith("[") and line.strip().endswith("]"):
            title = line.strip()[1:-1].strip().lower()
            sections[title] = []
        else:
            sections[title].append(line.strip())
    return _File(path, sections, text[at.end() :], 1 + text.count(b"\n", 0, at.end()))


def _names(file: _File) -> list[str]:
    """Names of the columns in lower case; one that comes a second time gets its place as an ending."""
    line = next((line for line in file.section("column names") if line), "")
    found: list[str] = []
    for index, word in enumerate(line.lower().split()):
        found.append(f"{word}#{index}" if word in found else word)
    if "time" not in found:
        raise ReadFailed(file.path, "its section [column names] names no time", line=file.first_line, hint=COPIED)
    return found


def _speed_unit(file: _File, params: VboxParams) -> str:
    told = next((line.lower() for line in file.section("header") if line.lower().startswith("velocity")), "")
    if params.speed_unit is not None:
        return params.speed_unit
    if "kmh" in told or "km/h" in told:
        return "km/h"
    if "knot" in told:
        return "kn"
    hint = "set reader.vbox.speed_unit to km/h or kn: the positions of a straight stretch tell which one is right"
    raise ReadFailed(file.path, "its header does not tell the unit of velocity", line=1, hint=hint)


def _dated(file: _File, clock_ns: Times, good: Mask) -> tuple[Times, dict[str, str], list[Metric]]:
    """Times of day with the date on which the file was created, ns since 1970."""
    t_ns = np.zeros_like(clock_ns)
    t_ns[good] = over_midnight(clock_ns[good])
    text = next((line for line in file.section("") if line.startswith("File created on")), "")
    found = _CREATED.match(text)
    if found is None or not good.any():
        note = "the file does not say when it was created: times count from midnight"
        return t_ns, {"clock": "relative"}, [warning(note)]
    day, month, year, hour, minute = (int(part or 0) for part in found.groups())
    date, known = days(*(np.array([number]) for number in (year, month, day)))
    if not known[0]:
        return t_ns, {"clock": "relative"}, [warning(f"'{text}' is no date: times count from midnight")]
    late = found[4] is not None and clock_ns[good][0] < (hour * 60 + minute) * 60 * NS - DAY_NS // 2
    return t_ns + (date[0] + late) * DAY_NS, {"clock": "absolute"}, [Metric("date", note=text)]


def _offset(file: _File, t_ns: Times) -> list[Metric]:
    """A warning where the box counted other leap seconds than there were."""
    found = next(filter(None, map(_OFFSET.search, file.section("comments"))), None)
    leaps = leap_seconds(int(t_ns.max())) if len(t_ns) else 0
    if found is None or leaps == int(found[1]) or not leaps:
        return []
    note = f"the box took {found[1]} s off GPS time where UTC was {leaps} s behind: its times may be off by the rest"
    return [warning(note)]


def _column(lines: Lines, name: str) -> Array:
    return vector(lines.table, name, gaps=True)


def _gnss(lines: Lines, t_ns: Times, missing: Mask, speed_unit: str) -> tuple[pa.Table | None, list[Metric]]:
    there = set(lines.table.column_names)
    if not {"lat", "long"} <= there:
        return None, [warning("the file has no columns lat and long")]
    groups = {"lat": _column(lines, "lat") / 60.0, "lon": -_column(lines, "long") / 60.0}
    if "height" in there:
        groups["height"] = _column(lines, "height")
    if "velocity" in there:
        groups["speed"] = convert(_column(lines, "velocity"), speed_unit, "m/s")
    if "heading" in there:
        groups["course"] = np.radians(_column(lines, "heading"))
    if "sats" in there:
        groups["satellites"] = np.mod(_column(lines, "sats"), FLAGS)
    source = Source(lines.path, "gnss", lines.line)
    made, learnt = stream(source, GNSS, t_ns, missing, groups)
    return made, [Metric("speed_unit", convert(1.0, speed_unit, "m/s"), "m/s", note=f"in {speed_unit}"), *learnt]


def _imu(lines: Lines, t_ns: Times, missing: Mask, params: VboxParams) -> tuple[pa.Table | None, list[Metric]]:
    """The IMU along forward, left, up. Raises ReadFailed where it reads -1 g upwards at rest."""
    there = set(lines.table.column_names)
    if not there.issuperset((*ACCEL, *RATES)):
        return None, []
    if not params.axes:
        return None, [warning(f"the IMU is left out, for the file does not tell its axes: {_AXES_HOW}")]
    order, signs = turn(params.axes)
    at_rest = 1.0 if params.at_rest == "up" else -1.0
    accel, gyro = (
        np.column_stack([_column(lines, name) for name in group])[:, order] * signs for group in (ACCEL, RATES)
    )
    accel = accel * (at_rest * STANDARD_GRAVITY)
    if np.nanmedian(accel[:, 2]) < 0.0:
        what = (
            f"with axes {params.axes} and at_rest {params.at_rest} the IMU feels {np.nanmedian(accel[:, 2]):.2f} m/s^2"
        )
        what = f"{what} upwards, where a vehicle feels +9.8"
        raise ReadFailed(lines.path, what, line=lines.first_line, hint="correct axes or at_rest")
    made, learnt = stream(
        Source(lines.path, "imu", lines.line), IMU, t_ns, missing, {"accel": accel, "gyro": np.radians(gyro)}
    )
    note = f"imu: logged along {params.axes}, given along forward, left, up; accelerations in g, rates in deg/s"
    return made, [Metric("axes", note=note), *learnt]


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of VBOX files."""
    yield Reader(
        name="vbox",
        summary="Racelogic VBOX files (.vbo): GNSS, and an IMU whose axes are given.",
        params=VboxParams,
        run=read,
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "satellites").possible(),
            "imu": IMU.only("accel", "gyro").possible(),
        },
        references=("Racelogic, VBOX file format (.vbo)", "Racelogic, Signing conventions"),
    )
