"""The drive as KML 2.2 with Google's extension gx: a map in 3D with a time slider.

    one Placemark for each track    gx:MultiTrack, a gx:Track for each piece without a gap: a `when` and a `gx:coord`
                                    for each row, in its ExtendedData speed, heading, ..., empty where not known
    one Placemark for each event    Point where it began, TimeSpan, in its ExtendedData value, unit, note, ...

An altitude of KML is above mean sea level. So where all heights of a track are known and above that, they are its
altitudes (altitudeMode absolute). Others would float above the ground or lie under it, by up to 100 m: such a track is
clamped to the ground with altitude 0, and its heights stand in the ExtendedData alone.

References
    OGC 07-147r2, KML 2.2; OGC 12-007r2, KML 2.3, clauses on Track and MultiTrack (there without the prefix gx).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.stages import Exporter
from recon_exporters._style import on_dark
from recon_exporters._text_columns import PLACE_DIGITS, decimals, elements, iso_8601, joined, xml
from recon_exporters._track_file import TrackFile
from recon_exporters._tracks import READS, UNITS, Chart, MapParams, Mark, Track
from recon_exporters._words import words

_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
"""


def _document(chart: Chart) -> Iterator[str]:
    yield f"{_HEAD}<Document>\n<name>{xml(chart.name)}</name>\n<description>{xml(chart.note)}</description>\n"
    yield from (_style(track) for track in chart.tracks)
    yield from (_schema(track) for track in chart.tracks)
    for track in chart.tracks:
        yield from _track(track)
    yield from (_event(mark, absolute=_has_altitudes(chart.tracks[0])) for mark in chart.marks)
    yield "</Document>\n</kml>\n"


kml = TrackFile("track.kml", _document)


def _has_altitudes(track: Track) -> bool:
    return track.height_datum == "mean_sea_level" and bool(np.isfinite(track.height).all())


def _mode(*, absolute: bool) -> str:
    return f"<altitudeMode>{'absolute' if absolute else 'clampToGround'}</altitudeMode>"


def _style(track: Track) -> str:
    """Its colour in KML: opacity, blue, green, red."""
    red, green, blue = bytes.fromhex(on_dark(f"{track.name} 1")[1:])
    line = f"<LineStyle><color>ff{blue:02x}{green:02x}{red:02x}</color><width>3</width></LineStyle>"
    return f'<Style id="style_{track.name}">{line}</Style>\n'


def _schema(track: Track) -> str:
    """The columns of a track's ExtendedData, with their units."""
    fields = "".join(
        f'<gx:SimpleArrayField name="{name}" type="float"><displayName>{name} [{UNITS[name]}]</displayName>'
        "</gx:SimpleArrayField>\n"
        for name in track.facts
    )
    return f'<Schema id="schema_{track.name}">\n{fields}</Schema>\n'


def _track(track: Track) -> Iterator[str]:
    absolute = _has_altitudes(track)
    altitude = track.height if absolute else np.zeros(len(track.t_ns))
    lon, lat = decimals(track.lon, PLACE_DIGITS), decimals(track.lat, PLACE_DIGITS)
    times = elements("when", iso_8601(track.t_ns))
    places = elements("gx:coord", joined(lon, " ", lat, " ", decimals(altitude)))
    facts = {name: joined("<gx:value>", decimals(v).fill_null(""), "</gx:value>") for name, v in track.facts.items()}
    yield f"<Placemark>\n<name>{track.name}</name>\n<description>{xml(track.note)}</description>\n"
    yield f"<styleUrl>#style_{track.name}</styleUrl>\n<gx:MultiTrack>\n{_mode(absolute=absolute)}\n"
    yield "<gx:interpolate>0</gx:interpolate>\n"
    for piece in track.pieces:
        yield f"<gx:Track>\n{_mode(absolute=absolute)}\n{_lines(times, piece)}{_lines(places, piece)}"
        yield f'<ExtendedData><SchemaData schemaUrl="#schema_{track.name}">\n'
        for name, values in facts.items():
            yield f'<gx:SimpleArrayData name="{name}">\n{_lines(values, piece)}</gx:SimpleArrayData>\n'
        yield "</SchemaData></ExtendedData>\n</gx:Track>\n"
    yield "</gx:MultiTrack>\n</Placemark>\n"


def _lines(texts: pa.Array, piece: slice) -> str:
    return "\n".join(texts.slice(piece.start, piece.stop - piece.start).to_pylist()) + "\n"


def _event(mark: Mark, *, absolute: bool) -> str:
    span = f"<begin>{mark.time}</begin><end>{mark.facts['end_time']}</end>"
    data = "".join(f'<Data name="{name}"><value>{xml(fact)}</value></Data>' for name, fact in mark.facts.items())
    place = f"{mark.lon:.{PLACE_DIGITS}f},{mark.lat:.{PLACE_DIGITS}f}" + (f",{mark.height:.3f}" if absolute else "")
    return (
        f"<Placemark>\n<name>{xml(words(mark.kind))}</name>\n<TimeSpan>{span}</TimeSpan>\n"
        f"<ExtendedData>{data}</ExtendedData>\n"
        f"<Point>{_mode(absolute=absolute)}<coordinates>{place}</coordinates></Point>\n</Placemark>\n"
    )


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of KML."""
    yield Exporter(
        name="kml",
        summary="The tracks with time, and the events, as KML for Google Earth and its like.",
        params=MapParams,
        run=kml,
        reads=READS,
        references=("OGC 07-147r2", "OGC 12-007r2"),
    )
