"""The drive as GPX 1.1: for navigation devices, sports programs and map editors.

    one trk for each track    a trkseg for each piece without a gap, a trkpt for each row: ele, time, extensions
    one wpt for each event    where it began: ele, time, name, desc, type, extensions

GPX knows neither speed nor direction. Speed and course are written as TrackPointExtension v2 of Garmin, in m/s and deg,
which most programs read; heading and standard deviations as elements of a namespace of our own, named and measured as
in `_tracks`. An element is left out where its number is not known. GPX does not say what an `ele` is above; the
description of the file does.

References
    Foster (2004), "GPX 1.1 schema documentation", http://www.topografix.com/GPX/1/1/
    Garmin, "TrackPointExtension v2", http://www.garmin.com/xmlschemas/TrackPointExtensionv2.xsd
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.rounding import rounded
from recon.stages import Exporter
from recon_exporters._text_columns import PLACE_DIGITS, decimals, elements, iso_8601, joined, xml
from recon_exporters._track_file import TrackFile
from recon_exporters._tracks import READS, Chart, MapParams, Mark, Track
from recon_exporters._words import words

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="recon" xmlns="http://www.topografix.com/GPX/1/1"
 xmlns:gpxtpx="http://www.garmin.com/xmlschemas/TrackPointExtension/v2" xmlns:recon="urn:recon:track:1"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://www.topografix.com/GPX/1/1 http://www.topografix.com/GPX/1/1/gpx.xsd">
"""
_GARMIN = ("speed", "course")


def _document(chart: Chart) -> Iterator[str]:
    yield f"{_HEAD}<metadata><name>{xml(chart.name)}</name><desc>{xml(chart.note)}</desc></metadata>\n"
    yield from (_waypoint(mark) for mark in chart.marks)
    for track in chart.tracks:
        yield from _track(track)
    yield "</gpx>\n"


gpx = TrackFile("track.gpx", _document)


def _waypoint(mark: Mark) -> str:
    """An event; its value stands with its unit, rounded, in the description, all that it says in the extensions."""
    sizes = [(mark.facts["duration"], "s"), (mark.facts.get("value"), mark.facts.get("unit", ""))]
    told = [f"{rounded(float(str(size)))} {unit}".strip() for size, unit in sizes if size is not None]
    shown = dict.fromkeys([*told, str(mark.facts.get("note", ""))])  # the value of a standstill is how long it lasted
    names = f"<name>{xml(words(mark.kind))}</name><desc>{xml('; '.join(filter(None, shown)))}</desc>"
    height = f"<ele>{mark.height:.3f}</ele>" if np.isfinite(mark.height) else ""
    return (
        f'<wpt lat="{mark.lat:.{PLACE_DIGITS}f}" lon="{mark.lon:.{PLACE_DIGITS}f}">{height}<time>{mark.time}</time>'
        f"{names}<type>{xml(mark.kind)}</type>{_own(mark.facts)}</wpt>\n"
    )


def _own(facts: Mapping[str, object]) -> str:
    told = "".join(f"<recon:{name}>{xml(fact)}</recon:{name}>" for name, fact in facts.items())
    return f"<extensions>{told}</extensions>"


def _track(track: Track) -> Iterator[str]:
    lat, lon = decimals(track.lat, PLACE_DIGITS), decimals(track.lon, PLACE_DIGITS)
    points = joined(
        joined('<trkpt lat="', lat, '" lon="', lon, '">'),
        elements("ele", decimals(track.height)),
        elements("time", iso_8601(track.t_ns)),
        _extensions(track),
        "</trkpt>",
    )
    yield f"<trk><name>{track.name}</name><desc>{xml(track.note)}</desc>\n"
    for piece in track.pieces:
        lines = "\n".join(points.slice(piece.start, piece.stop - piece.start).to_pylist())
        yield f"<trkseg>\n{lines}\n</trkseg>\n"
    yield "</trk>\n"


def _extensions(track: Track) -> pa.Array | str:
    """The extensions of each row: (n,) texts; "" where the track knows nothing that GPX has no element for."""
    texts = {name: decimals(values) for name, values in track.facts.items() if name != "height"}
    garmin = [elements(f"gpxtpx:{name}", texts[name]) for name in _GARMIN if name in texts]
    own = [elements(f"recon:{name}", text) for name, text in texts.items() if name not in _GARMIN]
    if garmin:
        garmin = ["<gpxtpx:TrackPointExtension>", *garmin, "</gpxtpx:TrackPointExtension>"]
    return joined("<extensions>", *garmin, *own, "</extensions>") if garmin or own else ""


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of GPX."""
    yield Exporter(
        name="gpx",
        summary="The tracks and events as GPX 1.1, for navigation devices and map editors.",
        params=MapParams,
        run=gpx,
        reads=READS,
        references=("GPX 1.1 schema", "Garmin TrackPointExtension v2"),
    )
