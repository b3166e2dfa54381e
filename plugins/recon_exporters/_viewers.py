"""What the files for viewers have in common: lines of ways, the zoom of a map, lanes of events, groups of sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.columns import Column
from recon.rows import spans
from recon.schema import group_of, unnumbered
from recon.tables import has, schema_of
from recon_exporters._decimate import gaps, pieces
from recon_exporters._tracks import due
from recon_exporters._words import unit_symbol

LINE_RATE: Final = 10.0
"""Hz: as many points of a line as the eye tells apart; bodies move at every row."""
LONGEST_GAP: Final = 2.0
"""s that a line bridges."""
BODY: Final = (4.5, 1.8, 1.5)
"""m: length, width and height of a passenger car, since no log tells its own."""

_UNNAMED: Final = "event"
_SHORTEST: Final = 500
"""Lanes show an event as no shorter than this part of the run."""
_SENSORS: Final = ("imu", "mag", "baro", "wheel")
_DEGREES: Final = {"rad": "°", "rad/s": "°/s"}
_EARTH_M: Final = 4.0e7
"""m around the equator."""
_HALF_WINDOW_PX: Final = 100.0
"""px from the middle of the map to its nearest edge, in a small window."""


def line_pieces(t_ns: NDArray[np.int64]) -> list[NDArray[np.intp]]:
    """Rows of the lines that stand for a way, (n,) ns: a few in a second, and both ends of each piece."""
    begins = gaps(t_ns, LONGEST_GAP)
    ends = np.append(begins[1:], True)
    rows = np.flatnonzero(due(t_ns, LINE_RATE) | begins | ends)
    return [rows[piece] for piece in pieces(rows, begins)]


def map_zoom(reach: float) -> float:
    """The level at which `reach` m to either side fit a small window: the Earth has 256 px at level 0."""
    return float(np.clip(np.log2(_EARTH_M * _HALF_WINDOW_PX / (256.0 * max(reach, 1.0))), 1.0, 19.0))


def lanes(events: pa.Table | None, span_ns: tuple[int, int]) -> dict[str, NDArray[np.int64]]:
    """Begin and end of the events of each kind, those that overlap as one, and long enough to be seen: (2 m,) ns."""
    if events is None:
        return {}
    shortest_ns = max((span_ns[1] - span_ns[0]) // _SHORTEST, 1)
    kinds = [kind or _UNNAMED for kind in events["kind"].to_pylist()]
    named = events.set_column(events.column_names.index("kind"), "kind", pa.array(kinds, pa.string()))
    return {kind: _lane(spans(named, kind), shortest_ns) for kind in dict.fromkeys(kinds)}


def _lane(found: Sequence[tuple[int, int]], shortest_ns: int) -> NDArray[np.int64]:
    edges: list[int] = []
    for begin, end in found:
        end = max(end, begin + shortest_ns)
        if edges and begin <= edges[-1]:
            edges[-1] = max(edges[-1], end)
        else:
            edges += [begin, end]
    return np.array(edges, dtype=np.int64)


def sensor_groups(streams: Mapping[str, pa.Table]) -> Iterator[tuple[str, str, Sequence[Column]]]:
    """Stream, group and columns of every number of the sensors that GNSS does not stand for; columns of none left out.

    A crash test may have measured along one axis.
    """
    for name, table in streams.items():
        if unnumbered(name) in _SENSORS and table.num_rows:
            for group in dict.fromkeys(group_of(each.name) for each in schema_of(table).columns if each.name != "time"):
                columns = [column for column in schema_of(table).columns_of(group) if has(table, column.name)]
                if columns:
                    yield name, group, columns


def axes_of(columns: Sequence[Column]) -> list[int] | None:
    """Which axis each column is of, x as 0; None where they are none of axes."""
    ends = [column.name.rpartition("_")[2] for column in columns]
    return ["xyz".index(end) for end in ends] if set(ends) <= set("xyz") else None


def shown_in_degrees(unit: str) -> bool:
    """Are numbers in that unit drawn in degrees?"""
    return unit in _DEGREES


def shown_unit(unit: str) -> str:
    """The unit in which numbers are drawn."""
    return _DEGREES.get(unit, unit_symbol(unit))
