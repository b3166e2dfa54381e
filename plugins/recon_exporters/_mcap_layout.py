"""How Foxglove shows the file, as the layout that a user imports: space and map to the left, plots right, events below.

A layout names its panels `TYPE!NAME`, holds a configuration for each, and divides the window by a tree of rows and
columns. It is for the very file beside it: it shows what is there, and plots begin where the recording does.

References
    Layouts as Foxglove Studio 1.48.0 imports and exports them (@foxglove/studio-base, MPL-2.0).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from recon.schema import unnumbered
from recon.tables import vector
from recon_exporters._mcap_foxglove import LOCAL, frame_of
from recon_exporters._mcap_tabs import Json, Layout, Shown, tabs_of
from recon_exporters._style import on_dark, role_of_fixes
from recon_exporters._viewers import map_zoom
from recon_exporters._words import words

Mosaic = str | Json

_LEFT, _ABOVE = 40.0, 78.0
"""Per cent of the width and of the height."""
_PLACE: Final = ("lat", "lon")
_METRES_PER_DEGREE: Final = 111_320.0
_GRID_LINES: Final = 400
_BELOW: Final = 0.75
"""m: the ground below the middle of the car."""


def layout(shown: Shown) -> Json:
    """The layout of all that there is."""
    made = Layout()
    places = [each for each in (_space(made, shown), _map(made, shown)) if each]
    tabs = [{"title": title, "layout": _grid(plots)} for title, plots in tabs_of(made, shown).items() if plots]
    events = list(_events(made, shown))
    left = [_split(places, "column")] if places else []
    right: list[Mosaic] = [made.add("Tab", "plots", activeTabIdx=0, tabs=tabs)] if tabs else []
    below = [_split(events, "row")] if events else []
    left, right = (left, [*right, *below]) if right else ([*left, *below], [])
    columns = [_split(column, "column", _ABOVE) for column in (left, right) if column]
    whole = {"layout": _split(columns, "row", _LEFT)} if columns else {}
    return {
        "configById": made.panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        **whole,
    }


def _split(parts: Sequence[Mosaic], direction: str, first: float | None = None) -> Mosaic:
    """The parts beside or above each other, of one size, or the first with so many per cent."""
    if len(parts) == 1:
        return parts[0]
    rest = _split(parts[1:], direction)
    return {
        "direction": direction,
        "first": parts[0],
        "second": rest,
        "splitPercentage": first or 100.0 / len(parts),
    }


def _grid(parts: Sequence[str]) -> Mosaic:
    """One column, or two of more than four."""
    if len(parts) <= 4:
        return _split(parts, "column")
    half = (len(parts) + 1) // 2
    return _split([_split(parts[:half], "column"), _split(parts[half:], "column")], "row")


def _space(made: Layout, shown: Shown) -> str | None:
    """The first body from behind, or all ways from above; None where nothing is in space."""
    if "/scene" not in shown.topics:
        return None
    points = np.concatenate([shown.places[source.stream] for source in shown.sources])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    reach = max(0.5 * float((high - low)[:2].max()), 10.0)
    bodies = [frame_of(each.stream) for each in shown.sources if f"/{each.stream}/pose" in shown.topics]
    camera: Json = {"perspective": True, "fovy": 45, "near": 0.5, "far": max(5000.0, 10.0 * reach)}
    middle = (0.5 * (low + high)).round(3).tolist()
    if bodies:
        camera |= {"distance": 25, "phi": 60, "thetaOffset": 90, "targetOffset": [0, 0, 0]}
    else:
        camera |= {"distance": 3.0 * reach, "phi": 0, "thetaOffset": 90, "targetOffset": middle}
    spacing = 10.0 ** np.ceil(np.log10(max(2.0 * reach / _GRID_LINES, 10.0)))
    divisions = int(np.ceil(2.2 * reach / spacing)) + 2
    grid = {
        "layerId": "foxglove.Grid",
        "instanceId": "ground",
        "label": f"Ground, {spacing:g} m",
        "visible": True,
        "frameId": LOCAL,
        "size": divisions * spacing,
        "divisions": divisions,
        "lineWidth": 1,
        "color": "#99999966",
        "position": [*middle[:2], round(float(low[2]) - _BELOW, 3)],
        "rotation": [0, 0, 0],
        "order": 1,
    }
    return made.add(
        "3D",
        "space",
        followTf=bodies[0] if bodies else LOCAL,
        followMode="follow-pose" if bodies else "follow-none",
        cameraState={"target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], **camera},
        scene={"transforms": {"showLabel": False, "lineWidth": 0}},
        transforms={f"frame:{name}": {"visible": False} for name in (LOCAL, *bodies[1:])},
        topics={"/scene": {"visible": True}},
        layers={"ground": grid},
    )


def _map(made: Layout, shown: Shown) -> str | None:
    """All of the ways and fixes; None where nothing has a place on the Earth."""
    roles = {source.stream: source.role for source in shown.sources}
    roles |= {name: role_of_fixes(name) for name in shown.streams if unnumbered(name) == "gnss"}
    placed = [stream for stream in roles if f"/{stream}/fix" in shown.topics]
    fine = [f"/{stream}/fix" for stream in placed if f"/{stream}/place" in shown.topics]
    if not placed:
        return None
    lat, lon = (np.concatenate([vector(shown.streams[name], axis, gaps=True) for name in placed]) for axis in _PLACE)
    lat, lon = lat[np.isfinite(lat) & np.isfinite(lon)], lon[np.isfinite(lat) & np.isfinite(lon)]
    center = {"lat": 0.5 * float(lat.min() + lat.max()), "lon": 0.5 * float(lon.min() + lon.max())}
    wide = float(np.ptp(lon)) * np.cos(np.radians(center["lat"]))
    reach = 0.5 * _METRES_PER_DEGREE * max(float(np.ptp(lat)), wide)
    colors = {f"/{name}/{what}": on_dark(roles[name]) for name in placed for what in ("fix", "place", "way")}
    return made.add(
        "map",
        "way",
        center=center,
        zoomLevel=int(map_zoom(reach)),
        layer="map",
        customTileUrl="",
        disabledTopics=fine,
        followTopic="",
        topicColors={topic: color for topic, color in colors.items() if topic in shown.topics and topic not in fine},
    )


def _events(made: Layout, shown: Shown) -> Iterator[str]:
    if shown.kinds:
        lanes = [
            {
                "value": f"/events/states{{kind=={json.dumps(kind)}}}.active",
                "label": words(kind),
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for kind in shown.kinds
        ]
        yield made.add("StateTransitions", "events", foxglovePanelTitle="Events", isSynced=True, paths=lanes)
    if "/log" in shown.topics:
        yield made.add("RosOut", "log", topicToRender="/log", minLogLevel=1, searchTerms=[])
