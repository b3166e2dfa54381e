"""A Rerun file from its streams: what is drawn over time, and the text about it. Space is drawn by _rerun_space."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import numpy as np
import pyarrow as pa
import rerun as rr
from rerun.error_utils import catch_and_log_exceptions

from recon.columns import Column
from recon.manifest import RunInfo
from recon.recording import Recording
from recon.tables import time_ns, vector
from recon_exporters._panels import Curve, Panel, panels_of
from recon_exporters._rerun_camera import draw_frames
from recon_exporters._rerun_layout import Shown, layout
from recon_exporters._rerun_space import draw_space
from recon_exporters._rerun_style import AXIS_COLORS, color_of, packed, times
from recon_exporters._style import EVENTS, OTHER_EVENT, style_of
from recon_exporters._text_columns import iso_8601
from recon_exporters._viewers import axes_of, lanes, sensor_groups, shown_in_degrees, shown_unit
from recon_exporters._words import unit_symbol, words

_NOTHING: Final = ""
"""State of a lane between two events."""


def write(path: Path, streams: Mapping[str, pa.Table], about: RunInfo) -> None:
    """Write the file."""
    span = Recording(streams).span_ns() or (0, 0)
    with catch_and_log_exceptions("recon", strict=True):  # else what is refused would become a warning
        # Of itself a file would say when it was exported.
        file = rr.RecordingStream(_application(about.name), send_properties=False)
        file.save(path)
        file.send_recording_name(about.name)
        file.send_recording_start_time_nanos(span[0])
        space = draw_space(file, streams)
        panels = [panel for panel in panels_of(streams) if panel.group != "sensors"]  # all of a sensor is drawn below
        panels += list(_sigma_panels(panels))
        for panel in panels:
            for number, curve in enumerate(panel.curves):
                _draw_curve(file, rr.new_entity_path(["plots", panel.key, str(number)]), curve)
        sensors = _draw_sensors(file, streams)
        kinds = _draw_events(file, streams.get("events"), span)
        pictures = draw_frames(file, streams, about)
        file.log("about", rr.TextDocument(_text(about, space.left_out), media_type="text/markdown"), static=True)
        file.send_blueprint(layout(Shown(span, space, panels, sensors, kinds, pictures)))
        file.flush()
        file.disconnect()


def _application(run: str) -> str:
    """The viewer keeps one layout for each application, so every run is one. Rerun takes 180 ASCII letters, digits,
    blanks, hyphens and underscores; what is left of other names has a sum of the whole behind it.
    """
    plain = re.sub(r"[^A-Za-z0-9 _-]", "-", run)[:80]
    return f"recon {plain}" if plain == run else f"recon {plain} {crc32(run.encode()):08x}"


def _draw_curve(file: rr.RecordingStream, path: str, curve: Curve) -> None:
    color, mark = color_of(curve.role), style_of(curve.role).mark
    style: rr.AsComponents
    if mark == "line" or curve.role == "wheel":  # wheels are read so often that dots would cover all else
        style = _line(color, curve.name)
    elif mark == "dots":
        style = rr.SeriesPoints(colors=color, names=curve.name, markers="circle", marker_sizes=1.5)
    else:
        style = rr.SeriesPoints(colors=color, names=curve.name, markers="cross", marker_sizes=5.0)
    file.log(path, style, static=True)
    file.send_columns(path, [times(curve.t_ns)], rr.Scalars.columns(scalars=curve.values))


def _line(colors: Any, names: Any) -> rr.SeriesLines:
    """Where many rows fall on a pixel both ends of what they span are drawn: a mean would hide the peak of a crash."""
    return rr.SeriesLines(colors=colors, names=names, widths=1.5, aggregation_policy="MinMax")


def _sigma_panels(panels: Sequence[Panel]) -> Iterator[Panel]:
    """The sigmas of curves as curves of their own, but for those that are drawn already."""
    for panel in panels:
        curves = [replace(curve, values=curve.sigma, sigma=None) for curve in panel.curves if curve.sigma is not None]
        if curves:
            what = panel.title.partition(",")[0].lower()
            yield Panel(f"{panel.key}_std", f"Sigma of {what}", panel.unit, "uncertainty", curves)


def _draw_sensors(file: rr.RecordingStream, streams: Mapping[str, pa.Table]) -> dict[str, str]:
    """Every number of the sensors; titles by path."""
    titles = {}
    for name, group, columns in sensor_groups(streams):
        path = f"sensors/{name}/{group}"
        titles[path] = _draw_group(file, path, name, group, columns, streams[name])
    return titles


def _draw_group(
    file: rr.RecordingStream, path: str, stream: str, group: str, columns: Sequence[Column], table: pa.Table
) -> str:
    """All columns of a group as one plot; its title."""
    values = np.column_stack([vector(table, column.name, gaps=True) for column in columns])
    known = np.isfinite(values).all(axis=1)
    unit = columns[0].unit
    shown = np.degrees(values[known]) if shown_in_degrees(unit) else values[known]
    names = [column.name for column in columns]
    chosen = axes_of(columns) or [*range(len(columns))]
    file.log(path, _line(AXIS_COLORS[chosen] if max(chosen) < len(AXIS_COLORS) else None, names), static=True)
    scalars = rr.Scalars.columns(scalars=shown.ravel()).partition(np.full(len(shown), len(names)))
    file.send_columns(path, [times(time_ns(table)[known])], scalars)
    return f"{words(group)} of {stream} [{shown_unit(unit)}]"


def _draw_events(file: rr.RecordingStream, events: pa.Table | None, span_ns: tuple[int, int]) -> list[str]:
    """A lane for each kind and a line of text for each event; the kinds."""
    if events is None or not events.num_rows:
        return []
    found = lanes(events, span_ns)
    for kind, edges in found.items():
        path = rr.new_entity_path(["events", kind])
        color = packed(EVENTS.get(kind, OTHER_EVENT))
        look = rr.StateConfiguration(values=[words(kind), _NOTHING], colors=[color, color], visible=[True, False])
        file.log(path, look, static=True)
        states = rr.StateChange.columns(state=[words(kind), _NOTHING] * (len(edges) // 2))
        file.send_columns(path, [times(edges)], states)
    lines = rr.TextLog.columns(text=_sentences(events))
    file.send_columns("events_as_text", [times(time_ns(events))], lines)
    return list(found)


def _sentences(events: pa.Table) -> list[str]:
    """What is known of each event; when it began with all nanoseconds, since the viewer shortens times."""
    begin, end = time_ns(events), time_ns(events, "end_time")
    told = events.drop_columns(["time", "end_time"]).to_pylist()
    when, lasts = iso_8601(begin).to_pylist(), (end - begin) * 1e-9
    return [_sentence(*row) for row in zip(when, lasts.tolist(), told, strict=True)]


def _sentence(when: str, lasts: float, event: Mapping[str, Any]) -> str:
    value = "" if event["value"] is None else f"{event['value']:.6g} {unit_symbol(event['unit'])}".strip()
    parts = [f"{when} {words(event['kind'] or 'event')}, {lasts:.3f} s long", value, event["note"], event.get("step")]
    return "; ".join(part for part in parts if part)


def _text(about: RunInfo, left_out: Sequence[str]) -> str:
    """What made the run, as Markdown."""
    manifest = about.manifest
    inputs = ", ".join(str(part.get("name", "")) for part in manifest.get("inputs", []))
    facts = {
        "pipeline": manifest.get("pipeline", {}).get("name", ""),
        "inputs": inputs,
        "recon": manifest.get("recon", ""),
    }
    lines = [f"# {about.name}", "", *(f"- {name}: {value}" for name, value in facts.items() if value)]
    lines += [f"- not in space, since its place about the common anchor is not known: {name}" for name in left_out]
    lines += ["", "## Warnings", "", *(f"- {text}" for text in about.warnings)] if about.warnings else []
    return "\n".join(lines) + "\n"
