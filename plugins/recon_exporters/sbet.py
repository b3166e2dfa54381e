"""The trajectory as SBET, "smoothed best estimate of trajectory": for laser scanning and photogrammetry.

A file without a head, of records of 17 doubles, little-endian:

     1     time             s of the GPS week in which the trajectory begins; counts on where the next week begins
     2, 3  latitude, longitude                rad
     4     altitude         m, above the height_datum of the stream (SBET expects the WGS84 ellipsoid)
     5..7  velocity         m/s, east, north, up: the axes of the wander frame where the wander angle is zero
     8..10 roll, pitch, heading               rad; right side down, nose up, clockwise from true north are positive
    11     wander angle     rad, zero
    12..14 acceleration     m/s^2, gravity removed; body axes: forward, right, down
    15..17 angular rate     rad/s, body axes

What the trajectory does not know is NaN. Rows without latitude, longitude, height or attitude are left out. Beside it
lies a text that says what the records cannot: which rows, which clock, which datum.

References
    Applanix, POSPac MMS User Guide, "SBET format"; readers.sbet of PDAL (pdal.io). They name the fields and leave the
    senses of the axes open: those above are what published readers take.
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., 2.2.
    IS-GPS-200, 20.3.3.5.2.4 (UTC and GPS time); IERS Bulletin C (leap seconds).
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from recon.errors import NothingToExport
from recon.hookspecs import hookimpl
from recon.manifest import RunInfo
from recon.numerics.gnss_time import GPS_EPOCH_NS, WEEK_NS, utc_to_gps
from recon.numerics.rotation import heading_from_yaw, to_euler
from recon.parameters import NoParams
from recon.schema import TRAJECTORY
from recon.stages import Exporter
from recon.tables import Array, matrix, matrix_or_nan, meta, select_rows, time_ns, vector

_FORWARD_RIGHT_DOWN: Final = (1.0, -1.0, -1.0)
_DATUMS: Final = {"ellipsoid": "the WGS84 ellipsoid", "mean_sea_level": "mean sea level, which SBET does not expect"}


def sbet(*, trajectory: pa.Table, folder: Path, about: RunInfo, params: NoParams) -> list[Path]:
    """Write `folder/sbet_trajectory.out` and the text beside it; their paths.

    Raises NothingToExport where no row has latitude, longitude, height and attitude.
    """
    known = np.isfinite(np.column_stack([matrix(trajectory, g, gaps=True) for g in ("lat", "lon", "height", "q")]))
    rows = select_rows(trajectory, np.asarray(known.all(axis=1)))
    if not rows.num_rows:
        raise NothingToExport(
            "no row of trajectory has latitude, longitude, height and attitude, which SBET needs",
            "tum and kitti write the local frame, which needs no place on the Earth",
        )
    records, notes = folder / "sbet_trajectory.out", folder / "sbet_trajectory.txt"
    records.write_bytes(_records(rows).astype("<f8").tobytes())
    notes.write_text(_notes(rows, trajectory.num_rows, about), encoding="utf-8", newline="\n")
    return [records, notes]


def _records(rows: pa.Table) -> Array:
    """(n, 17), units as in the module's table."""
    yaw, pitch, roll = to_euler(matrix(rows, "q"))
    place = np.radians([vector(rows, "lat"), vector(rows, "lon")])
    attitude = (roll, -pitch, heading_from_yaw(yaw))
    still = np.zeros(rows.num_rows)
    accel, gyro = (matrix_or_nan(rows, group) * _FORWARD_RIGHT_DOWN for group in ("accel", "gyro"))
    columns = [_gps_seconds(rows), *place, vector(rows, "height"), *matrix_or_nan(rows, "vel").T, *attitude, still]
    return np.column_stack([*columns, *accel.T, *gyro.T])


def _gps_seconds(rows: pa.Table) -> Array:
    """Seconds since the GPS week of the first row began: (n,)."""
    t_ns = (utc_to_gps(time_ns(rows)) if _is_utc(rows) else time_ns(rows)) - GPS_EPOCH_NS
    return np.asarray((t_ns - t_ns[0] // WEEK_NS * WEEK_NS) * 1e-9)


def _is_utc(rows: pa.Table) -> bool:
    return str(meta(rows).get("time_scale", "UTC")).upper() == "UTC"


def _notes(rows: pa.Table, of: int, about: RunInfo) -> str:
    facts = meta(rows)
    scale = "GPS time, made from UTC" if _is_utc(rows) else f"those of the log, {facts['time_scale']}"
    lines = [
        f"{' '.join(about.name.split())}: {rows.num_rows} of {of} rows; those without place or attitude are left out",
        f"records: 17 doubles, little-endian; times: {scale}, s since the week of the first row began",
        f"altitudes: above {_DATUMS.get(facts.get('height_datum', ''), 'a datum that is not known')}",
        "velocity: east, north, up; acceleration and angular rate: forward, right, down; gravity removed",
        "heading: clockwise from true north; wander angle: zero",
    ]
    if facts.get("clock") == "relative":
        lines.append("the clock was not set, so week and time of week mean nothing")
    return "\n".join(lines) + "\n"


@hookimpl
def declare_exporters() -> Iterable[Exporter]:
    """The exporter of SBET files."""
    yield Exporter(
        name="sbet",
        summary="The trajectory as SBET, 17 doubles a record, for laser scanning and photogrammetry.",
        run=sbet,
        reads={"trajectory": TRAJECTORY.need("lat", "lon", "height", "q", maybe=("vel", "accel", "gyro"))},
        references=("Applanix, POSPac MMS User Guide",),
    )
