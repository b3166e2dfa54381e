"""Standstills by GNSS speed under a threshold that grows only as far as needed.

    still(t) : speed(t) <= threshold,    threshold = start, start + step, ..., cap

The lowest threshold that gives enough standstills is used. The cap is what keeps motion from being called a stop: a
log without a stop under it gives no event and a warning. At rest the noise of the speed exceeds a low threshold for
some tenths of a second at a time: such a spell does not end a standstill as long as the speed stays under the cap.

A receiver filters its speed and reports a change late. So a standstill is shortened at both ends by a margin, but
not where the record begins, breaks off or ends.

A vehicle that is parked all the time may be reported once, or never anew: where no speed exceeds the lowest threshold
it stands throughout the record, imu included, and a warning tells where reports are too few to be sure.

References
    The growing threshold is that of the thesis on vehicle reconstruction from inertial and GNSS data, section 4.1.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import model_validator

from recon import (
    EVENTS,
    GNSS,
    IMU,
    Array,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    events,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    setting,
    time_ns,
    warning,
)
from recon.numerics.signals import runs

Spans = NDArray[np.int64]
"""(m, 2) start and end, ns since 1970."""


class StandstillSpeedParams(Params):
    """Parameters of detector.standstill_speed."""

    speed: Literal["reported", "derived"] = setting(
        "reported", doc="Speed as the receiver reports it, or horizontal part of vel (see filter.gnss_kinematics)."
    )
    start: float = quantity(0.5, "km/h", ge=0, le=50, doc="Threshold that is tried first.")
    step: float = quantity(0.1, "km/h", ge=0.01, le=50, doc="By how much the threshold grows.")
    cap: float = quantity(2.0, "km/h", ge=0, le=50, doc="Highest threshold; motion above it is never a standstill.")
    enough: int = setting(1, gt=0, doc="Number of standstills at which the threshold stops growing.")
    min_duration: float = quantity(1.0, "s", gt=0, le=86_400, doc="Shortest standstill that counts, margins taken off.")
    margin: float = quantity(0.5, "s", ge=0, le=60, doc="Taken off both ends, because the speed of receivers is late.")
    bridge: float = quantity(
        0.5, "s", ge=0, le=60, doc="A faster spell up to this long, or of one fix, under the cap, ends no standstill."
    )
    max_gap: float = quantity(1.5, "s", gt=0, le=3600, doc="A longer gap between speeds ends a standstill.")

    @model_validator(mode="after")
    def _start_under_cap(self) -> Self:
        if self.start > self.cap:
            raise ValueError(f"start ({_kmh(self.start)}) must not be above cap ({_kmh(self.cap)})")
        return self


def standstill_speed(*, gnss: pa.Table, imu: pa.Table | None, params: StandstillSpeedParams) -> Streams:
    """Events of kind standstill, and the threshold that was used.

    gnss : speed m/s, or vel m/s local; missing values are left out
    imu : only its times, for a vehicle that is parked throughout
    """
    speed, notes = _speed(gnss, params)
    known = np.isfinite(speed)
    t_ns, speed = time_ns(gnss)[known], speed[known]
    parked = len(speed) and speed.max() <= params.start
    threshold, found = (params.start, _throughout(t_ns, imu, params)) if parked else _search(t_ns, speed, params)
    if parked and len(found):
        notes += _doubts(t_ns, found, params)
    if not len(found):
        notes.append(warning(f"no standstill: no {params.min_duration:g} s of gnss speed under {_kmh(params.cap)}"))
    elif len(found) < params.enough:
        notes.append(warning(f"{len(found)} of {params.enough} standstills found under {_kmh(params.cap)}"))
    learnt = [
        Metric("threshold", threshold, "m/s", method=f"{params.speed} speed"),
        Metric("standstills", float(len(found))),
        Metric("still_time", float((found[:, 1] - found[:, 0]).sum()) * 1e-9, "s"),
    ]
    return {
        "events": events(Event(int(start), int(end), "standstill") for start, end in found),
        "metrics": metrics([*learnt, *notes]),
    }


def _speed(gnss: pa.Table, params: StandstillSpeedParams) -> tuple[Array, list[Metric]]:
    """Speed over ground (n,) m/s as asked for; the other kind, with a warning, where that is missing."""
    other = "derived" if params.speed == "reported" else "reported"
    group = {"reported": "speed", "derived": "vel"}
    for kind in (params.speed, other):
        if has(gnss, group[kind]):
            values = matrix(gnss, group[kind], gaps=True)
            speed = np.hypot(values[:, 0], values[:, 1]) if kind == "derived" else values[:, 0]
            fallback = warning(f"gnss has no {params.speed} speed: the {kind} one is used")
            return speed, [] if kind == params.speed else [fallback]
    return np.full(gnss.num_rows, np.nan), [warning("gnss has neither speed nor vel")]


def _throughout(t_ns: NDArray[np.int64], imu: pa.Table | None, params: StandstillSpeedParams) -> Spans:
    """The whole record, of gnss and of an imu that runs at the same time, as one standstill if it is long enough."""
    first, last = t_ns[0], t_ns[-1]
    if imu is not None and imu.num_rows:
        imu_ns = time_ns(imu)
        if imu_ns[0] <= last and first <= imu_ns[-1]:
            first, last = min(first, imu_ns[0]), max(last, imu_ns[-1])
    spans = [(first, last)] if last - first >= params.min_duration * 1e9 else []
    return np.array(spans, dtype=np.int64).reshape(-1, 2)


def _doubts(t_ns: NDArray[np.int64], found: Spans, params: StandstillSpeedParams) -> list[Metric]:
    """A warning where a standstill throughout rests on reports with gaps between them."""
    longest = float(np.diff(np.concatenate((found[0, :1], t_ns, found[0, 1:]))).max()) * 1e-9
    if longest <= params.max_gap:
        return []
    note = (
        f"no gnss speed exceeds {_kmh(params.start)}, but {len(t_ns)} in all leave gaps of up to {longest:.1f} s: the "
        "vehicle is taken to stand all the time"
    )
    return [warning(note)]


def _search(t_ns: NDArray[np.int64], speed: Array, params: StandstillSpeedParams) -> tuple[float, Spans]:
    """The lowest threshold that gives enough standstills, or the lowest that gives most; and its standstills."""
    best, found = params.cap, np.empty((0, 2), dtype=np.int64)
    for threshold in (*np.arange(params.start, params.cap, params.step), params.cap):
        spans = _standstills(t_ns, speed, float(threshold), params)
        if len(spans) > len(found):
            best, found = float(threshold), spans
        if len(found) >= params.enough:
            break
    return best, found


def _standstills(t_ns: NDArray[np.int64], speed: Array, threshold: float, params: StandstillSpeedParams) -> Spans:
    """Spans under one threshold, shortened by the margin, that are long enough."""
    bridge, gap, margin, shortest = (
        round(s * 1e9) for s in (params.bridge, params.max_gap, params.margin, params.min_duration)
    )
    still = _bridged(t_ns, speed, speed <= threshold, bridge, params.cap)
    held = still[1:] & still[:-1] & (np.diff(t_ns) <= gap)
    first, last = runs(held).T
    silent = np.diff(t_ns) > gap
    breaks_off, begins = np.append(silent, True), np.append(True, silent)
    starts = np.where(begins[first], t_ns[first], t_ns[first] + margin)
    ends = np.where(breaks_off[last], t_ns[last], t_ns[last] - margin)
    long = ends - starts >= shortest
    return np.stack((starts[long], ends[long]), axis=1)


def _bridged(
    t_ns: NDArray[np.int64], speed: Array, still: NDArray[np.bool_], bridge_ns: int, cap: float
) -> NDArray[np.bool_]:
    """Still, and also the short spells between two still samples in which the speed stays under the cap."""
    spells = runs(~still)
    spells = spells[(spells[:, 0] > 0) & (spells[:, 1] < len(still))]
    single = np.diff(spells, axis=1)[:, 0] == 1
    short = single | (t_ns[spells[:, 1]] - t_ns[spells[:, 0] - 1] <= bridge_ns)
    slow = np.maximum.reduceat(speed, spells.ravel())[::2] <= cap if len(spells) else short
    bridged = still.copy()
    for start, stop in spells[short & slow]:
        bridged[start:stop] = True
    return bridged


def _kmh(speed: float) -> str:
    return f"{speed * 3.6:g} km/h"


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.standstill_speed."""
    yield Detector(
        name="standstill_speed",
        summary="Standstills by GNSS speed under a growing, capped threshold.",
        params=StandstillSpeedParams,
        reads={"gnss": GNSS.need(maybe=("speed", "vel")), "imu": IMU.need(optional=True)},
        writes={"events": EVENTS},
        run=standstill_speed,
    )
