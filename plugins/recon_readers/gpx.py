"""GPX 1.0 and 1.1: the points of tracks, with speed and course where they are told.

Speed and course are elements of GPX 1.0, and in 1.1 extensions: of Garmin (TrackPointExtension v2), of OsmAnd, of
recon's own exporter. All are in m/s and in deg from true north. Times are in UTC. GPX does not say what an elevation is
above: `height_datum` may.

Points of routes and waypoints are not read. A file that is cut or damaged is read as far as it is whole.

Reference: Foster (2004), "GPX 1.1 schema documentation"; "GPX 1.0 developer's manual".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, Literal

import numpy as np

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.parameters import Params, setting
from recon.rows import Metric, metrics
from recon.schema import GNSS
from recon.stages import Reader, Sniff
from recon.tables import Streams, with_meta
from recon_readers._lines import COPIED
from recon_readers._track_xml import Points, damage, fixes, number, parse, unread

FIXES: Final = {"none": 0.0, "2d": 2.0, "3d": 3.0, "dgps": 3.0, "pps": 3.0}
_NUMBERS: Final = {"ele": "height", "speed": "speed", "course": "course", "sat": "satellites"}
_GPX: Final = re.compile(rb"<(?:\w+:)?gpx[\s>]")


class GpxParams(Params):
    """What the file does not tell."""

    height_datum: Literal["mean_sea_level", "ellipsoid"] | None = setting(
        None, doc="Surface above which elevations count: GNSS loggers mostly write mean_sea_level."
    )


class _Track:
    """Collects the points of tracks."""

    def __init__(self) -> None:
        self.points = Points(("lat", "lon", *_NUMBERS.values(), "fix"))
        self.count = self.untimed = self.others = self.unread = 0
        self._inside = False
        self._time = ""
        self._values: dict[str, float] = {}

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        if name == "trkpt":
            self._inside, self._time = True, ""
            self._values = {axis: self._number(attributes.get(axis, "")) for axis in ("lat", "lon")}
        elif name in ("wpt", "rtept"):
            self.others += 1

    def end(self, name: str, text: str) -> None:
        if name == "trkpt":
            self._inside = False
            self.count += 1
            self.untimed += not self._time
            self.points.add(self._time, self._values)
        elif not self._inside:
            return
        elif name == "time":
            self._time = text
        elif name == "fix":
            self._values["fix"] = FIXES.get(text.lower(), np.nan)
        elif name in _NUMBERS:
            self._values[_NUMBERS[name]] = self._number(text)

    def _number(self, text: str) -> float:
        found = number(text)
        self.unread += bool(np.isnan(found)) and text.lower() not in ("", "nan")
        return found


def read(path: Path, params: GpxParams) -> Streams:
    """The stream gnss. Raises ReadFailed where no point of a track has a time."""
    track = _Track()
    line, reason = parse(path, track)
    if track.untimed == track.count:
        what = f"its {track.count} points of tracks have no times" if track.count else "it holds no point of a track"
        what = f"it is damaged here: {reason}" if reason and not track.count else what
        what += f", only {track.others} waypoints and points of routes" if track.others and not track.count else ""
        hint = "a planned route holds no measurement; export the recorded activity with its times"
        hint = COPIED if reason and not track.count else hint
        raise ReadFailed(path, what, line=line or 1, hint=hint)
    columns = track.points.columns()
    if "course" in columns:
        columns["course"] = np.radians(columns["course"])
    gnss, learnt = fixes(path, columns, track.count, line)
    if track.others:
        learnt.append(Metric("points_not_read", float(track.others), note="waypoints and points of routes"))
    learnt += [*unread(track.unread), *damage(path, line, reason)]
    if params.height_datum is None and "height" in gnss.column_names:
        note = "GPX does not tell it: reader.gpx.height_datum may"
        learnt.append(Metric("height_datum", method="not known", note=note))
    facts = {"height_datum": params.height_datum, "heading_kind": "course_true", "time_scale": "UTC"}
    return {"gnss": with_meta(gnss, clock="absolute", format="GPX", **facts), "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """The element gpx."""
    plain = head.replace(b"\0", b"")  # UTF-16
    return Sniff(0.95, "an element gpx") if _GPX.search(plain[:4096]) else Sniff(0.0, "no element gpx")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of GPX."""
    yield Reader(
        name="gpx",
        summary="GPX 1.0 and 1.1: points of tracks, with speed and course.",
        params=GpxParams,
        run=read,
        sniff=sniff,
        writes={"gnss": GNSS.only("lat", "lon", "height", "speed", "course", "satellites", "fix").possible()},
        references=("Foster (2004), GPX 1.1 schema documentation, http://www.topografix.com/GPX/1/1/",),
    )
