"""What a Rerun file shows in space: paths and moving bodies about one anchor, and the same on a map.

Every stream is brought to the anchor of the first one that has one: as it is where the anchor is its own, otherwise by
its latitude, longitude and height; without a height above the same datum it is drawn at the height of the anchor.
Rows that no position about the common anchor is known of are left out.

    world/<stream>/path    the way, in pieces without a gap          map/<stream>/path    the same on the Earth
    world/<stream>/body    pose at every row: box and axes           map/<stream>/now     place at every row
    world/<stream>/body/sensor   axes of the box, as it was found to be mounted
    world/<gnss>           every fix                                 map/<gnss>/fixes, map/<gnss>/now
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import rerun as rr
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor
from recon.placing import about_anchor, anchor_of
from recon.schema import unnumbered
from recon.tables import Array, has, matrix, meta, time_ns, vector
from recon_exporters._panels import Source, sources_of
from recon_exporters._rerun_style import AXIS_COLORS, color_of, times
from recon_exporters._style import role_of_fixes
from recon_exporters._viewers import BODY, line_pieces

AXIS: Final = 3.5
"""m"""

_MOUNT: Final = ("mount_qw", "mount_qx", "mount_qy", "mount_qz")


@dataclass(frozen=True)
class Drawn:
    """What came of it.

    bodies : streams with a pose in space; on_map : is there anything on the map?
    reach : m, half of the longer side of what all paths fill; center : (3,) m, its middle
    left_out : streams whose place about the common anchor is not known
    """

    bodies: tuple[str, ...]
    on_map: bool
    reach: float
    center: Array
    left_out: tuple[str, ...]


@dataclass(frozen=True)
class Place:
    """Where rows of a stream are about the common anchor: rows (n,), t_ns (n,) ns, position (n, 3) m."""

    rows: NDArray[np.intp]
    t_ns: NDArray[np.int64]
    position: Array


def draw_space(file: rr.RecordingStream, streams: Mapping[str, pa.Table]) -> Drawn:
    """Draw all streams that have a place."""
    sources = sources_of(streams)
    fixes = {name: table for name, table in streams.items() if unnumbered(name) == "gnss" and table.num_rows}
    anchor, datum = _common_frame([*(source.table for source in sources), *fixes.values()])
    mount = _mounting(streams.get("metrics"))
    file.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    drawn: dict[str, Array] = {}
    bodies = []
    for source in sources:
        place = place_of(source.table, anchor, datum)
        if place is None:
            continue
        drawn[source.name] = place.position
        _draw_path(file, source, place)
        if has(source.table, "q"):
            bodies.append(source.name)
            _draw_body(file, source, place, mount if source.role == "trajectory 1" else None)
    for name, table in fixes.items():
        place = place_of(table, anchor, datum)
        if place is not None:
            drawn[name] = place.position
            points = rr.Points3D(place.position, colors=color_of(role_of_fixes(name)), radii=rr.Radius.ui_points(2.5))
            file.log(f"world/{name}", points, static=True)
    on_map = [_draw_on_map(file, source.name, source.role, source.table) for source in sources]
    on_map += [_draw_on_map(file, name, role_of_fixes(name), table) for name, table in fixes.items()]
    center, reach = _extent(list(drawn.values()))
    left_out = [name for name in [*(s.name for s in sources), *fixes] if name not in drawn]
    return Drawn(tuple(bodies), any(on_map), reach, center, tuple(left_out))


def place_of(table: pa.Table, anchor: Anchor | None, datum: str) -> Place | None:
    """Where the rows of a stream are; None where no row has a place about the anchor."""
    position = about_anchor(table, anchor, datum)
    rows = np.flatnonzero(np.isfinite(position).all(axis=1))
    return Place(rows, time_ns(table)[rows], position[rows]) if len(rows) else None


def _common_frame(tables: list[pa.Table]) -> tuple[Anchor | None, str]:
    """The first anchor among the streams, and the datum of heights there; None and "" where none has one."""
    for table in tables:
        anchor = anchor_of(table)
        if anchor is not None:
            return anchor, str(meta(table).get("height_datum", ""))
    return None, ""


def _mounting(metrics: pa.Table | None) -> Array | None:
    """(4,) from sensor to vehicle, as a step found it; None where none did."""
    if metrics is None:
        return None
    chosen = metrics.filter(pc.is_in(metrics["name"], pa.array(_MOUNT)))
    found = {row["name"]: row["value"] for row in chosen.select(["name", "value"]).to_pylist()}
    return np.array([found[name] for name in _MOUNT]) if len(found) == len(_MOUNT) else None


def _draw_path(file: rr.RecordingStream, source: Source, place: Place) -> None:
    strips = [place.position[rows] for rows in line_pieces(place.t_ns)]
    lines = rr.LineStrips3D(strips, colors=color_of(source.role), radii=rr.Radius.ui_points(1.5))
    file.log(["world", source.name, "path"], lines, static=True)


def _draw_body(file: rr.RecordingStream, source: Source, place: Place, mount: Array | None) -> None:
    q = matrix(source.table, "q", gaps=True)[place.rows]
    known = np.isfinite(q).all(axis=1)
    path: list[object] = ["world", source.name, "body"]
    pose = rr.Transform3D.columns(translation=place.position[known], quaternion=q[known][:, [1, 2, 3, 0]])
    file.send_columns(rr.new_entity_path(path), [times(place.t_ns[known])], pose)
    color = color_of(source.role)
    box = rr.Boxes3D(sizes=[BODY], colors=color, fill_mode="transparentfillmajorwireframe", radii=0.03)
    file.log(path, box, static=True)  # beside the pose, so that the eye can follow it
    file.log([*path, "axes"], _axes(AXIS, named=source.role == "trajectory 1"), static=True)
    if mount is not None:
        file.log([*path, "sensor"], rr.Transform3D(quaternion=rr.Quaternion(xyzw=mount[[1, 2, 3, 0]])), static=True)
        file.log([*path, "sensor", "axes"], _axes(0.6 * AXIS, named=False), static=True)


def _axes(length: float, *, named: bool) -> rr.Arrows3D:
    names = ["x", "y", "z"] if named else None
    return rr.Arrows3D(vectors=length * np.eye(3), colors=AXIS_COLORS, labels=names, radii=0.05)


def _draw_on_map(file: rr.RecordingStream, name: str, role: str, table: pa.Table) -> bool:
    """Is there a row with a place on the Earth?"""
    if not (has(table, "lat") and has(table, "lon")):
        return False
    place = np.column_stack((vector(table, "lat", gaps=True), vector(table, "lon", gaps=True)))
    rows = np.flatnonzero(np.isfinite(place).all(axis=1))
    if not len(rows):
        return False
    t_ns, place, color = time_ns(table)[rows], place[rows], color_of(role)
    if role.startswith("gnss "):
        fixes = rr.GeoPoints(lat_lon=place, colors=color, radii=rr.Radius.ui_points(1.0))
        file.log(["map", name, "fixes"], fixes, static=True)
    else:
        lines = [place[piece] for piece in line_pieces(t_ns)]
        path = rr.GeoLineStrings(lat_lon=lines, colors=color, radii=rr.Radius.ui_points(2.5))
        file.log(["map", name, "path"], path, static=True)
    now = rr.GeoPoints.columns(positions=place)
    file.send_columns(rr.new_entity_path(["map", name, "now"]), [times(t_ns)], now)
    size = 7.0 if role.startswith("trajectory") else 3.0
    style = rr.GeoPoints.from_fields(colors=color, radii=rr.Radius.ui_points(size))
    file.log(["map", name, "now"], style, static=True)
    return True


def _extent(positions: list[Array]) -> tuple[Array, float]:
    """Middle (3,) and half of the longer side of the box around all positions, m."""
    if not positions:
        return np.zeros(3), 0.0
    low = np.min([position.min(axis=0) for position in positions], axis=0)
    high = np.max([position.max(axis=0) for position in positions], axis=0)
    return 0.5 * (low + high), float(0.5 * (high - low).max())
