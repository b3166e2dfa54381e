"""What Foxglove draws in space: a car and a way for each trajectory and reference, and the fixes of GNSS."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.tables import Array, has, time_ns
from recon_exporters._mcap_file import Channel
from recon_exporters._mcap_foxglove import LOCAL, frame_of, pose, single
from recon_exporters._mcap_protobuf import Part, doubles, joined, message, rows_of, sized, timestamp, whole
from recon_exporters._panels import Source
from recon_exporters._style import on_dark, role_of_fixes
from recon_exporters._viewers import BODY, line_pieces

_FRONT: Final = "#F0E442"
"""Of the arrow that tells the front of a car: of no role."""
_OPAQUE: Final = {"trajectory 1": 0.8}
_FAINT: Final = 0.35
"""Of the cars beside that of the first trajectory."""
_WAY_PX: Final = 3.0
_FIX_SIZE: Final = 0.6
"""m"""
_MOST_POINTS: Final = 5000
_NO_ROTATION: Final = (0.0, 0.0, 0.0, 1.0)
_STILL: Final = message(1, pose((0.0, 0.0, 0.0), _NO_ROTATION))


def scene_channel(
    sources: Sequence[Source], fixes: Mapping[str, pa.Table], places: Mapping[str, Array]
) -> Channel | None:
    """SceneUpdate, one message; None where there is nothing to draw.

    sources : trajectories and references; fixes : tables of GNSS by stream
    places : (n, 3) m in the frame `local` by stream, NaN where it is not known
    """
    entities: list[Part] = []
    for source in sources:
        position = places[source.stream]
        if np.isfinite(position).all(axis=1).any():
            if has(source.table, "q"):
                entities += message(2, _car(source))
            entities += message(2, _way(source, position))
    if not entities:
        return None
    for name, table in fixes.items():
        points = _thinned(places[name])
        if len(points):
            entities += message(2, _fixes(name, points, time_ns(table)[:1]))
    t_ns = np.min([time_ns(source.table)[:1] for source in sources], axis=0)
    return single("/scene", "SceneUpdate", t_ns, [joined(entities)])


def _thinned(position: Array) -> Array:
    known = position[np.isfinite(position).all(axis=1)]
    return known[np.linspace(0, len(known) - 1, min(_MOST_POINTS, len(known))).astype(np.intp)]


def _entity(t_ns: NDArray[np.int64], frame: str, name: str) -> Iterator[Part]:
    yield from timestamp(1, t_ns)
    yield from sized(2, frame)
    yield from sized(3, name)


def _car(source: Source) -> Iterable[Part]:
    """A box that moves with its frame, with an arrow ahead."""
    alpha = _OPAQUE.get(source.role, _FAINT)
    box = [*_STILL, *message(2, doubles(1, BODY)), *message(3, _color(on_dark(source.role), alpha))]
    front = message(1, pose((BODY[0] / 2, 0.0, 0.0), _NO_ROTATION))
    arrow = [*front, *doubles(2, (1.0, 0.15, 0.5, 0.4)), *message(6, _color(_FRONT, alpha))]
    frame = frame_of(source.stream)
    return [
        *_entity(time_ns(source.table)[:1], frame, f"{source.stream} car"),
        *whole(5, 1),
        *message(7, arrow),
        *message(8, box),
    ]


def _way(source: Source, position: Array) -> Iterable[Part]:
    """Lines that bridge no gap."""
    known = np.flatnonzero(np.isfinite(position).all(axis=1))
    t_ns, parts = time_ns(source.table)[known], []
    for rows in line_pieces(t_ns):
        points = position[known[rows]]
        line = [*message(2, pose((0.0, 0.0, 0.0), _NO_ROTATION)), *doubles(3, (_WAY_PX,)), *whole(4, 1)]
        line += [rows_of(message(5, doubles(1, points.T)), len(points)).tobytes()]
        parts += message(11, [*line, *message(6, _color(on_dark(source.role)))])
    return [*_entity(t_ns[:1], LOCAL, f"{source.stream} way"), *parts]


def _fixes(stream: str, points: Array, t_ns: NDArray[np.int64]) -> Iterable[Part]:
    sphere = message(1, pose(points.T, _NO_ROTATION))
    sphere += message(2, doubles(1, (_FIX_SIZE, _FIX_SIZE, _FIX_SIZE)))
    sphere += message(3, _color(on_dark(role_of_fixes(stream))))
    return [*_entity(t_ns, LOCAL, stream), rows_of(message(9, sphere), len(points)).tobytes()]


def _color(color: str, alpha: float = 1.0) -> list[Part]:
    """The fields of a Color from #RRGGBB."""
    return doubles(1, (*(part / 255.0 for part in bytes.fromhex(color[1:])), alpha))
