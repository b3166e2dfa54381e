"""How severe a crash was, in the terms of the field, each number with its sigma and an interval of 95 %.

Time zero and end are those of the events `crash`; recon.numerics.severity has the formulas and the standards. The
acceleration is that of the trajectory, or, where there is none, of the imu with gravity taken off. Where nobody knows
which way is forward, only sizes are told.

The sigmas carry, by propagation (recon.numerics.budget), the noise before the impact, what is constant in the
acceleration (bias and tilt, as far as the smoother says), scale errors, the mounting, the turn rate, the lever arm and
the time zero. Of a pulse that the sensor clipped the trajectory tells how much was lost, by the speed before and after,
and the interval spans how it may have been lost; where it does not, the value is as recorded and has bounds
(recon.clipping). The note of each number says how much of its sigma comes from where.

With several crashes the numbers are those of the severest one, by delta-V; events `impact` list all of them.

The speed into a wall is delta-V over 1 + restitution. Restitution falls with the speed (Monson and Germane 1999, on
tests of NHTSA); four rear channels of test 10146, 57.09 km/h into a rigid wall, came back with 0.16 to 0.18 of it.
Nothing is taken for granted: without `restitution` no such speed is told, and `restitution_sigma` is in its interval.

References
    49 CFR 563; SAE J211-1; EN 1317-1:1998, 2010; MASH 2016, appendix F.
    Monson, Germane (1999), "Determination and mechanisms of motor vehicle structural restitution from crash test data",
    SAE 1999-01-0097.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
import pyarrow as pa

from recon import (
    EVENTS,
    Analyzer,
    Event,
    Metric,
    Streams,
    events,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    setting,
    time_ns,
    warning,
)
from recon.numerics import severity
from recon.numerics.budget import NORMAL_95, Doubt, Pulse, Uncertain, propagate
from recon.numerics.channel_class import LEAST_RATE
from recon.numerics.rotation import conjugate, rotate
from recon.rows import spans
from recon_analyzers._crash_measures import OLDEST_DELTA_V_S, measures, time_of_max
from recon_analyzers._impact_state import ROLLS_S, speed_at, tipped
from recon_analyzers._pulse import NEEDS, Known, Motion, PulseParams, motion_of, pulse_at

_ABOUT: Final[Mapping[str, tuple[str, str]]] = {
    "delta_v_long_max": ("km/h", "as 49 CFR 563, but always to 300 ms; forward positive"),
    "delta_v_lat_max": ("km/h", "as 49 CFR 563, but always to 300 ms; left positive"),
    "delta_v_resultant_max": ("km/h", "as 49 CFR 563, but always to 300 ms; horizontal"),
    "time_of_max": ("s", "of the largest horizontal delta-V, after time zero"),
    "accel_peak_cfc60": ("g", "SAE J211 CFC 60; longitudinal, forward positive"),
    "accel_peak_cfc60_magnitude": ("g", "SAE J211 CFC 60; of all three axes"),
    "pdof": ("deg", "direction of delta-V, clockwise from the front"),
    "asi_1998": ("1", "EN 1317-1:1998, means over 50 ms"),
    "asi_2010": ("1", "EN 1317-1:2010, 13 Hz"),
    "thiv": ("km/h", "EN 1317-1:1998, 2010"),
    "phd": ("g", "EN 1317-1:1998, highest 10 ms mean after the head's impact"),
    "oiv_long": ("km/h", "MASH flail space; forward positive"),
    "oiv_lat": ("km/h", "MASH flail space; left positive"),
    "ridedown": ("g", "MASH flail space, highest 10 ms mean of one axis after the occupant's impact"),
}
"""Unit and method of every number."""
_SIZES: Final = (
    "delta_v_resultant_max",
    "accel_peak_cfc60_magnitude",
    "asi_1998",
    "asi_2010",
    "thiv",
    "phd",
    "ridedown",
)
_RESTORING: Final = "restoring"
"""The share of a sigma that is there where what clipping cut off is told by the change of velocity."""
_RESTORED: Final = "clipped: what was cut off is told by the speed before and after"
_AS_RECORDED: Final = "clipped: as recorded, the interval holds what was cut off"
_SURE: Final = 4.0
"""Sigmas beyond which a change of velocity was not recorded: simulated crashes that were are below 2."""
_TOLD: Final = 3.0
"""Sigmas by which a size is told from zero: that of two or three components exceeds two of them too easily."""
_LEVEL: Final = np.radians(5.0)
"""What roads, springs and flat tyres make of the lean of a vehicle within seconds is less."""
_ROLLING: Final = np.radians(45.0)
"""More is none of a car on its wheels, whatever an impact does to its springs."""
_UNDIRECTED: Final = ("delta_v_resultant_max", "time_of_max", "accel_peak_cfc60_magnitude")
"""What can be told where nobody knows which way is forward."""
_ALONG: Final[Mapping[str, tuple[str, ...]]] = {
    "accel_x": ("delta_v_long_max", "accel_peak_cfc60", "pdof", "oiv_long"),
    "accel_y": ("delta_v_lat_max", "pdof", "oiv_lat"),
}
"""What cannot be told where an axis was not measured."""
_UPRIGHT: Final = ("accel_peak_cfc60_magnitude", "asi_1998", "asi_2010")
"""What has the vertical axis in it."""


class CrashParams(PulseParams):
    """Parameters of analyzer.crash."""

    head_ahead: float = quantity(0.0, "m", doc="How far the head sits ahead of the point whose motion is given.")
    restitution: float | None = setting(
        None, ge=0, le=1, doc="Speed after over speed before, where it hit a wall: tells speed_before without GNSS."
    )
    restitution_sigma: float = setting(0.05, ge=0, le=1, doc="Sigma of restitution.")


def analyze_crash(
    *,
    trajectory: pa.Table | None,
    imu: pa.Table | None,
    knots: pa.Table | None,
    events: pa.Table | None,
    metrics: pa.Table | None,
    params: CrashParams,
) -> Streams:
    """Metrics of the severest crash, events `impact` of all.

    trajectory : accel m/s^2, gyro rad/s, vehicle; vel m/s with sigma
    imu : accel m/s^2, gyro rad/s, in place of a trajectory, and to see what the sensor clipped
    """
    motion = motion_of(trajectory, imu)
    found = spans(events, "crash")
    if motion is None or not found:
        why = "none was found" if motion is not None else "there are no accelerations"
        return _answer([], [Metric("impacts", 0.0, note=why)])
    pulses = [(span, pulse_at(motion, span[0], imu, events, trajectory, knots)) for span in found]
    impacts = [(span, pulse) for span, pulse in pulses if pulse is not None]
    known = Known(motion, trajectory, knots, metrics, params, found)
    told = [(span, pulse, _told(pulse, known.doubt(pulse, span[0]), motion, params)) for span, pulse in impacts]
    if not told:
        return _answer([], [Metric("impacts", 0.0, note="hardly a sample of the imu lies in the crash")])
    span, pulse, numbers = max(told, key=lambda one: one[2]["delta_v_resultant_max"].value)
    before = speed_at(trajectory, span[0], knots)
    speed = _speed(before, _way(trajectory, span[0], before), numbers["delta_v_resultant_max"], params)
    rows = [Metric("impacts", float(len(told))), speed, *_rows(numbers, motion), *_closure(known, span, pulse)]
    rows += _tipping(trajectory, span)
    return _answer([_impact(s, n) for s, _, n in told], [*rows, *_doubts(pulse, numbers, motion)])


def _answer(impacts: list[Event], rows: Iterable[Metric]) -> Streams:
    return {"events": events(impacts), "metrics": metrics(rows)}


def _closure(known: Known, span: tuple[int, int], pulse: Pulse) -> Iterable[Metric]:
    """What the speed before and after says of the sum of the accelerations, two roads to the same number."""
    found = known.closure(span) if not len(pulse.restored) else None
    if found is None:
        return
    size, sigma, sigmas = found
    how, note = "trajectory less accelerations", "of delta-V, by the speed before and after"
    yield Metric("delta_v_not_recorded", 3.6 * size, "km/h", 3.6 * sigma, method=how, note=note)
    if sigmas > _SURE:
        yield warning(
            f"by the speed before and after, {3.6 * size:.1f} km/h of delta-V are not in the accelerations: was the "
            "sensor near the end of its range, or the pulse sampled too slowly? do not trust the intervals"
        )


def _tipping(trajectory: pa.Table | None, span: tuple[int, int]) -> Iterable[Metric]:
    """Did the vehicle roll over or tip, or the box turn in its mount? What it feels is the same."""
    after, most = tipped(trajectory, span) or (0.0, 0.0)
    if after > _LEVEL:
        yield warning(
            f"after the crash the box leans by {np.degrees(after):.0f} deg from how it was right before: did the "
            "vehicle tip, or come to stand askew? else the box was knocked in its mount, and no direction holds: that "
            "of the force, what is told along and across, and the heading behind the crash"
        )
    if most > _ROLLING:
        yield warning(
            f"within {ROLLS_S:g} s of the crash the box leans by up to {np.degrees(most):.0f} deg: of a vehicle that "
            "rolls over nothing holds that wheels on a road do; do not trust the intervals of the speed before, nor "
            "of how far and how fast it went behind the crash"
        )


def _told(pulse: Pulse, doubt: Doubt, motion: Motion, params: CrashParams) -> dict[str, Uncertain]:
    numbers = propagate(pulse, doubt, partial(measures, pulse=pulse, ahead=params.head_ahead), angles=("pdof",))
    numbers["time_of_max"] = time_of_max(pulse, doubt)
    for name in _SIZES:
        known = numbers[name].value >= _TOLD * _sigma_unclipped(numbers[name])
        numbers[name] = replace(numbers[name], low=max(numbers[name].low, 0.0) if known else 0.0)
    unknown = {name for axis, names in _ALONG.items() if axis in motion.unmeasured for name in names}
    return {n: value for n, value in numbers.items() if n not in unknown and (motion.directed or n in _UNDIRECTED)}


def _sigma_unclipped(found: Uncertain) -> float:
    """Of what clipping does not make: that only adds to a size."""
    return float(np.sqrt(max(found.sigma**2 - found.shares.get("clipping", 0.0) ** 2, 0.0)))


def _way(trajectory: pa.Table | None, zero_ns: int, known: tuple[float, float] | None) -> str:
    """Where the vehicle went as seen from its seats, unless ahead. known : as of _speed"""
    if trajectory is None or known is None or not known[0] > _SURE * known[1] or not has(trajectory, "q"):
        return ""
    row = trajectory.slice(int(np.searchsorted(time_ns(trajectory), zero_ns)), 1)
    ahead, left, _ = rotate(conjugate(matrix(row, "q", gaps=True)[0]), matrix(row, "vel", gaps=True)[0])
    if ahead > abs(left):
        return ""
    return ", backwards" if -ahead > abs(left) else f", sideways to the {'left' if left > 0.0 else 'right'}"


def _speed(known: tuple[float, float] | None, way: str, gained: Uncertain, params: CrashParams) -> Metric:
    """known : speed and sigma by the trajectory, m/s; way : where it went, unless ahead"""
    if known is not None and np.isfinite(known[0]):
        speed, sigma = (3.6 * value for value in known)
        method, note = "trajectory at time zero, with the sigma of its velocity", f"horizontal{way}"
    elif params.restitution is not None:
        return _speed_of_impact(gained, params.restitution, params.restitution_sigma)
    else:
        return Metric("speed_before", None, "km/h", note="no trajectory tells it; against a wall, restitution does")
    low, high = (max(speed - NORMAL_95 * sigma, 0.0), speed + NORMAL_95 * sigma) if np.isfinite(sigma) else (None, None)
    return Metric("speed_before", speed, "km/h", sigma, low, high, method, note)


def _speed_of_impact(gained: Uncertain, restitution: float, sigma: float) -> Metric:
    """The speed before, as if it came against something that did not move. sigma : of the restitution"""
    speed = gained.value / (1.0 + restitution)
    doubt = speed * sigma / (1.0 + restitution)
    below, above, spread = (
        float(np.hypot(part / (1.0 + restitution), size * doubt))
        for part, size in (
            (gained.value - gained.low, NORMAL_95),
            (gained.high - gained.value, NORMAL_95),
            (gained.sigma, 1.0),
        )
    )
    method = "delta-V over 1 + restitution"
    note = f"if it came against something that did not move, with a restitution of {restitution:g}, sigma {sigma:g}"
    return Metric("speed_before", speed, "km/h", spread, max(speed - below, 0.0), speed + above, method, note)


def _rows(numbers: Mapping[str, Uncertain], motion: Motion) -> Iterable[Metric]:
    for name, (unit, method) in _ABOUT.items():
        found = numbers.get(name)
        if found is None or not np.isfinite(found.value):
            why = (
                "it is not known which way is forward"
                if not motion.directed
                else "an axis that it needs was not measured"
            )
            note = why if found is None else "not reached while the log goes on"
            yield Metric(name, None, unit, method=method, note=note)
            continue
        notes = [*_lacking(name, motion), _budget(found, name)]
        yield Metric(
            name, found.value, unit, found.sigma, found.low, found.high, method, "; ".join(filter(None, notes))
        )


def _lacking(name: str, motion: Motion) -> list[str]:
    """That axes which a size or a time is made of were not measured, as its interval knows nothing of them."""
    lacking = [axis for axis in motion.unmeasured if axis != "accel_z" or name in _UPRIGHT]
    if not lacking or name not in (*_SIZES, "time_of_max"):
        return []
    return [f"{' and '.join(lacking)} not measured and counted as zero, also in the interval"]


def _budget(found: Uncertain, name: str) -> str:
    """Where the sigma comes from, the largest first."""
    parts = [(source, f"{share:.2g}") for source, share in found.shares.items() if share > 0.05 * found.sigma]
    shown = ", ".join(" ".join(part) for part in sorted(parts, key=lambda part: (-float(part[1]), part[0])))
    notes = [f"sigma from {shown}"] if shown else []
    if name == "pdof":
        notes.insert(0, f"{severity.clock(np.radians(found.value))} o'clock")
    if name == "time_of_max" and found.high >= OLDEST_DELTA_V_S:
        notes.insert(0, f"perhaps behind the {1e3 * OLDEST_DELTA_V_S:.0f} ms looked at: the delta-V may still grow")
    if found.clipped:
        notes.insert(0, _RESTORED if _RESTORING in found.shares else _AS_RECORDED)
    return "; ".join(notes)


def _impact(span: tuple[int, int], numbers: Mapping[str, Uncertain]) -> Event:
    found = numbers["delta_v_resultant_max"]
    within, at = (f"{1e3 * t_s:.0f} ms" for t_s in (OLDEST_DELTA_V_S, numbers["time_of_max"].value))
    pdof = f"; direction of force {numbers['pdof'].value:.0f} deg" if "pdof" in numbers else ""
    note = (
        f"largest delta-V within {within} of time zero, at {at}; 95 %: {found.low:.1f} to {found.high:.1f} km/h{pdof}"
    )
    return Event(*span, "impact", found.value, "km/h", note)


def _doubts(pulse: Pulse, numbers: Mapping[str, Uncertain], motion: Motion) -> Iterable[Metric]:
    rate_hz = 1.0 / pulse.step_s
    if rate_hz < LEAST_RATE * 60:
        delta_v = "delta-V is not affected" if rate_hz >= severity.LEAST_DELTA_V_RATE else "delta-V is wrong, too"
        yield warning(
            f"CFC 60 wants {LEAST_RATE * 60:.0f} samples per second, here are {rate_hz:.0f}: "
            f"vibration may be aliased into the peaks, or peaks be too low; {delta_v}"
        )
    if not motion.directed:
        yield warning("it is not known which way is forward: only sizes are told; turn imu into the vehicle first")
    if not motion.turning:
        yield warning("there is no gyro: the vehicle is taken not to turn during the impact")
    if pulse.lead == 0:
        yield warning(
            "the log begins in the impact, or right before it: what came before its first row is in no number"
        )
    if (len(pulse.accel) - pulse.lead) * pulse.step_s < OLDEST_DELTA_V_S:
        yield warning("the log ends within 300 ms of time zero: the largest delta-V may lie behind its end")
    if len(pulse.restored):
        yield warning(
            "the accelerometer was clipped in the crash: what it lost is told by the speed before and after; peaks "
            "depend on how it was lost, read their intervals"
        )
    elif any(number.clipped for number in numbers.values()):
        yield warning("the accelerometer was clipped in the crash: its numbers are as recorded, read the intervals")


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """The analyzer `crash`."""
    yield Analyzer(
        name="crash",
        summary="Delta-V, direction of force, ASI, THIV, PHD, OIV of a crash, with intervals of 95 %.",
        version=8,
        params=CrashParams,
        run=analyze_crash,
        reads=NEEDS,
        writes={"events": EVENTS},
        references=("49 CFR 563", "SAE J211-1", "EN 1317-1:1998, 2010", "MASH 2016, appendix F"),
    )
