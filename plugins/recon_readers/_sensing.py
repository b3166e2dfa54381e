"""What inertial sensors and magnetometers feel: turned into the axes of recon, and doubts about units and signs."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Final

import numpy as np
import pyarrow as pa

from recon.numerics.axes import turn
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import Metric, warning
from recon.schema import unnumbered
from recon.tables import Array, has, matrix, select_rows
from recon_readers._limits import FASTEST_TURN, USUAL_SIZE

_UPRIGHT: Final = 0.7
"""Share of gravity that an axis feels which points up, within 45 deg."""
_STRONGEST_T: Final = 1e-3
"""No car magnetizes its sensors more."""
_ENOUGH: Final = 100_000
"""Rows from which a median is told."""


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
