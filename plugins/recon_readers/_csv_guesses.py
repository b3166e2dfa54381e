"""Which columns are which sensor's, in which unit, along which axes: guesses with their reasons.

One that the values cannot settle is marked `check`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.tables import Array
from recon_readers._csv_looks import Look, TimeLook

_USUAL: Final = 0.6
"""Share of rows within half of the median size that tells an accelerometer, crashes and all."""
_VECTORS: Final = {
    "accel": r"^(a|acc\w*|accel\w*|acel\w*|fb?|imu acc\w*)\b|accelero\w*|acceleration",
    "gyro": r"^(g|gyr\w*|gir\w*|w|wb|omega)\b|gyro|rotation rate|angular|^rate$",
    "mag": r"^(m|mag\w*|campo\w*)\b|magnet\w*",
}
_NO_GRAVITY: Final = r"\b(linear|user|without|lin|free|linacc|aceleracaolinear)\b|linear"
_SCALARS: Final = {
    "lat": r"\blat(itude)?\b",
    "lon": r"\b(lon|lng|long|longitude)\b",
    "height": r"^(?!.*relative).*\b(alt|altitude|height|elevation)\b",
    "speed": r"\b(speed|velocity|vel|spd)\b",
    "course": r"\b(course|bearing|heading|track|cog)\b",
    "fix": r"\bfix$",
    "satellites": r"\b(satellites( used)?|sats|numsv|nsat|numsats)$",
}
_NOT_MEASURED: Final = r"accuracy|std|sigma|variance|error|view|timestamp|wheel|angular|true|magnetic"
_SPEEDS: Final = {"m/s": 1.0, "kn": 3600.0 / 1852.0, "mph": 1.0 / 0.44704, "km/h": 3.6}
"""How many of each unit 1 m/s is."""
_SAME_SPEED: Final = 0.06
"""Logarithm of a ratio; those of knots and miles per hour are 0.14 apart."""
_SHORTEST_WAY: Final = 300.0
"""m, below which the noise of positions counts."""
_EARTH_RADIUS: Final = 6_371_000.0
"""m"""
_AXIS: Final = re.compile(r"(.*?)([xyz])")
_ALONG: Final = re.compile(r"(.*?) ?(n|e|d|u|north|east|down|up)")
_STEMS: Final = {
    "vel": (("v", "vel", "velocity"), "m/s"),
    "pos_std": (("sd", "pos std", "position std"), "m"),
    "vel_std": (("sdv", "vel std", "velocity std"), "m/s"),
}
"""Names of the groups along the axes of the Earth, without these, and their usual unit."""
_TURNS: Final = {"rollrate": "x", "pitchrate": "y", "yawrate": "z"}


@dataclass(frozen=True)
class Group:
    """Lines of one group; `looks` are the columns that it takes."""

    name: str
    looks: tuple[Look, ...]
    keys: str
    reason: str


def time_for(looks: Iterable[Look], times: Sequence[TimeLook]) -> TimeLook:
    """The clock that is there in most rows of a group, of the same sensor where several are."""
    group = list(looks)
    rows = group[0].known
    head = group[0].words[:1]

    def rank(time: TimeLook) -> float:
        there = float(np.mean(np.logical_and.reduce([look.known for look in time.columns])[rows]))
        return there + time.rank + 0.05 * (time.columns[0].words[:1] == head)

    return max(times, key=rank)


# --- vectors --------------------------------------------------------------------------------------------------------


def named_vectors(looks: Sequence[Look], path: Path) -> list[Group]:
    """Accelerometer, gyroscope and magnetometer by the words of the header, of the file's name where these are bare."""
    triads: dict[str, dict[str, Look]] = {}
    for look in looks:
        axis = _TURNS.get(look.phrase)
        key = "rate"
        if axis is None and (match := _AXIS.fullmatch(look.words[-1] if look.words else "")):
            key, axis = " ".join([*look.words[:-1], match[1]]).strip(), match[2]
        if axis is not None:
            triads.setdefault(key, {}).setdefault(axis, look)
    found: dict[str, Group] = {}
    for key, axes in sorted(triads.items(), key=lambda item: bool(re.search(_NO_GRAVITY, item[0]))):
        if set(axes) == set("xyz"):
            name = _vector_name(key or " ".join(re.split(r"[^a-z]+", path.stem.lower())))
            if name and name not in found:
                found[name] = _vector(name, tuple(axes[axis] for axis in "xyz"), f"{key} {path.stem.lower()}")
    return list(found.values())


def _vector_name(key: str) -> str:
    return next((name for name, pattern in _VECTORS.items() if re.search(pattern, key)), "")


def unnamed_vectors(looks: Sequence[Look]) -> list[Group]:
    """Without a header: three columns of the size of gravity, and the three behind them."""
    for first in range(len(looks) - 2):
        triad = tuple(looks[first : first + 3])
        size = _size(triad)
        near = [gravity for gravity in (1.0, STANDARD_GRAVITY) if 0.8 < np.median(size) / gravity < 1.25]
        if near and float(np.mean(np.abs(size / np.median(size) - 1) < 0.5)) > _USUAL:
            found = [_vector("accel", triad, "accel")]
            behind = tuple(looks[first + 3 : first + 6])
            if len(behind) == 3 and float(np.median(_size(behind))) > 0.0:
                gyro = _vector("gyro", behind, "gyro")
                found.append(replace(gyro, reason=f"check: the columns behind it; {gyro.reason}"))
            return found
    return []


def _size(looks: Sequence[Look]) -> Array:
    size = np.linalg.norm(np.column_stack([_values(look) for look in looks]), axis=1)
    return np.asarray(size[~np.isnan(size)]) if not np.isnan(size).all() else np.zeros(1)


def _values(look: Look) -> Array:
    return look.values if look.values is not None else np.full(len(look.texts), np.nan)


def _vector(name: str, looks: tuple[Look, ...], words: str) -> Group:
    size = _size(looks)
    keys, reason = {"accel": _accel_unit, "gyro": _gyro_unit, "mag": _mag_unit}[name](looks[0].unit, size)
    if name == "accel" and re.search(_NO_GRAVITY, words):
        keys, reason = f"{keys}, at_rest: zero", f"{reason}; check: its name says that gravity is removed"
    return Group(name, looks, keys, reason)


def _accel_unit(unit: str, size: Array) -> tuple[str, str]:
    middle = float(np.median(size))
    shown = f"median size {middle:.4g}"
    if unit:
        return f"unit: {unit}", f"its header says {unit}; {shown}"
    for known, gravity in (("m/s^2", STANDARD_GRAVITY), ("g", 1.0), ("mg", 1000.0)):
        if 0.75 < middle / gravity < 1.33:
            return f"unit: {known}", shown
    for counts in (2048, 4096, 8192, 16384):
        if 0.93 < middle / counts < 1.07:
            return f"unit: g, scale: {1 / counts:.10g}", f"check: {shown} looks like counts of 1/{counts} g"
    return "unit: m/s^2", f"check: {shown} fits no unit"


def _gyro_unit(unit: str, size: Array) -> tuple[str, str]:
    high = float(np.percentile(size, 99))
    if unit:
        return f"unit: {unit}", f"its header says {unit}"
    if high > 6.0:
        return "unit: deg/s", f"{'check: ' * (high < 12.0)}99 % below {high:.3g}, too fast for rad/s"
    return "unit: rad/s", f"check: 99 % below {high:.3g}; deg/s if it hardly turned"


def _mag_unit(unit: str, size: Array) -> tuple[str, str]:
    middle = float(np.median(size))
    for known, low, high in (("uT", 15, 120), ("gauss", 0.15, 1.2), ("T", 1.5e-5, 1.2e-4), ("mG", 150, 1200)):
        if low <= middle <= high:
            return f"unit: {unit or known}", f"median size {middle:.3g}, the Earth's field"
    return f"unit: {unit or 'uT'}", f"check: median size {middle:.3g}, the Earth's field is 25 to 65 uT"


def axes_of(accel: Group) -> list[tuple[str, str]]:
    """Where x, y and z may point, by gravity."""
    if "at_rest" in accel.keys:
        return []
    mean = np.array([float(np.nanmedian(_values(look))) for look in accel.looks])
    axis = int(np.argmax(np.abs(mean)))
    if np.abs(mean[axis]) < 0.8 * np.linalg.norm(mean) or axis != 2:
        shown = ", ".join(f"{part:.3g}" for part in mean)
        return [("# axes: FLU", f"check: gravity shows as {shown}; without axes they come as logged")]
    if mean[2] > 0:
        return [("axes: FLU", f"check: z shows {mean[2]:.3g}, so z points up; x forward?")]
    reason = f"check: z shows {mean[2]:.3g}: down (x forward?), or up, with 'at_rest: down' in accel, as on iPhones"
    return [("axes: FRD", reason)]


# --- the other sensors ----------------------------------------------------------------------------------------------


def gnss_groups(looks: Sequence[Look], times: Sequence[TimeLook]) -> list[Group]:
    """What a receiver reports, by the words of the header; speed alone where no columns can be a place."""
    found: dict[str, Look] = {}
    along_earth = _along_earth(looks)
    taken = {id(look) for group in along_earth for look in group.looks}
    for name, pattern in _SCALARS.items():
        for look in looks:
            if id(look) not in taken and re.search(pattern, look.phrase) and not re.search(_NOT_MEASURED, look.phrase):
                found.setdefault(name, look)
    values = {name: _values(look) for name, look in found.items()}
    if "lat" not in found or "lon" not in found or np.nanmax(np.abs(values["lat"])) > 90:
        found = {name: look for name, look in found.items() if name == "speed"}
    if "fix" in found and not np.isin(values["fix"][~np.isnan(values["fix"])], (0, 1, 2, 3)).all():
        del found["fix"]
    groups = [_gnss_group(name, look, values, time_for([look], times)) for name, look in found.items()]
    return groups + along_earth if groups else []


def _gnss_group(name: str, look: Look, values: dict[str, Array], time: TimeLook) -> Group:
    own = values[name]
    least, most = float(np.nanmin(own)), float(np.nanmax(own))
    keys, reason = "", f"{least:.7g} to {most:.7g}"
    if name in ("lat", "lon"):
        radians = np.nanmax(np.abs(values["lat"])) < 1.6 and np.nanmax(np.abs(values["lon"])) < 3.2
        keys, reason = ("unit: rad", f"check: {reason}") if radians else ("", reason)
    elif name == "height":
        keys = f"unit: {look.unit or 'm'}"
    elif name == "course":
        keys = f"unit: {look.unit or ('deg' if most > 6.4 else 'rad')}"
    elif name == "speed":
        unit, why = (look.unit, "its header says so") if look.unit else _speed_unit(values, time)
        keys, reason = f"unit: {unit}", f"{why}; {reason}"
    for odd in (-9999.0, -1.0):
        if name in ("speed", "course", "height") and least == odd:
            keys, reason = f"{keys}, invalid: [{odd:g}]", f"{reason}; check: is {odd:g} no value?"
    return Group(name, (look,), keys, reason)


def _speed_unit(values: dict[str, Array], time: TimeLook) -> tuple[str, str]:
    """The unit in which the mean speed agrees best with the way along the positions."""
    most = float(np.nanmax(values["speed"]))
    plain = ("km/h", "check: too fast for m/s") if most > 45.0 else ("m/s", "check: or km/h")
    lasted = time.seconds()
    if "lat" not in values or lasted is None:
        return plain
    lat, lon = np.deg2rad(values["lat"]), np.deg2rad(values["lon"])
    there = ~np.isnan(lat) & ~np.isnan(lon) & (np.abs(lat) + np.abs(lon) > 0)
    way = _EARTH_RADIUS * np.hypot(np.diff(lat[there]), np.diff(lon[there]) * np.cos(lat[there][1:]))
    if way.sum() < _SHORTEST_WAY:
        return plain
    ratio = float(np.nanmean(values["speed"]) * lasted / way.sum())
    near = min(_SPEEDS, key=lambda unit: abs(np.log(max(ratio, 1e-9) / _SPEEDS[unit])))
    doubt = "" if abs(np.log(max(ratio, 1e-9) / _SPEEDS[near])) < _SAME_SPEED else "check: "
    return near, f"{doubt}its mean is {ratio:.3g} times that of the way along the positions in m/s"


def _along_earth(looks: Sequence[Look]) -> list[Group]:
    """Velocity and sigmas along North, East and down or up, by names such as vn, vel_e, velocity_up and sdn."""
    named: dict[tuple[str, str], Look] = {}
    for look in looks:
        if match := _ALONG.fullmatch(look.phrase):
            named.setdefault((match[1].strip(), match[2][0]), look)
    found = []
    for name, (stems, usual) in _STEMS.items():
        for stem, letters in product(stems, ("ned", "enu")):
            columns = tuple(named[stem, one] for one in letters if (stem, one) in named)
            if len(columns) == 3:
                keys = f"unit: {columns[0].unit or usual}, axes: {letters.upper()}"
                found.append(Group(name, columns, keys, "by the names"))
                break
    return found


def other_groups(looks: Sequence[Look]) -> dict[str, Group]:
    """Wheel speed and pressure, by stream."""
    found: dict[str, Group] = {}
    for look in looks:
        middle = float(np.nanmedian(_values(look)))
        if re.search(r"\b(odo\w*|wheel)\b", look.phrase):
            found.setdefault("wheel", Group("speed", (look,), f"unit: {look.unit or 'm/s'}", f"median {middle:.3g}"))
        elif re.search(r"\bpress(ure)?\b", look.phrase):
            unit = look.unit or ("hPa" if middle < 2000 else "Pa")
            found.setdefault("baro", Group("pressure", (look,), f"unit: {unit}", f"median {middle:.6g}"))
    return found
