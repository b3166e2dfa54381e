"""Interpolation of sensors of different rates onto one time base.

    y(t) = (1 - s) y_i + s y_(i+1),    s = (t - t_i) / (t_(i+1) - t_i)

Loggers that write one sensor per row leave the others empty: here each group is interpolated from its own samples.
The time base is that of the imu, a regular grid from its first row on, or the times of another stream: `in: {clock:
gnss}` brings the imu onto those of gnss, `in: {clock: frames}` onto those of the images. What goes with the imu,
attitude and trajectory, comes along; gnss and mag where asked for. Angles take the short way around the circle,
attitudes turn at a constant rate, counts and codes hold their last value. Nothing is invented: no value outside the
span of a group's samples, none inside a gap longer than `max_gap`.

A time base slower than the samples of a column would alias vibration into its band. There the value is the
mean of y over one period of it about t: the integral, which is what is wanted of an imu, is conserved, and what is
aliased is damped by sinc(f / rate), by 13 dB at least beyond the new rate. Averaged are imu and mag alone.

References
    Shoemake (1985), "Animating rotation with quaternion curves", SIGGRAPH 85, 245-254: attitudes.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    ATTITUDE,
    GNSS,
    IMU,
    MAG,
    SAME,
    TRAJECTORY,
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
from recon.errors import DataError
from recon.numerics.rotation_series import slerp
from recon.numerics.signals import bracket, interpolate, interpolate_angle, interval_mean, median_rate
from recon.schema import spread

Times = NDArray[np.int64]

_TURNS = {"course": (2.0 * np.pi, 0.0), "lon": (360.0, -180.0)}
"""Angles: a full turn and the lowest value, both in the unit of the column."""
SLOWER = 0.9
"""A grid whose rate is below this share of that of the samples is a slower one: clocks jitter by some per cent."""
MOST_ROWS = 50_000_000
MOST_GROWTH = 100
"""A grid of more rows, or of so many times those of the log, is refused: it fills the memory and tells nothing new."""


class ResampleParams(Params):
    """Parameters of filter.resample."""

    rate: float | None = quantity(
        None, "Hz", ge=0.01, le=10_000, doc="Rate of a regular grid; none keeps the times of the imu, or of the clock."
    )
    gnss: bool = setting(False, doc="Bring gnss onto the same times as well.")
    mag: bool = setting(False, doc="Bring mag onto the same times as well.")
    max_gap: float = quantity(
        0.5, "s", gt=0, le=3600, doc="Longest gap between two samples of imu or mag that is interpolated."
    )
    gnss_max_gap: float = quantity(
        1.5, "s", gt=0, le=3600, doc="Longest gap between two rows of gnss that is interpolated."
    )


def resample(
    *,
    imu: pa.Table,
    gnss: pa.Table | None,
    mag: pa.Table | None,
    attitude: pa.Table | None,
    trajectory: pa.Table | None,
    clock: pa.Table | None,
    params: ResampleParams,
) -> Streams:
    """The imu complete in every row, with what goes with it; gnss and mag untouched, or on the same times.

    imu : accel m/s^2, gyro rad/s, any frame; null where the other one was measured. Rows that stay incomplete, at
        the ends and in gaps, are dropped. A group with an axis without any value drops nothing.
    attitude, trajectory : rows where they are not known are dropped; gnss, mag : null where unknown
    clock : its times are the time base
    Raises DataError where the grid would have far more rows than the log, both a rate and a clock are given, or the
    sensors are never known together.
    """
    gap_ns, gnss_gap_ns = round(params.max_gap * 1e9), round(params.gnss_max_gap * 1e9)
    t_ns, rate, base = _time_base(time_ns(imu), clock, params.rate, gap_ns)
    filled = _onto(t_ns, imu, gap_ns, rate)
    complete = _complete(filled, imu, params)
    streams = {"imu": select_rows(filled, complete)}
    for name, table, gap in (("attitude", attitude, gap_ns), ("trajectory", trajectory, gap_ns)):
        if table is not None:
            streams[name] = _known(_onto(t_ns[complete], table, gap))
    if gnss is not None:
        streams["gnss"] = _onto(t_ns[complete], gnss, gnss_gap_ns) if params.gnss else gnss
    if mag is not None:
        streams["mag"] = _onto(t_ns[complete], mag, gap_ns, rate) if params.mag else mag
    learnt = [
        Metric("rows", float(complete.sum()), method=base),
        Metric("rows_dropped", float((~complete).sum()), note="at the ends and in gaps"),
        *(row for group in ("accel", "gyro") for row in _completed(imu, group)),
    ]
    return {**streams, "metrics": metrics(learnt)}


def _complete(filled: pa.Table, imu: pa.Table, params: ResampleParams) -> NDArray[np.bool_]:
    """Rows in which all sensors of the imu are known: (n,). Raises DataError where there is none."""
    groups = [group for group in ("accel", "gyro") if has(imu, group)]
    complete = np.ones(filled.num_rows, dtype=bool)
    for group in groups:
        complete &= np.isfinite(matrix(filled, group, gaps=True)).all(axis=1)
    if imu.num_rows and len(complete) and not complete.any():
        raise DataError(
            f"imu tells {' and '.join(groups)} within {params.max_gap:g} s at none of {len(complete)} times",
            "do both sensors run, and at the same time? 'recon inspect' shows how many values are missing",
        )
    return complete


def _time_base(
    given: Times, clock: pa.Table | None, rate: float | None, gap_ns: int
) -> tuple[Times, float | None, str]:
    """The new times, the rate to which faster samples are averaged (None where none are), and what they are."""
    if clock is None:
        t_ns = given if rate is None else _grid(given, rate, gap_ns)
        return t_ns, rate, "times of imu" if rate is None else f"{rate:g} Hz"
    if rate is not None:
        raise DataError("filter.resample is given both a rate and a clock", "leave one of them away")
    t_ns = time_ns(clock)
    if len(given):
        t_ns = t_ns[(t_ns >= given[0]) & (t_ns <= given[-1])]
    clock_rate = median_rate(t_ns)
    return t_ns, clock_rate if np.isfinite(clock_rate) else None, "times of another stream"


def _known(table: pa.Table) -> pa.Table:
    """The rows whose attitude is known."""
    return select_rows(table, np.asarray(np.isfinite(matrix(table, "q", gaps=True)).all(axis=1)))


def _completed(imu: pa.Table, group: str) -> list[Metric]:
    """How much of a group was measured, and how much of it is filled in between, axis by axis."""
    values = matrix(imu, group, gaps=True)
    blank = ~np.isfinite(values)
    names = spread(group, imu.column_names)
    empty = [f"imu.{name}" for name, column in zip(names, blank.T, strict=True) if column.all()]
    if len(empty) == len(names):
        return [warning(f"imu has no {group}: it stays empty")]
    if empty:
        return [warning(f"{' and '.join(empty)} holds no number: {group} stays incomplete")]
    measured = Metric(f"{group}_samples", float((~blank).all(axis=1).sum()), note=f"measured in {len(values)} rows")
    partly = blank & ~blank.all(axis=1, keepdims=True)
    return [
        measured,
        *(
            Metric(f"{name}_filled", float(column.sum()), note="rows in which other axes are measured: interpolated")
            for name, column in zip(names, partly.T, strict=True)
            if column.any()
        ),
    ]


def _grid(t_ns: Times, rate: float, gap_ns: int) -> Times:
    """Multiples of the period after the first time, where the times leave no gap: (m,) ns.

    Each time is rounded to a nanosecond by itself, so that errors do not add up. Raises DataError on a grid that is
    far longer than the times.
    """
    if not len(t_ns):
        return t_ns
    period = 1e9 / rate
    since = t_ns - t_ns[0]
    breaks = np.flatnonzero(np.diff(since) > gap_ns)
    first = np.ceil(since[np.concatenate(([0], breaks + 1))] / period).astype(np.int64)
    last = np.floor(since[np.concatenate((breaks, [len(since) - 1]))] / period).astype(np.int64)
    rows, most = int((last - first + 1).sum()), max(len(t_ns), min(MOST_ROWS, MOST_GROWTH * len(t_ns)))
    if rows > most:
        raise DataError(
            f"a grid of {rate:g} Hz would have {rows:,} rows where imu has {len(t_ns):,}",
            f"lower the rate: the imu itself has {median_rate(t_ns):.1f} Hz",
        )
    counts = np.concatenate([np.arange(a, b + 1) for a, b in zip(first, last, strict=True)])
    return np.asarray(t_ns[0] + np.rint(counts * period).astype(np.int64))


def _onto(t_new: Times, table: pa.Table, gap_ns: int, rate: float | None = None) -> pa.Table:
    """The table on other times: (m,) ns; its columns, fields and metadata are kept.

    rate : Hz of the grid that t_new is, onto which faster columns are averaged; None only interpolates
    """
    t = time_ns(table)
    turns = _attitudes(t_new, t, table, gap_ns)
    arrays = []
    for field in table.schema:
        if field.name == "time":
            arrays.append(times(t_new))
        elif field.name in turns:
            arrays.append(pa.array(turns[field.name], type=field.type, from_pandas=True))
        elif pa.types.is_floating(field.type):
            values = vector(table, field.name, gaps=True)
            if rate is not None and rate < SLOWER * median_rate(t[~np.isnan(values)]):
                values = interval_mean(t_new, t, values, 1.0 / rate, gap_ns * 1e-9)
            else:
                values = _interpolated(t_new, t, values, field.name, gap_ns)
            arrays.append(pa.array(values, type=field.type, from_pandas=True))
        else:
            arrays.append(_held(t_new, t, table[field.name], gap_ns))
    return pa.Table.from_arrays(arrays, schema=table.schema)


def _attitudes(t_new: Times, t: Times, table: pa.Table, gap_ns: int) -> dict[str, Array]:
    """The columns of the quaternion, where the table has one."""
    names = spread("q", table.column_names)
    q = matrix(table, "q", gaps=True) if names else np.zeros((0, 4))
    if not np.isfinite(q).all(axis=1).any():
        return {}
    return dict(zip(names, slerp(t_new, t, q, gap_ns).T, strict=True))


def _interpolated(t_new: Times, t: Times, values: Array, name: str, gap_ns: int) -> Array:
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
        reads={
            "imu": IMU.need("accel", "gyro"),
            "gnss": GNSS.need(optional=True),
            "mag": MAG.need(optional=True),
            "attitude": ATTITUDE.need(optional=True),
            "trajectory": TRAJECTORY.need(optional=True),
            "clock": GNSS.need("time", optional=True),
        },
        writes=dict.fromkeys(("imu", "gnss", "mag", "attitude", "trajectory"), SAME),
        run=resample,
        version=2,
        linear=True,
        unit_gain=True,
        resamples=True,
        references=("Shoemake (1985), SIGGRAPH 85, 245-254",),
    )
