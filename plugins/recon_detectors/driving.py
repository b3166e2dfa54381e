"""Trips, harsh braking, acceleration and cornering, and speeding, from a trajectory.

    a_x, a_y   horizontal acceleration along the way and to the left (ISO 8855 intermediate system), low-passed
    harsh      -a_x, a_x or |a_y| beyond a limit for long enough, not slower than a lowest speed
    speeding   speed beyond a limit that is given, and a tolerance, for long enough
    trip       motion between two stops of some minutes

What happens within an event `crash`, and as long before and after as the low-pass would spread it, is nothing of these.

There is no standard of what is harsh. Limits are sets of data with a name, a version and a source
(driving_thresholds.yaml); the metrics tell which one was used, and what a pipeline changed in it. Speeding is looked
for only where a limit is given: recon has no map.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, Literal

import numpy as np
import pyarrow as pa

from recon import (
    EVENTS,
    Array,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    hookimpl,
    metrics,
    quantity,
    setting,
    warning,
)
from recon.handling import NEED, Handling, handling_of
from recon.numerics.handling import pieces, spells
from recon.rows import events as event_rows
from recon.rows import spans
from recon_detectors._driving_thresholds import KINDS, Thresholds, sets

_SLOWEST_RATE: Final = 4.0
"""Hz; of fewer rows a second a low-pass at 2 Hz makes nothing."""


class DrivingParams(Params):
    """Parameters of detector.driving. What is none is as the set says."""

    thresholds: Literal["naturalistic", "telematics", "damoov"] = setting(
        "naturalistic", doc="Named set of limits, see driving_thresholds.yaml."
    )
    harsh_acceleration: float | None = quantity(None, "g", gt=0, doc="Limit of acceleration.")
    harsh_braking: float | None = quantity(None, "g", gt=0, doc="Limit of braking.")
    harsh_cornering: float | None = quantity(None, "g", gt=0, doc="Limit of acceleration to either side.")
    speed_limit: float | None = quantity(None, "km/h", gt=0, doc="Speed that is allowed; none: no speeding is found.")
    speed_tolerance: float = quantity(3.0, "km/h", ge=0, doc="Speed beyond the limit that is not counted.")
    speeding_duration: float = quantity(3.0, "s", ge=0, doc="Shortest speeding that counts.")
    speeding_merge: float = quantity(5.0, "s", ge=0, doc="Pause of speeding that does not end it.")
    trip_pause: float = quantity(3.0, "min", gt=0, doc="Stop, or gap of the log, that ends a trip.")
    trip_speed: float = quantity(5.0, "km/h", gt=0, doc="Speed of a vehicle that is under way.")
    trip_distance: float = quantity(100.0, "m", ge=0, doc="Shortest trip that counts.")


def driving(*, trajectory: pa.Table, events: pa.Table | None, params: DrivingParams) -> Streams:
    """Events of the kinds trip, harsh_acceleration, harsh_braking, harsh_cornering and speeding.

    The value of a harsh event is its peak in m/s^2, of speeding the highest speed in m/s, of a trip its length in m.

    trajectory : vel m/s, q; accel m/s^2 where it has it; events : of detector.crash, none where it was not asked

    Raises NotEnoughData where fewer than three rows are known.
    """
    chosen = _chosen(params)
    crashes = spans(events, "crash")
    found = handling_of(trajectory, chosen.cutoff, crashes)
    happened = [*_trips(found, params), *_harsh(found, chosen), *_speeding(found, params)]
    learnt = [*_told(chosen, params), *_counts(happened, params)]
    if crashes:
        learnt.append(Metric("crashes_left_out", float(len(crashes)), note="what a crash does to a car is no driving"))
    if found.rate < _SLOWEST_RATE:
        learnt.append(warning(f"the trajectory has {found.rate:.2g} rows a second: short harsh events are missed"))
    return {"events": event_rows(happened), "metrics": metrics(learnt)}


def _chosen(params: DrivingParams) -> Thresholds:
    named = sets()[params.thresholds]
    own = {kind: value for kind in KINDS if (value := getattr(params, kind)) is not None}
    return Thresholds(**{**vars(named), "limits": {**named.limits, **own}})


def _harsh(found: Handling, chosen: Thresholds) -> Iterator[Event]:
    fast = found.speed >= chosen.min_speed
    sizes = {
        "harsh_acceleration": found.along,
        "harsh_braking": -found.along,
        "harsh_cornering": np.abs(found.left),
    }
    for kind in KINDS:
        beyond = np.nan_to_num(sizes[kind]) >= chosen.limits[kind]
        for first, last in spells(found.t_ns, beyond & fast, chosen.merge, chosen.min_duration, found.max_gap_s):
            rows = slice(first, last + 1)
            yield _event(found, first, last, kind, float(np.nanmax(sizes[kind][rows])), "m/s^2", _about(found, rows))


def _about(found: Handling, rows: slice) -> str:
    speed: Array = found.speed[rows]
    return f"speed {speed[0] * 3.6:.1f} to {speed[-1] * 3.6:.1f} km/h"


def _event(found: Handling, first: int, last: int, kind: str, value: float, unit: str, note: str) -> Event:
    return Event(int(found.t_ns[first]), int(found.t_ns[last]), kind, value, unit, note)


def _speeding(found: Handling, params: DrivingParams) -> Iterator[Event]:
    if params.speed_limit is None:
        return
    beyond = found.speed > params.speed_limit + params.speed_tolerance
    for first, last in spells(found.t_ns, beyond, params.speeding_merge, params.speeding_duration, found.max_gap_s):
        top = float(found.speed[first : last + 1].max())
        note = f"{(top - params.speed_limit) * 3.6:.1f} km/h beyond {params.speed_limit * 3.6:.0f} km/h"
        yield _event(found, first, last, "speeding", top, "m/s", note)


def _trips(found: Handling, params: DrivingParams) -> Iterator[Event]:
    """Stretches from the first row under way to the last one before a long stop or gap."""
    moving, way = found.speed >= params.trip_speed, found.distance
    for start, stop in pieces(found.t_ns, params.trip_pause):
        part = slice(start, stop)
        for first, last in spells(found.t_ns[part], moving[part], params.trip_pause, 0.0, params.trip_pause) + start:
            if way[last] - way[first] >= params.trip_distance:
                yield _event(found, first, last, "trip", float(way[last] - way[first]), "m", "")


def _told(chosen: Thresholds, params: DrivingParams) -> Iterator[Metric]:
    """Which limits were used."""
    yield Metric("thresholds_version", float(chosen.version), method=chosen.name, note=chosen.source)
    for kind, limit in chosen.limits.items():
        own = getattr(params, kind) is not None
        yield Metric(f"{kind}_limit", limit, "m/s^2", method="given" if own else f"{chosen.name} {chosen.version}")
    yield Metric("cutoff", chosen.cutoff, "Hz", method="four running means, no delay")
    yield Metric("min_duration", chosen.min_duration, "s")
    yield Metric("min_speed", chosen.min_speed, "m/s")


def _counts(happened: Iterable[Event], params: DrivingParams) -> Iterator[Metric]:
    kinds = [event.kind for event in happened]
    for kind in ("trip", *KINDS, *(("speeding",) if params.speed_limit is not None else ())):
        yield Metric(f"{kind}_count", float(kinds.count(kind)))


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.driving."""
    yield Detector(
        name="driving",
        summary="Trips, harsh braking, acceleration and cornering by named limits, and speeding.",
        version=4,
        params=DrivingParams,
        reads={"trajectory": NEED, "events": EVENTS.need("time", "end_time", "kind", optional=True)},
        writes={"events": EVENTS},
        run=driving,
        references=(
            "ISO 8855:2011",
            "Simons-Morton et al. (2012), Am. J. Epidemiology 175(10)",
            "PosiTrace, harsh behavior detection; Damoov, telematics SDK",
        ),
    )
