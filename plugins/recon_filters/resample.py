"""Interpolation of sensors of different rates onto one time base.

    y(t) = (1 - s) y_i + s y_(i+1),    s = (t - t_i) / (t_(i+1) - t_i)

Loggers that write one sensor per row leave the others empty: here each group is interpolated from its own samples.
The time base is that of the imu, or a regular grid from its first row on. Angles take the short way around the
circle, counts and codes hold their last value. Nothing is invented: no value outside the span of a group's samples,
none inside a gap longer than `max_gap`.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    GNSS,
    IMU,
    SAME,
    Array,
    Filter,
    Metric,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    select_rows,
    setting,
    time_ns,
    times,
    vector,
    warning,
)
from recon.numerics.signals import bracket, interpolate, interpolate_angle

Times = NDArray[np.int64]

_TURNS = {"course": (2.0 * np.pi, 0.0), "lon": (360.0, -180.0)}
"""Angles: a full turn and the lowest value, both in the unit of the column."""


class ResampleParams(Params):
    """Parameters of filter.resample."""

    rate: float | None = quantity(None, "Hz", gt=0, doc="Rate of a regular grid; none keeps the times of the imu.")
    gnss: bool = setting(False, doc="Bring gnss onto the same times as well.")
    max_gap: float = quantity(1.5, "s", gt=0, doc="Longest gap between two samples that is interpolated.")


def resample(*, imu: pa.Table, gnss: pa.Table | None, params: ResampleParams) -> Streams:
    """The imu complete in every row; gnss untouched, or on the times of the imu and null where unknown.

    imu : accel m/s^2, gyro rad/s, any frame; null where the other one was measured. Rows that stay incomplete, at
        the ends and in gaps, are dropped. A group without any value stays null and drops nothing.
    gnss : any columns
    """
    gap_ns = round(params.max_gap * 1e9)
    groups = [group for group in ("accel", "gyro") if has(imu, group)]
    notes = [warning(f"imu has no {group}: it stays empty") for group in ("accel", "gyro") if group not in groups]
    given = time_ns(imu)
    t_ns = given if params.rate is None else _grid(given, params.rate, gap_ns)
    filled = _onto(t_ns, imu, gap_ns)
    complete = np.ones(len(t_ns), dtype=bool)
    for group in groups:
        complete &= np.isfinite(matrix(filled, group, gaps=True)).all(axis=1)
        measured = int(np.isfinite(matrix(imu, group, gaps=True)).all(axis=1).sum())
        notes.append(Metric(f"{group}_samples", float(measured), note=f"measured in {imu.num_rows} rows"))
    streams = {"imu": select_rows(filled, complete)}
    if gnss is not None:
        streams["gnss"] = _onto(t_ns[complete], gnss, gap_ns) if params.gnss else gnss
    learnt = [
        Metric("rows", float(complete.sum()), method="times of imu" if params.rate is None else f"{params.rate:g} Hz"),
        Metric("rows_dropped", float((~complete).sum()), note="at the ends and in gaps"),
    ]
    return {**streams, "metrics": metrics([*learnt, *notes])}


def _grid(t_ns: Times, rate: float, gap_ns: int) -> Times:
    """Multiples of the period after the first time, where the times leave no gap: (m,) ns.

    Each time is rounded to a nanosecond by itself, so that errors do not add up.
    """
    if not len(t_ns):
        return t_ns
    period = 1e9 / rate
    since = t_ns - t_ns[0]
    breaks = np.flatnonzero(np.diff(since) > gap_ns)
    first = np.ceil(since[np.concatenate(([0], breaks + 1))] / period).astype(np.int64)
    last = np.floor(since[np.concatenate((breaks, [len(since) - 1]))] / period).astype(np.int64)
    counts = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    return np.asarray(t_ns[0] + np.rint(counts * period).astype(np.int64))


def _onto(t_new: Times, table: pa.Table, gap_ns: int) -> pa.Table:
    """The table on other times: (m,) ns. Its columns, fields and metadata are kept."""
    t = time_ns(table)
    arrays = []
    for field in table.schema:
        if field.name == "time":
            arrays.append(times(t_new))
        elif pa.types.is_floating(field.type):
            values = _column(t_new, t, vector(table, field.name, gaps=True), field.name, gap_ns)
            arrays.append(pa.array(values, type=field.type, from_pandas=True))
        else:
            arrays.append(_held(t_new, t, table[field.name], gap_ns))
    return pa.Table.from_arrays(arrays, schema=table.schema)


def _column(t_new: Times, t: Times, values: Array, name: str, gap_ns: int) -> Array:
    if name not in _TURNS:
        return interpolate(t_new, t, values, gap_ns)
    turn, lowest = _TURNS[name]
    angle = interpolate_angle(t_new, t, values * (2.0 * np.pi / turn), gap_ns) * (turn / (2.0 * np.pi))
    wrapped = np.where(angle < lowest, angle + turn, angle)
    return np.asarray(np.where(wrapped >= lowest + turn, lowest, wrapped))


def _held(t_new: Times, t: Times, values: pa.ChunkedArray, gap_ns: int) -> pa.ChunkedArray:
    """The last value before each new time, with the same limits as for interpolation."""
    known = np.flatnonzero(np.asarray(values.is_valid()))
    if not len(known):
        return pa.nulls(len(t_new), values.type)
    left, right, fraction = bracket(t_new, t[known])
    near = (t[known][right] - t[known][left] <= gap_ns) | (fraction == 0.0) | (fraction == 1.0)
    chosen = known[np.where(fraction == 1.0, right, left)]
    return values.take(pa.array(chosen, mask=~(np.isfinite(fraction) & near)))


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.resample."""
    yield Filter(
        name="resample",
        summary="Sensors of different rates on one time base.",
        params=ResampleParams,
        reads={"imu": IMU.need("accel", "gyro"), "gnss": GNSS.need(optional=True)},
        writes={"imu": SAME, "gnss": SAME},
        run=resample,
    )
