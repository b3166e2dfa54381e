"""What exporters wrote, read by other roads than theirs: columns by stream, in the units of the streams."""

from __future__ import annotations

import csv as text_csv
import json
import re
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


def blender(paths: Sequence[Path]) -> Columns:
    """Times and positions of the keys; the attitudes may have changed their sign."""
    origin = json.loads(next(path for path in paths if path.name == "scene.json").read_text(encoding="utf-8"))["origin"]
    with np.load(next(path for path in paths if path.name == "scene.npz")) as keys:
        place = (keys["position"] + origin).T
        return {"trajectory": {"time": keys["time"], "pos_e": place[0], "pos_n": place[1], "pos_u": place[2]}}


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


def mcap(paths: Sequence[Path]) -> Columns:
    """All columns of the streams, from their JSON messages; /STREAM/... is made of them for viewers."""
    from mcap.reader import make_reader

    rows: dict[str, list[dict[str, Any]]] = {}
    with paths[0].open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            stream = channel.topic.removeprefix("/")
            if channel.message_encoding == "json" and "/" not in stream:
                rows.setdefault(stream, []).append(json.loads(message.data))
    found = {}
    for stream, objects in rows.items():
        names = {name: None for one in objects for name in one}
        found[stream] = {name: [_of_json(name, one.get(name)) for one in objects] for name in names}
    return found


def _of_json(name: str, value: Any) -> Any:
    if isinstance(value, dict):
        return value["sec"] * 1_000_000_000 + value["nsec"]
    if value is None:
        return "" if name in TEXTS else np.nan
    return value


def sbet(paths: Sequence[Path]) -> Columns:
    """Places and velocities."""
    records = np.fromfile(next(path for path in paths if path.suffix == ".out"), dtype="<f8").reshape(-1, 17).T
    place = {"lat": np.degrees(records[1]), "lon": np.degrees(records[2]), "height": records[3]}
    return {"trajectory": {**place, "vel_e": records[4], "vel_n": records[5], "vel_u": records[6]}}


def hdf5(paths: Sequence[Path]) -> Columns:
    """All columns of the streams but those of lists."""
    import h5py

    with h5py.File(paths[0]) as file:
        return {
            stream: {
                name: column.asstr()[:] if h5py.check_string_dtype(column.dtype) else column[:]
                for name, column in group.items()
                if h5py.check_vlen_dtype(column.dtype) in (None, str)
            }
            for stream, group in file.items()
        }


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


def rerun(paths: Sequence[Path]) -> Columns:
    """Times and places of what moves on the map; times and numbers of the imu, angles back from degrees."""
    from rerun.chunk import RrdReader

    found: dict[str, dict[str, Any]] = {}
    for chunk in RrdReader(str(paths[0])).stream():
        match chunk.entity_path.split("/")[1:]:
            case ["map", stream, "now"] if not chunk.is_static:
                batch = chunk.to_record_batch()
                lat, lon = _flat(batch["GeoPoints:positions"]).reshape(-1, 2).T
                found.setdefault(stream, {}).update(time=_flat(batch["time"]), lat=lat, lon=lon)
            case ["sensors", "imu", group] if not chunk.is_static:
                batch = chunk.to_record_batch()
                vectors = _flat(batch["Scalars:scalars"]).reshape(-1, 3)
                vectors = np.radians(vectors) if group == "gyro" else vectors
                parts = {f"{group}_{axis}": part for axis, part in zip("xyz", vectors.T, strict=True)}
                found.setdefault("imu", {}).update(time=_flat(batch["time"]), **parts)
    return found


def _flat(column: pa.Array) -> np.ndarray:
    """All numbers of a column, however deep they lie; times in ns."""
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    return np.asarray(column.cast(pa.int64()) if pa.types.is_timestamp(column.type) else column)


def street_map(paths: Sequence[Path]) -> Columns:
    """Times and places of each track."""
    (text,) = re.findall(r'id="data">(.*?)</script>', paths[0].read_text(encoding="utf-8"), re.DOTALL)
    found = {}
    for track in json.loads(text)["tracks"]:
        times = [time for piece in track["pieces"] for time in piece["time"]]
        found[track["name"]] = _track(times, [tuple(place) for piece in track["pieces"] for place in piece["place"]])
    return found


def report(paths: Sequence[Path]) -> Columns:
    """Metrics and events."""
    data = json.loads(next(path for path in paths if path.suffix == ".json").read_text(encoding="utf-8"))
    found = {}
    for stream in ("metrics", "events"):
        names = {name: None for row in data[stream] for name in row if name not in ("t_s", "duration")}
        found[stream] = {name: _values(name, [_cell(name, row[name]) for row in data[stream]]) for name in names}
    return found


def _cell(name: str, value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else repr(value)


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
