"""Do IMU and GNSS tell the same time? Zones, leap seconds, and the lag that is left, by the motion that both see.

The lag of velocities is that of recon.numerics.smoothing.lag, for any mounting. Clocks that are set to another zone, or
that count leap seconds differently, differ by quarters of an hour or by 18, 36, 37 s; a common error of both clocks
shows in nothing that either of them measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import Finding, Floats, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Gnss, Imu
from recon.numerics.doctor.motion import spans_of
from recon.numerics.geodesy import radii_of_curvature
from recon.numerics.signals import wrap_angle
from recon.numerics.smoothing.lag import UNKNOWN, Lag, find_lag
from recon.numerics.smoothing.samples import regular_samples
from recon.numerics.smoothing.stops import Blocks, block_means

LEAPS: Final = (18.0, 36.0, 37.0)
"""s; GPS and UTC since 2017, twice as much, TAI and UTC."""
_BLOCK_S: Final = 0.1
_FEWEST: Final = 8
"""Changes of speed."""
_LEAST_OVERLAP_S: Final = 30.0
_CLEARLY, _AT_ALL = 15.0, 4.0
"""Of the log-likelihood, over none and over no relation."""
_QUARTER_S: Final = 900.0


@dataclass(frozen=True)
class Clocks:
    """shift_s : to take off the stamps of GNSS beforehand (zone, leap seconds); lag : what is left, of velocities."""

    shift_s: float
    lag: Lag
    blocks: Blocks | None

    @property
    def whole_s(self) -> float:
        """All that is to be taken off the stamps of GNSS."""
        return self.shift_s + (self.lag.seconds if np.isfinite(self.lag.sigma) else 0.0)


def clocks_of(imu: Imu, gnss: Gnss) -> Clocks:
    """Where the clocks stand to each other: at one, apart by leap seconds, or by the zones that bring them together.

    Of the shifts at which a lag of less than two seconds stands out the likeliest is taken, another one than none only
    where it is clearly likelier than that, and likelier than no relation: long drives resemble themselves here and
    there.
    """
    blocks = blocks_of(imu)
    if blocks is None:
        return Clocks(0.0, UNKNOWN, None)
    best, best_told = Clocks(0.0, UNKNOWN, blocks), _AT_ALL
    for shift in _shifts(imu, gnss):
        own = gnss.later(-shift)
        if _overlap(imu.t_s, own.t_s) < _LEAST_OVERLAP_S:
            continue
        lag = lag_of(blocks, own)
        if not np.isfinite(lag.sigma):
            continue
        told = _told(imu, own, lag.seconds) + (_CLEARLY if shift == 0.0 else 0.0)
        if told >= best_told:
            best, best_told = (
                Clocks(_nearest(shift, lag), Lag(shift + lag.seconds - _nearest(shift, lag), lag.sigma), blocks),
                told,
            )
    return best


def _shifts(imu: Imu, gnss: Gnss) -> list[float]:
    """s by which the stamps of GNSS may be late."""
    apart = float(np.median(gnss.t_s) - np.median(imu.t_s))
    together = _overlap(imu.t_s, gnss.t_s) > 0.3 * min(np.ptp(imu.t_s), np.ptp(gnss.t_s))
    quarters = [] if together else [_QUARTER_S * (round(apart / _QUARTER_S) + k) for k in (0, -1, 1, -2, 2)]
    leaps = [sign * leap for leap in LEAPS for sign in (1.0, -1.0)] if together or abs(apart) < _QUARTER_S else []
    return list(dict.fromkeys([0.0, *leaps, *quarters]))


def _nearest(shift: float, lag: Lag) -> float:
    """Shifts of 36 and 37 s are nearer to each other than a lag may be: the one that leaves the least."""
    whole = shift + lag.seconds
    same = [sign * leap for leap in LEAPS for sign in (1.0, -1.0)]
    return min(same, key=lambda leap: abs(whole - leap)) if shift in same else shift


def _overlap(a: Floats, b: Floats) -> float:
    return float(min(a[-1], b[-1]) - max(a[0], b[0])) if len(a) and len(b) else 0.0


def blocks_of(imu: Imu) -> Blocks | None:
    """Means of about 0.1 s; None where there is too little."""
    known = np.isfinite(imu.accel).all(axis=1)
    gyro = np.where(np.isfinite(imu.gyro), imu.gyro, 0.0)
    if known.sum() < 50:
        return None
    t_s = imu.t_s[known]
    try:
        samples = regular_samples(t_s, gyro[known], imu.accel[known])
    except ValueError:
        return None
    return block_means(samples, max(1, round(_BLOCK_S / float(np.median(np.diff(t_s))))))


def lag_of(blocks: Blocks, gnss: Gnss, largest_s: float = 2.0) -> Lag:
    """Of the velocities that GNSS tells, or of those that its positions make."""
    speed, course = gnss.over_ground, gnss.direction
    if not np.isfinite(speed).any():
        speed, course = _from_positions(gnss)
    return find_lag(blocks, gnss.t_s, speed, course, largest_s)


def _from_positions(gnss: Gnss) -> tuple[Floats, Floats]:
    """Speed m/s and course rad by the positions before and after: (m,) each, NaN where there is none."""
    east, north = plane(gnss)
    t_s = gnss.t_s
    speed, course = np.full((2, len(t_s)), np.nan)
    if len(t_s) > 2:
        step = t_s[2:] - t_s[:-2]
        along_e, along_n = (east[2:] - east[:-2]) / step, (north[2:] - north[:-2]) / step
        near = step < 5.0
        speed[1:-1] = np.where(near, np.hypot(along_e, along_n), np.nan)
        course[1:-1] = np.where(near, np.arctan2(along_e, along_n), np.nan)
    return speed, course


def plane(gnss: Gnss) -> tuple[Floats, Floats]:
    """Positions in m east of the first and north of the median: (m,) each, NaN where there is none."""
    known = np.isfinite(gnss.lat + gnss.lon) & ((gnss.lat != 0.0) | (gnss.lon != 0.0))
    if not known.any():
        return np.full(len(gnss.lat), np.nan), np.full(len(gnss.lat), np.nan)
    lat, lon = np.where(known, gnss.lat, np.nan), np.where(known, gnss.lon, np.nan)
    lat_0, lon_0 = float(np.nanmedian(lat)), lon[known][0]
    meridian, normal = radii_of_curvature(lat_0)
    east = normal * np.cos(np.radians(lat_0)) * wrap_angle(np.radians(lon - lon_0))
    return east, meridian * np.radians(lat - lat_0)


def _told(imu: Imu, gnss: Gnss, lag_s: float) -> float:
    """Log-likelihood of a lag over no relation, by the changes of speed that the accelerometer explains."""
    left, independent = unexplained(imu, gnss, lag_s)
    return float(-0.5 * independent * np.log(left))


def unexplained(imu: Imu, gnss: Gnss, lag_s: float) -> tuple[float, float]:
    """Share of the variance of changes of speed that is left, and how many of them are independent (as of AR(1))."""
    spans = spans_of(imu, gnss, lag_s)
    known = (spans.speed > 0.5) & np.isfinite(spans.accel).all(axis=1)
    if known.sum() < _FEWEST:
        return 1.0, 0.0
    causes = np.column_stack([spans.accel[known], np.ones(known.sum())])
    y = spans.ahead[known]
    rest = y - causes @ np.linalg.lstsq(causes, y, rcond=None)[0]
    whole, left = float(((y - y.mean()) ** 2).sum()), float(rest @ rest)
    alike = float(np.clip(rest[1:] @ rest[:-1] / max(left, 1e-12), 0.0, 0.95))
    return float(np.clip(left / max(whole, 1e-12), 1e-6, 1.0)), float(known.sum() * (1.0 - alike) / (1.0 + alike))


def leap_seconds(clocks: Clocks) -> Finding:
    """Does one of the clocks count leap seconds and the other not?"""
    code = "leap_seconds"
    if not np.isfinite(clocks.lag.sigma):
        return unknown(
            code, "The motion does not bring IMU and GNSS together, so that their clocks cannot be compared."
        )
    near = min(LEAPS, key=lambda leap: abs(abs(clocks.shift_s) - leap))
    if abs(abs(clocks.shift_s) - near) < 1.0:
        why = {
            18.0: "GPS time counts no leap seconds, UTC does",
            36.0: "leap seconds were put on twice",
            37.0: "atomic time (TAI) is ahead of UTC",
        }[near]
        side = "late" if clocks.shift_s > 0 else "early"
        text = f"The stamps of GNSS are {near:.0f} s {side} against the IMU: {why}."
        return contradicted(code, float(np.sign(clocks.shift_s) * near), text, shift_s=clocks.shift_s)
    text = "The clocks of IMU and GNSS differ by no leap seconds. (An error that both share shows in no motion.)"
    return confirmed(code, 0.0, text, shift_s=clocks.shift_s)


def time_zone(clocks: Clocks, imu: Imu, gnss: Gnss) -> Finding:
    """Are the clocks set to the same zone?"""
    code = "time_zone"
    hours = round(clocks.shift_s / _QUARTER_S) * 0.25
    if abs(clocks.shift_s) >= _QUARTER_S and np.isfinite(clocks.lag.sigma):
        text = (
            f"The clock of GNSS is {hours:+g} h off that of the IMU: one of them tells local time. With that set "
            "right, their motions agree."
        )
        return contradicted(code, hours, text, shift_s=clocks.shift_s)
    overlap = _overlap(imu.t_s, gnss.t_s)
    if overlap > 0.0:
        text = (
            "IMU and GNSS were recorded at the same time by their stamps: no zone between them. (An error that both "
            "share shows in no motion.)"
        )
        return confirmed(code, 0.0, text, overlap_s=overlap)
    text = (
        "IMU and GNSS have no time in common, and no shift by quarters of an hour brings their motions together: are "
        "they of the same drive?"
    )
    return unknown(code, text, overlap_s=overlap)
