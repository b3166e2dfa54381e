"""The table that an event data recorder would hold, from the reconstruction, beside what one recorded and what GNSS
says.

Elements, units, resolutions and times are those of 49 CFR part 563 (see recon.edr): the speed before time zero, 5 s at
2 Hz or, by the coming rule, 20 s at 10 Hz; delta-V at 100 Hz to 250 ms or 30 ms after the end of the event; its maxima.
Values are rounded as the regulation does, and their sigmas hold that beside what those of analyzer.crash carry. What an
IMU cannot know, as the brake's switch, is left out, and so is what lies along an axis that was not measured.

Time zero of a recorder is its own: tables are laid side by side by the time from it. GNSS lags, by the delay that the
fuser found; within half a second of the impact a receiver smears what it did, so the speed before is compared up to
there.

References
    49 CFR 563.5, 563.7, 563.8; 89 FR 102810; ISO/TR 12353-3:2013 (interpretation of recorded data).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon import (
    GNSS,
    METRICS,
    Analyzer,
    Array,
    Metric,
    Streams,
    build,
    hookimpl,
    metrics,
    setting,
)
from recon.edr import (
    ACCELERATIONS,
    AFTER_END_S,
    DELTA_V,
    DELTA_V_LAT,
    DELTA_V_LONG,
    EDR,
    EDR_COMPARISON,
    ELEMENTS,
    LONGEST_MAXIMUM_S,
    NOT_TOLD,
    PRE_CRASH,
    SPEED,
    TIME_RESOLUTION_S,
    Element,
    Rule,
)
from recon.numerics import severity
from recon.numerics.budget import Pulse, Uncertain, fineness, propagate, refined
from recon.numerics.channel_class import channel_class
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.rows import spans
from recon.schema import Schema
from recon_analyzers._edr_sheet import Rows, less_gnss, sheet_of, verdict
from recon_analyzers._impact_state import speed_at
from recon_analyzers._pulse import NEEDS, Known, PulseParams, motion_of, pulse_at

_SAE: Final = np.array([1.0, -1.0, -1.0])
"""ISO 8855 to SAE J1698."""
_DELTA_V: Final = (DELTA_V_LONG, DELTA_V_LAT)


class EdrParams(PulseParams):
    """Parameters of analyzer.edr."""

    rule: Rule = setting("2006", doc="Pre-crash data: 2006 for 5 s at 2 Hz, 2024 for 20 s at 10 Hz.")
    rounded: bool = setting(True, doc="Values in the resolution of the regulation; false: as they are.")


def analyze_edr(
    *,
    trajectory: pa.Table | None,
    imu: pa.Table | None,
    knots: pa.Table | None,
    gnss: pa.Table | None,
    events: pa.Table | None,
    metrics: pa.Table | None,
    recorded_pre_crash: pa.Table | None,
    recorded_crash: pa.Table | None,
    params: EdrParams,
) -> Streams:
    """Streams edr_pre_crash, edr_crash and edr_comparison, and the elements that are single numbers.

    recorded_pre_crash, recorded_crash : as reader.edr_csv reads them from a recorder's table
    """
    found, motion = spans(events, "crash"), motion_of(trajectory, imu)
    before: Rows = []
    after: Rows = []
    learnt = [Metric("edr_number_of_events", float(len(found)), note="Multi-event, number of events")]
    for number, (zero_ns, end_ns) in enumerate(found, start=1):
        before += _before(trajectory, knots, number, zero_ns, params)
        if motion is None or not motion.directed:
            continue
        pulse = pulse_at(motion, zero_ns, imu, events, trajectory, knots)
        if pulse is not None:
            known = Known(motion, trajectory, knots, metrics, params, found)
            rows, largest = _after(pulse, known, number, zero_ns, end_ns)
            after += rows
            learnt += largest
    learnt += _of_all(found, after)
    sheet = sheet_of(before, after, recorded_pre_crash, recorded_crash, gnss, [zero for zero, _ in found], metrics)
    return {
        "edr_pre_crash": _table(EDR, _rounded(before, params)),
        "edr_crash": _table(EDR, _rounded(after, params)),
        "edr_comparison": _table(EDR_COMPARISON, sheet),
        "metrics": _metrics([*learnt, *verdict(sheet), *less_gnss(trajectory, gnss, metrics, found)]),
    }


def _metrics(rows: list[Metric]) -> pa.Table:
    return metrics(rows)


def _row(number: int, t: float, element: Element, value: float, sigma: float | None = None) -> dict[str, Any]:
    return {"event": number, "t": t, "element": element.name, "unit": element.unit, "value": value, "sigma": sigma}


def _before(trajectory: pa.Table | None, knots: pa.Table | None, number: int, zero_ns: int, params: EdrParams) -> Rows:
    """Speeds up to time zero; none where the trajectory does not reach or tell them."""
    length_s, rate_hz = PRE_CRASH[params.rule]
    rows: Rows = []
    for t in (np.arange(-round(length_s * rate_hz), 1) / rate_hz).tolist():
        told = speed_at(trajectory, zero_ns + round(t * 1e9), knots)
        if told is not None and np.isfinite(told[0]):
            rows.append(_row(number, t, SPEED, *(3.6 * value for value in told)))
    return rows


def _after(pulse: Pulse, known: Known, number: int, zero_ns: int, end_ns: int) -> tuple[Rows, list[Metric]]:
    """Delta-V at 100 Hz, and its maxima."""
    until_s = (end_ns - zero_ns) * 1e-9 + AFTER_END_S
    length_s, rate_hz = DELTA_V
    here_s = (len(pulse.accel) - pulse.lead - 1) * pulse.step_s
    t_s = np.arange(int(min(length_s, until_s, here_s) * rate_hz + 1e-6) + 1) / rate_hz
    longest_s = min(LONGEST_MAXIMUM_S, until_s, here_s)
    measures = partial(_elements, pulse=pulse, t_s=t_s, longest_s=longest_s)
    told = propagate(pulse, known.doubt(pulse, zero_ns), measures)
    force = channel_class(pulse.accel, 60, 1.0 / pulse.step_s)[pulse.lead :] * _SAE / STANDARD_GRAVITY
    own_s = np.arange(len(force)) * pulse.step_s
    axes = [i for i, axis in enumerate("xyz") if f"accel_{axis}" not in known.motion.unmeasured]
    rows: Rows = []
    for i, t in enumerate(t_s.tolist()):
        gained = [(_DELTA_V[axis], told[f"{_DELTA_V[axis].name} {i}"]) for axis in axes if axis < len(_DELTA_V)]
        rows += [_row(number, t, element, found.value, found.sigma) for element, found in gained]
        rows += [_row(number, t, ACCELERATIONS[axis], float(np.interp(t, own_s, force[:, axis]))) for axis in axes]
    needed = {"longitudinal": {0}, "lateral": {1}, "resultant": {0, 1}}
    names = [name for name, own in needed.items() if own <= set(axes)]
    return rows, [metric for name in names for metric in _maximum(told, name, number)]


def _elements(accel: Array, yaw_rate: Array, *, pulse: Pulse, t_s: Array, longest_s: float) -> dict[str, Array]:
    """Delta-V of many variants of a pulse at some times, and its maxima, km/h and s: (b,) each."""
    times = fineness(pulse.step_s)
    step_s, after = pulse.step_s / times, refined(accel, times)[:, pulse.lead * times :, :2]
    gained = 3.6 * severity.integral(after, step_s) * _SAE[:2]
    own_s = np.arange(gained.shape[1]) * step_s
    found: dict[str, Array] = {}
    for axis, element in enumerate(_DELTA_V):
        at = np.stack([np.interp(t_s, own_s, one) for one in gained[..., axis]])
        found |= {f"{element.name} {i}": at[:, i] for i in range(len(t_s))}
    within = gained[:, : round(longest_s / step_s) + 1]
    for name, values in (
        ("longitudinal", within[..., 0]),
        ("lateral", within[..., 1]),
        ("resultant", np.hypot(within[..., 0], within[..., 1])),
    ):
        at_most = np.abs(values).argmax(axis=1)
        found[f"maximum_{name}"] = values[np.arange(len(values)), at_most]
        found[f"time_{name}"] = at_most * step_s
    return found


def _maximum(told: Mapping[str, Uncertain], name: str, number: int) -> list[Metric]:
    """As it is; the notes say what a recorder would write."""
    largest, when = told[f"maximum_{name}"], told[f"time_{name}"].value
    coarse = TIME_RESOLUTION_S * float(np.round(when / TIME_RESOLUTION_S))
    suffix = "" if number == 1 else f"_event_{number}"
    how, title = (
        "49 CFR 563, 0 to 300 ms or to the end of the event and 30 ms; forward, right +",
        f"maximum delta-V, {name}",
    )
    note = f"M{title[1:]}: {largest.value:.0f} km/h; crash {number}"
    later = f"Time, {title}: {1e3 * coarse:g} ms; crash {number}"
    return [
        Metric(
            f"edr_maximum_delta_v_{name}{suffix}",
            largest.value,
            "km/h",
            largest.sigma,
            largest.low,
            largest.high,
            how,
            note,
        ),
        Metric(f"edr_time_maximum_delta_v_{name}{suffix}", when, "s", method=how, note=later),
    ]


def _of_all(found: list[tuple[int, int]], after: Rows) -> Iterable[Metric]:
    if len(found) > 1:
        apart = (found[1][0] - found[0][0]) * 1e-9
        yield Metric("edr_time_from_event_1_to_2", apart, "s", note="Time from event 1 to 2")
    complete = {row["event"] for row in after} == set(range(1, len(found) + 1))
    yield Metric("edr_complete_file_recorded", float(complete), note="Complete file recorded: 1 yes, 0 no")
    yield Metric("edr_elements_left_out", note=NOT_TOLD)


def _rounded(rows: Rows, params: EdrParams) -> Rows:
    """In the resolution of each element, where that is asked for; nought without a sign. Sigmas then hold that."""
    return [_coarse(row, ELEMENTS[row["element"]].resolution) for row in rows] if params.rounded else rows


def _coarse(row: dict[str, Any], step: float) -> dict[str, Any]:
    sigma = row["sigma"]
    doubt = None if sigma is None else float(np.hypot(sigma, step / np.sqrt(12.0)))
    return row | {"value": step * round(row["value"] / step) + 0.0, "sigma": doubt}


def _table(schema: Schema, rows: Rows) -> pa.Table:
    columns = {c.name: pa.array([row.get(c.name) for row in rows], c.type, from_pandas=True) for c in schema.columns}
    return build(schema, **columns)


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """The analyzer `edr`."""
    recorded = EDR.need("event", "t", "element", "value", optional=True)
    yield Analyzer(
        name="edr",
        summary="The table of an event data recorder (49 CFR 563), beside a recorder's own and GNSS.",
        version=6,
        params=EdrParams,
        run=analyze_edr,
        reads={
            **NEEDS,
            "gnss": GNSS.need(maybe=["speed"], optional=True),
            "metrics": METRICS.need("name", "value", "sigma", optional=True),
            "recorded_pre_crash": recorded,
            "recorded_crash": recorded,
        },
        writes={"edr_pre_crash": EDR, "edr_crash": EDR, "edr_comparison": EDR_COMPARISON},
        references=("49 CFR 563", "89 FR 102810", "SAE J1698-1"),
    )
