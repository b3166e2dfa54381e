"""How late velocities and positions of GNSS are against the IMU.

Positions p lag behind velocities v of the same receiver by d where

    p(t2) - p(t1) = integral of v + (v(t1) - v(t2)) d

which is solved for d by least squares over spans of a few seconds.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from recon.numerics.doctor.clocks import Clocks, plane, unexplained
from recon.numerics.doctor.finding import Finding, Floats, confidence_of, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Gnss, Imu, pairs
from recon.numerics.smoothing.lag import Lag
from recon.numerics.smoothing.robust import cauchy_weights

_SURE: Final = 3.0
"""Standard deviations from zero."""
_SURE_OF_POSITIONS: Final = 4.0
"""The same of positions, whose slow errors look like a lag."""
_LIKELY: Final = 2.0
"""Standard deviations from which a lag is not called none either."""
_ON_TIME: Final = "{} are on time as far as this log can tell: {}."
_PERHAPS: Final = "{} may be {}: too little driving to be sure."
_NOTICED_S: Final = 0.1
"""A lag below does no harm: fuser.map finds it."""
_SPAN_S, _NEAR_S = 4.0, 8.0
_WORDS: Final = "each GNSS value belongs to a time {0:.2f} s before the one that stands beside it"


def _told(lag: Lag) -> str:
    return f"{abs(lag.seconds):.2f} s {'late' if lag.seconds >= 0.0 else 'early'}, give or take {lag.sigma:.2f} s"


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
    if size >= _NOTICED_S and _LIKELY <= deviations < _SURE:
        return unknown(code, _PERHAPS.format("Speeds and courses", _told(lag)), **numbers)
    if size < _NOTICED_S or deviations < _SURE:
        text = _ON_TIME.format("Speeds and courses", _told(lag))
        return confirmed(code, value, text, **numbers)
    when = (
        _WORDS.format(lag.seconds)
        if lag.seconds > 0
        else f"they come {-lag.seconds:.2f} s early, which points to a clock that is wrong"
    )
    text = f"GNSS speeds are late: {when}." if lag.seconds > 0 else f"GNSS speeds are early: {when}."
    return contradicted(code, value, text, confidence_of(deviations), **numbers)


def _apart(imu: Imu, gnss: Gnss, lag_s: float) -> float:
    """Standard deviations that a lag is from none: root of twice the difference of their log-likelihoods."""
    (at_lag, independent), (at_none, _) = (unexplained(imu, gnss, lag) for lag in (lag_s, 0.0))
    return float(np.sqrt(max(independent * np.log(at_none / at_lag), 0.0)))


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
    if _NOTICED_S <= abs(lag.seconds) < _SURE_OF_POSITIONS * lag.sigma and _LIKELY * lag.sigma <= abs(lag.seconds):
        return unknown(code, _PERHAPS.format("Positions", _told(lag)), **numbers)
    if abs(lag.seconds) < max(_NOTICED_S, _SURE_OF_POSITIONS * lag.sigma):
        text = _ON_TIME.format("Positions", _told(lag))
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
    first, last = pairs(t_s, _SPAN_S, _NEAR_S)
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
