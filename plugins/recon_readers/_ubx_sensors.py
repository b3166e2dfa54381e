"""Sensors of u-blox receivers: ESF-MEAS and ESF-RAW to imu and wheel, on the receiver's own clock."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.parameters import Params, quantity, setting
from recon.rows import Metric, warning
from recon.schema import IMU, WHEEL
from recon.tables import Array
from recon_readers._arrays import interleave
from recon_readers._streams import Source, stream
from recon_readers._time_order import Times, in_order, repeating
from recon_readers._ubx_frames import ESF_MEAS, ESF_RAW, Messages, Places

RATES: Final = (14, 13, 5)
FORCES: Final = (16, 17, 18)
SPEED: Final = 11
"""Types of ESF data: gyroscope and accelerometer x, y, z; speed."""
_AT_REST_HOW: Final = (
    "set reader.ubx.at_rest: 'up' where an axis that points up reads +9.8 m/s^2 at rest, or one that points forward "
    "reads more than zero while the vehicle speeds up, else 'down'"
)

Made: TypeAlias = tuple[pa.Table | None, list[Metric]]


class UbxParams(Params):
    """What the messages do not tell."""

    at_rest: Literal["up", "down"] | None = setting(
        None, doc="Where the accelerometer's reading at rest points: up is specific force. Without it no imu is given."
    )
    raw_tick: float | None = quantity(None, "us", gt=0, doc="Time of one tick of ESF-RAW, 39.0625 us in M8 receivers.")


def clock_of(found: Messages, t_ns: Times, place: Places) -> tuple[int | None, list[Metric]]:
    """UTC in ns at which the clock of ESF-MEAS was zero, None where nothing tells; and what is to be told of it."""
    measured = found.raw(ESF_MEAS)
    if not measured or not len(t_ns):
        note = "no navigation message tells UTC: times of imu and wheel count from the start of the receiver"
        return None, [warning(note)]
    at = np.concatenate([places for places, _ in measured])
    tag_ns = np.concatenate([_u4(payloads, 0)[:, 0] for _, payloads in measured]) * 1_000_000
    before = np.searchsorted(place, at, side="right") - 1
    known = before >= 0
    if not known.any():
        return None, [warning("no navigation message comes before those of the imu: its times count from its start")]
    zero_ns = int(np.max(t_ns[before[known]] - tag_ns[known]))
    note = "UTC at which the receiver's clock was zero; stamps of imu and wheel may be early by its computing time"
    return zero_ns, [Metric("clock_offset", zero_ns * 1e-9, "s", sigma=0.1, note=note)]


def _u4(payloads: NDArray[np.uint8], at: int) -> NDArray[np.int64]:
    """Unsigned numbers of four bytes from a place of each payload on: (m, k)."""
    count = (payloads.shape[1] - at) // 4
    return np.ascontiguousarray(payloads[:, at : at + 4 * count]).view("<u4").astype(np.int64)


def _data(found: Messages, params: UbxParams) -> tuple[Times, NDArray[np.int64], NDArray[np.int64]]:
    """Time (n,) ns of the receiver, type (n,) and signed value (n,) of all ESF data."""
    parts = []
    for _, payloads in found.raw(ESF_MEAS):
        if payloads.shape[1] < 12:
            continue
        count = _u4(payloads, 4)[:, 0] >> 11 & 0x1F
        words = _u4(payloads, 8)
        there = np.arange(words.shape[1]) < count[:, None]
        tags = np.broadcast_to(_u4(payloads, 0)[:, :1] * 1_000_000, words.shape)
        parts.append((tags[there], words[there]))
    if params.raw_tick is not None:
        tick_ns = params.raw_tick * 1e9
        for _, payloads in found.raw(ESF_RAW):
            words = _u4(payloads, 4)
            words = words[:, : words.shape[1] // 2 * 2]
            parts.append((np.round(words[:, 1::2] * tick_ns).astype(np.int64).ravel(), words[:, ::2].ravel()))
    t_ns = np.concatenate([np.zeros(0, dtype=np.int64), *(times for times, _ in parts)])
    word = np.concatenate([np.zeros(0, dtype=np.int64), *(words for _, words in parts)])
    return t_ns, word >> 24 & 0x3F, ((word & 0xFFFFFF) ^ 0x800000) - 0x800000


def imu(path: Path, found: Messages, zero_ns: int | None, params: UbxParams) -> Made:
    """The stream imu, m/s^2 and rad/s along the receiver's axes, None where an axis or its sense is missing.

    zero_ns : as of `clock_of`; None leaves the times of the receiver
    """
    t_ns, kind, value = _data(found, params)
    learnt = []
    if found.raw(ESF_RAW) and params.raw_tick is None:
        learnt.append(warning("ESF-RAW is left out: set reader.ubx.raw_tick to the time of one tick of its clock"))
    if not np.isin(kind, (*RATES, *FORCES)).any():
        return None, learnt
    if params.at_rest is None:
        return None, [*learnt, warning(f"the imu is left out, for its sense is not known: {_AT_REST_HOW}")]
    sense = 1.0 if params.at_rest == "up" else -1.0
    parts = {}
    for group, kinds, unit in (("accel", FORCES, sense * 2.0**-10), ("gyro", RATES, np.radians(2.0**-12))):
        axes = {
            axis: _series(t_ns[kind == number], value[kind == number])
            for axis, number in zip("xyz", kinds, strict=True)
        }
        if all(len(times) for times, _ in axes.values()):
            times, spread = interleave(axes)
            parts[group] = (times, np.column_stack([spread[axis] for axis in "xyz"]) * unit)
    if not parts:
        return None, [*learnt, warning("the imu is left out: an axis of its accelerometer or gyroscope is missing")]
    times, groups = interleave(parts)
    made, told = stream(Source(path, "imu"), IMU, times + (zero_ns or 0), np.zeros(len(times), dtype=bool), groups)
    note = f"imu: as the receiver has them; accelerations at rest point {params.at_rest}, given as specific force"
    return made, [*learnt, Metric("axes", note=note), *told]


def wheel(path: Path, found: Messages, zero_ns: int | None) -> Made:
    """The stream wheel, m/s, None where no message tells a speed. zero_ns : as of `clock_of`"""
    t_ns, kind, value = _data(found, UbxParams())
    times, speed = _series(t_ns[kind == SPEED], value[kind == SPEED])
    if not len(times):
        return None, []
    return stream(
        Source(path, "wheel"), WHEEL, times + (zero_ns or 0), np.zeros(len(times), dtype=bool), {"speed": speed * 1e-3}
    )


def _series(t_ns: Times, value: NDArray[np.int64]) -> tuple[Times, Array]:
    """Values at times that rise: (m,) ns, (m,)."""
    usable = in_order(t_ns, np.zeros(len(t_ns), dtype=bool))
    usable &= ~repeating(t_ns, [usable])
    return t_ns[usable], value[usable].astype(np.float64)
