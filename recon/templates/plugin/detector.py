"""Times at which the vehicle is fast: the speed is above a limit without a break."""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from recon import (
    EVENTS,
    GNSS,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    events,
    hookimpl,
    metrics,
    quantity,
    time_ns,
    vector,
)
from recon.numerics.signals import runs


class FastParams(Params):
    """Parameters of detector.$name."""

    limit: float = quantity(30.0, "km/h", gt=0, doc="Speed above which the vehicle is fast.")


def fast(*, gnss: pa.Table, params: FastParams) -> Streams:
    """The events `fast`, each with the highest speed in it.

    gnss : speed m/s; a row without a speed ends an event
    """
    t_ns, speed = time_ns(gnss), vector(gnss, "speed", gaps=True)
    found = [
        Event(int(t_ns[start]), int(t_ns[stop - 1]), "fast", float(speed[start:stop].max()), "m/s")
        for start, stop in runs(speed > params.limit)
    ]
    return {"events": events(found), "metrics": metrics([Metric("fast", float(len(found)), note="times")])}


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.$name."""
    yield Detector(
        name="$name",
        summary="Times at which the vehicle is fast.",
        params=FastParams,
        run=fast,
        reads={"gnss": GNSS.need("speed")},
        writes={"events": EVENTS},
    )
