"""Placing streams: rows and silences in time, attitude at the times of the imu, a trajectory on the Earth."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import DataError
from recon.numerics.geodesy import SPHERE, WGS84, Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.gnss_time import NS
from recon.numerics.signals import runs
from recon.rows import Metric, spans, warning
from recon.tables import Array, has, matrix, meta, replace, time_ns, vector, with_meta

EARTHS: Final = {"wgs84": WGS84, "sphere": SPHERE}
"""Figures of the Earth by the name that a stream's fact `earth` gives."""

SHOWN_SILENCES: Final = 3
_FIRST_DATE_NS: Final = 315_532_800 * NS
"""1980, when GPS time began. Earlier times count from the start of a log or of a device."""


def silent_steps(imu: pa.Table, max_gap: float, longest_gap: float) -> NDArray[np.bool_]:
    """Steps between rows in which the imu tells nothing, because they are longer than max_gap: (n-1,) bool.

    max_gap, longest_gap : s
    raises : DataError where a step is longer than longest_gap, after which nothing of before would hold
    """
    t_ns = time_ns(imu)
    step_ns = np.diff(t_ns)
    if len(step_ns) and step_ns.max() > longest_gap * 1e9:
        row = int(step_ns.argmax())
        raise DataError(
            f"the log has a hole: no imu for {_length(step_ns[row])} from {moment(t_ns, row)}",
            "cut the log there and reconstruct its parts one by one, or raise longest_gap of the integrators "
            f"({longest_gap:g} s)",
        )
    return np.asarray(step_ns > max_gap * 1e9)


def silence_warnings(imu: pa.Table, silent: NDArray[np.bool_], assumed: str) -> list[Metric]:
    """What a user must know of the silences of the imu: where they are, and what is assumed of them."""
    t_ns, rows = time_ns(imu), np.flatnonzero(silent)
    notes = [
        f"no imu for {_length(t_ns[row + 1] - t_ns[row])} from {moment(t_ns, row)}: what happened there is unknown, "
        f"{assumed}"
        for row in rows[:SHOWN_SILENCES]
    ]
    if len(rows) > SHOWN_SILENCES:
        total = _length(np.diff(t_ns)[rows].sum())
        notes.append(f"no imu in {len(rows) - SHOWN_SILENCES} more gaps; {total} are missing in all")
    return [warning(note) for note in notes]


def _length(span_ns: np.int64) -> str:
    """A span of time as people say it."""
    span_s = float(span_ns) * 1e-9
    for unit, of_s in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if span_s >= 2.0 * of_s:
            return f"{span_s / of_s:.1f} {unit}"
    return f"{span_s:.1f} s"


def moment(t_ns: NDArray[np.int64], row: int) -> str:
    """Time of a row, and how long that is after the first row; the latter alone where the clock is no calendar."""
    since = f"{(t_ns[row] - t_ns[0]) * 1e-9:.1f} s after the first row"
    return since if t_ns[row] < _FIRST_DATE_NS else f"{clock_text(t_ns[row], 'ms')} ({since})"


def clock_text(t_ns: np.int64, to: Literal["s", "ms"] = "s") -> str:
    """A time in ns as its date and time of day, or in s where the clock is no calendar."""
    if t_ns < _FIRST_DATE_NS:
        return f"{t_ns * 1e-9:.1f} s"
    return str(t_ns.view("datetime64[ns]").astype(f"datetime64[{to}]")).replace("T", " ")


def rows_during(table: pa.Table, events: pa.Table | None, kind: str) -> NDArray[np.intp]:
    """Rows of a stream that lie inside the events of one kind, their ends included.

    Events that overlap or leave no row between them count as one; events without any row are left out.

    returns : (m, 2) start and stop of each run of rows, half-open, rising
    """
    t_ns = time_ns(table)
    found = np.array(spans(events, kind), dtype=np.int64).reshape(-1, 2)
    opened = np.zeros(len(t_ns) + 1, dtype=np.intp)
    np.add.at(opened, np.searchsorted(t_ns, found[:, 0], side="left"), 1)
    np.add.at(opened, np.searchsorted(t_ns, found[:, 1], side="right"), -1)
    return runs(np.cumsum(opened)[:-1] > 0)


def attitude_of(imu: pa.Table, attitude: pa.Table) -> Array:
    """The attitude at each row of the imu: (n, 4), vehicle to local.

    Raises DataError where the two streams do not have the same times.
    """
    if not np.array_equal(time_ns(imu), time_ns(attitude)):
        raise DataError(
            f"attitude ({attitude.num_rows} rows) and imu ({imu.num_rows} rows) do not have the same times",
            "put integrator.attitude after the last step that changes the times of imu",
        )
    return matrix(attitude, "q")


def anchor_of(table: pa.Table | None) -> Anchor | None:
    """Origin of the local frame in which a stream's positions are given; None where it is not known."""
    facts = {} if table is None else meta(table)
    return Anchor(**facts["anchor"]) if "anchor" in facts else None


def about_anchor(table: pa.Table, anchor: Anchor | None, datum: str) -> Array:
    """Positions of a stream about an anchor, (n, 3) m, to lay streams over each other; NaN where not known there.

    As they are where the anchor is the stream's own, else by latitude, longitude and height. A height above another
    datum than the anchor's says nothing there: such a stream is laid at the height of the anchor.
    """
    if has(table, "pos") and anchor_of(table) == anchor:
        return matrix(table, "pos", gaps=True)
    if anchor is None or not (has(table, "lat") and has(table, "lon")):
        return np.full((table.num_rows, 3), np.nan)
    height = np.full(table.num_rows, anchor.height)
    if has(table, "height") and str(meta(table).get("height_datum", "")) == datum:
        height = vector(table, "height", gaps=True)
    lat, lon = vector(table, "lat", gaps=True), vector(table, "lon", gaps=True)
    return geodetic_to_enu(lat, lon, height, anchor, EARTHS[meta(table).get("earth", "wgs84")])


def geolocate(trajectory: pa.Table, anchored: pa.Table | None) -> pa.Table:
    """The trajectory with lat, lon (deg) and height (m) of its positions, null where the anchor is not known.

    anchored : a stream whose own facts name the local frame: anchor, earth, height_datum; they become facts of the
    trajectory as well
    """
    anchor = anchor_of(anchored)
    facts = {} if anchored is None else meta(anchored)
    place = np.full((3, trajectory.num_rows), np.nan)
    if anchor is not None:
        ellipsoid = EARTHS[facts.get("earth", "wgs84")]
        place = np.array(enu_to_geodetic(matrix(trajectory, "pos", gaps=True), anchor, ellipsoid))
    lat, lon, height = place
    located = replace(trajectory, lat=lat, lon=lon, height=height)
    return with_meta(located, **{name: facts.get(name) for name in ("anchor", "earth", "height_datum")})
