"""What the film says of events: markers on its time line, captions in the picture, the force of a crash at the car.

    markers    frame, kind, name              every event that the film shows, and every outage
    captions   text, row, spans (from, to)    what a viewer should notice, while it lasts; rows count upwards from below
    force      angle, span (from, to)         rad to the left of the vehicle's front from where the force came; None
                                              unless one step told the principal direction of force of a crash

A caption stays for READING s of the film, however short its event was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from recon.tables import time_ns
from recon_exporters._blender_film import Film
from recon_exporters._words import unit_symbol, words

Json = dict[str, Any]

CAPTIONS: Final = {"impact": "impact, delta-V", "outage": "no GNSS", "saturation": "sensor at its range"}
"""Besides these all kinds that begin with `harsh_`, and `speeding`. What stands before the value, where it is told."""
VALUED: Final = ("impact",)
READING: Final = 2.0
"""s"""
ROWS: Final = 3
"""Captions that stand in the picture at a time; what comes while there are as many is a marker alone."""
_NS: Final = 1e9


class Happening(NamedTuple):
    """An event from `begin` to `end`, ns since 1970."""

    begin: int
    end: int
    kind: str
    value: float | None
    unit: str


def happenings(events: pa.Table | None, outages: Sequence[tuple[int, int]], film: Film) -> list[Happening]:
    """Events and outages that the film shows, by their beginning."""
    found = [Happening(begin, end, "outage", (end - begin) / _NS, "s") for begin, end in outages]
    if events is not None:
        told = events.select(["kind", "value", "unit"]).to_pylist()
        ends = events["end_time"].cast(pa.int64()).to_pylist()
        found += [
            Happening(begin, end, row["kind"] or "event", row["value"], row["unit"] or "")
            for begin, end, row in zip(time_ns(events).tolist(), ends, told, strict=True)
        ]
    first, last = (film.start_ns + round(float(film.seconds[end]) * _NS) for end in (0, -1))
    shown = [one for one in found if one.begin <= last and (one.begin >= first or one.end > first)]
    return sorted(shown, key=lambda one: one.begin)


def _marker_name(one: Happening) -> str:
    value = "" if one.value is None else f" {one.value:.1f} {unit_symbol(one.unit)}"
    return f"{words(one.kind)}{value}".rstrip()


def markers(found: Sequence[Happening], film: Film) -> list[Json]:
    """A marker at the frame nearest to the beginning of each, or at the first frame."""
    return [
        {
            "frame": round(_frame(film, one.begin)),
            "kind": one.kind,
            "name": _marker_name(one),
        }
        for one in found
    ]


def captions(found: Sequence[Happening], film: Film, fps: int) -> list[Json]:
    """The captions, none over another; a text that comes again in the same row is one caption with several spans."""
    until = [0] * ROWS
    made: dict[tuple[str, int], list[list[int]]] = {}
    for one in found:
        text = _caption(one)
        first, last = _lasting(one, film, fps)
        row = next((row for row, free in enumerate(until) if free < first), None)
        if text and row is not None:
            until[row] = last
            made.setdefault((text, row), []).append([first, last])
    return [{"text": text, "row": row, "spans": spans} for (text, row), spans in made.items()]


def _caption(one: Happening) -> str:
    """What stands in the picture; "" where the kind is a marker alone."""
    if one.kind not in CAPTIONS:
        return words(one.kind) if one.kind.startswith("harsh_") or one.kind == "speeding" else ""
    value = f" {one.value:.0f} {unit_symbol(one.unit)}" if one.kind in VALUED and one.value is not None else ""
    return f"{CAPTIONS[one.kind]}{value}"


def force(found: Sequence[Happening], film: Film, fps: int, streams: Mapping[str, pa.Table]) -> Json | None:
    """Where the force of the severest impact came from, and when it is shown: as long as its caption would be."""
    impacts = [one for one in found if one.kind == "impact" and one.value is not None]
    clockwise = list(_directions(streams.get("metrics")))
    if not impacts or len(clockwise) != 1:
        return None
    worst = max(impacts, key=lambda one: one.value or 0.0)
    return {"angle": -float(np.radians(clockwise[0])), "span": list(_lasting(worst, film, fps))}


def _directions(metrics: pa.Table | None) -> Iterator[float]:
    """Principal directions of force that steps told, deg clockwise from the front."""
    if metrics is not None:
        yield from metrics.filter(pc.equal(metrics["name"], "pdof"))["value"].drop_null().to_pylist()


def _lasting(one: Happening, film: Film, fps: int) -> tuple[int, int]:
    """The frames from and to which something is shown that is to be read."""
    first = int(np.floor(_frame(film, one.begin)))
    return first, max(int(np.ceil(_frame(film, one.end))), first + round(READING * fps))


def _frame(film: Film, t_ns: int) -> float:
    return float(film.frame_of(np.array([t_ns]))[0])
