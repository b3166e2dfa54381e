"""Streams of the suite's drives as a stage asks for them: in its frames, without gravity where it wants none."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from recon.numerics.rotation import conjugate, from_euler, rotate
from recon.recording import Recording
from recon.schema import ANY, APPENDED, STREAMS, Change, Need, group_of, spread
from recon.tables import conform, matrix, replace, time_ns
from recon.testing.drives import GRAVITY, MOUNT_YAW, MOUNTING


def serve(recording: Recording, reads: Mapping[str, Need]) -> dict[str, pa.Table]:
    """The streams that are read, turned into the frames and quantities that are asked for, by port."""
    return {port: _as_needed(recording, port, need) for port, need in reads.items() if port in recording}


def _as_needed(recording: Recording, stream: str, need: Need) -> pa.Table:
    table = recording[stream]
    frames = {group_of(c.name): c.frame for c in need.columns if c.frame not in (ANY, "")}
    quantities = {group_of(c.name): c.quantity for c in need.columns if c.quantity != ANY}
    if stream in ("imu", "mag"):
        table = _turned(table, recording, frames, quantities)
    planned = Change(frames, quantities).apply(STREAMS[stream]) if stream in STREAMS else None
    return table if planned is None or stream in APPENDED else conform(table, planned, stream=stream, step="drive")


def _turned(
    table: pa.Table, recording: Recording, frames: Mapping[str, str], quantities: Mapping[str, str]
) -> pa.Table:
    """Vectors in the frames asked for, and without gravity where acceleration is asked for, by the truth."""
    rows = np.searchsorted(time_ns(recording["attitude"]), time_ns(table))
    q_nv = matrix(recording["attitude"], "q")[rows]
    from_vehicle = {
        "sensor": conjugate(MOUNTING),
        "level": from_euler(-MOUNT_YAW, 0.0, 0.0),
        "vehicle": from_euler(0.0, 0.0, 0.0),
        "local": q_nv,
    }
    for group in ("accel", "gyro", "mag"):
        if not spread(group, table.column_names):
            continue
        values_v = rotate(MOUNTING, matrix(table, group))
        if group == "accel" and quantities.get("accel") == "acceleration":
            values_v = values_v - rotate(conjugate(q_nv), np.array([0.0, 0.0, GRAVITY]))
        table = replace(table, **{group: rotate(from_vehicle[frames.get(group, "sensor")], values_v)})
    return table
