"""What plots in Foxglove need beside the streams: speed, attitude and height in the units of people, states of events.

/trajectory/motion    speed (m/s), heading, pitch, roll (deg), height (m), each with the edges of its band of two
                      sigma, as the report draws them, to six decimals; also /reference/motion
/events/states        kind, state: its name when an event of that kind begins, nothing when it ends
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.schema import TIME, Column, Schema
from recon.tables import Array, build, time_ns
from recon_exporters._mcap_file import Channel
from recon_exporters._mcap_json import json_channel
from recon_exporters._panels import Curve, Panel, Source

MOTION: Final[Mapping[str, str]] = {"speed": "m/s", "heading": "deg", "pitch": "deg", "roll": "deg", "height": "m"}
"""Unit of each panel whose values are in no column."""
LOW, HIGH = "low", "high"

_DECIMALS: Final = 6
_SIGMAS: Final = 2.0
_STATES: Final = Schema((TIME, Column("kind", type=pa.string()), Column("active", type=pa.bool_())))


def is_of(curve: Curve, source: Source) -> bool:
    """Does the curve tell of that stream?"""
    return (curve.name, curve.role) == (source.name, source.role)


def motion_channels(panels: Sequence[Panel], sources: Sequence[Source]) -> Iterator[Channel]:
    """The channel /STREAM/motion of each source of which there is something to tell."""
    for source in sources:
        t_ns = time_ns(source.table)
        found: dict[str, Array] = {}
        for panel in panels:
            for curve in panel.curves:
                if panel.key in MOTION and is_of(curve, source):
                    found |= dict(_with_edges(panel.key, curve, t_ns))
        if found:
            units = {name: MOTION[name.partition("_")[0]] for name in found}
            schema = Schema((TIME, *(Column(name, unit) for name, unit in units.items())))
            yield json_channel(f"{source.stream}/motion", build(schema, time=t_ns, **found), 0)


def _with_edges(name: str, curve: Curve, t_ns: NDArray[np.int64]) -> Iterator[tuple[str, Array]]:
    """Values of a curve and the edges of its band at all times (n,), NaN where it has none."""
    columns = {name: curve.values}
    if curve.sigma is not None:
        columns[f"{name}_{LOW}"] = curve.values - _SIGMAS * curve.sigma
        columns[f"{name}_{HIGH}"] = curve.values + _SIGMAS * curve.sigma
    rows = np.searchsorted(t_ns, curve.t_ns)
    for each, values in columns.items():
        whole = np.full(len(t_ns), np.nan)
        whole[rows] = np.round(values, _DECIMALS)
        yield each, whole


def state_channel(lanes: Mapping[str, NDArray[np.int64]], start_ns: int) -> Channel | None:
    """The channel /events/states, where no kind is active at the start; None without an event.

    lanes : by kind, (2 m,) ns at which its events begin and end
    """
    if not lanes:
        return None
    rows = [(start_ns, kind, False) for kind in lanes]
    for kind, edges in lanes.items():
        rows += [(int(t_ns), kind, at % 2 == 0) for at, t_ns in enumerate(edges)]
    rows.sort(key=lambda row: row[0])
    times, kinds, active = zip(*rows, strict=True)
    return json_channel("events/states", build(_STATES, time=np.array(times), kind=kinds, active=active), start_ns)
