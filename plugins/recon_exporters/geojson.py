"""The drive as GeoJSON (RFC 7946): for GIS programs and web maps.

    one feature for each track    MultiLineString, a line for each piece without a gap
      properties                  name, note, units, height_datum
      coordinateProperties        times, height, speed, heading, ...: an array for each line, an entry for each
                                  position, null where it is not known; after the proposal that togeojson made common
    one more                      MultiPoint: rows that stand alone between two gaps, with the same properties
    one feature for each event    Point where it began: kind, time, end_time, duration (s), value, unit, note, step

Positions are (lon, lat), and (lon, lat, height) where every height is known and above the ellipsoid, the only datum
that RFC 7946 allows. A line that crosses the antimeridian is cut there; the two ends that this adds have a time, and a
height, and nothing else. The bounding box is the smallest, so its west is beyond its east where it spans that meridian.

References
    RFC 7946, sections 3.1.1 (positions), 3.1.9 (antimeridian), 5 (bounding box), 11.2 (precision).
    Mapbox, "geojson-coordinate-properties", a proposal for an extension of GeoJSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.hookspecs import hookimpl
from recon.stages import Exporter
from recon.tables import Array
from recon_exporters._text_columns import DIGITS, PLACE_DIGITS, iso_8601
from recon_exporters._track_file import TrackFile
from recon_exporters._tracks import READS, UNITS, Chart, MapParams, Mark, Track

Json = dict[str, Any]

_PLACE = ("lon", "lat", "height")


def _document(chart: Chart) -> list[str]:
    deep = _heights_allowed(chart)
    features = [feature for track in chart.tracks for feature in _features(track, deep=deep)]
    features += [_event(mark, deep=deep) for mark in chart.marks]
    collection = {
        "type": "FeatureCollection",
        "name": chart.name,
        "description": chart.note,
        "bbox": _bounds(chart, deep=deep),
        "features": features,
    }
    return [json.dumps(collection, ensure_ascii=False, allow_nan=False, separators=(",", ":")), "\n"]


geojson = TrackFile("track.geojson", _document)


def _everywhere(chart: Chart) -> tuple[Array, Array, Array]:
    """Longitudes, latitudes and heights of all that is drawn."""
    drawn = (*chart.tracks, *chart.marks)
    lon, lat, height = (np.concatenate([np.atleast_1d(getattr(x, name)) for x in drawn]) for name in _PLACE)
    return lon, lat, height


def _heights_allowed(chart: Chart) -> bool:
    heights = _everywhere(chart)[2]
    return bool(np.isfinite(heights).all()) and all(track.height_datum == "ellipsoid" for track in chart.tracks)


def _features(track: Track, *, deep: bool) -> Iterable[Json]:
    cut = _cut_at_antimeridian(track)
    lines = [piece for piece in cut.pieces if piece.stop - piece.start > 1]
    alone = np.array([piece.start for piece in cut.pieces if piece.stop - piece.start == 1], dtype=np.intp)
    if lines:
        yield _feature(cut, "MultiLineString", lines, deep=deep)
    if len(alone):
        yield _feature(cut, "MultiPoint", alone, deep=deep)


def _feature(track: Track, kind: str, parts: Sequence[slice] | NDArray[np.intp], *, deep: bool) -> Json:
    """A feature of the rows in `parts`: an array of them for each slice, or one array of the rows named."""

    def arranged(values: list[Any]) -> list[Any]:
        return [values[part] for part in parts]

    columns = {"times": iso_8601(track.t_ns).to_pylist()}
    columns |= {name: _numbers(values) for name, values in track.facts.items()}
    properties = {
        "name": track.name,
        "description": track.note,
        "units": {name: UNITS[name] for name in track.facts},
        "height_datum": track.height_datum or None,
        "coordinateProperties": {name: arranged(values) for name, values in columns.items()},
    }
    geometry = {"type": kind, "coordinates": arranged(_positions(track, deep=deep))}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _positions(track: Track, *, deep: bool) -> list[list[float]]:
    place = [track.lon.round(PLACE_DIGITS), track.lat.round(PLACE_DIGITS)]
    rows: list[list[float]] = np.column_stack([*place, track.height.round(DIGITS)] if deep else place).tolist()
    return rows


def _numbers(values: Array) -> list[float | None]:
    """Rounded, None for NaN: (n,)."""
    numbers = values.round(DIGITS).astype(object)
    numbers[np.isnan(values)] = None
    return list(numbers)


def _event(mark: Mark, *, deep: bool) -> Json:
    place = [round(mark.lon, PLACE_DIGITS), round(mark.lat, PLACE_DIGITS)] + [round(mark.height, DIGITS)] * deep
    properties = {"kind": mark.kind, "time": mark.time, **mark.facts}
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Point", "coordinates": place}}


def _cut_at_antimeridian(track: Track) -> Track:
    """The track with two more rows at each crossing, on either side of it, and a cut between the two."""
    inside = np.ones(max(len(track.lon) - 1, 0), dtype=bool)
    inside[[piece.start - 1 for piece in track.pieces[1:]]] = False
    before = np.flatnonzero(inside & (np.abs(np.diff(track.lon)) > 180.0))
    if not len(before):
        return track
    side = np.copysign(180.0, track.lon[before])
    to_edge = side - track.lon[before]
    fraction = to_edge / (to_edge + np.copysign(180.0, side) + track.lon[before + 1])

    def between(values: NDArray[Any]) -> NDArray[Any]:
        step = (values[before + 1] - values[before]) * fraction
        return _inserted(values, before, values[before] + step.astype(values.dtype))

    facts = {name: _inserted(values, before, np.full(len(before), np.nan)) for name, values in track.facts.items()}
    if "height" in facts:
        facts["height"] = between(track.facts["height"])
    lon = np.insert(track.lon, np.repeat(before + 1, 2), np.column_stack((side, -side)).ravel())
    cuts = before + 2 + 2 * np.arange(len(before))
    starts = [piece.start + 2 * int(np.searchsorted(before, piece.start)) for piece in track.pieces]
    edges = sorted([*starts, *cuts.tolist(), len(lon)])
    pieces = [slice(*ends) for ends in pairwise(edges)]
    return replace(track, t_ns=between(track.t_ns), lat=between(track.lat), lon=lon, facts=facts, pieces=pieces)


def _inserted(values: NDArray[Any], before: NDArray[np.intp], added: NDArray[Any]) -> NDArray[Any]:
    """The values with each of `added` twice behind the row of its place in `before`."""
    return np.insert(values, np.repeat(before + 1, 2), np.repeat(added, 2))


def _bounds(chart: Chart, *, deep: bool) -> list[float]:
    """West, south, (lowest,) east, north (, highest). RFC 7946, 5.2: it begins behind the widest gap in longitude."""
    lon, lat, height = _everywhere(chart)
    lon = np.sort(lon)
    widest = int(np.argmax(np.diff(lon, append=lon[0] + 360.0)))
    low, high = [lon[(widest + 1) % len(lon)], lat.min()], [lon[widest], lat.max()]
    corners = [*low, height.min(), *high, height.max()] if deep else [*low, *high]
    return [round(float(corner), PLACE_DIGITS) for corner in corners]


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of GeoJSON."""
    yield Exporter(
        name="geojson",
        summary="The tracks and events as GeoJSON, for GIS programs and web maps.",
        params=MapParams,
        run=geojson,
        reads=READS,
        references=("RFC 7946",),
    )
