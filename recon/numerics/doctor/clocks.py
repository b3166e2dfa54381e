"""Do IMU and GNSS tell the same time? How late positions and velocities are, and whether clocks drift, jump or are set
to another zone.

The lag of velocities is that of recon.numerics.smoothing.lag, for any mounting; sought again in pieces of the log it
tells how the clocks run against each other. Positions p lag behind velocities v of the same receiver by d where

    p(t2) - p(t1) = integral of v + (v(t1) - v(t2)) d

which is solved for d by least squares over spans of a few seconds. Clocks that are set to another zone, or that count
leap seconds differently, differ by quarters of an hour or by 18, 36, 37 s; a common error of both clocks shows in
nothing that either of them measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import (
    Curve,
    Finding,
    Floats,
    Picture,
    confidence_of,
    confirmed,
    contradicted,
    unknown,
)
from recon.numerics.doctor.log import Gnss, Imu
from recon.numerics.doctor.motion import spans_of
from recon.numerics.smoothing.lag import UNKNOWN, Lag, find_lag
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.samples import Samples
from recon.numerics.smoothing.stops import Blocks, block_means

LEAPS: Final = (18.0, 36.0, 37.0)
"""s; GPS and UTC since 2017, twice as much, TAI and UTC."""
JUMP: Final = "jump"
_BLOCK_S: Final = 0.1
_SURE: Final = 3.0
"""Standard deviations from zero."""
_NOTICED_S: Final = 0.1
"""A lag below does no harm: fuser.map finds it."""
_FEWEST: Final = 8
"""Changes of speed."""
_LEAST_OVERLAP_S: Final = 30.0
_CLEARLY: Final = 15.0
"""Of the log-likelihood."""
_QUARTER_S: Final = 900.0
_PIECE_S: Final = 120.0
_SPAN_S, _NEAR_S = 4.0, 8.0
_DRIFT: Final = 0.15
"""s over the whole log, from which a drift is told."""
_WORDS: Final = "each GNSS value belongs to a time {0:.2f} s before the one that stands beside it"


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
    where it is so clearly: long drives resemble themselves here and there.
    """
    blocks = blocks_of(imu)
    if blocks is None:
        return Clocks(0.0, UNKNOWN, None)
    best, best_told = Clocks(0.0, UNKNOWN, blocks), -np.inf
    for shift in _shifts(imu, gnss):
        own = gnss.later(-shift)
        if _overlap(imu.t_s, own.t_s) < _LEAST_OVERLAP_S:
            continue
        lag = _lag(blocks, own)
        if not np.isfinite(lag.sigma):
            continue
        told = _told(imu, own, lag.seconds) + (_CLEARLY if shift == 0.0 else 0.0)
        if told > best_told:
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
    from recon.numerics.smoothing.samples import regular_samples

    try:
        samples: Samples = regular_samples(t_s, gyro[known], imu.accel[known])
    except ValueError:
        return None
    return block_means(samples, max(1, round(_BLOCK_S / float(np.median(np.diff(t_s))))))


def _lag(blocks: Blocks, gnss: Gnss, largest_s: float = 2.0) -> Lag:
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
    """Positions in m east and north of the median: (m,) each, NaN where there is none."""
    known = np.isfinite(gnss.lat + gnss.lon) & ((gnss.lat != 0.0) | (gnss.lon != 0.0))
    if not known.any():
        return np.full(len(gnss.lat), np.nan), np.full(len(gnss.lat), np.nan)
    lat, lon = np.where(known, gnss.lat, np.nan), np.where(known, gnss.lon, np.nan)
    lat_0, lon_0 = float(np.nanmedian(lat)), float(np.nanmedian(lon))
    sine = np.sin(np.radians(lat_0)) ** 2
    meridian, normal = 6_335_439.0 * (1.0 - 0.00669438 * sine) ** -1.5, 6_378_137.0 * (1.0 - 0.00669438 * sine) ** -0.5
    east = normal * np.cos(np.radians(lat_0)) * np.radians(lon - lon_0)
    return east, meridian * np.radians(lat - lat_0)


def velocity_lag(clocks: Clocks, imu: Imu, gnss: Gnss) -> Finding:
    """How late the speeds and courses of GNSS are.

    Few changes of speed make the sigma of a lag large although it is plain that it is not zero: then the likelihood of
    both tells, that of how much of the changes of speed the accelerometer explains.
    """
    code, lag = "gnss_velocity_lag", clocks.lag
    if not np.isfinite(gnss.over_ground).any():
        return unknown(code, "GNSS tells no velocities.")
    if not np.isfinite(lag.sigma):
        return unknown(code, "No time between -2 and 2 s brings the changes of speed and course together with the IMU.")
    numbers = {"lag_s": lag.seconds, "sigma_s": lag.sigma}
    value, size = round(lag.seconds, 3), abs(lag.seconds)
    deviations = size / lag.sigma
    if _NOTICED_S < size < _SURE * lag.sigma:
        own = gnss.later(-clocks.shift_s)
        deviations = numbers["deviations"] = max(deviations, _apart(imu, own, lag.seconds))
    if size < _NOTICED_S or deviations < _SURE:
        text = f"Speeds and courses are on time (late by {lag.seconds:.2f} s, give or take {lag.sigma:.2f} s)."
        return confirmed(code, value, text, **numbers)
    when = (
        _WORDS.format(lag.seconds)
        if lag.seconds > 0
        else f"they come {-lag.seconds:.2f} s early, which points to a clock that is wrong"
    )
    text = f"GNSS speeds are late: {when}." if lag.seconds > 0 else f"GNSS speeds are early: {when}."
    return contradicted(code, value, text, confidence_of(deviations), **numbers)


def _told(imu: Imu, gnss: Gnss, lag_s: float) -> float:
    """Log-likelihood of a lag over no relation, by the changes of speed that the accelerometer explains."""
    left, independent = _unexplained(imu, gnss, lag_s)
    return float(-0.5 * independent * np.log(left))


def _apart(imu: Imu, gnss: Gnss, lag_s: float) -> float:
    """Standard deviations that a lag is from none: root of twice the difference of their log-likelihoods."""
    (at_lag, independent), (at_none, _) = (_unexplained(imu, gnss, lag) for lag in (lag_s, 0.0))
    return float(np.sqrt(max(independent * np.log(at_none / at_lag), 0.0)))


def _unexplained(imu: Imu, gnss: Gnss, lag_s: float) -> tuple[float, float]:
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


def position_lag(clocks: Clocks, gnss: Gnss) -> Finding:
    """How late the positions of GNSS are."""
    code = "gnss_position_lag"
    if not np.isfinite(gnss.lat).any():
        return unknown(code, "GNSS tells no positions.")
    if np.isfinite(gnss.over_ground).any():
        behind = _behind(gnss)
        if behind is None or not np.isfinite(clocks.lag.sigma):
            return unknown(code, "Too little driving to compare positions with speeds, or speeds with the IMU.")
        lag = Lag(clocks.lag.seconds + behind.seconds, float(np.hypot(clocks.lag.sigma, behind.sigma)))
    else:
        lag = clocks.lag
    if not np.isfinite(lag.sigma) or lag.sigma > 0.3:
        return unknown(code, "The positions are too noisy, or there are too few bends, to tell how late they are.")
    numbers = {"lag_s": lag.seconds, "sigma_s": lag.sigma}
    value = round(lag.seconds, 3)
    if abs(lag.seconds) < max(_NOTICED_S, 4.0 * lag.sigma):
        text = f"Positions are on time (late by {lag.seconds:.2f} s, give or take {lag.sigma:.2f} s)."
        return confirmed(code, value, text, **numbers)
    if lag.seconds > 0:
        text = f"GNSS positions are late: {_WORDS.format(lag.seconds)}; at 50 km/h that is {13.9 * lag.seconds:.0f} m."
    else:
        text = f"GNSS positions are {-lag.seconds:.2f} s early, which points to a clock that is wrong."
    return contradicted(code, value, text, confidence_of(lag.seconds / lag.sigma), **numbers)


def _behind(gnss: Gnss) -> Lag | None:
    """How much later positions are than the velocities of the same fixes; None where it cannot be told."""
    east, north = plane(gnss)
    speed, course = gnss.over_ground, gnss.direction
    course = np.where((speed < 1.0) & np.isnan(course), 0.0, course)
    rows = np.flatnonzero(np.isfinite(east + speed + course))
    if len(rows) < 20:
        return None
    t_s = gnss.t_s[rows]
    vel = np.column_stack([speed[rows] * np.sin(course[rows]), speed[rows] * np.cos(course[rows])])
    way = np.concatenate((np.zeros((1, 2)), np.cumsum(0.5 * (vel[1:] + vel[:-1]) * np.diff(t_s)[:, None], axis=0)))
    place = np.column_stack([east[rows], north[rows]])
    after = np.searchsorted(t_s, t_s + _SPAN_S)
    first = np.flatnonzero(after < len(rows))
    last = after[first]
    near = t_s[last] - t_s[first] < _NEAR_S
    first, last = first[near], last[near]
    if len(first) < 20:
        return None
    miss = (place[last] - place[first]) - (way[last] - way[first])
    change = vel[first] - vel[last]
    return _slope(change, miss, t_s[first])


def _slope(x: Floats, y: Floats, t_s: Floats) -> Lag | None:
    """The factor of x (s, 2) in y (s, 2), robust, with a variance by clusters of twenty seconds."""
    weight = np.ones(len(x))
    for _ in range(4):
        information = float((weight[:, None] * x**2).sum())
        if information < 20.0:
            return None
        slope = float((weight[:, None] * x * y).sum()) / information
        squared = ((y - slope * x) ** 2).sum(axis=1)
        weight = cauchy_weights(squared / max(float(np.median(squared)), 1e-6), 6.0)
    score = (weight[:, None] * x * (y - slope * x)).sum(axis=1)
    cluster = np.floor((t_s - t_s[0]) / 20.0).astype(int)
    bend = np.bincount(cluster, (weight[:, None] * x**2).sum(axis=1))
    without = np.maximum(information - bend, 0.1 * information)
    return Lag(slope, float(np.sqrt(((np.bincount(cluster, score) / without) ** 2).sum() + 0.01**2)))


def drift(clocks: Clocks, gnss: Gnss) -> Finding:
    """Do the clocks run equally fast, without a jump?"""
    code = "clock_drift"
    if clocks.blocks is None:
        return unknown(code, "There is no IMU to compare with GNSS.")
    own = gnss.later(-clocks.shift_s)
    t_s, lag_s, sigma_s = _pieces(clocks.blocks, own)
    if len(t_s) < 3:
        return unknown(code, "The log is too short, or holds too little driving, to see the clocks drift apart.")
    picture = Picture(
        "How late GNSS is, piece by piece", "s", (Curve("found in a piece of the log", t_s, lag_s, points=True),)
    )
    at, step, left_step = _jump(t_s, lag_s, sigma_s)
    rate, sigma, left_line = _line(t_s, lag_s, sigma_s)
    numbers = {"drift_ppm": 1e6 * rate, "sigma_ppm": 1e6 * sigma, "jump_s": step, "jump_at_s": at}
    if abs(step) > 0.4 and left_step < 0.6 * left_line:
        text = (
            f"One of the clocks jumps by {abs(step):.2f} s near {at:.0f} s: GNSS and IMU belong together before or "
            "after, "
            "not both. Cut the log there, or set the later stamps right."
        )
        return contradicted(code, JUMP, text, **numbers).shown_by(picture)
    if abs(rate) > 4.0 * sigma and abs(rate) * np.ptp(t_s) > _DRIFT:
        text = (
            f"The clocks of GNSS and IMU run apart by {1e3 * abs(rate) * 60:.1f} ms a minute ({1e6 * rate:+.0f} "
            "parts in a "
            f"million), {abs(rate) * np.ptp(t_s):.2f} s over this log."
        )
        return contradicted(code, round(1e6 * rate, 1), text, confidence_of(rate / sigma), **numbers).shown_by(picture)
    text = (
        f"The clocks of GNSS and IMU keep step: {1e6 * rate:+.0f} parts in a million, give or take {1e6 * sigma:.0f}."
    )
    return confirmed(code, round(1e6 * rate, 1), text, **numbers)


def _pieces(blocks: Blocks, gnss: Gnss) -> tuple[Floats, Floats, Floats]:
    """The lag in pieces that overlap by half: middle s, lag s, sigma s."""
    length = max(_PIECE_S, (blocks.t_s[-1] - blocks.t_s[0]) / 8.0)
    found = []
    for start in np.arange(blocks.t_s[0], blocks.t_s[-1] - 0.9 * length, 0.5 * length):
        inside = (blocks.t_s >= start) & (blocks.t_s < start + length)
        some = (gnss.t_s > start - 5.0) & (gnss.t_s < start + length + 5.0)
        if inside.sum() < 100 or some.sum() < 20:
            continue
        rows = slice(int(inside.argmax()), int(inside.argmax() + inside.sum()))
        piece = Blocks(
            blocks.size,
            blocks.t_s[rows],
            blocks.gyro[:, rows],
            blocks.accel[:, rows],
            blocks.vibration[rows],
            blocks.measured[rows],
        )
        lag = _lag(piece, gnss.some(some), 4.0)
        if np.isfinite(lag.sigma):
            found.append((start + 0.5 * length, lag.seconds, float(np.hypot(lag.sigma, 0.02))))
    return tuple(np.array(found).reshape(-1, 3).T)  # type: ignore[return-value]


def _line(t_s: Floats, lag_s: Floats, sigma_s: Floats) -> tuple[float, float, float]:
    """Slope, its sigma (pieces overlap: two count as one), and the weighted sum of squares that is left."""
    weight = sigma_s**-2
    centre = weight @ t_s / weight.sum()
    x = t_s - centre
    information = float(weight @ x**2)
    slope = float(weight @ (x * lag_s)) / max(information, 1e-12)
    rest = lag_s - weight @ lag_s / weight.sum() - slope * x
    left = float(weight @ rest**2)
    scale = max(1.0, left / max(len(t_s) - 2, 1))
    return slope, float(np.sqrt(2.0 * scale / max(information, 1e-12))), left


def _jump(t_s: Floats, lag_s: Floats, sigma_s: Floats) -> tuple[float, float, float]:
    """Best time of one step with two pieces on either side, its height, and the weighted squares that are left."""
    weight, best = sigma_s**-2, (0.0, 0.0, np.inf)
    for cut in range(2, len(t_s) - 1):
        parts = [(slice(None, cut)), (slice(cut, None))]
        means = [weight[p] @ lag_s[p] / weight[p].sum() for p in parts]
        left = sum(float(weight[p] @ (lag_s[p] - m) ** 2) for p, m in zip(parts, means, strict=True))
        if left < best[2]:
            best = (float(0.5 * (t_s[cut - 1] + t_s[cut])), float(means[1] - means[0]), left)
    return best


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
