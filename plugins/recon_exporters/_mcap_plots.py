"""What plots in Foxglove show beside the sensors: the motion in the units of people, and states of events.

    /trajectory/motion    speed (m/s), acceleration (m/s^2), turn rate (deg/s), heading, pitch, roll (deg), height (m)
                          as the report draws them, edges of their bands of two sigma, sigmas; also /reference/motion
    /events/states        kind, active: true when an event of that kind begins, false when it ends

A viewer keeps all that it plots in memory, as an object for each row. So there are rows for the eye, as the report
thins its curves: of each 1000th of the run those with the lowest and the highest value of each column, and all around
the severest crash. Values have six decimals.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.schema import TIME, Column, Schema
from recon.tables import Array, build, has, time_ns, vector
from recon_exporters._decimate import extremes, gaps
from recon_exporters._mcap_file import Channel
from recon_exporters._mcap_json import json_channel
from recon_exporters._panels import Curve, Panel, Source
from recon_exporters._viewers import LONGEST_GAP

GROUPS: Final = ("motion", "attitude")
"""Of the panels whose curves are in /STREAM/motion."""
SIGMAS: Final[Mapping[str, tuple[str, ...]]] = {
    "pos_std": ("e", "n", "u"),
    "vel_std": ("e", "n", "u"),
    "att_std": ("roll", "pitch", "yaw"),
}
"""Columns of sigmas there, by group; those of the attitude in degrees."""
LOW, HIGH = "low", "high"
AROUND_NS: Final = 1_000_000_000
"""To either side of a crash, where every row is kept."""

_SPANS: Final = 1000
_DECIMALS: Final = 6
_BAND: Final = 2.0
_UNITS: Final = {"m/s²": "m/s^2", "°": "deg", "°/s": "deg/s", "σ": ""}
_STATES: Final = Schema((TIME, Column("kind", type=pa.string()), Column("active", type=pa.bool_())))


def is_of(curve: Curve, source: Source) -> bool:
    """Does the curve tell of that stream?"""
    return (curve.name, curve.role) == (source.name, source.role)


def motion_channels(panels: Sequence[Panel], sources: Sequence[Source], impact_ns: int | None) -> Iterator[Channel]:
    """The channel /STREAM/motion of each source of which there is something to tell."""
    for source in sources:
        t_ns = time_ns(source.table)
        found = _sigmas(source.table)
        for panel in (panel for panel in panels if panel.group in GROUPS):
            for curve in (curve for curve in panel.curves if is_of(curve, source)):
                unit = _UNITS.get(panel.unit, panel.unit)
                found |= {Column(name, unit): values for name, values in _with_edges(panel.key, curve, t_ns)}
        if found:
            rows = _rows(t_ns, list(found.values()), impact_ns)
            values = {column.name: np.round(whole[rows], _DECIMALS) for column, whole in found.items()}
            table = build(Schema((TIME, *found)), time=t_ns[rows], **values)
            yield json_channel(f"{source.stream}/motion", table, 0)


def _sigmas(table: pa.Table) -> dict[Column, Array]:
    found = {}
    for group, axes in SIGMAS.items():
        for name in (f"{group}_{axis}" for axis in axes):
            if has(table, group):
                values = vector(table, name, gaps=True)
                unit = {"pos_std": "m", "vel_std": "m/s"}.get(group, "deg")
                found[Column(name, unit)] = np.degrees(values) if unit == "deg" else values
    return found


def _with_edges(name: str, curve: Curve, t_ns: NDArray[np.int64]) -> Iterator[tuple[str, Array]]:
    """Values of a curve and the edges of its band at all times (n,), NaN where it has none."""
    columns = {name: curve.values}
    if curve.sigma is not None:
        columns[f"{name}_{LOW}"] = curve.values - _BAND * curve.sigma
        columns[f"{name}_{HIGH}"] = curve.values + _BAND * curve.sigma
    rows = np.searchsorted(t_ns, curve.t_ns)
    for each, values in columns.items():
        whole = np.full(len(t_ns), np.nan)
        whole[rows] = values
        yield each, whole


def _rows(t_ns: NDArray[np.int64], columns: Sequence[Array], impact_ns: int | None) -> NDArray[np.intp]:
    """Rows to write, rising."""
    kept = np.zeros(len(t_ns), dtype=bool)
    for values in columns:
        known = np.flatnonzero(np.isfinite(values))
        kept[known[extremes(t_ns[known], values[known], gaps(t_ns[known], LONGEST_GAP), _SPANS)]] = True
    if impact_ns is not None:
        kept |= np.abs(t_ns - impact_ns) <= AROUND_NS
    return np.flatnonzero(kept)


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
