"""Sensors of u-blox receivers: ESF-MEAS and ESF-RAW to imu and wheel, on the receiver's own clock."""

from __future__ import annotations

from dataclasses import dataclass
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

_RESTARTED_NS: Final = 1_000_000_000
"""By more than this a clock falls where the receiver starts again, or where its number of 32 bits ends."""
_RAW_SOURCE: Final = -1

Made: TypeAlias = tuple[pa.Table | None, list[Metric]]
Whole: TypeAlias = NDArray[np.int64]


class UbxParams(Params):
    """What the messages do not tell."""

    at_rest: Literal["up", "down"] | None = setting(
        None, doc="Where the accelerometer's reading at rest points: up is specific force. Without it no imu is given."
    )
    raw_tick: float | None = quantity(None, "us", gt=0, doc="Time of one tick of ESF-RAW, 39.0625 us in M8 receivers.")


@dataclass(frozen=True)
class Measured:
    """ESF data: time (n,) ns, type (n,) and signed value (n,), in the order of the file for each source.

    absolute : are the times UTC? Else they count from the start of the receiver
    """

    t_ns: Times
    kind: Whole
    value: Whole
    absolute: bool


def measured(found: Messages, t_ns: Times, place: Places, params: UbxParams) -> tuple[Measured, list[Metric]]:
    """All ESF data at UTC, where navigation messages tell it; and what is to be told of it.

    t_ns : (k,) UTC of navigation messages; place : (k,) theirs in the file
    """
    sources = _sources(found, params.raw_tick)
    told = {source: _utc(at, tag_ns, t_ns, place) for source, (at, tag_ns, _) in sources.items()}
    absolute = any(zeros for *_, zeros in told.values())
    times, words, lost = [], [], 0
    for source, (_, tag_ns, word) in sources.items():
        utc_ns, known, _ = told[source]
        times.append(utc_ns[known] if absolute else tag_ns)
        words.append(word[known] if absolute else word)
        lost += int((~known).sum()) if absolute else 0
    word = np.concatenate([np.zeros(0, dtype=np.int64), *words])
    data = Measured(
        np.concatenate([np.zeros(0, dtype=np.int64), *times]),
        word >> 24 & 0x3F,
        ((word & 0xFFFFFF) ^ 0x800000) - 0x800000,
        absolute,
    )
    return data, _about_clock([zero for *_, zeros in told.values() for zero in zeros], lost, len(t_ns))


def _about_clock(zeros: list[int], lost: int, navigation: int) -> list[Metric]:
    """zeros : UTC in ns of each start of the receiver; lost : data that are left out; navigation : messages with UTC"""
    if not zeros and not navigation:
        return [warning("no navigation message tells UTC: times of imu and wheel count from the start of the receiver")]
    if not zeros:
        return [warning("no navigation message comes before those of the imu: its times count from its start")]
    note = "UTC at which the receiver's clock was zero; stamps of imu and wheel may be early by its computing time"
    learnt = [Metric("clock_offset", zero_ns * 1e-9, "s", sigma=0.1, note=note) for zero_ns in zeros]
    if lost:
        what = "behind a start of the receiver, or of a sensor's own clock, that no navigation message sets to UTC"
        learnt.append(warning(f"{lost} data of imu and wheel are left out: {what}"))
    return learnt


def _utc(at: Places, tag_ns: Times, t_ns: Times, place: Places) -> tuple[Times, NDArray[np.bool_], list[int]]:
    """UTC of data (n,) ns; where it is known, (n,) bool; UTC at which the clock was zero, at each start of it.

    at : (n,) places in the file; tag_ns : (n,) ns of the clock; t_ns, place : as of `measured`
    """
    utc_ns, known, zeros = tag_ns.copy(), np.zeros(len(at), dtype=bool), []
    begins = [0, *np.flatnonzero(np.diff(tag_ns, prepend=tag_ns[:1]) < -_RESTARTED_NS).tolist()]
    for begin, end in zip(begins, [*begins[1:], len(at)], strict=True):
        own = slice(begin, end)
        before = np.searchsorted(place, at[own], side="right") - 1
        first = np.searchsorted(place, at[begin]) if begin else 0  # those above may be of the time before a restart
        told = before >= first
        if told.any():
            zeros.append(int(np.max(t_ns[before[told]] - tag_ns[own][told])))
            utc_ns[own] += zeros[-1]
            known[own] = True
    return utc_ns, known, zeros


def _sources(found: Messages, raw_tick: float | None) -> dict[int, tuple[Places, Times, Whole]]:
    """Place (n,), time (n,) ns of its clock and word (n,) of all data, by source: the number that ESF-MEAS gives it.

    What ESF-RAW holds is in ESF-MEAS again, averaged, and is then not taken from there.
    """
    none = np.zeros((0, 4), dtype=np.int64)
    every = np.concatenate([none, *(_meas(*part) for part in found.raw(ESF_MEAS) if part[1].shape[1] >= 12)])
    if raw_tick is not None:
        raw = np.concatenate([none, *(_raw(*part, raw_tick) for part in found.raw(ESF_RAW))])
        averaged = np.isin(every[:, 3] >> 24 & 0x3F, (*RATES, *FORCES)) if len(raw) else np.zeros(len(every), bool)
        every = np.concatenate([every[~averaged], raw])
    every = every[np.argsort(every[:, 0], kind="stable")]
    parts = {source: every[every[:, 1] == source] for source in np.unique(every[:, 1]).tolist()}
    return {source: (part[:, 0], part[:, 2], part[:, 3]) for source, part in parts.items()}


def _meas(places: Places, payloads: NDArray[np.uint8]) -> Whole:
    """Place, source, time in ns and word of the data of ESF-MEAS: (n, 4).

    How many a message holds may be left to its length.
    """
    head, words = _u4(payloads[:, :8], 0), _u4(payloads, 8)
    count, with_time = head[:, 1] >> 11 & 0x1F, head[:, 1] >> 3 & 1
    count = np.where(count == 0, words.shape[1] - with_time, count)
    there = np.arange(words.shape[1]) < count[:, None]
    each = [np.broadcast_to(part[:, None], words.shape) for part in (places, head[:, 1] >> 16, head[:, 0] * 1_000_000)]
    return np.column_stack([part[there] for part in (*each, words)])


def _raw(places: Places, payloads: NDArray[np.uint8], tick_s: float) -> Whole:
    """The same of ESF-RAW, each of whose data has a time of its own."""
    words = _u4(payloads, 4)
    words = words[:, : words.shape[1] // 2 * 2]
    ticks, data = words[:, 1::2], words[:, ::2]
    each = np.broadcast_to(places[:, None], data.shape).ravel()
    t_ns = np.round(ticks * (tick_s * 1e9)).astype(np.int64).ravel()
    return np.column_stack([each, np.full(len(each), _RAW_SOURCE), t_ns, data.ravel()])


def _u4(payloads: NDArray[np.uint8], at: int) -> Whole:
    """Unsigned numbers of four bytes from a place of each payload on: (m, k)."""
    count = (payloads.shape[1] - at) // 4
    return np.ascontiguousarray(payloads[:, at : at + 4 * count]).view("<u4").astype(np.int64)


def imu(path: Path, found: Messages, data: Measured, params: UbxParams) -> Made:
    """The stream imu, m/s^2 and rad/s along the receiver's axes, None where an axis or its sense is missing."""
    t_ns, kind, value = data.t_ns, data.kind, data.value
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
    made, told = stream(Source(path, "imu"), IMU, times, np.zeros(len(times), dtype=bool), groups)
    note = f"imu: as the receiver has them; accelerations at rest point {params.at_rest}, given as specific force"
    return made, [*learnt, Metric("axes", note=note), *told]


def wheel(path: Path, data: Measured) -> Made:
    """The stream wheel, m/s, None where no message tells a speed."""
    times, speed = _series(data.t_ns[data.kind == SPEED], data.value[data.kind == SPEED])
    if not len(times):
        return None, []
    return stream(Source(path, "wheel"), WHEEL, times, np.zeros(len(times), dtype=bool), {"speed": speed * 1e-3})


def _series(t_ns: Times, value: NDArray[np.int64]) -> tuple[Times, Array]:
    """Values at times that rise: (m,) ns, (m,)."""
    usable = in_order(t_ns, np.zeros(len(t_ns), dtype=bool))
    usable &= ~repeating(t_ns, [usable])
    return t_ns[usable], value[usable].astype(np.float64)
