"""Are the units right? By gravity, by what turns and changes of speed feel like, and by the way between positions.

A unit that was mistaken makes a number too large by a factor that is known beforehand: 3.6, 57.3, 9.81. Sensors are
wrong by a few percent, and what slopes do to a log by ten or twenty, so that the two are not mixed up.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import Finding, Floats, confidence_of, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Claims, Gnss, Imu, pairs
from recon.numerics.doctor.motion import FEWEST, Direction, Motion, regress
from recon.numerics.geodesy import STANDARD_GRAVITY

SPEEDS: Final[Mapping[str, float]] = {
    "m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "knots": 1852.0 / 3600.0, "cm/s": 0.01, "mm/s": 0.001
}  # fmt: skip
ACCELERATIONS: Final[Mapping[str, float]] = {
    "m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY, "cm/s^2": 0.01, "ft/s^2": 0.3048
}  # fmt: skip
RATES: Final[Mapping[str, float]] = {
    "rad/s": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3, "mdeg/s": 1e-3 * np.pi / 180.0, "deg/min": np.pi / 10800.0
}  # fmt: skip
"""What one of each is in SI."""

_ROUGH, _FINE = 1.35, 1.12
"""Factors within which a unit is right: by the IMU, and by positions."""
_SPAN_S: Final = 5.0
_LEAST_WAY: Final = 15.0
"""m in these seconds."""
_COURSE: Final = "the course of GNSS"
_FASTEST_TURN: Final = 12.0
"""rad/s that no vehicle turns with for a hundredth of its time."""


def gravity_of(imu: Imu) -> float:
    """Median of the magnitude that the accelerometer feels, m/s^2; NaN without any."""
    size = np.sqrt((imu.accel**2).sum(axis=1))
    return float(np.nanmedian(size)) if np.isfinite(size).any() else float("nan")


def accel_unit(imu: Imu, claims: Claims) -> Finding:
    """By gravity, which every accelerometer feels, whatever the drive."""
    code, size = "accel_unit", np.sqrt((imu.accel**2).sum(axis=1))
    size = size[np.isfinite(size)]
    if not len(size):
        return unknown(code, "The log holds no acceleration.")
    felt, spread = float(np.median(size)), float(np.subtract(*np.percentile(size, [75.0, 25.0])))
    numbers = {"felt_m_s2": felt, "spread_m_s2": spread}
    said = f"The accelerometer feels {felt:.4g} m/s^2 as a rule"
    if spread > 0.6 * felt and felt < 0.6 * STANDARD_GRAVITY:
        if claims.at_rest == "zero":
            return unknown(code, f"{said}: gravity was taken off before, and with it what tells the unit.", **numbers)
        text = (
            f"{said}, and it changes as much: gravity is missing. The file holds what phones call linear acceleration; "
            "most of recon needs the raw one, which a box at rest shows as 9.81 m/s^2 upwards."
        )
        return contradicted(code, "gravity removed", text, **numbers)
    ratio = felt / STANDARD_GRAVITY
    if 1.0 / _ROUGH < ratio < _ROUGH:
        text = f"{said}; gravity is 9.81. The unit {claims.accel_unit} is right."
        return confirmed(code, claims.accel_unit, text, **numbers)
    value = _unit(ACCELERATIONS, claims.accel_unit, ratio)
    text = f"{said}, where gravity is 9.81: the file is not in {claims.accel_unit}. {_guess(value, ratio)}"
    return contradicted(code, value, text, **numbers)


def gyro_unit(imu: Imu, motion: Motion | None, claims: Claims) -> Finding:
    """By the turns that GNSS sees, else by bends, in which speed and turn rate make the acceleration across."""
    code = "gyro_unit"
    rates = np.abs(imu.gyro[np.isfinite(imu.gyro)])
    if not len(rates) or not rates.any():
        return unknown(code, "The log holds no turn rates.")
    fast = float(np.percentile(rates, 99.0))
    found = _turns(motion) if motion else None
    if found is None:
        if fast > _FASTEST_TURN:
            text = f"The gyroscope turns faster than {fast:.3g} rad/s for a hundredth of the time; no vehicle does."
            value = _unit(RATES, claims.gyro_unit, 180.0 / np.pi)
            return contradicted(code, value, f"{text} {_guess(value, 180.0 / np.pi)}", fastest_rad_s=fast)
        return unknown(code, "Too few turns at speed to compare the gyroscope with GNSS.", fastest_rad_s=fast)
    ratio, sigma, how = found
    numbers = {"ratio": ratio, "sigma": sigma, "fastest_rad_s": fast}
    if 1.0 / _ROUGH < ratio < _ROUGH:
        text = f"The gyroscope turns {_times(ratio)}as fast as {how}: its unit {claims.gyro_unit} is right."
        return confirmed(code, claims.gyro_unit, text, **numbers)
    value = _unit(RATES, claims.gyro_unit, ratio)
    if value.startswith("times"):
        text = f"The gyroscope turns {_times(ratio)}as fast as {how}, which no unit explains: too few turns to tell."
        return unknown(code, text, **numbers)
    text = f"The gyroscope turns {_times(ratio)}as fast as {how}, so it is not in {claims.gyro_unit}."
    return contradicted(code, value, f"{text} {_guess(value, ratio)}", confidence_of(ratio / sigma), **numbers)


def _turns(motion: Motion) -> tuple[float, float, str] | None:
    """How many times too fast the gyroscope turns, its sigma, and against what."""
    if motion.turn is not None and motion.turn.told:
        return motion.turn.length, motion.turn.sigma, _COURSE
    forward, spans = motion.forward, motion.spans
    if forward is None or motion.up is None or not forward.told:
        return None
    up = motion.up.unit
    side = np.cross(up, forward.unit)
    rate = spans.gyro @ up
    known = np.isfinite(rate) & (spans.speed > 1.0)
    if known.sum() < 2 * FEWEST:
        return None
    felt = (spans.accel @ side)[known] * STANDARD_GRAVITY / motion.up.length
    centrifugal = spans.speed[known] * rate[known]
    causes = np.column_stack([centrifugal, np.ones_like(centrifugal)])
    found = regress(causes, np.column_stack([felt, 0.0 * felt, 0.0 * felt]), spans.t_s[known])[0]
    slope = float(found.vector[0])
    if abs(slope) < 6.0 * np.sqrt(3.0) * found.sigma:
        return None
    ratio, sigma = 1.0 / abs(slope), np.sqrt(3.0) * found.sigma / slope**2
    if motion.turn is not None and _known_otherwise(motion.turn, ratio, sigma):
        return None  # banked bends push aside by less
    return ratio, float(sigma), "bends at this speed need by what they push aside"


def _known_otherwise(turn: Direction, ratio: float, sigma: float) -> bool:
    """Is what the course says of the gyroscope, known to a quarter at least, another ratio?"""
    return turn.length > 4.0 * turn.sigma and abs(ratio - turn.length) > 6.0 * float(np.hypot(sigma, turn.sigma))


def speed_unit(gnss: Gnss, motion: Motion | None, claims: Claims) -> Finding:
    """By the way between positions, else by the accelerometer."""
    code = "speed_unit"
    if not np.isfinite(gnss.speed).any():
        return unknown(code, "The log holds no speed.")
    found = _by_way(gnss) or (_by_accelerometer(motion) if motion else None)
    if found is None:
        return unknown(code, "Neither positions nor changes of speed tell how large the speeds must be.")
    ratio, sigma, limit, how = found
    numbers = {"ratio": ratio, "sigma": sigma}
    value = _unit(SPEEDS, claims.speed_unit, ratio)
    if 1.0 / limit < ratio < limit or value == claims.speed_unit:
        text = f"The speeds are {_times(ratio)}as large as {how}: the unit {claims.speed_unit} is right."
        return confirmed(code, claims.speed_unit, text, confidence_of(np.log(_ROUGH) * ratio / sigma), **numbers)
    text = (
        f"The speeds are {_times(ratio)}as large as {how}: they are not in {claims.speed_unit}. {_guess(value, ratio)}"
    )
    return contradicted(code, value, text, confidence_of((ratio - 1.0) / sigma), **numbers)


def _by_way(gnss: Gnss) -> tuple[float, float, float, str] | None:
    """Median ratio of the speed to the way between positions, in steps of five seconds."""
    rows = np.flatnonzero(np.isfinite(gnss.lat + gnss.lon + gnss.speed) & ((gnss.lat != 0.0) | (gnss.lon != 0.0)))
    if len(rows) < FEWEST:
        return None
    t_s, speed = gnss.t_s[rows], gnss.speed[rows]
    way = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t_s))))
    first, last = pairs(t_s, _SPAN_S, 2.0 * _SPAN_S)
    north = 111_200.0 * (gnss.lat[rows][last] - gnss.lat[rows][first])
    east = 111_300.0 * np.cos(np.radians(gnss.lat[rows][first])) * (gnss.lon[rows][last] - gnss.lon[rows][first])
    chord, sum_of = np.hypot(east, north), way[last] - way[first]
    far = (chord > _LEAST_WAY) & (chord < 500.0)
    if far.sum() < FEWEST:
        return None
    ratio = sum_of[far] / chord[far]
    spread = 0.741 * float(np.subtract(*np.percentile(ratio, [75.0, 25.0])))
    independent = max(1.0, float(t_s[last[far]][-1] - t_s[first[far]][0]) / _SPAN_S)
    sigma = float(np.hypot(spread / np.sqrt(min(independent, far.sum())), 0.01))
    return float(np.median(ratio)), sigma, _FINE, "the way between the positions says"


def _by_accelerometer(motion: Motion) -> tuple[float, float, float, str] | None:
    forward, up = motion.forward, motion.up
    if forward is None or up is None or not forward.told:
        return None
    ratio = up.length / STANDARD_GRAVITY / forward.length
    how = "pulling away and braking feel to the accelerometer"
    return ratio, ratio * forward.sigma / forward.length, _ROUGH, how


def _unit(units: Mapping[str, float], claimed: str, ratio: float) -> str:
    """The unit that makes up for a number that is `ratio` times too large; "times N" where none does."""
    wanted = units.get(claimed, 1.0) / ratio
    near = min(units, key=lambda unit: abs(np.log(units[unit] / wanted)))
    return near if abs(np.log(units[near] / wanted)) < np.log(_ROUGH) else f"times {1.0 / ratio:.3g}"


def _times(ratio: float) -> str:
    """What stands before "as fast as": nothing where the two are the same."""
    shown = f"{ratio:.3g}"
    return "" if shown == "1" else f"{shown} times "


def _guess(value: str, ratio: float) -> str:
    return f"It is {value}." if not value.startswith("times") else f"No usual unit fits a factor of {ratio:.3g}."


def scale_of(units: Mapping[str, float], claimed: str, value: str) -> float:
    """By what numbers must be multiplied that were read in `claimed` and are in `value`."""
    if value.startswith("times "):
        return float(value.removeprefix("times "))
    return units.get(value, 1.0) / units.get(claimed, 1.0)


def normal(imu: Imu) -> Floats:
    """The accelerations (n, 3) as large as gravity says that they must be, m/s^2."""
    felt = gravity_of(imu)
    wrong = np.isfinite(felt) and felt > 0.0 and not 1.0 / _ROUGH < felt / STANDARD_GRAVITY < _ROUGH
    return imu.accel * (STANDARD_GRAVITY / felt) if wrong else imu.accel
