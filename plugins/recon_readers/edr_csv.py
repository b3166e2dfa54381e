"""Tables of event data recorders, as pasted from the report of a download tool or exported by recon.

    Times (sec),"Speed, Vehicle Indicated (MPH [km/h])","Service Brake (On, Off)"
    -5.0,34 [55],Off
    ...

    Time (msec),"Delta-V, longitudinal (MPH [km/h])"
    0,0 [0]
    10,-1 [-2]

A header names the time and the elements with their units; a blank line or another header begins the next table. Fields
are separated by commas, semicolons or tabs, decimals are points, or commas that cannot part thousands. Where two units
are given, that in brackets is read. Elements that 49 CFR part 563 names become its names and units, other numbers keep
theirs; texts are left out. Signs are taken as the recorder has them: forward, right and down positive (SAE J1698).

References
    49 CFR 563.7; SAE J1698-1; ISO/TR 12353-3:2013.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from recon.edr import ACCELERATIONS, DELTA_V_LAT, DELTA_V_LONG, EDR, ELEMENTS, SPEED, Element
from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import Params, setting
from recon.rows import Metric, metrics, warning
from recon.stages import Reader, Sniff
from recon.tables import Streams, build
from recon.units import UnitError, convert
from recon_readers._text_blocks import contents, plain

_KNOWN: Final[tuple[tuple[str, Element], ...]] = (
    (r"delta.?v.*long|long.*delta.?v", DELTA_V_LONG),
    (r"delta.?v.*lat|lat.*delta.?v", DELTA_V_LAT),
    (r"long.*accel", ACCELERATIONS[0]),
    (r"lat.*accel", ACCELERATIONS[1]),
    (r"(normal|vert).*accel", ACCELERATIONS[2]),
    (r"speed.*vehicle|vehicle.*speed|^speed", SPEED),
)
_TIMES: Final = {"sec": 1.0, "s": 1.0, "seconds": 1.0, "msec": 1e-3, "ms": 1e-3, "milliseconds": 1e-3}
_UNITS: Final = {"MPH": "mph", "KM/H": "km/h", "KPH": "km/h", "G": "g", "M/S^2": "m/s^2"}
_NUMBER: Final = re.compile(r"[-+]?\d+(?:\.\d*)?|[-+]?\.\d+")
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d*,(?:\d{1,2}|\d{4,})")
_TIME: Final = re.compile(r"^times?\b[^(\[]*[(\[]\s*([a-z]+)", re.IGNORECASE)
_OWN: Final = ("event", "t", "element", "unit", "value")
_COPIED: Final = "paste the table with its header line, which names the time and the elements with their units"


class EdrCsvParams(Params):
    """Parameters of reader.edr_csv."""

    event: int = setting(1, ge=1, doc="Number of the event that the tables belong to, where they do not say.")


@dataclass(frozen=True)
class _Element:
    """One column of a table: name, unit as written, and as kept; bracketed : its second number counts."""

    column: int
    name: str
    unit: str
    kept: str
    bracketed: bool


def read(path: Path, params: EdrCsvParams) -> Streams:
    """Streams recorded_pre_crash and recorded_crash. Raises ReadFailed with the line."""
    lines = _lines(path)
    rows: list[dict[str, Any]] = []
    elements: list[_Element] = []
    scale = 0.0
    texts: dict[str, list[int]] = {}
    untimed: list[int] = []
    own: list[str] | None = None
    for number, cells in lines:
        seconds = _TIME.match(cells[0])
        if [cell.split(" [")[0] for cell in cells][: len(_OWN)] == list(_OWN):
            own, elements = [cell.split(" [")[0] for cell in cells], []
        elif seconds and seconds[1].lower() in _TIMES:
            scale, elements, own = _TIMES[seconds[1].lower()], [_element(i, c) for i, c in enumerate(cells) if i], None
        elif own is not None:
            rows.append(_own_row(path, number, dict(zip(own, cells, strict=False))))
        elif elements and _number(cells[0]) is None:
            untimed += [number] * (sum(_number(cell) is not None for cell in cells) > 0)
        elif elements:
            for element in elements:
                value = _value(cells, element)
                if value is None:
                    texts.setdefault(element.name, []).append(number)
                    continue
                row = {
                    "event": params.event,
                    "t": scale * (_number(cells[0]) or 0.0),
                    "element": element.name,
                    "unit": element.kept,
                }
                rows.append(row | {"value": _converted(path, number, value, element)})
    if not rows:
        raise ReadFailed(path, "it holds no table of an event data recorder", line=1, hint=_COPIED)
    before = [row for row in rows if not _of_crash(row)]
    learnt = [Metric("edr_values", float(len(rows)))]
    learnt += _left_out({row["element"] for row in rows}, texts, untimed)
    streams = {"recorded_pre_crash": before, "recorded_crash": [row for row in rows if _of_crash(row)]}
    return {**{name: _table(found) for name, found in streams.items() if found}, "metrics": metrics(learnt)}


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """The lines that are not blank, in fields, with their numbers."""
    text = plain(contents(path)).decode("utf-8", "replace")
    head = next((line for line in text.splitlines() if re.match(r'"?(times?\b|event)', line, re.IGNORECASE)), "")
    separator = max(",;\t", key=lambda mark: re.sub(r'"[^"]*"', "", head).count(mark))
    rows = enumerate(csv.reader(text.splitlines(), delimiter=separator), start=1)
    try:
        return [(number, [cell.strip() for cell in cells]) for number, cells in rows if any(c.strip() for c in cells)]
    except csv.Error as error:
        raise ReadFailed(path, f"it is no table: {error}", hint=_COPIED) from error


def _element(column: int, title: str) -> _Element:
    """From a title such as "Delta-V, longitudinal (MPH [km/h])"."""
    units = re.findall(r"[(\[]\s*([^()\[\]]+?)\s*(?=[)\]\[])", title)
    bracketed = len(units) > 1
    unit = units[-1] if units else ""
    unit = _UNITS.get(unit.upper().replace("²", "^2"), unit)
    name = re.sub(r"\s*[(\[].*", "", title).strip()
    for pattern, known in _KNOWN:
        if re.search(pattern, name, re.IGNORECASE) and unit:
            return _Element(column, known.name, unit, known.unit, bracketed)
    return _Element(column, name, unit, unit, bracketed)


def _value(cells: list[str], element: _Element) -> float | None:
    """The number in a field, that in brackets where two units are given; None where there is none."""
    cell = cells[element.column] if element.column < len(cells) else ""
    inside = re.search(r"\[([^\]]*)\]", cell) if element.bracketed else None
    text = (inside[1] if inside else cell).strip()
    return _number(text)


def _number(text: str) -> float | None:
    """Of a field; None where it holds none. A comma before three digits may part thousands: then nobody knows."""
    text = text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text
    return float(text) if _NUMBER.fullmatch(text) else None


def _left_out(read: set[str], texts: dict[str, list[int]], untimed: list[int]) -> Iterator[Metric]:
    """What is to be said of fields that hold no number. texts : lines by element; untimed : lines without a time"""
    for name, lines in sorted(texts.items()):
        yield Metric("edr_left_out", float(len(lines)), method=name, note="holds texts")
        if name in read:  # an element of words, such as that of a switch, has no number anywhere
            yield warning(f"{name} is no number in {len(lines)} lines, the first line {lines[0]}: they are left out")
    if untimed:
        yield warning(f"{len(untimed)} lines have numbers and no time, the first line {untimed[0]}: they are left out")


def _converted(path: Path, number: int, value: float, element: _Element) -> float:
    if element.unit == element.kept:
        return value
    try:
        return convert(value, element.unit, element.kept)
    except UnitError as error:
        what = f"{element.name} is in '{element.unit}', which is no unit like {element.kept}"
        raise ReadFailed(
            path, what, line=number, hint="write the unit in the header as km/h, mph, g or m/s^2"
        ) from error


def _own_row(path: Path, number: int, cells: dict[str, str]) -> dict[str, Any]:
    """A row of recon's own export."""
    try:
        found = {"event": int(float(cells["event"])), "t": float(cells["t"]), "value": float(cells["value"])}
        return {**found, "element": cells["element"], "unit": cells["unit"]}
    except (KeyError, ValueError, OverflowError) as error:
        raise ReadFailed(path, f"this row is no value of an element: {error}", line=number, hint=_COPIED) from error


def _of_crash(row: dict[str, Any]) -> bool:
    """Does a value belong to the crash rather than to the time before it?"""
    if row["element"] == SPEED.name:
        return False
    return row["element"] in ELEMENTS or row["t"] > 0.0


def _table(rows: list[dict[str, Any]]) -> pa.Table:
    return build(EDR, **{c.name: pa.array([row.get(c.name) for row in rows], c.type) for c in EDR.columns})


def sniff(path: Path, head: bytes) -> Sniff:
    """A header with a time and delta-V or the vehicle's speed, in words of 49 CFR 563."""
    text = head.decode("utf-8", "replace").lower()
    named = "delta-v" in text or "speed, vehicle indicated" in text
    timed = re.search(r'^"?times?\b[^\n]*[(\[](sec|s|msec|ms)\b', text, re.MULTILINE) or text.startswith("event,t [s],")
    if named and timed:
        return Sniff(0.95, "table of an event data recorder: time, delta-V or vehicle speed")
    return Sniff(0.0, "no header with a time and delta-V")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """Declare reader.edr_csv."""
    yield Reader(
        name="edr_csv",
        version=2,
        summary="Tables of event data recorders: speed before, delta-V and accelerations in a crash.",
        params=EdrCsvParams,
        writes={"recorded_pre_crash": EDR.possible(), "recorded_crash": EDR.possible()},
        run=read,
        sniff=sniff,
        references=("49 CFR 563.7", "SAE J1698-1"),
    )
