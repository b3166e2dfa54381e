"""Logs of the Physycom box as it writes them, and how they are read and refused."""

from __future__ import annotations

from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from metric_rows import row_named

from recon.errors import ReadFailed
from recon.tables import Array, Streams
from recon_readers.physycom import PhysycomParams, read

G = 9.80665
T0 = 518_716_448
"""8 June 2016, 16:54:08 in Bologna: summer time, so 14:54:08 UTC."""
T0_UTC_NS = int(datetime(2016, 6, 8, 14, 54, 8, tzinfo=UTC).timestamp()) * 1_000_000_000
WORDS = {
    4: "timestamp ax ay az",
    10: "timestamp speed ax ay az gx gy gz |a| timestamp_rel",
    14: "timestamp lat lon alt heading speed ax ay az gx gy gz |a| timestamp_rel",
}
HELD_ROWS = 20
"""Rows of 5 ms between two reports of the receiver: 10 Hz."""
GOOD = f"{T0}.0\t0.1\t0.2\t1.0\n{T0}.1\t0.1\t0.2\t1.0\n{T0}.2\t0.1\t0.2\t1.0\n"
HEAD = "# timestamp ax ay az\n"
RECORDS: list[dict[str, Any]] = [
    {"lat": 44.5, "lon": 11.25, "timestamp": T0 + k, "speed": 36.0, "alt": 45.0, "heading": 270.0, "fix": 3}
    for k in range(12)
]


def read_text(folder: Path, text: str | bytes, **params: Any) -> Streams:
    path = folder / "log.txt"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read(path=path, params=PhysycomParams(**params))


def refusal(folder: Path, text: str | bytes, **params: Any) -> ReadFailed:
    with pytest.raises(ReadFailed) as caught:
        read_text(folder, text, **params)
    assert "\n" not in caught.value.message
    assert caught.value.hint
    return caught.value


def counts(streams: Streams) -> tuple[float, float, float]:
    read_rows, used, dropped = (row_named(streams, f"rows_{name}")["value"] for name in ("read", "used", "dropped"))
    return read_rows, used, dropped


def motion(n: int = 400, *, place: bool = True, speed: float = 36.0) -> Array:
    """Rows as in fullinertial (14 columns) or inertial (10): 200 Hz, a noisy IMU, GNSS that changes on every row."""
    rng = np.random.default_rng(1)
    t = np.arange(n) * 0.005
    accel = np.round([0.0, 0.0, 1.0] + 0.02 * rng.standard_normal((n, 3)), 5)
    gyro = np.round(rng.standard_normal((n, 3)), 5)
    where = np.column_stack([44.5 + 1e-5 * t, 11.35 + 1e-5 * t, 45.0 + t, (350.0 + 10 * t) % 360]) if place else []
    columns = [where] if place else []
    size = np.linalg.norm(accel, axis=1)
    return np.column_stack([T0 + t, *columns, speed + t, accel, gyro, size, t])


def held(rows: Array, every: int = HELD_ROWS) -> Array:
    """The same with GNSS columns that change on every 20th row only."""
    last = rows.shape[1] - 8
    out = rows.copy()
    out[:, 1:last] = rows[np.arange(len(rows)) // every * every, 1:last]
    return out


def row_text(values: Any, separator: str = "\t", blank: str = "") -> str:
    time = f"{Decimal(T0) + Decimal(str(round(values[0] - T0, 4))):.4f}"
    return separator.join([time, *(blank if np.isnan(value) else f"{value:.7f}" for value in values[1:])])


def text_of(rows: Array, separator: str = "\t", blank: str = "", header: str | None = None) -> str:
    top = f"#\t{WORDS[rows.shape[1]]}".replace(" ", "\t") if header is None else header
    lines = [*([top] if top else []), *(row_text(row, separator, blank) for row in rows)]
    return "\n".join(lines) + "\n"
