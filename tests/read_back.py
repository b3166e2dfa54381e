"""What exporters wrote, read by other roads than theirs: columns by stream, in the units of the streams."""

from __future__ import annotations

import csv as text_csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa

from recon.schema import STREAMS

Columns: TypeAlias = Mapping[str, Mapping[str, Any]]

TEXTS = {column.name for schema in STREAMS.values() for column in schema.columns if pa.types.is_string(column.type)}
GPX = "{http://www.topografix.com/GPX/1/1}"
KML = "{http://www.opengis.net/kml/2.2}"
GX = "{http://www.google.com/kml/ext/2.2}"


def csv(paths: Sequence[Path]) -> Columns:
    """All columns of the streams; those that only the files have are left out."""
    found = {}
    for path in paths:
        with path.open(encoding="utf-8", newline="") as file:
            header, *rows = text_csv.reader(file)
        cells = {name.partition(" [")[0]: [row[index] for row in rows] for index, name in enumerate(header)}
        derived = ("t_s", "roll", "pitch", "yaw", "heading")
        found[path.stem] = {name: _values(name, column) for name, column in cells.items() if name not in derived}
    return found


def tum(paths: Sequence[Path]) -> Columns:
    """Times, positions and attitudes."""
    lines = [line.split() for line in paths[0].read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    names = ("pos_e", "pos_n", "pos_u", "qx", "qy", "qz", "qw")
    values = np.array([line[1:] for line in lines], dtype=np.float64).T
    times = [int(line[0].replace(".", "")) for line in lines]  # nine digits behind the point
    return {"trajectory": {"time": times, **dict(zip(names, values, strict=True))}}


def kitti(paths: Sequence[Path]) -> Columns:
    """Positions; the attitudes are those of matrices."""
    poses = np.loadtxt(next(path for path in paths if path.name == "poses.txt"))
    return {"trajectory": {"pos_e": poses[:, 3], "pos_n": poses[:, 7], "pos_u": poses[:, 11]}}


def gpx(paths: Sequence[Path]) -> Columns:
    """Times and places of each track."""
    found = {}
    for track in ElementTree.parse(paths[0]).getroot().iter(f"{GPX}trk"):
        points = list(track.iter(f"{GPX}trkpt"))
        times = [point.findtext(f"{GPX}time", "") for point in points]
        places = [(float(point.attrib["lat"]), float(point.attrib["lon"])) for point in points]
        found[track.findtext(f"{GPX}name", "")] = _track(times, places)
    return found


def kml(paths: Sequence[Path]) -> Columns:
    """Times and places of each track."""
    found = {}
    for mark in ElementTree.parse(paths[0]).getroot().iter(f"{KML}Placemark"):
        coordinates = [(place.text or "").split() for place in mark.iter(f"{GX}coord")]
        places = [(float(lat), float(lon)) for lon, lat, *_ in coordinates]
        if places:
            times = [when.text or "" for track in mark.iter(f"{GX}Track") for when in track.iter(f"{KML}when")]
            found[mark.findtext(f"{KML}name", "")] = _track(times, places)
    return found


def geojson(paths: Sequence[Path]) -> Columns:
    """Times and places of each track."""
    found = {}
    for feature in json.loads(paths[0].read_text(encoding="utf-8"))["features"]:
        if feature["geometry"]["type"] == "MultiLineString":
            times = [time for line in feature["properties"]["coordinateProperties"]["times"] for time in line]
            places = [(lat, lon) for line in feature["geometry"]["coordinates"] for lon, lat, *_ in line]
            found[feature["properties"]["name"]] = _track(times, places)
    return found


def _track(times: Sequence[str], places: Sequence[tuple[float, float]]) -> dict[str, Any]:
    lat, lon = zip(*places, strict=True)
    return {"time": [_ns(time) for time in times], "lat": lat, "lon": lon}


def _values(name: str, cells: Sequence[str]) -> Sequence[Any]:
    if name in TEXTS or name == "step":
        return cells
    if name in ("time", "end_time"):
        return [_ns(cell) for cell in cells]
    words = {"": np.nan, "true": 1.0, "false": 0.0}
    return [words[cell] if cell in words else float(cell) for cell in cells]


def _ns(text: str) -> int:
    return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))
