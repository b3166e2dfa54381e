"""Is every sample what a sensor measured, at the time that stands beside it?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from recon.numerics.doctor.finding import Finding, Floats, confirmed, contradicted, unknown
from recon.numerics.doctor.log import Claims, Gnss, Imu
from recon.numerics.signals import runs

_GAP_STEPS, _GAP_S = 4.0, 0.05
"""Median steps and s, both of which a step that is a hole exceeds."""
_JITTER: Final = 0.1
"""Of the median step: what a steady clock stays below."""
_REPEATED: Final = 0.2
"""Share of rows that repeat the one above; a standing box with coarse steps reaches a few percent."""
_PLATEAU: Final = 3
"""Samples at one extreme, one behind the other, twice over or six in all: no noise does that."""
_FAR: Final = 12.0
"""Median deviations from the median."""
_STILL: Final = 0.2
"""Share of samples that repeat the one before, from which a plateau at an extreme says nothing."""
_COARSE: Final = 0.6
"""Share of samples that are the same as the one before, although the vehicle moves."""
CHANNELS: Final = tuple(f"{sensor}_{axis}" for sensor in ("accel", "gyro") for axis in "xyz")


def channels(imu: Imu) -> dict[str, Floats]:
    """Every axis by its name, without what is missing altogether."""
    return dict(zip(CHANNELS, np.column_stack([imu.accel, imu.gyro]).T, strict=True))


def gaps(imu: Imu) -> Finding:
    """Is the record of the IMU without holes?"""
    t_s = _times(imu)
    code, step = "gaps", np.diff(t_s)
    if len(step) < 2:
        return unknown(code, "The log holds hardly a row.")
    usual = float(np.median(step))
    holes = np.flatnonzero(step > max(_GAP_STEPS * usual, _GAP_S))
    numbers = {"count": float(len(holes)), "longest_s": float(step.max()), "usual_s": usual}
    if not len(holes):
        return confirmed(code, 0.0, f"No hole in {t_s[-1] - t_s[0]:.0f} s of the IMU.", **numbers)
    worst = int(step.argmax())
    if len(holes) == 1:
        silent = f"once, for {step[worst]:.3g} s, at {t_s[worst]:.1f} s"
    else:
        silent = f"{len(holes)} times, for {step[holes].sum():.3g} s in all; the longest hole is {step[worst]:.3g} s"
        silent += f", at {t_s[worst]:.1f} s"
    text = f"The IMU is silent {silent}. What the vehicle did there was not measured."
    return contradicted(code, float(step.max()), text, **numbers)


def jitter(imu: Imu) -> Finding:
    """Do the times of the IMU come as evenly as those of its clock?"""
    code, step = "jitter", np.diff(_times(imu))
    if len(step) < 20:
        return unknown(code, "The log holds too few rows.")
    usual = float(np.median(step))
    near = step[step < _GAP_STEPS * usual]
    size = float(1.4826 * np.median(np.abs(near - usual)))
    wide = float(np.std(near))
    numbers = {"mad_s": size, "std_s": wide, "usual_s": usual}
    spread = max(size, 0.5 * wide)
    if spread <= _JITTER * usual:
        least = max(1e3 * size, 1e-3)
        text = f"The times of the IMU are even: a step is {1e3 * usual:.4g} ms, give or take {least:.2g} ms."
        return confirmed(code, round(size, 6), text, **numbers)
    text = (
        f"The times of the IMU are uneven: a step is {1e3 * usual:.4g} ms, give or take {1e3 * spread:.2g} ms. Either "
        "the sensor was read unevenly, which does no harm, or the logger stamped rows when it found the time, and then "
        "every change is seen a little early or late."
    )
    return contradicted(code, spread, text, **numbers)


def duplicates(imu: Imu | None, gnss: Gnss | None, claims: Claims) -> Finding:
    """Do rows repeat what was measured before?"""
    code = "duplicates"
    found: dict[str, float] = {}
    texts = []
    if imu is not None and len(imu.t_s) > 20:
        found["imu_share"] = _repeated(imu)
        if found["imu_share"] > _REPEATED:
            rate = (1.0 - found["imu_share"]) / float(np.median(np.diff(imu.t_s)))
            texts.append(
                f"{100 * found['imu_share']:.0f} % of the rows of the IMU repeat the row above: its true rate is "
                f"about {rate:.3g} Hz"
            )
    if gnss is not None and len(gnss.t_s) > 20:
        moving = gnss.over_ground[1:] > 1.0
        values = np.column_stack([gnss.lat, gnss.lon, gnss.speed, gnss.course])
        same = (np.nan_to_num(np.diff(values, axis=0)) == 0.0).all(axis=1)
        if moving.sum() > 10:
            found["gnss_share"] = float(same[moving].mean())
            if found["gnss_share"] > _REPEATED:
                texts.append(
                    f"{100 * found['gnss_share']:.0f} % of the fixes of the moving vehicle repeat the one before"
                )
    times = claims.dropped.get("same time", 0.0)
    found["same_time_rows"] = times
    if times:
        texts.append(f"{times:.0f} rows have the time of another row" if times > 1 else "a row has the time of another")
    if not found.keys() - {"same_time_rows"} and not times:
        return unknown(code, "The log holds hardly a row.")
    value = max([share for name, share in found.items() if name.endswith("share")], default=0.0)
    if not texts:
        return confirmed(code, value, "Rows do not repeat one another.", **found)
    text = "; ".join(texts) + ". Repeated rows are no measurements, and whoever counts them trusts the sensor too much."
    if value > _REPEATED:
        return contradicted(code, round(value, 3), text, **found)
    return replace(contradicted(code, times, text, **found), unit="rows")


def _repeated(imu: Imu) -> float:
    """Share of the rows of a sensor that repeat the one before; of the sensor that repeats least."""
    shares = []
    for values in (imu.accel, imu.gyro):
        own = values[np.isfinite(values).all(axis=1)]
        if len(own) > 20 and np.ptp(own, axis=0).any():
            shares.append(float((np.diff(own, axis=0) == 0.0).all(axis=1).mean()))
    return min(shares, default=0.0)


def _times(imu: Imu) -> Floats:
    """When the accelerometer reported, else the gyroscope: (k,) s. Loggers may give each of them rows of its own."""
    for values in (imu.accel, imu.gyro):
        own = np.isfinite(values).all(axis=1)
        if own.sum() > 2:
            return imu.t_s[own]
    return imu.t_s


def reversals(claims: Claims) -> Finding:
    """Did times run backwards in the file?"""
    code, count = "reversals", claims.dropped.get("backwards", 0.0)
    if not count:
        return confirmed(code, 0.0, "Times never run backwards.")
    rows, them = ("one row", "it") if count == 1 else (f"{count:.0f} rows", "them")
    text = (
        f"In {rows} the time runs backwards or leaps away; the reader left {them} out. Was the clock set during the "
        "drive, or are two logs in one file?"
    )
    return contradicted(code, count, text, rows=count)


def clipping(imu: Imu) -> Finding:
    """Does a sensor stop at its range?"""
    code, hit, most = "clipping", {}, 0.0
    for name, values in channels(imu).items():
        count, limit = _at_the_limit(values[np.isfinite(values)])
        if count:
            hit[name] = limit
            most = max(most, limit if name.startswith("accel") else 0.0)
    if not hit:
        return confirmed(code, None, "No sensor reaches the end of its range.")
    named = ", ".join(f"{name} at {limit:.4g} {_unit(name)}" for name, limit in hit.items())
    text = (
        f"Sensors reach the end of their range and stay there: {named}. What was larger is lost, so that speeds after "
        "it are too small."
    )
    limits = {f"{name}_limit": limit for name, limit in hit.items()}
    found = contradicted(code, most or max(hit.values()), text, **limits)
    return replace(found, unit="m/s^2" if most else "rad/s")


def _unit(channel: str) -> str:
    return "m/s^2" if channel.startswith("accel") else "rad/s"


def _at_the_limit(values: Floats) -> tuple[int, float]:
    """How many samples lie at an extreme in plateaus, and where that is; 0 where none do.

    Far from what is usual, a single plateau tells; nearer, there must be several, more crowded than the level below,
    in a signal that does not stand still elsewhere.
    """
    if len(values) < 50 or np.ptp(values) == 0.0:
        return 0, 0.0
    middle = float(np.median(values))
    usual = float(np.median(np.abs(values - middle)))
    for sign in (1.0, -1.0):
        signal = sign * values
        limit = float(signal.max())
        at = signal >= limit - 1e-9 * abs(limit)
        lengths = np.array([stop - start for start, stop in runs(at)])
        count, longest = int(at.sum()), int(lengths.max())
        if limit - sign * middle > _FAR * usual:
            told = longest >= 2 * _PLATEAU or (longest >= _PLATEAU and count >= 2 * _PLATEAU)
        else:
            below = float(signal[~at].max())
            crowd = int((signal[~at] >= below - 1e-9 * abs(below)).sum())
            still = float(((np.diff(signal) == 0.0) & ~at[1:]).mean())
            told = count >= 4 * _PLATEAU and (lengths >= 2).sum() >= _PLATEAU and count > 3 * crowd and still < _STILL
        if told:
            return count, limit
    return 0, 0.0


def quantisation(imu: Imu, moving: np.ndarray | None) -> Finding:
    """Are the steps of the numbers small enough? moving : (n,) rows while the vehicle moves, None where not known."""
    code, coarse, steps = "quantisation", {}, {}
    chosen = np.ones(len(imu.t_s), bool) if moving is None or moving.sum() < 100 else moving
    for name, values in channels(imu).items():
        part = values[chosen & np.isfinite(values)]
        if len(part) < 100 or np.ptp(part) == 0.0:
            continue
        change = np.diff(part)
        some = np.abs(change[change != 0.0])
        if not len(some):
            continue
        steps[name] = float(some.min())
        rate = 1.0 / float(np.median(np.diff(imu.t_s)))
        same = float((change == 0.0).mean())
        levels = len(np.unique(part))
        if same > _COARSE and levels < 0.02 * len(part) and rate > 5.0:
            coarse[name] = steps[name]
    repeated = (np.nan_to_num(np.diff(np.column_stack([imu.accel, imu.gyro])[chosen], axis=0)) == 0.0).all(axis=1)
    if not steps:
        return unknown(code, "The log holds too few changing numbers.")
    held = float(repeated.mean()) > _REPEATED and len(coarse) == len(steps) and not _few_levels(imu, chosen)
    if not coarse or held:
        text = "The numbers are written finely enough: neighbours differ."
        return confirmed(code, None, text, **{f"{name}_step": step for name, step in steps.items()})
    named = ", ".join(f"{n} {s:.3g} {_unit(n)}" for n, s in coarse.items())
    text = (
        f"Numbers come in steps so coarse that most samples repeat the one before while the vehicle moves: {named}. "
        "Small motion is lost; log more digits or a smaller range."
    )
    worst = max(coarse, key=coarse.__getitem__)
    found = contradicted(code, coarse[worst], text, **{f"{name}_step": step for name, step in coarse.items()})
    return replace(found, unit=_unit(worst))


def _few_levels(imu: Imu, chosen: np.ndarray) -> bool:
    """Are there so few different numbers that it is steps, not rows that were repeated?"""
    return any(
        len(np.unique(v[chosen & np.isfinite(v)])) < 60
        for v in channels(imu).values()
        if np.isfinite(v).any() and np.nanmax(v) != np.nanmin(v)
    )


def dead_channel(imu: Imu) -> Finding:
    """Does every axis measure?"""
    code, dead, copies = "dead_channel", [], []
    found = channels(imu)
    for name, values in found.items():
        known = values[np.isfinite(values)]
        if len(known) < 20:
            continue
        if np.ptp(known) == 0.0:
            dead.append(name)
    alive = {name: values for name, values in found.items() if name not in dead and np.isfinite(values).sum() >= 20}
    names = list(alive)
    copies = [
        f"{a} = {b}"
        for i, a in enumerate(names)
        for b in names[i + 1 :]
        if np.array_equal(alive[a], alive[b], equal_nan=True)
    ]
    missing = [name for name, values in found.items() if np.isfinite(values).sum() < 20]
    if len(missing) == 6:
        return unknown(code, "The log holds no IMU.")
    if not dead and not copies:
        without = f" Not in the log: {', '.join(missing)}." if missing else ""
        return confirmed(code, None, f"Every axis measures.{without}", missing=float(len(missing)))
    value = _together(dead) or copies[0]
    said = {"gyro": "The gyroscope is dead: it", "accel": "The accelerometer is dead: it"}.get(
        value, f"{value} is dead: it"
    )
    text = (
        f"{said} shows one and the same number from beginning to end."
        if dead
        else f"Two axes show the same numbers: {', '.join(copies)}."
    )
    return contradicted(
        code,
        value,
        f"{text} Turns, or that direction, were not measured; no pipeline can make up for it.",
        count=float(len(dead)),
    )


def _together(dead: list[str]) -> str:
    """A whole sensor by its name, else the axes."""
    for sensor in ("gyro", "accel"):
        if [name for name in dead if name.startswith(sensor)] == dead and len(dead) == 3:
            return sensor
    return ", ".join(dead)


def sample_findings(
    imu: Imu | None, gnss: Gnss | None, claims: Claims, moving: np.ndarray | None
) -> Mapping[str, Finding]:
    """All findings of this module, by code."""
    found = [duplicates(imu, gnss, claims), reversals(claims)]
    if imu is None:
        found += [
            unknown(code, "The log holds no IMU.")
            for code in ("gaps", "jitter", "clipping", "quantisation", "dead_channel")
        ]
    else:
        found += [gaps(imu), jitter(imu), clipping(imu), quantisation(imu, moving), dead_channel(imu)]
    return {one.code: one for one in found}
