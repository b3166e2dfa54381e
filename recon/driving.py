"""Streams as what the smoother takes in: whole drives, their impacts, and what comes of them. GNSS: recon.fixes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import pyarrow as pa

from recon.clipping import saturated
from recon.errors import DataError, NotEnoughData
from recon.fixes import Observed
from recon.numerics.integration import cumulative
from recon.numerics.rotation import to_euler
from recon.numerics.saturation import clipped, hidden
from recon.numerics.smoothing import Drive, Estimate, Impact, Model, Noise, estimate, regular_samples
from recon.numerics.smoothing.soa import matrix_to_quat
from recon.numerics.smoothing.state import MOUNT
from recon.rows import Metric, spans
from recon.tables import Array, has, known_rows, matrix, seconds, select_rows, time_ns, vector

_FELT: Final = (5.0, 15.0)
"""m/s^2 between which the usual specific force of a vehicle lies, whatever the sensor's scale and bias."""


_SPINNING: Final = np.radians(100.0)
"""rad/s; no gyroscope's range ends below."""
_APART_S: Final = 0.1
"""Times at the end of a gyroscope's range that follow each other sooner are one."""


def measured(imu: pa.Table) -> pa.Table:
    """The rows of an imu that hold all six numbers; loggers of phones leave some out.

    raises : DataError where half of them or more do not
    """
    known = known_rows(imu, "accel", "gyro")
    if known.all():
        return imu
    if 2 * known.sum() <= len(known):
        raise DataError(
            f"only {int(known.sum())} of {len(known)} rows of imu hold both acceleration and turn rate",
            "are they of two sensors with clocks of their own? put filter.resample before this step",
        )
    return select_rows(imu, known)


def drive_of(
    imu: pa.Table,
    wheel: pa.Table | None,
    observed: Observed,
    start_ns: int,
    impacts: tuple[Impact, ...] = (),
    fewest_fixes: int = 3,
) -> Drive:
    """A drive for the smoother. start_ns : time zero, that of the first row of imu.

    raises : DataError where imu is too short or feels no gravity, NotEnoughData where hardly a fix lies in its time
    """
    accel = matrix(imu, "accel")
    try:
        cuts = tuple(t_s for impact in impacts for t_s in (impact.start_s, impact.end_s))
        gyro, hidden_rate = matrix(imu, "gyro"), _hidden_rate(imu)
        gyro = gyro if hidden_rate is None else gyro + 0.5 * hidden_rate
        samples = regular_samples(seconds(imu), gyro, accel, cuts_s=cuts)
    except ValueError as error:
        raise DataError(f"the imu's record is too short: {error}", "give the whole drive") from error
    force = float(np.median(np.sqrt((accel**2).sum(axis=1))))
    if not _FELT[0] < force < _FELT[1]:
        raise DataError(
            f"the accelerometer feels {force:.2g} m/s^2 on average, where gravity is 9.8",
            "is its unit g, or has gravity been taken off?",
        )
    inside = (observed.fixes.t_s >= 0.0) & (observed.fixes.t_s <= samples.t_s[-1])
    if inside.sum() < fewest_fixes:
        raise NotEnoughData(
            "GNSS during the imu's record", needed=f"{fewest_fixes} fixes", found=str(int(inside.sum())),
            hint="do the clocks of imu and gnss agree?",
        )  # fmt: skip
    known = np.isfinite(vector(wheel, "speed", gaps=True)) if has(wheel, "speed") and wheel is not None else None
    none = np.zeros(0)
    if wheel is None or known is None:
        return Drive(samples, observed.fixes, observed.anchor, none, none, impacts=impacts)
    speed = vector(wheel, "speed", gaps=True)[known]
    return Drive(
        samples, observed.fixes, observed.anchor, seconds(wheel, since=start_ns)[known], speed, impacts=impacts
    )


def impacts_of(imu: pa.Table, events: pa.Table | None, error: float, slip_s: float) -> tuple[Impact, ...]:
    """The impacts of a drive, and when it turned faster than the gyroscope tells, for the smoother.

    What clipping may have hidden of an impact counts as missed, at least as much again as was recorded there; of a turn
    half of it counts as turned, and as its sigma.

    imu : accel m/s^2, specific force, gyro rad/s; events : of kinds crash and saturation
    error : share of a change of velocity that the IMU misses, by what no scale error explains; slip_s : s, as in Impact
    """
    if not imu.num_rows:
        return ()
    found = [*_pushes(imu, events, error, slip_s), *_spins(imu, slip_s)]
    return tuple(sorted(found, key=lambda impact: impact.start_s))


def _pushes(imu: pa.Table, events: pa.Table | None, error: float, slip_s: float) -> Iterator[Impact]:
    crashes = spans(events, "crash")
    if not crashes:
        return
    t_ns, accel = time_ns(imu), matrix(imu, "accel")
    mask = clipped(accel, least=_FELT[1]) | saturated(t_ns, accel, events)
    for start_ns, end_ns in crashes:
        rows = slice(*np.searchsorted(t_ns, [start_ns, end_ns + 1]))
        if rows.stop - rows.start < 2:
            continue
        t_s, part = (t_ns[rows] - t_ns[0]) * 1e-9, accel[rows]
        cut = np.stack([hidden(t_s, part[:, axis], mask[rows, axis]) for axis in range(3)], axis=1)
        cut = np.sign(part) * np.maximum(np.abs(cut), np.abs(part) * mask[rows])
        pushed = part - np.median(accel, axis=0)
        change, missed = (float(np.linalg.norm(cumulative(t_s, y, "trapezoid")[-1])) for y in (pushed, cut))
        yield Impact(float(t_s[0]), float(t_s[-1]), error * change + missed, slip_s)


def _spins(imu: pa.Table, slip_s: float) -> Iterator[Impact]:
    """What pushes the vehicle meanwhile is taken to point elsewhere by half of the turn that is not known."""
    hidden_rate = _hidden_rate(imu)
    if hidden_rate is None:
        return
    t_s, accel = seconds(imu), matrix(imu, "accel")
    rows = np.flatnonzero(hidden_rate.any(axis=1))
    for group in np.split(rows, np.flatnonzero(np.diff(t_s[rows]) > _APART_S) + 1):
        part = slice(max(group[0] - 1, 0), group[-1] + 2)
        turned, change = (
            float(np.linalg.norm(cumulative(t_s[part], y[part], "trapezoid")[-1]))
            for y in (0.5 * hidden_rate, accel - np.median(accel, axis=0))
        )
        yield Impact(float(t_s[part][0]), float(t_s[part][-1]), min(0.5 * turned, 1.0) * change, slip_s, turned)


def _hidden_rate(imu: pa.Table) -> Array | None:
    """The most that clipping may hide of the turn rate: (n, 3) rad/s, sensor; None where the gyroscope never clips."""
    t_s, gyro = seconds(imu), matrix(imu, "gyro")
    mask = clipped(gyro, least=_SPINNING)
    if not mask.any():
        return None
    return np.stack([hidden(t_s, gyro[:, axis], mask[:, axis]) for axis in range(3)], axis=1)


def solve(drive: Drive, model: Model, noise: Noise, learn_noise: bool) -> Estimate:
    """The best trajectory. Raises DataError where the log cannot tell it."""
    try:
        return estimate(drive, model, noise, learn_noise)
    except np.linalg.LinAlgError as error:  # a ValueError, too
        raise undetermined() from error
    except ValueError as error:
        hint = "give a log of a drive; of a crash alone 'recon run crash_pulse LOG' tells how severe it was"
        raise DataError(f"there is no motion to find the heading: {error}", hint) from error


def undetermined() -> DataError:
    """What to say of a log whose equations have no solution."""
    return DataError(
        "the log does not determine a trajectory: its equations have no solution",
        "are the units and the clocks of imu and gnss right, and was the box fixed in the vehicle? "
        "'recon doctor' looks for wrong units, axes, signs and clocks",
    )


def mounting_metrics(found: Estimate) -> list[Metric]:
    """The mounting that was found: angles of the box in the vehicle, and the quaternion from sensor to vehicle."""
    rot_vs = found.solved.state.rot_vs
    q_vs = matrix_to_quat(rot_vs[..., None])[:, 0]
    yaw, pitch, roll = (float(np.degrees(a)) for a in to_euler(q_vs))
    spread = found.covariance_common[MOUNT, MOUNT]
    ahead, side, up = (float(np.degrees(np.sqrt(max(c, 0.0)))) for c in np.diag(spread))
    note = "of the box in the vehicle, ISO 8855: yaw, then pitch, then roll"
    rows = [
        Metric("mount_yaw", yaw, "deg", up, note=note),
        Metric("mount_pitch", pitch, "deg", side, note=note),
        Metric("mount_roll", roll, "deg", ahead, note=f"{note}; relative to the mean road"),
    ]
    note = "takes vectors from the sensor to the vehicle"
    return rows + [Metric(f"mount_q{n}", float(v), "1", note=note) for n, v in zip("wxyz", q_vs, strict=True)]
