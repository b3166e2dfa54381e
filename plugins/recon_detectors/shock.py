"""Crashes by the size of the specific force, beyond gravity.

    | |f| - g | > threshold

Gravity is taken off before the comparison, so the threshold is what the vehicle does and not what the Earth does. The
magnitude does not depend on how the box is mounted, so no alignment is needed first.

Exceedances close to each other are one crash: a structure rings, and a vehicle hits more than once. What follows a
crash is kept, for the second impact and the run-out matter to a reconstruction, unless `cut` asks otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    GNSS,
    IMU,
    SAME,
    Array,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    events,
    hookimpl,
    matrix,
    metrics,
    quantity,
    select_rows,
    setting,
    time_ns,
)
from recon.numerics.geodesy import STANDARD_GRAVITY


class ShockParams(Params):
    """Parameters of detector.shock."""

    threshold: float = quantity(
        2.0, "g", gt=0, le=1000, doc="Deviation of the specific force from gravity that is a crash."
    )
    merge: float = quantity(0.5, "s", ge=0, le=3600, doc="Exceedances up to this far apart are one crash.")
    cut: bool = setting(False, doc="Drop the rows of imu and gnss after the end of the first crash.")


def shock(*, imu: pa.Table, gnss: pa.Table | None, params: ShockParams) -> Streams:
    """Events of kind crash; their value is the largest deviation of the specific force from gravity, m/s^2.

    imu : accel m/s^2, any frame, specific force; rows without it are left out
    gnss : only cut, never looked at
    """
    force = np.linalg.norm(matrix(imu, "accel", gaps=True), axis=1)
    known = np.isfinite(force)
    crashes = _crashes(time_ns(imu)[known], force[known], params)
    learnt = [
        Metric("crashes", float(len(crashes))),
        Metric("threshold", params.threshold, "m/s^2", method="deviation of |f| from gravity"),
    ]
    streams = {"imu": imu} if gnss is None else {"imu": imu, "gnss": gnss}
    if params.cut and crashes:
        kept = {name: select_rows(table, time_ns(table) <= crashes[0].end_ns) for name, table in streams.items()}
        for name, table in kept.items():
            learnt.append(Metric(f"{name}_rows_cut", float(streams[name].num_rows - table.num_rows)))
        streams = kept
    return {**streams, "events": events(crashes), "metrics": metrics(learnt)}


def _crashes(t_ns: NDArray[np.int64], force: Array, params: ShockParams) -> list[Event]:
    """One event for each group of exceedances.

    t_ns : (n,) ns since 1970; force : (n,) m/s^2, magnitude of the specific force
    """
    deviation = np.abs(force - STANDARD_GRAVITY)
    rows = np.flatnonzero(deviation > params.threshold)
    if not len(rows):
        return []
    apart = np.flatnonzero(np.diff(t_ns[rows]) > round(params.merge * 1e9)) + 1
    found = []
    for group in np.split(rows, apart):
        peak = group[deviation[group].argmax()]
        after = (t_ns[peak] - t_ns[group[0]]) * 1e-9
        note = f"specific force {force[peak]:.2f} m/s^2 at the peak, {after:.3f} s after the start"
        found.append(Event(int(t_ns[group[0]]), int(t_ns[group[-1]]), "crash", float(deviation[peak]), "m/s^2", note))
    return found


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.shock."""
    yield Detector(
        name="shock",
        summary="Crashes by the deviation of the specific force from gravity.",
        params=ShockParams,
        reads={"imu": IMU.need("accel", quantity={"accel": "specific_force"}), "gnss": GNSS.need(optional=True)},
        writes={"events": EVENTS, "imu": SAME, "gnss": SAME},
        run=shock,
    )
