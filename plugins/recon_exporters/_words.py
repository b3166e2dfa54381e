"""Names of ours as words for people: kinds of events, names of metrics, components of residuals, units."""

from __future__ import annotations

import re
from typing import Final

_WORDS: Final = {
    "accel": "acceleration",
    "asi": "ASI",
    "att": "attitude",
    "cfc60": "CFC 60",
    "cfc180": "CFC 180",
    "edr": "EDR",
    "gnss": "GNSS",
    "gyro": "gyroscope",
    "imu": "IMU",
    "lat": "latitude",
    "lon": "longitude",
    "long": "longitudinal",
    "mag": "magnetometer",
    "min": "smallest",
    "nees": "NEES",
    "oiv": "OIV",
    "p95": "95 %",
    "p99": "99 %",
    "pdof": "direction of force",
    "phd": "PHD",
    "pos": "position",
    "rms": "RMS",
    "std": "sigma",
    "thiv": "THIV",
    "vel": "velocity",
    "100km": "100 km",
}
_WHOLE: Final = {
    "rpa": "relative positive acceleration (RPA)",
    "va_pos_p95": "speed times positive acceleration, 95 %",
}
_AXES: Final = {"e": "east", "n": "north", "u": "up"}
"""Behind a position or a velocity; behind anything else such a letter stands for itself."""
_POWERS: Final = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def words(name: str | None) -> str:
    """`gnss_pos_e` is "GNSS position east", `accel_max` "largest acceleration"; others lose their underscores."""
    if name is None:
        return ""
    if name in _WHOLE:
        return _WHOLE[name]
    parts = name.replace("delta_v", "delta-V").split("_")
    if parts[-1] == "max":
        parts = ["largest", *parts[:-1]]
    found = [_WORDS.get(part, part) for part in parts]
    for at in range(1, len(parts)):
        if parts[at - 1] in ("pos", "vel", "std"):
            found[at] = _AXES.get(parts[at], found[at])
        elif parts[at] == "lat" and parts[at - 1] in ("delta-V", "oiv"):
            found[at] = "lateral"
    return " ".join(found)


def unit_symbol(text: str | None) -> str:
    """`m/s^2` is "m/s²", `deg/s` "°/s"; 1 and none are ""."""
    shown = re.sub(r"\^(-?\d+)", lambda found: found[1].translate(_POWERS), text or "")
    return "" if shown == "1" else re.sub(r"\bdeg\b", "°", shown)
