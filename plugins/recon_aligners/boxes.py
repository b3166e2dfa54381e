"""Several boxes in one vehicle: the further ones in the axes and the clock of the first, and at its place.

    f_1 = R f_2 - w. x r - w x (w x r),    w_1 = R w_2,    t_1 = t_2 - lag - drift (t_2 - middle)

Rotation R, lag, drift and lever arm r of every further box are found from what both measured (recon.numerics.boxes), or
given. Found or given, they become metrics, those found with sigmas and a verdict: does the drive show them? What moves
the specific force by the lever arm takes angular accelerations from means over 0.04 s: a shock stays as it was felt.

A rotation that is given stays; a clock that is given stays; a lever arm that is given stays: only the rest is found.

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sec. 2.5.5.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace as changed
from typing import Any

import numpy as np
import pyarrow as pa

from recon import (
    IMU,
    SAME,
    Aligner,
    Metric,
    NotEnoughData,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    time_ns,
    times,
    warning,
)
from recon.numerics.box_clocks import Inertial
from recon.numerics.boxes import Placement, lever_acceleration, place, quiet_rate
from recon.numerics.rotation import from_euler, rotate, to_euler
from recon.schema import FURTHER_IMUS

_SHOWN_DEG, _SHOWN_S, _SHOWN_M = 0.5, 0.005, 0.1
"""Sigmas up to which a drive shows a rotation, a lag and a lever arm."""


class BoxesParams(Params):
    """Parameters of aligner.boxes. Those of one box stand under its name; none: found from the drive."""

    largest_lag: float = quantity(10.0, "s", gt=0, le=600, doc="Lags are sought up to this, late and early.")
    rotation_2: tuple[float, float, float] | None = quantity(
        None, "deg", doc="Yaw, pitch and roll (ISO 8855) of imu_2 in the axes of imu; none: found."
    )
    rotation_3: tuple[float, float, float] | None = quantity(None, "deg", doc="The same of imu_3.")
    rotation_4: tuple[float, float, float] | None = quantity(None, "deg", doc="The same of imu_4.")
    lever_arm_2: tuple[float, float, float] | None = quantity(
        None, "m", doc="From imu to imu_2 along the axes of imu; none: found."
    )
    lever_arm_3: tuple[float, float, float] | None = quantity(None, "m", doc="The same of imu_3.")
    lever_arm_4: tuple[float, float, float] | None = quantity(None, "m", doc="The same of imu_4.")
    lag_2: float | None = quantity(None, "s", doc="What the clock of imu_2 shows more than that of imu; none: found.")
    lag_3: float | None = quantity(None, "s", doc="The same of imu_3.")
    lag_4: float | None = quantity(None, "s", doc="The same of imu_4.")


def align_boxes(
    *,
    imu: pa.Table,
    imu_2: pa.Table | None,
    imu_3: pa.Table | None,
    imu_4: pa.Table | None,
    params: BoxesParams,
) -> Streams:
    """Further boxes as imu would have measured. Raises NotEnoughData where one cannot be placed."""
    further = {
        name: table for name, table in zip(FURTHER_IMUS, (imu_2, imu_3, imu_4), strict=True) if table is not None
    }
    if not further:
        return {"metrics": metrics([warning("there is only one box (imu): nothing was aligned")])}
    first = _inertial(imu)
    learnt: list[Metric] = []
    moved: Streams = {}
    for name, table in further.items():
        placement = _placed(first, _inertial(table), name, params)
        learnt += _told(name, placement)
        moved[name] = _moved(table, placement)
    return {**moved, "metrics": metrics(learnt)}


def _inertial(table: pa.Table) -> Inertial:
    return Inertial(time_ns(table), matrix(table, "gyro"), matrix(table, "accel"))


def _placed(first: Inertial, second: Inertial, name: str, params: BoxesParams) -> Placement:
    """How a box stands to the first, as given and, where anything is not, as found."""
    number = name.removeprefix("imu_")
    euler, lever, lag = (getattr(params, f"{what}_{number}") for what in ("rotation", "lever_arm", "lag"))
    if euler is not None and lever is not None and lag is not None:
        middle = int(first.t_ns[0]) if len(first.t_ns) else 0
        found = Placement(np.zeros(4), np.zeros(3), 0.0, 0.0, 0.0, 0.0, middle, np.zeros(3), np.zeros(3))
    else:
        try:
            found = place(first, second, params.largest_lag)
        except ValueError as error:
            raise NotEnoughData(
                f"common motion of imu and {name}",
                needed="half a minute of driving that both measure",
                found=str(error),
                hint=f"give rotation_{number}, lever_arm_{number} and lag_{number}, or leave {name} out",
            ) from error
    given: dict[str, Any] = {}
    if euler is not None:
        given.update(q_12=from_euler(*euler), q_sigma=np.zeros(3))
    if lever is not None:
        given.update(lever=np.array(lever), lever_sigma=np.zeros(3))
    if lag is not None:
        given.update(lag=lag, lag_sigma=0.0, drift=0.0, drift_sigma=0.0)
    return changed(found, **given)


def _moved(table: pa.Table, placement: Placement) -> pa.Table:
    """The stream of a box as the first would have measured."""
    t_ns = placement.in_clock_of_first(time_ns(table))
    gyro, accel = (rotate(placement.q_12, matrix(table, group)) for group in ("gyro", "accel"))
    if len(t_ns) > 1 and placement.lever.any():
        box = Inertial(t_ns, gyro, accel)
        accel = accel - lever_acceleration(box._replace(gyro=gyro - quiet_rate(box)), placement.lever)
    return replace(table, time=times(t_ns), accel=accel, gyro=gyro)


def _told(name: str, placement: Placement) -> Iterator[Metric]:
    """What was found or given, and whether the drive shows it; a sigma of zero is that of what was given."""
    for angle, value in zip(("yaw", "pitch", "roll"), to_euler(placement.q_12), strict=True):
        yield _metric(
            f"{name}_{angle}", float(np.degrees(value)), "deg", np.degrees(placement.q_sigma.max()), "in imu's axes"
        )
    yield _metric(f"{name}_lag", placement.lag, "s", placement.lag_sigma, "taken off its times, in mid-drive")
    yield _metric(f"{name}_drift", placement.drift * 1e6, "us/s", placement.drift_sigma * 1e6, "its clock gains")
    for axis, value, sigma in zip("xyz", placement.lever, placement.lever_sigma, strict=True):
        yield _metric(f"{name}_lever_arm_{axis}", value, "m", sigma, "from imu, along imu's axes")
    seen = {
        "rotation": np.degrees(placement.q_sigma.max()) <= _SHOWN_DEG,
        "lag": placement.lag_sigma <= _SHOWN_S,
        **{
            f"lever arm along {axis}": sigma <= _SHOWN_M
            for axis, sigma in zip("xyz", placement.lever_sigma, strict=True)
        },
    }
    hidden = [what for what, shown in seen.items() if not shown]
    yield Metric(f"{name}_observable", float(not hidden), "1", note=", ".join(hidden) and f"not: {', '.join(hidden)}")
    if np.isnan(placement.lag_sigma + placement.q_sigma.sum() + placement.lever_sigma.sum()):
        yield warning(f"how exactly {name} is placed is not known: the boxes drove together for too short a time")
    elif hidden:
        yield warning(
            f"the drive does not show of {name}: {', '.join(hidden)}; drive bends both ways, brake hard, cross humps, "
            "or give what was measured by hand"
        )


def _metric(name: str, value: float, unit: str, sigma: float, note: str) -> Metric:
    how = "rigid-body equations" if sigma else "given"
    known = sigma > 0.0  # neither given nor NaN, which is not known
    return Metric(name, float(value), unit, float(sigma) if known else None, method=how, note=note)


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.boxes."""
    further = {name: IMU.need("accel", "gyro", optional=True) for name in FURTHER_IMUS}
    yield Aligner(
        name="boxes",
        summary="Finds how further boxes stand to the first, and writes them as the first would have measured.",
        version=3,
        params=BoxesParams,
        reads={"imu": IMU.need("accel", "gyro"), **further},
        writes=dict.fromkeys(FURTHER_IMUS, SAME),
        run=align_boxes,
        references=("Groves 2013, section 2.5.5", "Davenport 1968"),
    )
