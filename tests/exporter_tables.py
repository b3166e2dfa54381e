"""A drive and its fixes, with simple numbers, for the tests of the exporters of tracks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import from_euler
from recon.rows import Event, events
from recon.schema import GNSS, TRAJECTORY
from recon.tables import build, with_meta

START_NS = 1_714_550_400_000_000_000
"""2024-05-01T08:00:00Z"""
SECOND = 1_000_000_000


def drive(t_s: Any, *, datum: str | None = "ellipsoid", **groups: Any) -> pa.Table:
    """A trajectory at times in s: 5 m/s on a heading of 60 deg, rising; `groups` take the place of its columns."""
    t_s = np.asarray(t_s, dtype=np.float64)
    yaw = np.full(len(t_s), np.radians(30.0))
    columns = {
        "lat": 44.5 + 1e-5 * t_s,
        "lon": 11.3 + 2e-5 * t_s,
        "height": 100.0 + 0.1 * t_s,
        "pos": np.outer(t_s, (3.0, 4.0, 0.0)),
        "vel": np.tile((3.0, 4.0, 0.0), (len(t_s), 1)),
        "q": from_euler(yaw, 0.0, 0.0),
        **groups,
    }
    columns = {name: values for name, values in columns.items() if values is not None}
    table = build(TRAJECTORY, time=START_NS + np.rint(t_s * SECOND).astype(np.int64), **columns)
    return with_meta(table, height_datum=datum, time_scale="UTC")


def fixes(t_s: Any, **groups: Any) -> pa.Table:
    """GNSS north of the drive, heights above mean sea level."""
    t_s = np.asarray(t_s, dtype=np.float64)
    columns = {"lat": 45.5 + 1e-5 * t_s, "lon": 11.3 + 2e-5 * t_s, "height": 60.0 + 0.1 * t_s, **groups}
    table = build(GNSS, time=START_NS + np.rint(t_s * SECOND).astype(np.int64), **columns)
    return with_meta(table, height_datum="mean_sea_level", time_scale="UTC")


def happened(*spans: tuple[float, float], kind: str = "standstill", **facts: Any) -> pa.Table:
    """Events from and to times in s."""
    times = [[START_NS + round(t_s * SECOND) for t_s in span] for span in spans]
    return events([Event(*span, kind, **facts) for span in times])
