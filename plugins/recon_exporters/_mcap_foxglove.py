"""Channels of Foxglove's messages: places, poses, events and warnings.

Poses are those of the frame `vehicle` (x forward, y left, z up), or of one named after the stream, in the frame `local`
(East, North, Up about one anchor for all). Rows without a position are left out. An altitude that is not known is NaN,
as is a velocity.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.rotation import conjugate, rotate
from recon.schema import unnumbered
from recon.tables import (
    Array,
    has,
    known_rows,
    matrix,
    matrix_or_nan,
    meta,
    select_rows,
    time_ns,
    vector,
    vector_or_nan,
)
from recon.units import duration_text
from recon_exporters._mcap_file import Channel, fixed_binary
from recon_exporters._mcap_protobuf import (
    Part,
    choice,
    descriptor_set,
    doubles,
    joined,
    message,
    packed,
    rows_of,
    sized,
    timestamp,
    whole,
)
from recon_exporters._mcap_schemas import DEFINITIONS
from recon_exporters._text_columns import PLACE_DIGITS
from recon_exporters._viewers import line_pieces
from recon_exporters._words import unit_symbol, words

LOCAL: Final = "local"
VEHICLE: Final = "vehicle"

_DIAGONAL_KNOWN: Final = 2
_INFO, _WARNING = 2, 3
_SAME_S: Final = 1e-6


def location_channel(topic: str, table: pa.Table, frame: str) -> Channel | None:
    """LocationFix of the rows with a latitude and longitude; None where there are none.

    The covariance is that of pos_std, without what relates the axes; "unknown" in rows without.
    """
    if not (has(table, "lat") and has(table, "lon")):
        return None
    lat, lon = vector(table, "lat", gaps=True), vector(table, "lon", gaps=True)
    rows = np.flatnonzero(np.isfinite(lat) & np.isfinite(lon))
    place = np.column_stack((lat, lon, vector_or_nan(table, "height")))[rows]
    std = matrix_or_nan(table, "pos_std")[rows]
    known = np.asarray(np.isfinite(std).all(axis=1))
    variance = np.where(known[:, None], std, 0.0) ** 2
    t_ns = time_ns(table)[rows]

    def parts(some: slice) -> list[Part]:
        east, north, up = variance[some].T
        return [
            *doubles(1, place[some].T),
            *packed(4, [east, 0.0, 0.0, 0.0, north, 0.0, 0.0, 0.0, up]),
            *choice(5, known[some], _DIAGONAL_KNOWN),
            *timestamp(6, t_ns[some]),
            *sized(7, frame),
        ]

    about = {"height_datum": str(meta(table).get("height_datum", "unknown"))}
    return _channel(topic, "LocationFix", t_ns, parts, about) if len(rows) else None


def place_channel(topic: str, table: pa.Table, frame: str) -> Channel | None:
    """LocationFix of a few rows in a second, for a viewer that keeps them all."""
    if not (has(table, "lat") and has(table, "lon")):
        return None
    known = np.flatnonzero(known_rows(table, "lat", "lon"))
    kept = line_pieces(time_ns(table)[known])
    return location_channel(topic, select_rows(table, known[np.concatenate(kept)]), frame) if kept else None


def way_channel(topic: str, name: str, table: pa.Table) -> Channel | None:
    """GeoJSON, one message: the way as lines without gaps; None without two rows with a latitude and longitude."""
    if not (has(table, "lat") and has(table, "lon")):
        return None
    place = np.column_stack((vector(table, "lon", gaps=True), vector(table, "lat", gaps=True)))
    known = np.flatnonzero(np.isfinite(place).all(axis=1))
    t_ns = time_ns(table)[known]
    lines = [place[known[rows]].round(PLACE_DIGITS).tolist() for rows in line_pieces(t_ns) if len(rows) > 1]
    if not lines:
        return None
    feature = {
        "type": "Feature",
        "properties": {"name": name},
        "geometry": {"type": "MultiLineString", "coordinates": lines},
    }
    text = json.dumps(feature, ensure_ascii=False, separators=(",", ":"))
    return single(topic, "GeoJSON", t_ns[:1], [joined(sized(1, text))])


def pose_channels(stream: str, table: pa.Table, position: Array) -> list[Channel]:
    """PoseInFrame and FrameTransform of the rows with a position and an attitude, none where there are none.

    A trajectory also gets Odometry, its velocities in its own frame.

    position : (n, 3) m in the frame `local`, NaN where it is not known
    """
    if not has(table, "q"):
        return []
    frame, q = frame_of(stream), matrix(table, "q", gaps=True)
    rows = np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(q).all(axis=1))
    t_ns, position, q = time_ns(table)[rows], position[rows], q[rows]
    xyzw = q[:, [1, 2, 3, 0]]

    def placed(some: slice) -> list[Part]:
        return pose(position[some].T, xyzw[some].T)

    def in_frame(some: slice) -> list[Part]:
        return [*timestamp(1, t_ns[some]), *sized(2, LOCAL), *message(3, placed(some))]

    def frames(some: slice) -> list[Part]:
        return [*timestamp(1, t_ns[some]), *sized(2, LOCAL), *sized(3, frame)]

    def transform(some: slice) -> list[Part]:
        return [*frames(some), *_placed(4, position[some].T, xyzw[some].T)]

    def odometry(some: slice) -> list[Part]:
        velocity = rotate(conjugate(q[some]), vel[some])
        rates = [*message(5, doubles(1, velocity.T)), *message(6, doubles(1, gyro[some].T))]
        return [*frames(some), *message(4, placed(some)), *rates]

    channels = [
        _channel(f"/{stream}/pose", "PoseInFrame", t_ns, in_frame),
        _channel("/tf" if frame == VEHICLE else f"/{stream}/tf", "FrameTransform", t_ns, transform),
    ]
    if unnumbered(stream) == "trajectory":
        vel, gyro = matrix_or_nan(table, "vel")[rows], matrix_or_nan(table, "gyro")[rows]
        channels.append(_channel(f"/{stream}/odometry", "Odometry", t_ns, odometry))
    return channels if len(rows) else []


def frame_of(stream: str) -> str:
    """The frame of the body whose way a stream tells."""
    return VEHICLE if stream == "trajectory" else stream


def pose(position: Iterable[object], xyzw: Iterable[object]) -> list[Part]:
    """The fields of a Pose."""
    return _placed(1, position, xyzw)


def _placed(number: int, position: Iterable[object], xyzw: Iterable[object]) -> list[Part]:
    """A Vector3 and a Quaternion, numbered from `number`."""
    return [*message(number, doubles(1, position)), *message(number + 1, doubles(1, xyzw))]


def event_channel(events: pa.Table) -> Channel:
    """Event for each row of `events`, its other columns as metadata."""
    begin, end = time_ns(events), time_ns(events, "end_time")
    bodies = []
    for row, facts in enumerate(events.drop_columns(["time", "end_time"]).to_pylist()):
        parts = [*timestamp(1, begin[row : row + 1]), *timestamp(2, end[row : row + 1])]
        for key, value in facts.items():
            if value not in (None, ""):
                parts += message(3, [*sized(1, key), *sized(2, str(value))])
        bodies.append(joined(parts))
    return single("/events/spans", "Event", begin, bodies)


def log_channel(warnings: Sequence[str], events: pa.Table | None, start_ns: int) -> Channel:
    """Log: the warnings at the start, then a line for each event when it begins."""
    lines = [(start_ns, _WARNING, "warning", text) for text in warnings]
    if events is not None:
        begin, end = time_ns(events), time_ns(events, "end_time")
        told = events.select(["kind", "value", "unit", "note"]).to_pylist()
        lasts = ((end - begin) * 1e-9).tolist()
        lines += [(int(begin[row]), _INFO, "event", _told(event, lasts[row])) for row, event in enumerate(told)]
    lines.sort(key=lambda line: line[0])
    t_ns = np.array([line[0] for line in lines], dtype=np.int64)
    bodies = [
        joined([*timestamp(1, t_ns[row : row + 1]), *whole(2, level), *sized(3, text), *sized(4, name)])
        for row, (_, level, name, text) in enumerate(lines)
    ]
    return single("/log", "Log", t_ns, bodies)


def _told(event: Mapping[str, Any], lasts_s: float) -> str:
    """An event in words; its value is not said again where that is how long it lasts."""
    value, unit = event["value"], event["unit"]
    again = value is None or (unit == "s" and abs(value - lasts_s) < _SAME_S)
    size = "" if again else f" {value:.6g} {unit_symbol(unit)}".rstrip()
    note = f": {event['note']}" if event["note"] else ""
    return f"{words(event['kind'] or 'event')}{size} for {duration_text(lasts_s)}{note}"


def single(topic: str, title: str, t_ns: NDArray[np.int64], bodies: Sequence[bytes]) -> Channel:
    """Messages that differ in length, (n,) rising in time."""
    return _of(topic, title, t_ns, lambda rows: pa.array(bodies[rows], pa.binary()), {})


def _channel(
    topic: str,
    title: str,
    t_ns: NDArray[np.int64],
    parts: Callable[[slice], list[Part]],
    about: Mapping[str, str] | None = None,
) -> Channel:
    """Messages of one length, made of the parts for some rows."""
    return _of(topic, title, t_ns, lambda rows: fixed_binary(rows_of(parts(rows), rows.stop - rows.start)), about or {})


def _of(
    topic: str,
    title: str,
    t_ns: NDArray[np.int64],
    encode: Callable[[slice], pa.Array],
    about: Mapping[str, str],
) -> Channel:
    name = f"foxglove.{title}"
    return Channel(topic, "protobuf", name, "protobuf", descriptor_set(name, DEFINITIONS), t_ns, encode, about)
