"""Turns the box upright by the direction of gravity while the vehicle stands.

A still accelerometer feels g upwards, so the shortest rotation q_ls that takes the mean specific force of the first
stop to +z makes z vertical. It leaves the direction of x to aligner.forward. It is assumed that the vehicle stands on
flat ground at the first stop; later stops tell whether the box has come loose.

References
    Thesis, section 4.4.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    Aligner,
    Change,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    seconds,
    spans,
    time_ns,
    warning,
)
from recon.errors import DataError, NotEnoughData
from recon.numerics.rotation import Floats, rotate, shortest_arc, to_euler
from recon.placing import clock_text, rows_during

UP = np.array([0.0, 0.0, 1.0])
LEAST_GRAVITY = 5.0
"""m/s^2; a box that feels less than about half of gravity at rest has lost it to its own software."""
SHOWN_WARNINGS = 3
FEWEST_ROWS = 10
"""An imu with fewer rows is no log of a drive."""


class LevelParams(Params):
    """Parameters of aligner.level_at_stops."""

    tolerance: float = quantity(
        3.0, "deg", gt=0, le=180, doc="A later stop at which the vertical differs by more than this gives a warning."
    )


def level(*, imu: pa.Table, events: pa.Table, params: LevelParams) -> Streams:
    """Turn accel and gyro so that the specific force of the first stop points to +z.

    Raises NotEnoughData where the vehicle never stands, DataError where it stands only while imu is silent or where
    the box feels no gravity.
    """
    accel = matrix(imu, "accel")
    stops = rows_during(imu, events, "standstill")
    if not len(stops):
        raise _no_stop(imu, events)
    force_s = np.array([accel[start:stop].mean(axis=0) for start, stop in stops])
    gravity = float(np.linalg.norm(force_s[0]))
    if gravity < LEAST_GRAVITY:
        raise DataError(
            f"the accelerometer reads {gravity:.2f} m/s^2 at rest, where it must feel gravity",
            "log the raw accelerometer, or tell the reader that gravity was taken off",
        )
    q_ls = shortest_arc(force_s[0], UP)
    _, pitch, roll = to_euler(q_ls)
    learnt = [
        Metric("mount_roll", float(np.degrees(roll)), "deg", method="first stop"),
        Metric("mount_pitch", float(np.degrees(pitch)), "deg", method="first stop"),
        Metric("gravity_measured", gravity, "m/s^2", method="first stop"),
    ]
    learnt += _disagreements(seconds(imu)[stops[:, 0]], rotate(q_ls, force_s), params.tolerance)
    turned = {"accel": rotate(q_ls, accel), "gyro": rotate(q_ls, matrix(imu, "gyro"))}
    return {"imu": replace(imu, **turned), "metrics": metrics(learnt)}


def _no_stop(imu: pa.Table, events: pa.Table) -> DataError:
    """Why there is no row at rest: too few rows, standstills at other times than the imu, or no standstill."""
    t_ns, found = time_ns(imu), np.array(spans(events, "standstill"), dtype=np.int64)
    if len(t_ns) < FEWEST_ROWS:
        hint = "a log must begin with some seconds at rest and then hold a drive"
        return NotEnoughData("rows in imu", needed=f"at least {FEWEST_ROWS}", found=str(len(t_ns)), hint=hint)
    if len(found):
        return DataError(
            f"{len(found)} standstills were found, none while imu runs: imu from {clock_text(t_ns[0])} to "
            f"{clock_text(t_ns[-1])}, standstills from {clock_text(found.min())} to {clock_text(found.max())}",
            "gnss and imu overlap nowhere there: is it the same drive, and do their clocks agree?",
        )
    return NotEnoughData(
        "stops", needed="one standstill", found="none",
        hint="relax the thresholds of the standstill detector, or log a few seconds at rest",
    )  # fmt: skip


def _disagreements(start_s: NDArray[np.float64], force_l: Floats, tolerance: float) -> list[Metric]:
    """Warnings of the stops whose vertical is not that of the first.

    start_s : (m,) s since the first record; force_l : (m, 3) m/s^2, level; tolerance : rad
    """
    tilt = np.arctan2(np.hypot(force_l[:, 0], force_l[:, 1]), force_l[:, 2])
    bad = np.flatnonzero(tilt > tolerance)
    notes = [
        f"at the stop {start_s[k]:.1f} s after the first record the vertical differs by {np.degrees(tilt[k]):.1f} deg "
        "from that of the first stop: the road slopes there, or the box has moved in its mount"
        for k in bad[:SHOWN_WARNINGS]
    ]
    if len(bad) > SHOWN_WARNINGS:
        notes.append(f"the vertical differs so at {len(bad) - SHOWN_WARNINGS} more of {len(tilt)} stops")
    return [warning(note) for note in notes]


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.level_at_stops."""
    yield Aligner(
        name="level_at_stops",
        summary="Turns imu upright by gravity at the first stop, and warns where later stops disagree.",
        params=LevelParams,
        reads={
            "imu": IMU.need("accel", "gyro", frame="sensor", quantity={"accel": "specific_force"}),
            "events": EVENTS.need("end_time", "kind"),
        },
        writes={"imu": Change(frames={"accel": "level", "gyro": "level"})},
        run=level,
        rotation=True,
        references=("Thesis, section 4.4",),
    )
