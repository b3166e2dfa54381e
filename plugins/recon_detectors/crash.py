"""Crashes as event data recorders find them: by the change of velocity within a short time.

    wake-up    the velocity changes by more than 0.8 km/h within 20 ms; time zero is the beginning of that interval
    trigger    it changes by 8 km/h or more within 150 ms while awake; what does not reach that is no event
    end        it changes by 0.8 km/h or less within 20 ms, and stays so for `merge`

The regulation has time zero at 0.8 km/h of longitudinal change within 20 ms, or of lateral change within 5 ms. Here
20 ms count for both, so that of a blow from the side may lie up to 15 ms earlier.

Only what happens across gravity counts, so potholes and speed bumps, which push upwards, do not add up. On an imu that
is not yet turned into the vehicle, up is the mean specific force of the seconds around; forward is not needed, for the
size of the horizontal change counts, which is never less than its longitudinal part.

A box that falls is no crash of a vehicle: an impact right after free fall becomes an event `fall`. Where the sensor
came to the end of its range, events `saturation` say so. No row is dropped: what follows a crash matters to its
reconstruction.

References
    49 CFR 563.5: end of event, event, time zero, trigger threshold.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    IMU,
    Array,
    Detector,
    Event,
    Metric,
    Params,
    Streams,
    events,
    hookimpl,
    metrics,
    quantity,
    time_ns,
    warning,
)
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.integration import cumulative
from recon.numerics.moving_window import moving_average
from recon.numerics.saturation import clipped
from recon.numerics.severity import LEAST_DELTA_V_RATE
from recon.numerics.signals import interpolate, median_rate, runs
from recon.tables import measured_axes, schema_of

_GAP_S: Final = 0.2
"""A longer silence of the imu tells nothing of the velocity."""
_BLOCK_S: Final = 1.0
_UP_BLOCKS: Final = 11
"""Blocks over which specific force averages to gravity."""
_WEIGHTLESS: Final = 0.35 * STANDARD_GRAVITY
_AFTER_FALL_S: Final = 0.3
_LEAST_CLIPPED: Final = 1.2 * STANDARD_GRAVITY
_CLIPPED_APART_S: Final = 0.05
_LEAST_RATE: Final = 50.0
"""Hz; slower sampling may miss the pulse."""
_LOOKED_AT_S: Final = 0.3
"""From time zero on, in which 49 CFR 563 has the largest change of velocity."""
_NEARLY: Final = 0.3
"""Of the trigger: what may have been a crash where sensor or log came to their end."""
_SILENT_STEPS: Final = 3.0
"""Usual steps of the imu from which on a longer one is a silence."""
KM_H: Final = 1.0 / 3.6


class CrashParams(Params):
    """Parameters of detector.crash."""

    wake_up: float = quantity(0.8, "km/h", gt=0, doc="Change of velocity within wake_up_time that begins an event.")
    wake_up_time: float = quantity(20.0, "ms", gt=0, le=1000, doc="See wake_up.")
    trigger: float = quantity(8.0, "km/h", gt=0, doc="Change of velocity within trigger_time that makes it a crash.")
    trigger_time: float = quantity(150.0, "ms", gt=0, le=5000, doc="See trigger.")
    merge: float = quantity(100.0, "ms", ge=0, le=60000, doc="Wake-ups up to this far apart are one event.")
    fall: float | None = quantity(
        80.0, "ms", gt=0, doc="Free fall of this length before an impact: the box fell, the vehicle did not crash."
    )
    full_scale: float | None = quantity(
        None, "g", gt=0, doc="End of the accelerometer's range; none: seen where it stays at its extreme."
    )


def crash(*, imu: pa.Table, params: CrashParams) -> Streams:
    """Events `crash` from time zero to their end, `fall` and `saturation`.

    The value of a crash is its largest change of velocity within trigger_time, km/h.

    imu : accel m/s^2, any frame, specific force or acceleration; rows without it are left out
    """
    accel, unmeasured = measured_axes(imu, "accel")
    t_ns, known = time_ns(imu), np.isfinite(accel).all(axis=1)
    if not known.all():
        t_ns, accel = t_ns[known], accel[known]
    clips = _saturations(t_ns, clipped(accel, params.full_scale, _LEAST_CLIPPED), accel)
    learnt = [Metric("trigger", params.trigger / KM_H, "km/h", note=f"within {params.trigger_time * 1e3:g} ms")]
    if len(t_ns) < 2:
        return {"events": events(clips), "metrics": metrics([Metric("crashes", 0.0), *learnt])}
    horizontal, force = _across_gravity(t_ns, accel, imu)
    nearly = _crashes(t_ns, horizontal, params, _NEARLY * params.trigger)
    found = [event for event in nearly if (event.value or 0.0) >= params.trigger / KM_H]
    falls = [event for event in found if _fell(event.start_ns, t_ns, force, params)]
    crashes = [event for event in found if event not in falls]
    fallen = [Event(e.start_ns, e.end_ns, "fall", e.value, e.unit, "impact after free fall") for e in falls]
    learnt += [Metric("crashes", float(len(crashes))), Metric("falls", float(len(falls)))]
    learnt += [
        *_doubts(t_ns, crashes, falls, clips),
        *_hidden(t_ns, [event for event in nearly if event not in found], clips),
    ]
    if unmeasured:
        names = " and ".join(unmeasured)
        learnt.append(warning(f"no value of imu in {names}: counted as zero, so nothing told along it holds"))
    return {"events": events([*crashes, *fallen, *clips]), "metrics": metrics(learnt)}


def _across_gravity(t_ns: NDArray[np.int64], accel: Array, imu: pa.Table) -> tuple[Array, Array]:
    """Horizontal acceleration (n, 2 or 3) and size of the specific force (n,), m/s^2."""
    column = schema_of(imu)["accel_x"]
    if column.quantity == "acceleration":
        force = np.linalg.norm(accel + np.array([0.0, 0.0, STANDARD_GRAVITY]), axis=1)
        return accel[:, :2], force
    force = np.linalg.norm(accel, axis=1)
    if column.frame in ("vehicle", "level"):
        return accel[:, :2], force
    up = _up(t_ns, accel)
    return accel - (accel * up).sum(axis=1)[:, None] * up, force


def _up(t_ns: NDArray[np.int64], accel: Array) -> Array:
    """Direction of gravity (n, 3), from medians over blocks, which no impact moves, averaged over seconds."""
    size = max(round(_BLOCK_S * median_rate(t_ns)), 1)
    count = max(len(t_ns) // size, 1)
    size, longer = divmod(len(t_ns), count)
    cut = longer * (size + 1)
    parts = (slice(None, cut), (longer, size + 1)), (slice(cut, None), (count - longer, size))
    middle = np.concatenate([t_ns[rows].reshape(shape)[:, shape[1] // 2] for rows, shape in parts])
    medians = [np.median(accel[rows].reshape(*shape, 3), axis=1) for rows, shape in parts]
    smooth = moving_average(np.concatenate(medians), _UP_BLOCKS)
    inside = np.clip(t_ns, middle[0], middle[-1])
    up = interpolate(inside, middle, smooth)
    return np.asarray(up / np.maximum(np.linalg.norm(up, axis=1), 1e-9)[:, None])


def _crashes(t_ns: NDArray[np.int64], accel: Array, params: CrashParams, trigger: float) -> list[Event]:
    """One event for each time awake that reaches the trigger, m/s. accel : (n, k) m/s^2, horizontal"""
    t_s = (t_ns - t_ns[0]) * 1e-9
    vel = cumulative(t_s, accel, "trapezoid", held=np.diff(t_s) > _GAP_S)
    gained = _changed(t_s, vel, params.wake_up_time)
    awake = gained > params.wake_up
    rows = np.flatnonzero(awake)
    if not len(rows):
        return []
    apart = np.flatnonzero(np.diff(t_s[rows]) > params.merge + params.wake_up_time) + 1
    change = _changed(t_s, vel, params.trigger_time)
    found: list[Event] = []
    for group in np.split(rows, apart):
        until = np.searchsorted(t_s, t_s[group[-1]] + params.wake_up_time, side="right")
        largest = float(change[group[0] : until].max())
        if largest < trigger:
            continue
        zero_ns = int(t_ns[_woken(t_s, gained, int(group[0]), params)])
        start_ns = max(zero_ns, found[-1].end_ns) if found else zero_ns
        end_ns = int(t_ns[min(group[-1] + 1, len(t_ns) - 1)])
        note = (
            f"largest change of velocity within {params.trigger_time * 1e3:g} ms; time zero where it changes by "
            f"{params.wake_up / KM_H:g} km/h in {params.wake_up_time * 1e3:g} ms, end where it last does before "
            f"{params.merge * 1e3:g} ms without"
        )
        found.append(Event(start_ns, end_ns, "crash", largest / KM_H, "km/h", note))
    return found


def _woken(t_s: Array, gained: Array, first: int, params: CrashParams) -> int:
    """The row nearest to time zero; that of the first row awake would be half a sample late on average."""
    rows = slice(max(first - 1, 0), first + 1)
    crossed = float(np.interp(params.wake_up, gained[rows], t_s[rows]))
    return int(np.abs(t_s - (crossed - params.wake_up_time)).argmin())


def _changed(t_s: Array, vel: Array, window_s: float) -> Array:
    """Size of the change of velocity (n, k) within the time before each row: (n,) m/s."""
    earlier_s, squared = t_s - window_s, np.zeros(len(t_s))
    for axis in vel.T:
        squared += (axis - np.interp(earlier_s, t_s, axis)) ** 2
    return np.sqrt(squared)


def _fell(zero_ns: int, t_ns: NDArray[np.int64], force: Array, params: CrashParams) -> bool:
    """Was the box weightless right before time zero?"""
    if params.fall is None:
        return False
    until = np.searchsorted(t_ns, zero_ns + round(params.wake_up_time * 1e9))
    since = np.searchsorted(t_ns, zero_ns - round((_AFTER_FALL_S + params.fall) * 1e9))
    spans = runs(force[since:until] < _WEIGHTLESS) + since
    return any(t_ns[stop - 1] - t_ns[start] >= params.fall * 1e9 for start, stop in spans)


def _saturations(t_ns: NDArray[np.int64], mask: NDArray[np.bool_], accel: Array) -> list[Event]:
    """One event for each group of clipped samples, whatever their axis."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return []
    apart = np.flatnonzero(np.diff(t_ns[rows]) > round(_CLIPPED_APART_S * 1e9)) + 1
    found = []
    for group in np.split(rows, apart):
        axes = [name for name, axis in zip("xyz", mask[group].T, strict=True) if axis.any()]
        largest = float(np.abs(accel[group][mask[group]]).max())
        note = f"accel {', '.join(axes)} at the end of the range in {int(mask[group].any(axis=1).sum())} rows"
        found.append(Event(int(t_ns[group[0]]), int(t_ns[group[-1]]), "saturation", largest, "m/s^2", note))
    return found


def _doubts(t_ns: NDArray[np.int64], crashes: list[Event], falls: list[Event], clips: list[Event]) -> Iterable[Metric]:
    rate_hz = median_rate(t_ns)
    yield Metric("sampling_rate", rate_hz, "Hz", note="median")
    if rate_hz < (LEAST_DELTA_V_RATE if crashes else _LEAST_RATE):
        yield warning(
            f"{rate_hz:.0f} samples per second are too few for crashes: a pulse may lie between two of them, and no "
            "interval knows what it held there"
        )
    for event in falls:
        after = (event.start_ns - int(t_ns[0])) * 1e-9
        yield warning(
            f"the impact {after:.1f} s after the start follows free fall, so the box fell and it counts as no crash; "
            "if the vehicle itself flew, set fall to none"
        )
    silences_s = [_silence_s(t_ns, event) for event in crashes]
    holed = [silence_s for silence_s in silences_s if silence_s * rate_hz > _SILENT_STEPS]
    if holed:
        yield warning(
            f"in {len(holed)} of {len(crashes)} crashes the imu is silent for up to {1e3 * max(holed):.0f} ms: a line "
            "joins the samples beside that, and no interval knows what was felt there"
        )
    hit = [clip for clip in clips if any(_meet(clip, event) for event in crashes)]
    if hit:
        yield warning(
            f"the accelerometer came to the end of its range ({hit[0].value or 0.0:.1f} m/s^2) in {len(hit)} "
            f"place{'s' * (len(hit) > 1)} during a crash: what lies beyond was not recorded"
        )


def _hidden(t_ns: NDArray[np.int64], missed: list[Event], clips: list[Event]) -> Iterable[Metric]:
    """What may be a crash, though the trigger was not reached. missed : changes of velocity near it"""
    for event in missed:
        if any(_meet(clip, event) for clip in clips):
            how = "the accelerometer was at the end of its range"
        elif event.end_ns >= t_ns[-1]:
            how = "the log ends"
        elif event.start_ns <= t_ns[0]:
            how = "the log begins"
        else:
            continue
        after, recorded = (event.start_ns - int(t_ns[0])) * 1e-9, np.floor(10.0 * (event.value or 0.0)) / 10.0
        yield warning(
            f"{after:.1f} s after the start {how} while the velocity changed by {recorded:.1f} km/h as recorded: "
            f"this may be a crash of which too little was recorded; --set detector.crash.trigger='{recorded:.1f} km/h' "
            "takes it for one"
        )


def _meet(one: Event, other: Event) -> bool:
    return one.start_ns <= other.end_ns and other.start_ns <= one.end_ns


def _silence_s(t_ns: NDArray[np.int64], crash: Event) -> float:
    """The longest time without a row right before a crash and during it, and 300 ms at least, s."""
    until_ns = max(crash.end_ns, crash.start_ns + round(_LOOKED_AT_S * 1e9))
    first, last = np.searchsorted(t_ns, [crash.start_ns, until_ns])
    return float(np.diff(t_ns[max(first - 1, 0) : last + 1]).max(initial=0)) * 1e-9


@hookimpl
def declare_detectors() -> Iterable[Detector]:
    """detector.crash."""
    yield Detector(
        name="crash",
        summary="Crashes by the change of velocity, with time zero and end as event data recorders have them.",
        version=3,
        params=CrashParams,
        reads={"imu": IMU.need("accel")},
        writes={"events": EVENTS},
        run=crash,
        references=("49 CFR 563.5",),
    )
