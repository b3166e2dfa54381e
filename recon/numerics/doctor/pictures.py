"""The evidence over time, for those findings that a picture shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import Curve, Finding, Floats, Picture
from recon.numerics.doctor.log import Imu
from recon.numerics.doctor.motion import Motion
from recon.numerics.geodesy import STANDARD_GRAVITY

_MOST: Final = 800
"""Points of a curve."""


def picture_of(one: Finding, imu: Imu, motion: Motion | None) -> Picture | None:
    """What shows the evidence of a finding; None where a sentence says it all."""
    if one.code in _OF_MOTION and motion is not None:
        picture = _OF_MOTION[one.code](one, motion)
        if picture is not None:
            return picture
    if one.code in ("gaps", "jitter"):
        return _steps(imu)
    return _raw(one, imu) if one.code in _OF_SAMPLES else None


def _ahead(one: Finding, motion: Motion) -> Picture | None:
    if motion.forward is None or motion.up is None:
        return None
    spans, gravity = motion.spans, motion.up.length / STANDARD_GRAVITY
    felt = (spans.accel - np.median(spans.accel, axis=0)) @ motion.forward.unit / gravity
    x = (spans.accel - np.median(spans.accel, axis=0))[:, 0] / gravity
    curves = (
        Curve("change of the speed of GNSS", spans.t_s, spans.ahead),
        Curve("felt along what was found to be forward", spans.t_s, felt),
        Curve("felt along x", spans.t_s, x),
    )
    return Picture("Speeding up and braking", "m/s^2", _thinned(curves))


def _late(one: Finding, motion: Motion) -> Picture | None:
    if motion.forward is None or motion.up is None or not motion.forward.told or not isinstance(one.value, float):
        return None
    spans = motion.spans
    felt = (spans.accel - np.median(spans.accel, axis=0)) @ motion.forward.unit
    curves = (
        Curve("change of the speed of GNSS, as stamped", spans.t_s + one.value, spans.ahead),
        Curve("felt by the IMU", spans.t_s, felt * STANDARD_GRAVITY / motion.up.length),
        Curve(f"change of the speed, {one.value:.2f} s earlier", spans.t_s, spans.ahead),
    )
    return Picture("Speeding up and braking, by the stamps of GNSS and before", "m/s^2", _thinned(curves))


def _turning(one: Finding, motion: Motion) -> Picture | None:
    if motion.up is None:
        return None
    spans = motion.spans
    axis = motion.turn.unit if motion.turn is not None else motion.up.unit
    curves = (
        Curve("turn of the course of GNSS", spans.t_s, np.degrees(spans.turn)),
        Curve("gyroscope, about the vertical", spans.t_s, np.degrees(spans.gyro @ axis)),
    )
    return Picture("Turning", "deg/s", _thinned(curves))


def _across(one: Finding, motion: Motion) -> Picture | None:
    if motion.up is None or motion.forward is None or not np.isfinite(motion.spans.across).any():
        return None
    spans = motion.spans
    left = np.cross(motion.up.unit, motion.forward.unit)
    felt = (spans.accel - np.median(spans.accel, axis=0)) @ left
    curves = (
        Curve("bends by GNSS: speed times turn, to the left", spans.t_s, spans.across),
        Curve("felt where the left side should be", spans.t_s, felt),
    )
    return Picture("Pushed aside in bends", "m/s^2", _thinned(curves))


def _raw(one: Finding, imu: Imu) -> Picture:
    gyro = "gyro" in str(one.value) or any(name.startswith("gyro") for name in one.statistic)
    values, unit = (np.degrees(imu.gyro), "deg/s") if gyro else (imu.accel, "m/s^2")
    curves = tuple(Curve(axis, imu.t_s, column) for axis, column in zip("xyz", values.T, strict=True))
    return Picture("Gyroscope as logged" if gyro else "Accelerometer as logged", unit, _thinned(curves))


def _steps(imu: Imu) -> Picture:
    step = 1e3 * np.diff(imu.t_s)
    return Picture("Time from one row of the IMU to the next", "ms", _thinned((Curve("step", imu.t_s[1:], step),)))


def _thinned(curves: tuple[Curve, ...]) -> tuple[Curve, ...]:
    """Few enough points for a page: of each stretch the lowest and the highest."""
    return tuple(Curve(c.name, *_extremes(c.t_s, c.values), c.points) for c in curves)


def _extremes(t_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    known = np.isfinite(values)
    t_s, values = t_s[known], values[known]
    if len(values) <= _MOST:
        return t_s, values
    edges = np.linspace(0, len(values), _MOST // 2 + 1).astype(int)
    rows = [
        first + part
        for first, stop in pairwise(edges)
        for part in sorted((int(values[first:stop].argmin()), int(values[first:stop].argmax())))
    ]
    return t_s[rows], values[rows]


_OF_MOTION: Final[Mapping[str, Callable[[Finding, Motion], Picture | None]]] = {
    **dict.fromkeys(("speed_unit", "forward_axis", "leap_seconds", "time_zone"), _ahead),
    "gnss_velocity_lag": _late,
    "gyro_unit": _turning,
    **dict.fromkeys(("gravity_sign", "axes", "inverted_axis"), _across),
}
_OF_SAMPLES: Final = ("accel_unit", "gyro_unit", "axes", "mounting", "clipping", "dead_channel", "quantisation")
