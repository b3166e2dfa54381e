"""KML tracks: gx:Track (a `when` and a `gx:coord` for each point), and placemarks with a time stamp and a point.

Coordinates are longitude, latitude in deg, altitude in m above mean sea level. An altitude counts where altitudeMode is
absolute, of a track or of the gx:MultiTrack around it; elsewhere it is relative to the ground or ignored by viewers,
and left out. Lines without times are drawings, no recordings. A file that is cut or damaged is read as far as it is
whole.

References: OGC 07-147r2, KML 2.2; OGC 12-007r2, KML 2.3 (Track there without the prefix gx).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Final

import numpy as np

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import NoParams
from recon.rows import Metric, metrics
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Streams, with_meta
from recon_readers._track_xml import Points, damage, fixes, number, parse, unread

MOST_POINTS: Final = 4096
"""Of a track are kept before they are paired."""
_VIEWS: Final = ("LookAt", "Camera")
"""From where a placemark is looked at: times and altitudes in it are those of the eye."""
_DECIMAL_COMMA: Final = re.compile(r"[+-]?\d+,\d+")
_KML: Final = re.compile(rb"<(?:\w+:)?kml[\s>]")


class _Tracks:
    """Collects the points of tracks and of placemarks with a time."""

    def __init__(self) -> None:
        self.points = Points(("lat", "lon", "height"))
        self.count = self.drawn = self.unread = self.not_absolute = 0
        self._inside = self._absolute = self._view = False
        self._tracks = self._all_absolute = False
        self._whens: list[str] = []
        self._coords: list[str] = []

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        if name in ("Track", "Placemark"):
            self._begin(inside=name == "Track")
        elif name == "MultiTrack":
            self._tracks, self._all_absolute = True, False
        elif name in _VIEWS:
            self._view = True

    def end(self, name: str, text: str) -> None:
        if name in _VIEWS:
            self._view = False
        elif self._view:
            return
        elif name == "altitudeMode":
            self._absolute = text == "absolute"
            self._all_absolute = self._all_absolute if self._inside else self._tracks and self._absolute
        elif name == "when":
            self._whens.append(text)
        elif name == "coord" and self._inside:
            self._coords.append(text)
        elif name == "coordinates" and not self._inside:
            places = text.split()
            self.drawn += len(places) > 1
            self._coords = places if len(places) == 1 else []
        elif name == "MultiTrack":
            self._tracks = self._all_absolute = False
        elif name in ("Track", "Placemark"):
            self.finish()
            self._begin(inside=False)
        if self._inside and min(len(self._whens), len(self._coords)) >= MOST_POINTS and self._paired():
            self.finish()

    def _paired(self) -> bool:
        return len(self._whens) == len(self._coords)

    def _begin(self, *, inside: bool) -> None:
        self._inside, self._absolute = inside, inside and self._all_absolute
        self._whens, self._coords = [], []

    def finish(self) -> None:
        """Pair the times and places that came."""
        for when, coord in zip_longest(self._whens, self._coords, fillvalue=""):
            if not (when and coord):
                continue
            lon, lat, height = _place(coord)
            self.unread += bool(np.isnan(lon + lat))
            self.not_absolute += bool(np.isfinite(height)) and not self._absolute
            self.points.add(when, {"lat": lat, "lon": lon, "height": height if self._absolute else np.nan})
            self.count += 1
        self._whens, self._coords = [], []


def _place(text: str) -> list[float]:
    """Longitude, latitude and height, NaN where one is not told.

    Blanks part them, or commas; where blanks do, and there are no points, commas are those of decimals.
    """
    parts = text.split()
    if len(parts) < 2 or not all(map(_DECIMAL_COMMA.fullmatch, parts[:2])):
        parts = re.split(r"[\s,]+", text.strip())
    found = [number(part.replace(",", ".")) for part in parts]
    return [*found, np.nan, np.nan, np.nan][:3] if len(found) <= 3 else [np.nan, np.nan, np.nan]


def read(path: Path, params: NoParams) -> Streams:
    """The stream gnss. Raises ReadFailed where no point has a time."""
    tracks = _Tracks()
    line, reason = parse(path, tracks)
    tracks.finish()
    if not tracks.count:
        what = "no point in it has a time" + (f", {tracks.drawn} lines are drawn" if tracks.drawn else "")
        what = f"it is damaged here: {reason}" if reason else what
        hint = "a recorded track is a gx:Track with a 'when' for each point: export it as that, or as GPX"
        raise ReadFailed(path, what, line=line or 1, hint=hint)
    gnss, learnt = fixes(path, tracks.points.columns(), tracks.count, line)
    if tracks.not_absolute:
        note = f"of {tracks.count} points: their altitudeMode is not absolute, so they are not above mean sea level"
        learnt.append(Metric("heights_left_out", float(tracks.not_absolute), note=note))
    learnt += [*unread(tracks.unread), *damage(path, line, reason)]
    table = with_meta(gnss, clock="absolute", format="KML", time_scale="UTC", height_datum="mean_sea_level")
    return {"gnss": table, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """The element kml."""
    plain = head.replace(b"\0", b"")  # UTF-16
    return Sniff(0.95, "an element kml") if _KML.search(plain[:4096]) else Sniff(0.0, "no element kml")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of KML."""
    yield Reader(
        name="kml",
        summary="KML: gx:Track, and placemarks with a time stamp.",
        run=read,
        version=4,
        sniff=sniff,
        writes={"gnss": GNSS.only("lat", "lon", "height").possible()},
        references=("OGC 07-147r2, KML 2.2", "OGC 12-007r2, KML 2.3"),
    )
