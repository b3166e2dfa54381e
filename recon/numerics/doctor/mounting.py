"""Did the box stay as it was mounted? By where gravity is felt, ten seconds at a time."""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.doctor.axes import Axes
from recon.numerics.doctor.finding import Finding, Floats, confidence_of, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Imu
from recon.numerics.doctor.motion import Motion

_MOVED_DEG: Final = 10.0
_BLOCK_S: Final = 10.0


def mounting(axes: Axes | None, motion: Motion | None, imu: Imu) -> Finding:
    """Did the box stay as it was mounted? By where gravity is felt before and after."""
    code = "mounting"
    if axes is None:
        return unknown(code, "The accelerometer feels no gravity.")
    t_s, felt = _felt(imu, motion)
    value = _angles(axes)
    if len(t_s) < 6:
        return confirmed(code, value, f"The record is too short to see the box move: {value}.")
    angle, at, spread = _moved(t_s, felt)
    numbers = {"turned_deg": angle, "at_s": at, "usual_deg": spread}
    if angle > max(_MOVED_DEG, 5.0 * spread):
        text = (
            f"Gravity is felt {angle:.0f} deg elsewhere from {at:.0f} s on: the box was moved or its holder slipped. "
            "Cut the log there and take each part by itself."
        )
        return contradicted(code, round(angle, 1), text, confidence_of(angle / max(spread, 0.5)), **numbers)
    where = "" if axes.rot_sv is None else " (roll leans it to the side, pitch dips its nose, yaw turns it to the left)"
    return confirmed(code, value, f"The box stayed as it was mounted: {value}{where}.", **numbers)


def _angles(axes: Axes) -> str:
    if axes.rot_sv is None:
        tilt = float(np.degrees(np.arccos(np.clip(axes.up[2], -1.0, 1.0))))
        return f"z is {tilt:.0f} deg from upright"
    vs = axes.rot_sv.T
    yaw, pitch, roll = (
        np.arctan2(vs[1, 0], vs[0, 0]),
        -np.arcsin(np.clip(vs[2, 0], -1, 1)),
        np.arctan2(vs[2, 1], vs[2, 2]),
    )
    return ", ".join(
        f"{n} {round(float(np.degrees(a)))} deg" for n, a in (("roll", roll), ("pitch", pitch), ("yaw", yaw))
    )


def _felt(imu: Imu, motion: Motion | None) -> tuple[Floats, Floats]:
    """Medians over ten seconds of what is felt beside the motion: times (b,) s, directions (b, 3)."""
    if motion is not None and motion.forward is not None and len(motion.spans.t_s) > 30:
        spans = motion.spans
        across = np.nan_to_num(spans.across)[:, None] * (motion.left.vector if motion.left is not None else 0.0)
        t_s, rest = spans.t_s, spans.accel - spans.ahead[:, None] * motion.forward.vector - across
    else:
        whole = np.isfinite(imu.accel).all(axis=1)
        t_s, rest = imu.t_s[whole], imu.accel[whole]
    if not len(t_s):
        return np.zeros(0), np.zeros((0, 3))
    block = np.floor((t_s - t_s[0]) / _BLOCK_S).astype(int)
    some = [rows for rows in np.split(np.arange(len(t_s)), np.flatnonzero(np.diff(block)) + 1) if len(rows) > 3]
    if not some:
        return np.zeros(0), np.zeros((0, 3))
    middle = np.array([t_s[rows].mean() for rows in some])
    felt = np.array([np.median(rest[rows], axis=0) for rows in some])
    known = np.isfinite(felt).all(axis=1) & (np.linalg.norm(felt, axis=1) > 0.0)
    felt = felt[known]
    return middle[known], felt / np.linalg.norm(felt, axis=1)[:, None]


def _moved(t_s: Floats, felt: Floats) -> tuple[float, float, float]:
    """Largest angle between the medians before and after a time, deg; that time, s; the usual change there, deg."""
    best = (0.0, float(t_s[0]), 0.0)
    for cut in range(2, len(t_s) - 1):
        before, after = np.median(felt[:cut], axis=0), np.median(felt[cut:], axis=0)
        angle = _between(before, after)
        if angle > best[0]:
            spread = max(
                float(np.median(_between(part, whole))) for part, whole in ((felt[:cut], before), (felt[cut:], after))
            )
            best = (float(angle), float(0.5 * (t_s[cut - 1] + t_s[cut])), spread)
    return best


def _between(a: Floats, b: Floats) -> Floats:
    """Angles in deg between directions (..., 3)."""
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(np.degrees(np.arctan2(sine, (a * b).sum(axis=-1))))
