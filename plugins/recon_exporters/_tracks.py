"""What goes on a map, for every format: tracks in pieces without a gap, and events where they began.

A row without latitude and longitude, or more than `max_gap` after the row before it, ends a piece. Where a `rate` thins
the rows, the first and the last of each piece stay. Longitudes lie in [-180, 180) deg.

What is known beside the place, by name, is in the unit that UNITS gives:

    height                    above the height_datum of the stream
    speed                     as measured, otherwise the magnitude of the velocity
    heading, heading_std      where the vehicle points: clockwise from true north, and its standard deviation
    course                    where it moves, as GNSS measured it, clockwise from the stream's heading_kind
    pos_std_*, vel_std_*      standard deviations to the east, to the north and upwards
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import NothingToExport
from recon.manifest import RunInfo
from recon.numerics.rotation import heading_from_yaw, to_euler
from recon.numerics.signals import interpolate, interpolate_angle
from recon.parameters import Params, quantity, setting
from recon.schema import EVENTS, GNSS, TRAJECTORY
from recon.tables import Array, has, matrix, meta, select_rows, time_ns, vector, vector_or_nan
from recon_exporters._text_columns import DIGITS, PLACE_DIGITS, iso_8601

UNITS: Final[Mapping[str, str]] = {
    "height": "m",
    "speed": "m/s",
    "heading": "deg",
    "course": "deg",
    **{f"pos_std_{axis}": "m" for axis in "enu"},
    **{f"vel_std_{axis}": "m/s" for axis in "enu"},
    "heading_std": "deg",
}
READS: Final = {
    "trajectory": TRAJECTORY.need(
        "time", maybe=("lat", "lon", "height", "vel", "q", "pos_std", "vel_std", "att_std"), optional=True
    ),
    "gnss": GNSS.need(
        "time", maybe=("lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std"), optional=True
    ),
    "events": EVENTS.need("time", "end_time", "kind", "value", "unit", "note", optional=True),
}

_NS: Final = 1e9
_LARGEST: Final = 1e12
"""A number beyond it says nothing about a vehicle and is taken as missing."""
_DATUMS: Final = {"ellipsoid": "the WGS84 ellipsoid", "mean_sea_level": "mean sea level"}


class MapParams(Params):
    """What is drawn, and how finely."""

    rate: float | None = quantity(
        10.0, "Hz", ge=1e-6, le=1e6, doc="Most rows in a second that are written; none for every row."
    )
    max_gap: float = quantity(2.0, "s", gt=0, doc="No line joins rows that are further apart.")
    gnss: bool = setting(True, doc="Is raw GNSS drawn as a track of its own?")


@dataclass(frozen=True)
class Track:
    """Where something was.

    t_ns : (n,) ns since 1970; lat, lon : (n,) deg
    facts : what else is known, by name: (n,) in the unit of UNITS, NaN where it is missing
    pieces : rows that a line joins, in their order; together all rows
    height_datum : "" where it is not known; note : sentences for the user
    """

    name: str
    t_ns: NDArray[np.int64]
    lat: Array
    lon: Array
    facts: Mapping[str, Array]
    pieces: Sequence[slice]
    height_datum: str
    note: str

    @property
    def height(self) -> Array:
        """(n,) m, NaN where it is not known."""
        return self.facts.get("height", np.full(len(self.t_ns), np.nan))


@dataclass(frozen=True)
class Mark:
    """An event, where it began. time : ISO 8601; height : m, NaN where not known; facts : what else it says."""

    kind: str
    time: str
    lat: float
    lon: float
    height: float
    facts: Mapping[str, str | float]


@dataclass(frozen=True)
class Chart:
    """All that a file shows: at least one track."""

    name: str
    note: str
    tracks: Sequence[Track]
    marks: Sequence[Mark]


def chart_of(
    trajectory: pa.Table | None, gnss: pa.Table | None, events: pa.Table | None, about: RunInfo, params: MapParams
) -> Chart:
    """The tracks that there are, and the events along the first of them.

    Raises NothingToExport where no row of any track has a latitude and longitude.
    """
    tables = {"trajectory": trajectory, "gnss": gnss if params.gnss else None}
    tracks = [track for name, table in tables.items() if (track := track_of(name, table, params)) is not None]
    if not tracks:
        raise NothingToExport(
            f"no row of {' or '.join(tables) if params.gnss else 'trajectory'} has a latitude and longitude, "
            "which a map needs",
            "report, rerun, plots, tum and kitti take the local frame, which needs none",
        )
    marks = _marks(events, tables[tracks[0].name], params.max_gap)
    notes = [f"{track.name}: {track.note}" for track in tracks]
    if events is not None and len(marks) < events.num_rows:
        lost = f"{events.num_rows - len(marks)} of {events.num_rows}"
        notes.append(f"events: {lost} began where no position is known and are left out.")
    return Chart(about.name, " ".join(notes), tracks, marks)


def track_of(name: str, table: pa.Table | None, params: MapParams) -> Track | None:
    """The track of a stream; None where no row has a position."""
    lat, lon = _places(table) if table is not None else (np.zeros(0), np.zeros(0))
    rows = np.flatnonzero(np.isfinite(lat))
    if table is None or not len(rows):
        return None
    t_ns = time_ns(table)[rows]
    broken = (np.diff(rows) > 1) | (np.diff(t_ns) > params.max_gap * _NS)
    first, last = np.concatenate(([True], broken)), np.concatenate((broken, [True]))
    kept = first | last | due(t_ns, params.rate)
    chosen, starts = rows[kept], np.flatnonzero(first[kept])
    pieces = [slice(*ends) for ends in zip(starts.tolist(), [*starts[1:].tolist(), len(chosen)], strict=True)]
    facts = _facts(select_rows(table, chosen))
    note = _note(table, len(chosen), len(pieces), params, with_height="height" in facts)
    datum = str(meta(table).get("height_datum", ""))
    return Track(name, t_ns[kept], lat[chosen], lon[chosen], facts, pieces, datum, note)


def due(t_ns: NDArray[np.int64], rate: float | None) -> NDArray[np.bool_]:
    """Rows that a rate in Hz keeps: the first of each of its periods, by times that may shake by half a step.

    t_ns : (n,) rising; rate : None keeps every row
    returns : (n,) bool
    """
    if rate is None or len(t_ns) < 2:
        return np.ones(len(t_ns), dtype=bool)
    half_step = int(np.median(np.diff(t_ns))) // 2
    periods = (t_ns - t_ns[0] + half_step) // max(1, round(_NS / rate))
    return np.concatenate(([True], np.diff(periods) > 0))


def rows_kept(rate: float | None) -> str:
    """Which rows `due` keeps, in words."""
    return "all that there are" if rate is None else f"at most {rate:g} in a second"


def _places(table: pa.Table) -> tuple[Array, Array]:
    """Latitude, and longitude in [-180, 180), as they will be written: (n,) deg, both NaN in a row without."""
    if not (has(table, "lat") and has(table, "lon")):
        return np.full(table.num_rows, np.nan), np.full(table.num_rows, np.nan)
    lat, lon = vector(table, "lat", gaps=True), vector(table, "lon", gaps=True)
    known = (np.abs(lat) <= 90.0) & (np.abs(lon) <= 360.0)
    lat, lon = np.where(known, lat, np.nan).round(PLACE_DIGITS), np.where(known, lon, np.nan).round(PLACE_DIGITS)
    return lat, lon - 360.0 * np.floor((lon + 180.0) / 360.0)


def _facts(rows: pa.Table) -> dict[str, Array]:
    found = {name: _known(vector(rows, name, gaps=True)) for name in UNITS if has(rows, name)}
    if "speed" not in found and has(rows, "vel"):
        found["speed"] = np.asarray(np.linalg.norm(_known(matrix(rows, "vel", gaps=True)), axis=1))
    if has(rows, "q"):
        yaw, _, _ = to_euler(_known(matrix(rows, "q", gaps=True)))
        found["heading"] = _full_circle(heading_from_yaw(yaw))
    if "course" in found:
        found["course"] = _full_circle(found["course"])
    if has(rows, "att_std_yaw"):
        found["heading_std"] = np.degrees(_known(vector(rows, "att_std_yaw", gaps=True)))
    return {name: found[name] for name in UNITS if name in found}


def _known(values: Array) -> Array:
    return np.where(np.abs(values) < _LARGEST, values, np.nan)


def _full_circle(angle: Array) -> Array:
    """Angles of rad in degrees that are still below 360 when they are written: (n,)."""
    return np.degrees(angle).round(DIGITS) % 360.0


def _note(table: pa.Table, rows: int, pieces: int, params: MapParams, *, with_height: bool) -> str:
    facts = meta(table)
    lines = "1 piece" if pieces == 1 else f"{pieces} pieces"
    parts = [f"{rows} of {table.num_rows} rows, {rows_kept(params.rate)}"]
    parts.append(f"{lines}, apart where no position is known or {params.max_gap:g} s pass without a row")
    if with_height:
        parts.append(f"heights are above {_DATUMS.get(facts.get('height_datum', ''), 'a datum that is not known')}")
    if facts.get("heading_kind") == "magnetic":
        parts.append("courses count from magnetic north")
    if facts.get("time_scale", "UTC") != "UTC":
        parts.append(f"times are {facts['time_scale']} time, not UTC")
    if facts.get("clock") == "relative":
        parts.append("the clock was not set, so dates mean nothing")
    return "; ".join(parts) + "."


def _marks(events: pa.Table | None, table: pa.Table, max_gap: float) -> list[Mark]:
    """The events whose beginning lies on a track, placed between its rows, all of them rather than those drawn."""
    if events is None or not events.num_rows:
        return []
    begin, end, t_ns = time_ns(events), time_ns(events, "end_time"), time_ns(table)
    at = _before_gaps(begin, t_ns, max_gap)
    lat, lon = _places(table)
    height = _known(vector_or_nan(table, "height"))
    lat, height = interpolate(at, t_ns, np.column_stack((lat, height)), max_gap * _NS).T
    lon = np.degrees(interpolate_angle(at, t_ns, np.radians(lon), max_gap * _NS))
    told = events.select([name for name in ("step", "value", "unit", "note") if name in events.column_names])
    kinds, times, end_times = events["kind"].to_pylist(), iso_8601(begin).to_pylist(), iso_8601(end).to_pylist()
    marks = []
    for row, facts in enumerate(told.to_pylist()):
        lasted = {"end_time": end_times[row], "duration": float(end[row] - begin[row]) / _NS}
        known = {name: fact for name, fact in {**lasted, **facts}.items() if fact not in (None, "") and fact == fact}
        if np.isfinite(lat[row]):
            place = (float(lat[row]), float(lon[row]), float(height[row]))
            marks.append(Mark(kinds[row] or "event", times[row], *place, known))
    return marks


def _before_gaps(begin: NDArray[np.int64], t_ns: NDArray[np.int64], max_gap: float) -> NDArray[np.int64]:
    """For what begins within a usual step behind the last row before a gap that row, otherwise as it is: (m,) ns."""
    step = np.diff(t_ns)
    usual = np.median(step) if len(step) else 0.0
    left = np.clip(np.searchsorted(t_ns, begin, side="right") - 1, 0, max(len(t_ns) - 2, 0))
    in_gap = np.append(step, 0)[left] > max_gap * _NS
    return np.where(in_gap & (np.abs(begin - t_ns[left]) <= usual), t_ns[left], begin)
