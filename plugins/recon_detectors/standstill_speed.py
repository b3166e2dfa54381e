"""Standstills by GNSS speed under a threshold that grows only as far as needed.

    still(t) : speed(t) <= threshold,    threshold = start, start + step, ..., cap

The lowest threshold that gives enough standstills is used. The cap is what keeps motion from being called a stop: a
log without a stop under it gives no event and a warning. At rest the noise of the speed exceeds a low threshold for
some tenths of a second at a time: such a spell does not end a standstill as long as the speed stays under the cap.

A receiver filters its speed and reports a change late. So a standstill is shortened at both ends by a margin, but
not where the record begins or ends.

References
    The growing threshold is that of the thesis on vehicle reconstruction from inertial and GNSS data, section 4.1.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    GNSS,
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
    start: float = quantity(0.5, "km/h", ge=0, doc="Threshold that is tried first.")
    step: float = quantity(0.1, "km/h", ge=0.001, doc="By how much the threshold grows.")
    cap: float = quantity(2.0, "km/h", ge=0, doc="Highest threshold; motion above it is never called a standstill.")
    enough: int = setting(1, gt=0, doc="Number of standstills at which the threshold stops growing.")
    min_duration: float = quantity(1.0, "s", gt=0, doc="Shortest standstill that counts, margins taken off.")
    margin: float = quantity(0.5, "s", ge=0, doc="Taken off both ends, because the speed of receivers is late.")
    bridge: float = quantity(0.5, "s", ge=0, doc="A faster spell up to this long, under the cap, ends no standstill.")
    max_gap: float = quantity(1.5, "s", gt=0, doc="A longer gap between speeds ends a standstill.")


def standstill_speed(*, gnss: pa.Table, params: StandstillSpeedParams) -> Streams:
    """Events of kind standstill, and the threshold that was used.

    gnss : speed m/s, or vel m/s local; missing values are left out
    """
    speed, notes = _speed(gnss, params)
    known = np.isfinite(speed)
    t_ns, speed = time_ns(gnss)[known], speed[known]
    threshold, found = _search(t_ns, speed, params)
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
    starts = np.where(first > 0, t_ns[first] + margin, t_ns[first])
    ends = np.where(last < len(t_ns) - 1, t_ns[last] - margin, t_ns[last])
    long = ends - starts >= shortest
    return np.stack((starts[long], ends[long]), axis=1)


def _bridged(
    t_ns: NDArray[np.int64], speed: Array, still: NDArray[np.bool_], bridge_ns: int, cap: float
) -> NDArray[np.bool_]:
    """Still, and also the short spells between two still samples in which the speed stays under the cap."""
    spells = runs(~still)
    spells = spells[(spells[:, 0] > 0) & (spells[:, 1] < len(still))]
    short = t_ns[spells[:, 1]] - t_ns[spells[:, 0] - 1] <= bridge_ns
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
        reads={"gnss": GNSS.need(maybe=("speed", "vel"))},
        writes={"events": EVENTS},
        run=standstill_speed,
    )
