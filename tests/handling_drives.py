"""Trajectories of motions that are known in closed form, for the tests of driving and roads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from recon import TRAJECTORY, Streams, build, with_meta
from recon.numerics.rotation import from_euler

START_NS = 1_700_000_000_000_000_000
DT_S = 0.01


def trajectory_of(accel: np.ndarray, yaw: np.ndarray, speed: float = 0.0, slope: float = 0.0) -> pa.Table:
    """From accelerations (n, 3) m/s^2 along heading, left, up, headings (n,) rad and the first speed m/s, at 100 Hz."""
    east, north = np.cos(yaw), np.sin(yaw)
    local = np.column_stack(
        [accel[:, 0] * east - accel[:, 1] * north, accel[:, 0] * north + accel[:, 1] * east, accel[:, 2]]
    )
    first = speed * np.array([east[0], north[0], slope])
    vel = first + DT_S * np.concatenate([np.zeros((1, 3)), np.cumsum(local[:-1], axis=0)])
    pos = DT_S * np.concatenate([np.zeros((1, 3)), np.cumsum(vel[:-1], axis=0)])
    made = build(
        TRAJECTORY,
        time=START_NS + (np.arange(len(yaw)) * round(DT_S * 1e9)).astype(np.int64),
        pos=pos,
        vel=vel,
        q=from_euler(yaw, np.zeros(len(yaw)), np.zeros(len(yaw))),
        accel=accel,
        lat=44.0 + pos[:, 1] / 111_000.0,
        lon=11.0 + pos[:, 0] / 80_000.0,
    )
    return with_meta(made, anchor={"lat": 44.0, "lon": 11.0, "height": 0.0}, earth="wgs84")


def _still(rows: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((rows, 3)), np.zeros(rows)


def braking(
    size: float, duration_s: float = 2.0, again_after_s: float | None = None, backwards: bool = False
) -> pa.Table:
    """60 s at first 20 m/s, of which the speed falls by `size` from the 20th second on; once more after a pause."""
    accel, yaw = _still(6000)
    for start in [20.0] + ([20.0 + duration_s + again_after_s] if again_after_s else []):
        accel[round(start / DT_S) : round((start + duration_s) / DT_S), 0] = -size
    if backwards:  # the nose to the west, the way to the east
        made = trajectory_of(accel, yaw, 20.0)
        turned = from_euler(yaw + np.pi, yaw, yaw)
        columns = {f"q{name}": turned[:, index] for index, name in enumerate("wxyz")}
        columns |= {"accel_x": -accel[:, 0], "accel_y": -accel[:, 1]}
        for name, values in columns.items():
            index = made.column_names.index(name)
            made = made.set_column(index, made.schema.field(index), pa.array(values))
        return made
    return trajectory_of(accel, yaw, 20.0)


def cornering(radius: float) -> pa.Table:
    """60 s at 15 m/s, straight but for a bend of this radius, m, positive to the left, from the 20th to the 23rd s."""
    accel, rate = _still(6000)
    rate[2000:2300] = 15.0 / radius
    accel[:, 1] = 15.0 * rate
    return trajectory_of(accel, np.concatenate([[0.0], np.cumsum(rate[:-1]) * DT_S]), 15.0)


def gentle(speed: float = 15.0, slope: float = 0.0, pause_s: float = 0.0) -> pa.Table:
    """60 s at a steady speed; then, with a pause, standing so long, and 60 s more; a second to stop and to start."""
    if not pause_s:
        return trajectory_of(*_still(6000), speed, slope)
    accel, yaw = _still(round((120.0 + pause_s) / DT_S))
    stop, start = 6000, round((60.0 + pause_s) / DT_S)
    accel[stop - 600 : stop, 0] = -speed / 6.0
    accel[start : start + 600, 0] = speed / 6.0
    return trajectory_of(accel, yaw, speed)


def bumpy(
    amplitude: float, frequency: float, speed: float = 20.0, hits: tuple[float, ...] = (), rows: int = 6000
) -> pa.Table:
    """Straight at a steady speed over a road that shakes the body as a sine of this amplitude, m/s^2.

    hits : s after the start at which the body jumps by 8 m/s^2 for 50 ms and falls back as much
    """
    accel, yaw = _still(rows)
    accel[:, 2] = amplitude * np.sin(2.0 * np.pi * frequency * DT_S * np.arange(rows))
    for at in hits:
        row = round(at / DT_S)
        accel[row : row + 5, 2] += 8.0
        accel[row + 5 : row + 10, 2] -= 8.0
    return trajectory_of(accel, yaw, speed)


def told(streams: Streams, scope: str = "") -> dict[str, dict[str, Any]]:
    """The rows of metrics by name, of one scope."""
    rows = streams["metrics"].to_pylist()
    return {row["name"]: row for row in rows if not scope or (row["note"] or "").partition(";")[0] == scope}
