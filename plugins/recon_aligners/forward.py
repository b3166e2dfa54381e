"""Turns the level box about the vertical so that x points forward.

On straight road the horizontal acceleration lies along x. Over a window of about a second the mean acceleration a
(two components) and, where GNSS gives the speed, the mean rate of speed y are compared:

    forward = direction of cov(a, y),    largest over the lag of GNSS

The regression is of a on y and not the reverse, for on straight road the lateral acceleration hardly varies and its
coefficient would be undetermined. What leans the road or bends it pulls the direction aside for many windows in a row;
the sigma takes that of half a minute for one. Without GNSS forward is the principal axis of a, signed by the assumption
that the first motion after a stop is forward.

References
    Thesis, section 4.5 (horizontal alignment) and 5.2 (first motion is forward).
    Liang, Zeger (1986), "Longitudinal data analysis using generalized linear models", Biometrika 73(1) (sandwich).
    Bell, McCaffrey (2002), "Bias reduction in standard errors for linear regression with multi-stage samples", Survey
    Methodology 28(2), section 3 (jackknife).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from recon import (
    EVENTS,
    GNSS,
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
    setting,
    time_ns,
    vector,
)
from recon.errors import NotEnoughData
from recon.numerics.integration import cumulative
from recon.numerics.rotation import Floats, from_euler, rotate
from recon.numerics.signals import interpolate, wrap_angle
from recon.placing import rows_during
from recon_aligners._over_ground import speed_of

OF_LEVELLED = "about the vertical, of the box after it was levelled: with its tilt no triple of Euler angles"
STEP_S = 0.1
"""Distance between windows."""
LAGS_S = np.arange(0.0, 1.21, 0.05)
MAX_GAP_S = 2.0
"""Speeds further apart are not joined."""
MAX_SILENCE_S = 0.5
"""No window holds a longer gap of imu."""
FEWEST_WINDOWS = 3
"""From which a direction is found."""
_TOO_SLOW = (
    "so few tell no motion, whatever the yaw of the box: log imu at 10 Hz or more, or take the pipeline 'gnss', "
    "which needs none"
)
LASTING_S = 30.0
"""Roads lean and bend for less."""
LAUNCH_S = (-1.0, 3.0)
"""Span about the end of a stop in which the vehicle sets off; detectors fed by a late GNSS tell the end late."""


class ForwardParams(Params):
    """Parameters of aligner.forward."""

    angle: float | None = quantity(
        None,
        "deg",
        ge=-360,
        le=360,
        doc="Yaw of the box in the vehicle, positive to the left; none finds it from the drive.",
    )
    window: float = quantity(1.0, "s", gt=0, le=60, doc="Time over which accelerations are averaged.")
    straight: float = quantity(2.0, "deg/s", gt=0, le=360, doc="Road is straight where the yaw rate stays below this.")
    acceleration: float = quantity(0.5, "m/s^2", gt=0, le=100, doc="Smallest change of speed that tells a direction.")
    duration: float = quantity(3.0, "s", gt=0, le=3600, doc="How long the vehicle must so change its speed in all.")
    correlation: float = setting(0.7, gt=0, lt=1, doc="Smallest correlation of acceleration with the change of speed.")


class Windows(NamedTuple):
    """Means over windows of equal length, STEP_S apart, on straight road.

    middle_s : (m,) s since the first record of imu
    accel_l : (m, 2) m/s^2, level, horizontal
    """

    middle_s: Floats
    accel_l: Floats


class Direction(NamedTuple):
    """Where forward is in the level frame: angle and sigma in rad; `learnt` are further rows for the user."""

    angle: float
    sigma: float
    correlation: float
    samples: int
    method: str
    learnt: tuple[Metric, ...] = ()


def forward(*, imu: pa.Table, gnss: pa.Table | None, events: pa.Table | None, params: ForwardParams) -> Streams:
    """Turn accel and gyro about z so that x is forward.

    Raises NotEnoughData where the drive does not tell: too few accelerations on straight road, or neither GNSS speed
    nor a stop to give the sign.
    """
    if params.angle is not None:
        mount_yaw, learnt = params.angle, [Metric("mount_yaw", float(np.degrees(params.angle)), "deg", method="given")]
    else:
        found = _find(imu, gnss, events, params)
        mount_yaw, learnt = float(wrap_angle(-found.angle)), _metrics(found)
    q_vl = from_euler(mount_yaw, 0.0, 0.0)
    turned = {group: rotate(q_vl, matrix(imu, group)) for group in ("accel", "gyro")}
    return {"imu": replace(imu, **turned), "metrics": metrics(learnt)}


def _metrics(found: Direction) -> list[Metric]:
    yaw, sigma = np.degrees(wrap_angle(-found.angle)), np.degrees(found.sigma)
    return [
        Metric("mount_yaw", float(yaw), "deg", sigma=float(sigma), method=found.method, note=OF_LEVELLED),
        Metric("correlation", found.correlation, "1", method=found.method),
        Metric("samples", float(found.samples), "1", note=f"windows {STEP_S:g} s apart on straight road"),
        *found.learnt,
    ]


def _find(imu: pa.Table, gnss: pa.Table | None, events: pa.Table | None, params: ForwardParams) -> Direction:
    """Forward by GNSS speed where there is one, else by the principal axis; raises NotEnoughData."""
    windows = _straight_windows(imu, params)
    speed = speed_of(gnss)
    if gnss is not None and speed is not None:
        found, along = _by_speed(windows, seconds(gnss, since=_first_ns(imu)), speed, params)
    else:
        found, along = _by_principal_axis(windows, imu, events, params)
    told_s = STEP_S * int(np.count_nonzero(np.abs(along) >= params.acceleration))
    if told_s < params.duration:
        raise _not_enough("acceleration on straight road", f"{params.duration:g} s", f"{told_s:.1f} s")
    if found.correlation < params.correlation:
        raise _not_enough(
            f"agreement on a forward axis ({found.method})", f"{params.correlation:g}", f"{found.correlation:.2f}"
        )
    return found


def _not_enough(what: str, needed: str, found: str) -> NotEnoughData:
    hint = "give the yaw of the box in the vehicle by the parameter angle, for example '180 deg'"
    return NotEnoughData(what, needed=needed, found=found, hint=hint)


def _first_ns(imu: pa.Table) -> int:
    return int(time_ns(imu.slice(0, 1))[0])


def _straight_windows(imu: pa.Table, params: ForwardParams) -> Windows:
    """Raises NotEnoughData where imu is shorter than a window, its rows are too far apart or hardly any is straight."""
    t_s = seconds(imu)
    span = float(t_s[-1]) if len(t_s) else 0.0
    if span <= params.window:
        raise _not_enough("time in imu", f"{params.window:g} s", f"{span:g} s in {len(t_s)} rows")
    middle_s = _middles(t_s, params.window)
    if not len(middle_s):
        needed = f"rows at most {MAX_SILENCE_S:g} s apart for {params.window:g} s"
        found = f"rows {np.median(np.diff(t_s)):.3g} s apart"
        raise NotEnoughData("samples of imu", needed=needed, found=found, hint=_TOO_SLOW)
    accel_l = _means(t_s, matrix(imu, "accel")[:, :2], middle_s, params.window)
    yaw_rate = _means(t_s, vector(imu, "gyro_z")[:, None], middle_s, params.window)[:, 0]
    straight = np.abs(yaw_rate) < params.straight
    if np.count_nonzero(straight) < FEWEST_WINDOWS:
        raise _not_enough("straight road", f"{params.duration:g} s", f"{STEP_S * np.count_nonzero(straight):.1f} s")
    return Windows(middle_s[straight], accel_l[straight])


def _middles(t_s: Floats, window: float) -> Floats:
    """Middles (m,) s of the windows, STEP_S apart, that fit between the gaps of t_s (n,) s."""
    gaps = np.flatnonzero(np.diff(t_s) > MAX_SILENCE_S)
    starts, ends = t_s[np.append(0, gaps + 1)], t_s[np.append(gaps, len(t_s) - 1)]
    half = window / 2.0
    return np.concatenate([np.arange(a + half, b - half, STEP_S) for a, b in zip(starts, ends, strict=True)])


def _means(t_s: Floats, y: Floats, middle_s: Floats, window: float) -> Floats:
    """Mean of y (n, k) over each window: (m, k)."""
    area = cumulative(t_s, y, "trapezoid")
    later, earlier = (interpolate(middle_s + side * window / 2.0, t_s, area) for side in (1.0, -1.0))
    return (later - earlier) / window


def _by_speed(windows: Windows, fix_s: Floats, speed: Floats, params: ForwardParams) -> tuple[Direction, Floats]:
    """Direction in which the acceleration follows the rate of speed, and that rate at the best lag."""
    best, best_rate = None, np.zeros(0)
    for lag in LAGS_S:
        ends_s = np.add.outer([params.window / 2.0, -params.window / 2.0], windows.middle_s + lag)
        later, earlier = interpolate(ends_s.ravel(), fix_s, speed, MAX_GAP_S).reshape(ends_s.shape)
        rate = (later - earlier) / params.window
        known = np.isfinite(rate)
        found = _regress(Windows(*(part[known] for part in windows)), rate[known], params.window, float(lag))
        if found is not None and (best is None or found.correlation > best.correlation):
            best, best_rate = found, rate[known]
    if best is None:
        raise _no_speeds(windows, fix_s, speed)
    return best, best_rate


def _no_speeds(windows: Windows, fix_s: Floats, speed: Floats) -> NotEnoughData:
    """Why there is nothing to regress on: GNSS at other times, hardly a speed, or always the same one."""
    known = speed[np.isfinite(speed)]
    if len(known) and np.ptp(known) == 0.0:
        return _not_enough("changes of gnss speed", "a drive", f"{known[0] * 3.6:g} km/h throughout")
    until = windows.middle_s.max()
    span = f" from {fix_s[0]:.0f} to {fix_s[-1]:.0f} s" if len(fix_s) else ""
    return _not_enough("gnss speeds while imu runs", f"{FEWEST_WINDOWS} from 0 to {until:.0f} s", f"{len(known)}{span}")


def _regress(windows: Windows, rate: Floats, window: float, lag: float) -> Direction | None:
    """Direction of cov(accel, rate); None where there is nothing to compare. rate : (m,) m/s^2"""
    if len(rate) < FEWEST_WINDOWS or np.ptp(rate) == 0.0:
        return None
    accel_l, rate = windows.accel_l - windows.accel_l.mean(axis=0), rate - rate.mean()
    covariance = accel_l.T @ rate / len(rate)
    angle = float(np.arctan2(covariance[1], covariance[0]))
    along, across = _split(accel_l, angle)
    strength = float(np.hypot(*covariance))
    if not strength:
        return None
    least = across.std() * rate.std() / strength / np.sqrt(_independent(len(rate), window))
    sigma = max(float(least), _lasting(windows.middle_s, across * rate, along * rate))
    learnt = (
        Metric("gnss_speed_lag", lag, "s", method="best correlation"),
        Metric("accel_per_speed_rate", strength / float(rate.var()), "1", note="1 where units and lag are right"),
    )
    correlation = strength / float(along.std() * rate.std())
    return Direction(angle, sigma, correlation, len(rate), "regression on GNSS speed", learnt)


def _by_principal_axis(
    windows: Windows, imu: pa.Table, events: pa.Table | None, params: ForwardParams
) -> tuple[Direction, Floats]:
    """Principal axis of the horizontal acceleration with the sign of the launches, and the acceleration along it."""
    accel_l = windows.accel_l - windows.accel_l.mean(axis=0)
    (minor, major), axes = np.linalg.eigh(accel_l.T @ accel_l / len(accel_l))
    angle = float(np.arctan2(axes[1, 1], axes[0, 1]))
    if _launch(imu, events, angle) < 0.0:
        angle += np.pi
    along, across = _split(accel_l, angle)
    sigma, linearity = np.pi, 0.0
    if major > minor:
        least = np.sqrt(max(minor, 0.0) / major / _independent(len(along), params.window))
        sigma = max(float(least), _lasting(windows.middle_s, along * across, along**2 - across**2))
        linearity = float((major - minor) / (major + minor))
    return Direction(angle, sigma, linearity, len(along), "principal axis"), along


def _launch(imu: pa.Table, events: pa.Table | None, angle: float) -> float:
    """Change of speed along a direction when the vehicle sets off, summed over the stops: m/s.

    The mean over the stop is taken off, so that neither bias nor slope counts. Raises NotEnoughData without a stop.
    """
    stops = rows_during(imu, events, "standstill")
    if not len(stops):
        raise _not_enough("stops", "one standstill, for the sign of forward", "none")
    t_s, along = seconds(imu), _split(matrix(imu, "accel")[:, :2], angle)[0]
    gained = cumulative(t_s, along, "trapezoid")
    at_rest = np.array([along[start:stop].mean() for start, stop in stops])
    begin, end = (np.clip(t_s[stops[:, 1] - 1] + side, 0.0, t_s[-1]) for side in LAUNCH_S)
    return float(np.sum(interpolate(end, t_s, gained) - interpolate(begin, t_s, gained) - at_rest * (end - begin)))


def _split(accel_l: Floats, angle: float) -> tuple[Floats, Floats]:
    """Components (m,) along a direction and to its left."""
    cos, sin = np.cos(angle), np.sin(angle)
    return accel_l @ [cos, sin], accel_l @ [-sin, cos]


def _lasting(middle_s: Floats, pulls: Floats, holds: Floats) -> float:
    """Sigma of a direction, rad, where neighbouring windows pull it aside alike: so half a minute counts as one.

    Each half minute is seen by a direction found without it (sandwich estimate with jackknife).

    middle_s : (m,) s, rising; pulls : (m,) across it, whose sum is zero; holds : (m,) along it, per rad
    """
    starts = np.flatnonzero(np.diff(np.floor(middle_s / LASTING_S), prepend=-np.inf))
    pulled, held = (np.add.reduceat(values, starts) for values in (pulls, holds))
    total = held.sum()
    if len(starts) < 2 or np.any(held >= total):
        return 0.0
    return float(np.sqrt(np.sum((pulled / (total - held)) ** 2)))


def _independent(samples: int, window: float) -> float:
    """Number of windows that do not overlap."""
    return max(1.0, samples * min(STEP_S / window, 1.0))


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.forward."""
    yield Aligner(
        name="forward",
        summary="Turns the level imu about z so that x is forward, by GNSS speed or the principal axis.",
        version=2,
        params=ForwardParams,
        reads={
            "imu": IMU.need("accel", "gyro", frame="level", quantity={"accel": "specific_force"}),
            "gnss": GNSS.need(maybe=["speed", "vel"], optional=True),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
        },
        writes={"imu": Change(frames={"accel": "vehicle", "gyro": "vehicle"})},
        run=forward,
        rotation=True,
        references=("Thesis, sections 4.5 and 5.2",),
    )
