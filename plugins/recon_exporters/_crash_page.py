"""What a reader must know of a crash, at the top of a report: time line, vehicle, pulse, numbers, standards.

The numbers are the metrics of the step that gave delta-V (analyzer.crash), each with its interval of 95 %, the standard
that defines it and where its sigma comes from. With several crashes they are those of the severest one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.crash_summary import SIGN, severest_impact
from recon.rounding import in_a_sentence, with_interval
from recon.tables import has, matrix, time_ns
from recon_exporters._chart import Span
from recon_exporters._crash_drawing import Moment, time_line, vehicle
from recon_exporters._crash_pulse import pulse_charts
from recon_exporters._page import Json, crash_step, number, table
from recon_exporters._words import unit_symbol

_TITLES: Final[Mapping[str, str]] = {
    "speed_before": "Speed before",
    "delta_v_resultant_max": "Delta-V, horizontal",
    "delta_v_long_max": "Delta-V, longitudinal (forward +)",
    "delta_v_lat_max": "Delta-V, lateral (left +)",
    "time_of_max": "Time of largest delta-V",
    "pdof": "Principal direction of force, clockwise from the front",
    "accel_peak_cfc60": "Peak acceleration, longitudinal",
    "accel_peak_cfc60_magnitude": "Peak acceleration, magnitude",
    "asi_1998": "Acceleration severity index, 1998",
    "asi_2010": "Acceleration severity index, 2010",
    "thiv": "Theoretical head impact velocity",
    "phd": "Post-impact head deceleration",
    "oiv_long": "Occupant impact velocity, longitudinal",
    "oiv_lat": "Occupant impact velocity, lateral",
    "ridedown": "Occupant ridedown acceleration",
    "delta_v_not_recorded": "Delta-V beyond what was recorded",
}
_ANOTHER: Final = (
    '<p class="hint">Delta-V here is the largest within 300 ms of time zero. The event <i>crash</i> tells the largest '
    "change of velocity within the time of its trigger, and the table of an event data recorder goes to the end of the "
    "event and 30 ms: these may be smaller.</p>"
)
"""Why other numbers of the page are called a change of velocity, too."""
_OF_A_PLACE: Final = (
    '<p class="hint">Accelerations are those of {}. Intervals hold what a sensor of {}, its mounting and the '
    "reconstruction may have wrong, not what the structure does between that place and others: under the rear "
    "seats of a car against a wall four sensors of one kind told a delta-V that differed by 2 % and a peak in CFC 60 "
    "that differed by 18 %.</p>"
)
"""Of which point the numbers are, and how far they hold of the vehicle."""
_BEFORE_S, _AFTER_S = -5.0, 5.0
_AT_REST: Final = 0.1
"""m/s of a trajectory that stands, which errs by some hundredths."""
_RESTS_S: Final = 1.0
"""s; it is told to a tenth, by which it is wrong where a vehicle brakes gently."""
_KINDS: Final = {
    "harsh_braking": "harsh braking begins",
    "saturation": "the sensor reaches its range",
    "speeding": "speeding begins",
}


def numbers_of(facts: Json) -> dict[str, Json]:
    """Rows of the crash's metrics by name; empty where no step judged a crash."""
    step = crash_step(facts)
    return {row["name"]: row for row in facts["metrics"] if step and row["step"] == step and row["name"] in _TITLES}


def crash_page(facts: Json, streams: Mapping[str, pa.Table], spans: list[Span]) -> str:
    """The section's HTML; "" without a crash that was judged."""
    rows = numbers_of(facts)
    severest = _severest(streams.get("events"), [span for span in spans if span.kind == "crash"])
    if not rows or severest is None:
        return ""
    direction = rows.get("pdof")
    drawn = ""
    if direction is not None and direction["value"] is not None:
        drawn = vehicle(direction["value"], direction["low"], direction["high"])
    parts = [
        _sentence(rows),
        time_line([*_moments(rows, severest, spans), *_rests(streams, severest, spans)], _BEFORE_S, _AFTER_S),
        f'<div class="beside">{drawn}<div class="charts">{pulse_charts(streams, severest, spans)}</div></div>',
        _numbers(rows),
        _ANOTHER,
        _OF_A_PLACE.format(_place(facts, streams), _class(facts)),
        _others(facts),
    ]
    return "".join(parts)


def _severest(events: pa.Table | None, crashes: Sequence[Span]) -> Span | None:
    """The crash that the numbers are about: that of the largest `impact`, else the first; None without a crash."""
    worst = severest_impact(events)
    return next((span for span in crashes if span.start_ns == worst), crashes[0] if crashes else None)


def _place(facts: Json, streams: Mapping[str, pa.Table]) -> str:
    """Whose accelerations the numbers are made of, as analyzer.crash takes them."""
    trajectory = streams.get("trajectory")
    if trajectory is not None and has(trajectory, "accel"):
        return "the point of the trajectory, which is the box unless aligner.lever_arm moved it"
    named = (row["note"] for row in facts["metrics"] if row["name"] == "place" and row["method"] == "imu")
    return "".join(["the stream <code>imu</code>", *(f" ({escape(place)})" for place in named)])


def _class(facts: Json) -> str:
    """Of the sensor, as the step that judged the crash was told or takes for granted."""
    own = (step["params"] for step in facts["plan"] or () if step["id"] == crash_step(facts))
    named = next((params["sensor_class"] for params in own if "sensor_class" in params), None)
    return f"the class <code>{escape(str(named))}</code>" if named else "its class"


def _sentence(rows: Mapping[str, Json]) -> str:
    """Speed before, delta-V and direction in one line."""
    found = []
    for name, words in (
        ("speed_before", "At {}" + _supposed(rows)),
        (SIGN, "the velocity changed by {} within 300&nbsp;ms"),
        ("pdof", "the force came from {}, clockwise from straight ahead"),
    ):
        row = rows.get(name)
        if row is not None and row["value"] is not None:
            found.append(words.format(f"<b>{_with_interval(row)}</b>"))
    text = ", ".join(found)
    return f'<p class="verdict">{text[:1].upper()}{text[1:]}.</p>' if found else ""


def _supposed(rows: Mapping[str, Json]) -> str:
    """What the speed before rests on, where no trajectory told it; else where it went, unless ahead."""
    row = rows.get("speed_before")
    if not row or not row["note"]:
        return ""
    _, _, way = row["note"].partition(", ")
    return f" {escape(way)}".rstrip() if row["method"].startswith("trajectory") else f" ({escape(row['note'])})"


def _with_interval(row: Json) -> str:
    return with_interval(row, unit_symbol(row["unit"])).replace("-", "−")


def _short(row: Json) -> str:
    return in_a_sentence(row).replace("-", "−")


def _moments(rows: Mapping[str, Json], crash: Span, spans: Sequence[Span]) -> Iterator[Moment]:
    speed, size = rows.get("speed_before"), rows[SIGN]
    told = f", {_short(speed)} km/h" if speed and speed["value"] is not None else ""
    yield Moment(0.0, f"time zero{told}")
    at = rows.get("time_of_max", {}).get("value")
    if at is not None and size["value"] is not None:
        yield Moment(at, f"largest delta-V, {_short(size)} km/h")
    yield Moment((crash.end_ns - crash.start_ns) * 1e-9, "end of event")
    for span in spans:
        if span.kind in _KINDS:
            yield Moment((span.start_ns - crash.start_ns) * 1e-9, _KINDS[span.kind])
        elif span.kind == "crash" and span != crash:
            yield Moment((span.start_ns - crash.start_ns) * 1e-9, "another crash")


def _rests(streams: Mapping[str, pa.Table], crash: Span, spans: Sequence[Span]) -> Iterator[Moment]:
    """When the vehicle came to rest, by the trajectory: a standstill is only told where it is certain, a second later.

    Without a trajectory, when the standstill begins.
    """
    trajectory = streams.get("trajectory")
    moves = _moving(trajectory) if trajectory is not None else np.empty(0, dtype=np.int64)
    before = None
    for span in spans:
        if span.kind != "standstill":
            continue
        row = int(np.searchsorted(moves, span.start_ns)) - 1
        if trajectory is None:
            yield Moment((span.start_ns - crash.start_ns) * 1e-9, "standstill begins")
        elif row >= 0 and row != before:
            yield Moment((int(moves[row]) - crash.start_ns) * 1e-9, "comes to rest", _RESTS_S)
        before = row


def _moving(trajectory: pa.Table) -> NDArray[np.int64]:
    """Times of rows at which the vehicle is not at rest, ns: (m,)."""
    speed = np.linalg.norm(matrix(trajectory, "vel", gaps=True), axis=1)
    return np.asarray(time_ns(trajectory)[speed > _AT_REST])


def _numbers(rows: Mapping[str, Json]) -> str:
    """The table of metrics with intervals, methods and standards."""
    lines = []
    for name, title in _TITLES.items():
        row = rows.get(name)
        if row is None:
            continue
        sigma = row["sigma"]
        edges = [number(row[key], sigma) for key in ("low", "high")]
        told = (escape(row["method"] or ""), escape(row["note"] or ""))
        lines.append(
            (title, number(row["value"], sigma), number(sigma, sigma), *edges, unit_symbol(row["unit"]), *told)
        )
    head = ("", "value", "±&nbsp;sigma", "95&nbsp;% from", "to", "unit", "standard and method", "note")
    return table(head, lines, "Severity")


def _others(facts: Json) -> str:
    """All impacts, where there are several."""
    impacts: list[dict[str, Any]] = [
        row for row in facts["events"] if row["kind"] == "impact" and row["value"] is not None
    ]
    if len(impacts) < 2:
        return ""
    rows = ((number(row["t_s"], 0.01), number(row["value"]), escape(row["note"] or "")) for row in impacts)
    return table(("after [s]", "delta-V [km/h]", "note"), rows, "All impacts; the numbers above are the severest one's")
