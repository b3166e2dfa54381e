"""The drive on a street map: one page with the tracks, the raw fixes and the events, and without any key.

The ground is OpenStreetMap's where the page comes from a web server and the network is there, otherwise blank, with a
grid of round metres and a scale. OpenStreetMap's servers refuse pages that are opened as files, since these do not say
where they come from (https://wiki.openstreetmap.org/wiki/Blocked_tiles); the page then says so, and
`python -m http.server --bind 127.0.0.1` in its folder is enough. `tiles` names other servers, which are asked in any
case. Nothing else is fetched: Leaflet stands in the page.

References
    Leaflet 1.9.4 (BSD-2-Clause, see _leaflet/LICENSE).
    OpenStreetMap Foundation, "Tile usage policy", https://operations.osmfoundation.org/policies/tiles/.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.parameters import setting
from recon.stages import Exporter
from recon_exporters._page import asset, embedded
from recon_exporters._style import EVENTS, OTHER_EVENT, STYLES
from recon_exporters._text_columns import DIGITS, PLACE_DIGITS, iso_8601
from recon_exporters._tracks import READS, Chart, MapParams, Mark, Track, chart_of
from recon_exporters._words import words

_ROLES: Final = {"trajectory": "trajectory 1", "gnss": "gnss 1"}


class StreetMapParams(MapParams):
    """What is drawn, and on which ground."""

    tiles: str = setting(
        "", doc="Address of pictures of the ground with {z}, {x}, {y}; OpenStreetMap's, as far as it serves, if empty."
    )
    attribution: str = setting("", doc="To whom the pictures at `tiles` belong, shown on the map.")


def street_map(
    *,
    trajectory: pa.Table | None,
    gnss: pa.Table | None,
    events: pa.Table | None,
    folder: Path,
    about: RunInfo,
    params: StreetMapParams,
) -> list[Path]:
    """Write `folder/map.html`; its path. Raises NothingToExport where no row has a latitude and longitude."""
    chart = chart_of(trajectory, gnss, events, about, params)
    data = {
        "name": chart.name,
        "note": chart.note,
        "tracks": [_track(track, _first(chart)) for track in chart.tracks],
        "marks": [_mark(mark, _first(chart)) for mark in chart.marks],
        "tiles": params.tiles,
        "attribution": escape(params.attribution),
    }
    title = escape(chart.name)
    text = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<style>{asset('_leaflet/leaflet.css')}{asset('_page/map.css')}</style></head>\n"
        f'<body><div id="map"></div>\n<script type="application/json" id="data">{embedded(data)}</script>\n'
        f"<script>{asset('_leaflet/leaflet.js')}</script>\n<script>{asset('_page/map.js')}</script></body></html>\n"
    )
    path = folder / "map.html"
    path.write_text(text, encoding="utf-8", newline="\n")
    return [path]


def _first(chart: Chart) -> float:
    """Longitude where the first track begins, deg: all of one map lie on the same side of the 180th meridian."""
    return float(chart.tracks[0].lon[0])


def _turns(lon: float, near: float) -> float:
    """Whole circles, deg, that bring a longitude next to another one."""
    return 360.0 * round((near - lon) / 360.0)


def _track(track: Track, first: float) -> dict[str, Any]:
    """Times and places of each piece, with speeds; longitudes continuous, beyond 180 deg where need be."""
    lon = np.degrees(np.unwrap(np.radians(track.lon))) + _turns(float(track.lon[0]), first)
    places = np.column_stack((track.lat.round(PLACE_DIGITS), lon.round(PLACE_DIGITS))).tolist()
    times = iso_8601(track.t_ns).to_pylist()
    speed = track.facts.get("speed", np.full(len(times), np.nan)).round(DIGITS)
    speeds = [None if np.isnan(value) else value for value in speed.tolist()]
    style = STYLES[_ROLES[track.name]]
    return {
        "name": track.name,
        "color": style.color,
        "dots": style.mark == "dots",
        "pieces": [{"time": times[part], "place": places[part], "speed": speeds[part]} for part in track.pieces],
    }


def _mark(mark: Mark, first: float) -> dict[str, Any]:
    color, place = EVENTS.get(mark.kind, OTHER_EVENT), [mark.lat, mark.lon + _turns(mark.lon, first)]
    return {"kind": words(mark.kind), "time": mark.time, "place": place, "color": color, **mark.facts}


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of maps."""
    yield Exporter(
        name="map",
        summary="The drive on a street map in one page, without a key; offline on a blank ground with grid and scale.",
        params=StreetMapParams,
        run=street_map,
        reads=READS,
    )
