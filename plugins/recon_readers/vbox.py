"""Racelogic VBOX files (.vbo): GNSS at up to 100 Hz, and the IMU where one was connected.

A text of sections: [header] with names and some units, [column names], [data] with rows parted by blanks.

    sats       number of satellites, + 64 while the brake trigger is pressed, + 128 with differential corrections
    time       HHMMSS.sss, UTC; the date is that of the column Date (ddmmyy), else of the line "File created on", whose
               time of day may be another zone's; counts on over midnight
    lat, long  minutes, positive north and WEST
    velocity   km/h or knots, as [header] tells; heading deg clockwise from true north; height m above mean sea level

Without satellites a velocity of zero tells nothing, nor does the rest of the row but the IMU.

Of an IMU: X_Accel, Y_Accel, Z_Accel in g; RollRate, PitchRate, YawRate about x, y, z in deg/s. Boxes of Racelogic
differ in the senses of their axes, and the file does not tell: without the parameter `axes` the IMU is left out.

Reference: Racelogic, VBOX file format (.vbo); VBOX 3i user guide; "Signing conventions" (support.racelogic).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.axes import turn
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.gnss_time import DAY_NS, NS, leap_seconds
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU
from recon.stages import Reader, Sniff
from recon.tables import Streams, vector, with_meta
from recon.units import convert
from recon_readers._lines import COPIED, Form, Lines, read_lines
from recon_readers._mapping_parts import Axes
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import Text
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import clocks, days, over_midnight, short_dates

ACCEL: Final = ("x_accel", "y_accel", "z_accel")
RATES: Final = ("rollrate", "pitchrate", "yawrate")
FLAGS: Final = 64
"""Satellites are counted below this."""
_CREATED: Final = re.compile(r"File created on (\d\d)/(\d\d)/(\d{4})(?: @ (\d\d):(\d\d))?")
_OFFSET: Final = re.compile(r"GPS Time offset by -(\d+) seconds")
_GNSS_FACTS: Final = {"height_datum": "mean_sea_level", "heading_kind": "course_true"}
_AXES_HOW: Final = (
    "set reader.vbox.axes to where X, Y and Z point, such as FLU: on a drive, X_Accel grows when the vehicle speeds up "
    "if x points forward, YawRate is positive in a left turn if z points up"
)


class _Part(NamedTuple):
    """A column of the file, and the factor that gives it the unit and sign of its stream."""

    name: str
    factor: float = 1.0


class VboxParams(Params):
    """What the file does not tell."""

    axes: Axes = setting("", doc="Where X, Y and Z of the IMU point: FLU, FRD, ... Without it the IMU is left out.")
    at_rest: Literal["up", "down"] = setting("up", doc="Where accelerations at rest point: up is specific force.")
    speed_unit: Literal["km/h", "kn"] | None = setting(None, doc="Unit of the velocity where the header does not tell.")


@dataclass(frozen=True)
class _File:
    """Sections of a file: lines by title, the text above the first under ""; offset and line of the first row."""

    text: Text
    sections: Mapping[str, list[str]]
    start: int
    first_line: int

    @property
    def path(self) -> Path:
        """Where it is."""
        return self.text.path

    def section(self, title: str) -> list[str]:
        """Lines of a section, none where it is not there."""
        return self.sections.get(title, [])


def read(path: Path, params: VboxParams) -> Streams:
    """The stream gnss, and imu where the file holds one and `axes` is given.

    Raises ReadFailed, also where a parameter must tell, or contradicts the accelerations.
    """
    file = _opened(path)
    names = _names(file)
    imu, asked = _imu_parts(names, params)
    speed_unit = _speed_unit(file, params)
    gnss = _gnss_parts(names, speed_unit)
    texts = [name for name in ("time", "date") if name in names]
    kinds = {
        **dict.fromkeys(texts, pa.string()),
        **{part.name: pa.float64() for part in (*gnss.values(), *imu.values())},
    }
    lines = read_lines(
        path,
        file.text,
        Form(names, kinds),
        lambda table: _columns(table, gnss, imu),
        start=file.start,
        first_line=file.first_line,
    )
    clock_ns, good = lines.columns.pop("clock"), lines.columns.pop("good")
    t_ns, facts, learnt = _dated(file, clock_ns, good, lines.columns.pop("day", None))
    unit = Metric(
        "speed_unit",
        convert(1.0, speed_unit, "m/s"),
        "m/s",
        note=f"speed that the file writes as 1: it is in {speed_unit}",
    )
    learnt += [*_offset(file, t_ns), unit, *asked]
    facts = {**facts, "time_scale": "UTC", "format": "VBOX"}
    if imu:
        _check_rest(lines, params)
    streams = {}
    for name, schema, parts, more in (("gnss", GNSS, gnss, _GNSS_FACTS), ("imu", IMU, imu, {"axes": params.axes})):
        columns = {column: lines.columns.pop((name, column)) for column in parts}
        if not columns:
            continue
        made, told = stream(Source(path, name, lines.line), schema, t_ns, ~good, columns)
        learnt += told
        if made is not None:
            streams[name] = with_meta(made, **facts, **more)
    if not streams:
        raise ReadFailed(path, "no row holds a measurement", hint=COPIED)
    return {**streams, "metrics": metrics([*lines.learnt(), *learnt])}


def sniff(path: Path, head: bytes) -> Sniff:
    """The sections of a .vbo."""
    text = head.lower()
    if b"[header]" in text and (b"[column names]" in text or text.startswith(b"file created on")):
        return Sniff(0.95, "sections [header] and [column names] of a VBOX file")
    return Sniff(0.0, "no sections of a VBOX file")


def _opened(path: Path) -> _File:
    text = Text.open(path)
    at = re.search(rb"(?im)^\[data\][^\n]*\n?", text.head)
    if at is None:
        raise ReadFailed(path, "it has no section [data]", line=1 + text.head.count(b"\n"), hint=COPIED)
    sections: dict[str, list[str]] = {"": []}
    title = ""
    for line in text.head[: at.start()].decode("latin-1").split("\n"):
        if line.strip().startswith("[") and line.strip().endswith("]"):
            title = line.strip()[1:-1].strip().lower()
            sections[title] = []
        else:
            sections[title].append(line.strip())
    return _File(text, sections, at.end(), text.line_at(at.end()))


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


def _dated(
    file: _File, clock_ns: Times, good: Mask, days_told: Times | None
) -> tuple[Times, dict[str, str], list[Metric]]:
    """Times of day with the date that the rows tell, else that on which the file was created, ns since 1970.

    days_told : (n,) days since 1970, -1 where a row tells none; None where there is no such column
    """
    t_ns = np.zeros_like(clock_ns)
    t_ns[good] = over_midnight(clock_ns[good])
    dated = np.flatnonzero(good & (days_told >= 0))[:1] if days_told is not None else np.zeros(0, dtype=np.intp)
    if days_told is not None and len(dated):
        first = days_told[dated[0]] - t_ns[dated[0]] // DAY_NS
        return t_ns + first * DAY_NS, {"clock": "absolute"}, [Metric("date", note="of the column Date")]
    text = next((line for line in file.section("") if line.startswith("File created on")), "")
    found = _CREATED.match(text)
    if found is None or not good.any():
        note = "the file does not say when it was created: times count from midnight"
        return t_ns, {"clock": "relative"}, [warning(note)]
    day, month, year, hour, minute = (int(part or 0) for part in found.groups())
    date, known = days(*(np.array([number]) for number in (year, month, day)))
    if not known[0]:
        return t_ns, {"clock": "relative"}, [warning(f"'{text}' is no date: times count from midnight")]
    after_ns = clock_ns[good][0] - (hour * 60 + minute) * 60 * NS if found[4] is not None else 0
    late = int(after_ns < -DAY_NS // 2) - int(after_ns > DAY_NS // 2)
    return t_ns + (date[0] + late) * DAY_NS, {"clock": "absolute"}, [Metric("date", note=text)]


def _offset(file: _File, t_ns: Times) -> list[Metric]:
    """A warning where the box counted other leap seconds than there were."""
    found = next(filter(None, map(_OFFSET.search, file.section("comments"))), None)
    leaps = leap_seconds(int(t_ns.max())) if len(t_ns) else 0
    if found is None or leaps == int(found[1]) or not leaps:
        return []
    note = f"the box took {found[1]} s off GPS time where UTC was {leaps} s behind: its times may be off by the rest"
    return [warning(note)]


def _gnss_parts(names: Sequence[str], speed_unit: str) -> dict[str, _Part]:
    """What the columns of gnss are made of."""
    parts = {
        "lat": _Part("lat", 1.0 / 60.0),
        "lon": _Part("long", -1.0 / 60.0),
        "height": _Part("height"),
        "speed": _Part("velocity", convert(1.0, speed_unit, "m/s")),
        "course": _Part("heading", convert(1.0, "deg", "rad")),
        "satellites": _Part("sats"),
    }
    return {column: part for column, part in parts.items() if part.name in names}


def _imu_parts(names: Sequence[str], params: VboxParams) -> tuple[dict[str, _Part], list[Metric]]:
    """What the columns of imu along forward, left, up are made of, and what is to be told; none without `axes`."""
    if not {*ACCEL, *RATES} <= set(names):
        return {}, []
    if not params.axes:
        return {}, [warning(f"the IMU is left out, for the file does not tell its axes: {_AXES_HOW}")]
    order, signs = turn(params.axes)
    felt = STANDARD_GRAVITY if params.at_rest == "up" else -STANDARD_GRAVITY
    groups = (("accel", ACCEL, felt), ("gyro", RATES, convert(1.0, "deg", "rad")))
    parts = {
        f"{group}_{axis}": _Part(logged[at], sign * unit)
        for group, logged, unit in groups
        for axis, at, sign in zip("xyz", order, signs, strict=True)
    }
    note = f"imu: logged along {params.axes}, given along forward, left, up; accelerations in g, rates in deg/s"
    return parts, [Metric("axes", note=note)]


def _columns(table: pa.Table, gnss: Mapping[str, _Part], imu: Mapping[str, _Part]) -> dict[Any, NDArray[Any]]:
    """Of some rows: time of day, whether there is one, and the columns of both streams."""
    clock_ns, good = clocks(table["time"])
    found: dict[Any, NDArray[Any]] = {"clock": clock_ns, "good": good}
    if "date" in table.column_names:
        found["day"] = short_dates(table["date"].combine_chunks())
    for stream_name, parts in (("gnss", gnss), ("imu", imu)):
        for column, part in parts.items():
            values = vector(table, part.name, gaps=True)
            with np.errstate(invalid="ignore"):  # a damaged number may be infinite
                found[stream_name, column] = np.mod(values, FLAGS) if column == "satellites" else values * part.factor
    lost = (found.get(("gnss", "satellites"), 1.0) == 0.0) & (found.get(("gnss", "speed"), 1.0) == 0.0)
    for column in gnss if np.any(lost) else ():
        found["gnss", column] = np.where(lost, np.nan, found["gnss", column])
    return found


def _check_rest(lines: Lines, params: VboxParams) -> None:
    """Raises ReadFailed where the IMU reads -1 g upwards at rest."""
    felt = float(np.nanmedian(lines.columns["imu", "accel_z"]))
    if felt < 0.0:
        what = f"with axes {params.axes} and at_rest {params.at_rest} the IMU feels {felt:.2f} m/s^2 upwards"
        what = f"{what}, where a vehicle feels +9.8"
        raise ReadFailed(lines.path, what, line=lines.first_line, hint="correct axes or at_rest")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of VBOX files."""
    yield Reader(
        name="vbox",
        summary="Racelogic VBOX files (.vbo): GNSS, and an IMU whose axes are given.",
        params=VboxParams,
        run=read,
        version=2,
        sniff=sniff,
        writes={
            "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "satellites").possible(),
            "imu": IMU.only("accel", "gyro").possible(),
        },
        references=("Racelogic, VBOX file format (.vbo)", "Racelogic, Signing conventions"),
    )
