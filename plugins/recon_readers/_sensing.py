"""What readers of binary logs share: rows in the order of time, tables from columns, doubts about what is felt."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.numerics.axes import turn
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import Metric, warning
from recon.schema import STREAMS, Schema, group_of, unnumbered
from recon.tables import Array, build, has, matrix, select_rows
from recon_readers._limits import FASTEST_TURN, LIMITS, MOST_FAULTY, USUAL_SIZE
from recon_readers._time_order import Times, in_order

EARLIEST_NS: Final = 946_684_800 * 1_000_000_000
"""2000-01-01: a clock that shows less was never set."""
_UPRIGHT: Final = 0.7
"""Share of gravity that an axis feels which points up, within 45 deg."""
_STRONGEST_T: Final = 1e-3
"""No car magnetizes its sensors more."""
_FARTHEST: Final = 1e9
"""Largest number of columns that have no limits of their own."""
_ENOUGH: Final = 100_000
"""Rows from which a median is told."""


def rising(t_ns: Times, name: str) -> tuple[NDArray[np.intp] | slice, list[Metric]]:
    """Rows in the order of time, each time once, and what became of the others.

    Messages come as they were received: they are sorted by time. One that repeats a time is left out, as is a first or
    last one whose time is far from all others.

    t_ns : (n,) ns; name : of the sensor in its file
    """
    if (t_ns[1:] > t_ns[:-1]).all() and in_order(t_ns, np.zeros(len(t_ns), dtype=bool)).all():
        return slice(None), []
    order = np.argsort(t_ns, kind="stable")
    ordered = t_ns[order]
    usable = in_order(ordered, np.zeros(len(ordered), dtype=bool))
    repeated = np.diff(ordered, prepend=ordered[:1] - 1) <= 0
    learnt = []
    falls = np.count_nonzero(t_ns[1:] < t_ns[:-1])
    if falls:
        learnt.append(Metric("rows_sorted", float(falls), note=f"{name}: times that fell"))
    for what, count in (("of the time of an earlier one", repeated.sum()), ("far from all others", (~usable).sum())):
        if count:
            learnt.append(Metric("rows_left_out", float(count), note=f"{name}: {what}, of {len(t_ns)}"))
    return order[usable & ~repeated], learnt


def described(stream: str, t_ns: Times, columns: Mapping[str, Array]) -> pa.Table:
    """A stream of single columns, numbers of any type of the schema. t_ns : (n,) ns that rises; NaN where unknown."""
    if "course" in columns:
        columns = {**columns, "course": np.mod(columns["course"], 2.0 * np.pi)}
    schema = Schema(tuple(column for column in STREAMS[stream].columns if column.name in ("time", *columns)))
    typed: dict[str, Any] = {
        name: values
        if schema[name].type == pa.float64()
        else pa.array(values, from_pandas=True).cast(schema[name].type, safe=False)
        for name, values in columns.items()
    }
    return build(schema, time=t_ns, **typed)


def turned(columns: MutableMapping[str, Array], axes: str, *, down: bool = False) -> dict[str, Array]:
    """The columns, which are emptied, with vectors x, y, z along forward, left, up.

    axes : where they point as logged, such as FRD; down : a still accelerometer shows +g downwards
    """
    index, signs = turn(axes)
    found: dict[str, Array] = {}
    for group in ("accel", "gyro", "mag"):
        names = [f"{group}_{axis}" for axis in "xyz"]
        if not set(names) <= columns.keys():
            continue
        for name, source, sign in zip(names, index, signs, strict=True):
            factor = -sign if down and group == "accel" else sign
            values = columns.pop(names[source])
            found[name] = values if factor > 0.0 else -values
    return {**columns, **found}


def valued(columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns of groups that have a value anywhere."""
    groups = {group_of(name) for name, values in columns.items() if np.isfinite(values).any()}
    return {name: values for name, values in columns.items() if group_of(name) in groups}


def plausible(path: Path, stream: str, columns: Mapping[str, Array]) -> tuple[dict[str, Array], list[Metric]]:
    """The columns with NaN in the place of numbers that no vehicle shows, and how many these were.

    columns : (n,) in the units of the stream, by name. Raises ReadFailed where they are too many for slips.
    """
    found, learnt = {}, []
    for name, values in columns.items():
        low, high = LIMITS.get(name, LIMITS.get(group_of(name), (-_FARTHEST, _FARTHEST)))
        if len(values) and (np.nanmin(values, initial=high) < low or np.nanmax(values, initial=low) > high):
            wrong = (values < low) | (values > high)
            row = int(wrong.argmax())
            what = f"{stream}.{name} is {values[row]:g} in row {row}, which no vehicle shows"
            if wrong.sum() > MOST_FAULTY * len(values):
                raise ReadFailed(path, what, hint="the file is damaged or in other units: copy it again")
            values = np.where(wrong, np.nan, values)
            learnt += [Metric("values_left_out", float(wrong.sum()), note=what), warning(f"{what}, and is left out")]
        found[name] = values
    return found, learnt


def doubts(streams: Mapping[str, pa.Table]) -> list[Metric]:
    """Along which axis each IMU feels gravity, and whether units and signs can be right."""
    found = []
    for name, table in streams.items():
        if unnumbered(name) == "imu":
            found += _felt(name, table)
        if unnumbered(name) == "mag" and has(table, "mag"):
            size = float(np.nanmedian(np.linalg.norm(matrix(table, "mag", gaps=True), axis=1)))
            if size > _STRONGEST_T:
                text = f"{name}: the median field is {size:.3g} T, where that of the Earth has at most 7e-5 T"
                found.append(warning(f"{text}: does the log count gauss or microtesla?"))
    return found


def _felt(name: str, imu: pa.Table) -> list[Metric]:
    found = []
    some = imu if imu.num_rows < _ENOUGH else select_rows(imu, np.arange(0, imu.num_rows, imu.num_rows // _ENOUGH))
    if has(some, "accel"):
        up = np.nanmedian(matrix(some, "accel", gaps=True), axis=0) / STANDARD_GRAVITY
        size = float(np.linalg.norm(up))
        axis = int(np.argmax(np.abs(up)))
        felt = f"{'-' if up[axis] < 0.0 else '+'}{'xyz'[axis]}"
        found.append(Metric("gravity_felt", size * STANDARD_GRAVITY, "m/s^2", method=name, note=f"along {felt}"))
        if not USUAL_SIZE[0] <= size <= USUAL_SIZE[1]:
            text = f"{name}: the median acceleration is {size:.4g} g where a vehicle feels about 1 g"
            found.append(warning(f"{text}: is gravity removed, or the unit another?"))
        elif up[2] < _UPRIGHT * size:
            text = f"{name}: gravity is felt along {felt}, so z does not point up"
            found.append(
                warning(f"{text}: the box is mounted turned, or its axes or signs are not those of the format")
            )
    if has(some, "gyro") and np.nanpercentile(np.abs(matrix(some, "gyro", gaps=True)), 99) > FASTEST_TURN:
        found.append(warning(f"{name}: a hundredth of the rates exceed {FASTEST_TURN:g} rad/s: is the unit deg/s?"))
    return found
