"""Offset of the gyroscopes, measured at every standstill and taken off from there on.

    gyro(t) - mean of gyro over stop k,    start of stop k <= t < start of stop k + 1

An offset drifts, mostly with temperature, so each stop gives a new one. Before the first stop the first one's holds.
`between: linear` lets the offset go in a straight line from the end of one stop to the start of the next, which needs
the future and so is for work after the drive.

The rotation of the Earth (15 deg/h) is part of what is measured and taken off.

References
    "hold" is the method of the thesis on vehicle reconstruction from inertial and GNSS data, section 4.2.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    SAME,
    Array,
    Filter,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    replace,
    setting,
    spans,
    time_ns,
    warning,
)

Spans = NDArray[np.int64]
"""(k, 2) start and end of each stop, ns since 1970, sorted, without overlap."""


class GyroOffsetParams(Params):
    """Parameters of filter.gyro_offset."""

    between: Literal["hold", "linear"] = setting(
        "hold", doc="Offset between two stops: that of the first, or on a straight line from the first to the second."
    )


def gyro_offset(*, imu: pa.Table, events: pa.Table | None, params: GyroOffsetParams) -> Streams:
    """The imu with the offset taken off gyro; unchanged, with a warning, where there is no standstill.

    imu : gyro rad/s, any frame; missing values are left out of the means
    events : those of kind standstill count
    """
    t_ns, gyro = time_ns(imu), matrix(imu, "gyro", gaps=True)
    stops, samples = stops_of(t_ns, gyro, events)
    if not samples:
        return without_stops(imu)
    offsets = np.array([sample.mean(axis=0) for sample in samples])
    learnt = [Metric("stops", float(len(samples)))]
    for number, (start, sample) in enumerate(zip(stops[:, 0], samples, strict=True), start=1):
        learnt += _learnt(sample, f"stop {number}, {(start - t_ns[0]) * 1e-9:.2f} s after the first row")
    offset = between_stops(t_ns, stops, offsets, params.between)
    return {"imu": replace(imu, gyro=gyro - offset), "metrics": metrics(learnt)}


def without_stops(imu: pa.Table) -> Streams:
    """The imu as it is, with the warning."""
    return {"imu": imu, "metrics": metrics([Metric("stops", 0.0), warning("no standstill: gyro offset is kept")])}


def stops_of(
    t_ns: NDArray[np.int64], gyro: Array, events: pa.Table | None, longest_ns: int | None = None
) -> tuple[Spans, list[Array]]:
    """Stops that hold samples of the gyroscopes, and those samples, each (m, 3) rad/s.

    longest_ns : stops that last longer come in equal pieces; None leaves them whole
    """
    stops = _apart(spans(events, "standstill"))
    if longest_ns is not None:
        stops = _pieces(stops, longest_ns)
    first = np.searchsorted(t_ns, stops[:, 0], side="left")
    stop = np.searchsorted(t_ns, stops[:, 1], side="right")
    known = np.asarray(np.isfinite(gyro).all(axis=1))
    samples = [gyro[a:b][known[a:b]] for a, b in zip(first, stop, strict=True)]
    filled = np.array([len(sample) > 0 for sample in samples], dtype=bool)
    return stops[filled], [sample for sample in samples if len(sample)]


def _apart(pairs: Iterable[tuple[int, int]]) -> Spans:
    """Sorted spans, those that overlap (several detectors may have run) joined."""
    joined: list[tuple[int, int]] = []
    for start, end in pairs:
        if joined and start <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(joined[-1][1], end))
        else:
            joined.append((start, end))
    return np.array(joined, dtype=np.int64).reshape(-1, 2)


def _pieces(stops: Spans, longest_ns: int) -> Spans:
    """The stops, each in as few equal pieces as are short enough; a piece ends 1 ns before the next."""
    pieces = []
    for start, end in stops.tolist():
        edges = np.linspace(0, end - start, max(1, -(-(end - start) // longest_ns)) + 1).astype(np.int64) + start
        pieces.append(np.column_stack((edges[:-1], np.append(edges[1:-1] - 1, end))))
    return np.concatenate(pieces) if pieces else stops


def between_stops(t_ns: NDArray[np.int64], stops: Spans, offsets: Array, how: Literal["hold", "linear"]) -> Array:
    """Offset (n, 3) rad/s at each row from those of the stops (k, 3), as `between` of GyroOffsetParams says."""
    return _hold(t_ns, stops, offsets) if how == "hold" else _linear(t_ns, stops, offsets)


def _hold(t_ns: NDArray[np.int64], stops: Spans, offsets: Array) -> Array:
    """Offset (n, 3) rad/s of the last stop that has begun, before the first one that of the first."""
    index = np.searchsorted(stops[:, 0], t_ns, side="right") - 1
    return np.asarray(offsets[index.clip(min=0)])


def _linear(t_ns: NDArray[np.int64], stops: Spans, offsets: Array) -> Array:
    """Offset (n, 3) rad/s that is constant in each stop and at both ends, a straight line between two stops."""
    t_s, knots = ((t - stops[0, 0]) * 1e-9 for t in (t_ns, stops.ravel()))
    values = np.repeat(offsets, 2, axis=0)
    return np.column_stack([np.interp(t_s, knots, values[:, axis]) for axis in range(3)])


def _learnt(sample: Array, note: str) -> list[Metric]:
    """Offset of each axis in deg/s; sigma is that of the mean of white noise.

    sample : (m, 3) rad/s
    """
    count = len(sample)
    mean = np.degrees(sample.mean(axis=0))
    sigma = np.degrees(sample.std(axis=0, ddof=1) / np.sqrt(count)).tolist() if count > 1 else [None] * 3
    return [
        Metric(f"gyro_offset_{axis}", float(mean[i]), "deg/s", sigma=sigma[i], note=note)
        for i, axis in enumerate("xyz")
    ]


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.gyro_offset."""
    yield Filter(
        name="gyro_offset",
        summary="Takes off the offset of the gyroscopes anew at every standstill.",
        params=GyroOffsetParams,
        reads={"imu": IMU.need("gyro"), "events": EVENTS.need("time", "end_time", "kind", optional=True)},
        writes={"imu": SAME},
        run=gyro_offset,
        linear=True,
    )
