"""How a vehicle was driven: g-g diagram, friction circle, smoothness, and harsh events for 100 km; whole and by trip.

    friction demand   sqrt(a_x^2 + a_y^2) / g, horizontal: what tyres must transmit at least on a level road
    RPA, v a+         sum of v a over that of v, 95th percentile of v a, where a > 0.1 m/s^2: of speeds each second
    jerk              root mean square of the rate of change of a_x and a_y
    per 100 km        count / way from 500 m on, limits of 95 % by Poisson: few events on a short way tell little

The others are of the accelerations of `recon.handling`, low-passed, in the intermediate system of ISO 8855. The EU's
bounds of RPA and v a+ are for urban, rural and motorway speeds apart; here they are of all. The stream `gg` is the
g-g diagram: seconds spent in each cell of acceleration along the way and to the left, for all (trip 0) and each trip.

References
    Milliken, Milliken (1995), "Race car vehicle dynamics", chapter 9 (g-g diagram, friction circle).
    Commission Regulation (EU) 2017/1151, annex IIIA, appendix 7a (RPA, v a+).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import EVENTS, Analyzer, Array, Column, Metric, Params, Schema, Streams, build, hookimpl, metrics, quantity
from recon.handling import NEED, Handling, handling_of
from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.handling import (
    each_second,
    percentile_of_gains,
    poisson_limits,
    rate_of_change,
    relative_positive_acceleration,
    weighted_quantile,
)
from recon.rows import spans

GG: Final = Schema(
    (
        Column("trip", type=pa.int64(), doc="number of the trip from 1, 0 for the whole"),
        Column("accel_along", "m/s^2", quantity="acceleration", doc="middle of the cell, positive: faster"),
        Column("accel_left", "m/s^2", quantity="acceleration", doc="middle of the cell"),
        Column("duration", "s", quantity="time", doc="spent in the cell"),
    )
)
COUNTED: Final = ("harsh_acceleration", "harsh_braking", "harsh_cornering", "speeding")
_KM_100: Final = 100_000.0
_LEAST_WAY_M: Final = 500.0
"""From a shorter way, one event makes a rate of hundreds."""
_EACH_SECOND_HZ: Final = 0.9
"""Hz; rows a second apart, by a clock that jitters."""


class DrivingParams(Params):
    """Parameters of analyzer.driving."""

    cutoff: float = quantity(2.0, "Hz", gt=0, doc="Of the low-pass filter of accelerations.")
    cell: float = quantity(0.05, "g", gt=0, doc="Width of a cell of the g-g diagram.")
    moving: float = quantity(5.0, "km/h", ge=0, doc="Slower rows count for the way, the time, RPA and v a+ alone.")
    friction_level: float = quantity(0.3, "g", gt=0, doc="Friction demand beyond which the time is told.")


def analyze_driving(*, trajectory: pa.Table, events: pa.Table | None, params: DrivingParams) -> Streams:
    """Metrics of the whole and of each trip, whose note names the trip, and the stream `gg`.

    trajectory : vel m/s, q; accel m/s^2 where it has it; events : of detector.driving, none for the whole alone

    Raises NotEnoughData where fewer than three rows are known.
    """
    whole = handling_of(trajectory, params.cutoff, spans(events, "crash"))
    parts = [(0, "whole", whole)]
    for number, (start, end) in enumerate(spans(events, "trip"), 1):
        rows = (whole.t_ns >= start) & (whole.t_ns <= end)
        if rows.sum() > 2:
            parts.append((number, f"trip {number}", _some(whole, rows)))
    learnt = [row for _, scope, part in parts for row in _metrics(part, events, scope, params)]
    return {"metrics": metrics(learnt), "gg": _diagram([(number, part) for number, _, part in parts], params)}


def _some(whole: Handling, rows: NDArray[np.bool_]) -> Handling:
    columns = {name: values[rows] for name, values in vars(whole).items() if name != "rate"}
    return Handling(**columns, rate=whole.rate)


def _metrics(part: Handling, events: pa.Table | None, scope: str, params: DrivingParams) -> Iterator[Metric]:
    for row in (*_motion(part, params), *_friction(part, params), *_smoothness(part, params), *_gains(part)):
        yield replace(row, note=f"{scope}; {row.note}" if row.note else scope)
    for row in _rates(part, events):
        yield replace(row, note=scope)


def _motion(part: Handling, params: DrivingParams) -> Iterator[Metric]:
    way, moving = float((part.speed * part.weight_s).sum()), part.speed >= params.moving
    time = float(part.weight_s[moving].sum())
    yield Metric("distance", way, "m", method="integral of the speed")
    yield Metric("duration", float(part.weight_s.sum()), "s")
    yield Metric("moving_time", time, "s", note=f"at {params.moving * 3.6:.3g} km/h and more")
    if time:
        yield Metric("mean_moving_speed", float((part.speed * part.weight_s)[moving].sum()) / time, "m/s")
    yield Metric("top_speed", float(part.speed.max()), "m/s")


def _friction(part: Handling, params: DrivingParams) -> Iterator[Metric]:
    moving = part.speed >= params.moving
    size, weight = np.hypot(part.along, part.left)[moving], part.weight_s[moving]
    if not np.isfinite(size).any():
        return
    method = f"horizontal, low-passed at {params.cutoff:g} Hz"
    for name, values in (("accel", part.along), ("brake", -part.along), ("left", part.left), ("right", -part.left)):
        yield Metric(f"{name}_max", float(np.nanmax(values[moving])), "m/s^2", method=method)
    yield Metric("friction_demand_max", float(np.nanmax(size)) / STANDARD_GRAVITY, "1", method=method)
    for share in (0.95, 0.99):
        value = weighted_quantile(size, weight, share) / STANDARD_GRAVITY
        yield Metric(f"friction_demand_p{share * 100:.0f}", value, "1", method=method, note="of the time in motion")
    beyond = float(weight[np.nan_to_num(size) > params.friction_level].sum())
    note = f"beyond {params.friction_level / STANDARD_GRAVITY:.3g} g"
    yield Metric("friction_time", beyond, "s", method=method, note=note)


def _smoothness(part: Handling, params: DrivingParams) -> Iterator[Metric]:
    moving = part.speed >= params.moving
    weight = part.weight_s[moving]
    if not np.isfinite(part.along[moving]).any():
        return
    for name, values in (("along", part.along), ("left", part.left)):
        jerk = rate_of_change(part.t_ns, values, part.max_gap_s)[moving]
        yield Metric(f"jerk_{name}_rms", _rms(jerk, weight), "m/s^3", method=f"low-passed at {params.cutoff:g} Hz")


def _gains(part: Handling) -> Iterator[Metric]:
    """Of the speeds of every second, whatever the rate; none where rows are rarer."""
    if part.rate < _EACH_SECOND_HZ:
        return
    speed, accel = each_second(part.t_ns, part.speed, np.isfinite(part.along), part.max_gap_s)
    for name, value, unit in (
        ("rpa", relative_positive_acceleration(speed, accel), "m/s^2"),
        ("va_pos_p95", percentile_of_gains(speed, accel), "m^2/s^3"),
    ):
        if np.isfinite(value):
            yield Metric(name, value, unit, method="EU 2017/1151, IIIA, 7a", note="where a exceeds 0.1 m/s^2")


def _rms(values: Array, weight: Array) -> float:
    known = np.isfinite(values)
    total = float(weight[known].sum())
    return float(np.sqrt((values[known] ** 2 * weight[known]).sum() / total)) if total else float("nan")


def _rates(part: Handling, events: pa.Table | None) -> Iterator[Metric]:
    """Counts of events that begin in this part, and for 100 km with limits."""
    way = float((part.speed * part.weight_s).sum())
    kinds = set(events["kind"].to_pylist()) if events is not None else set()
    for kind in COUNTED:
        if events is None or not (kind in kinds or "trip" in kinds):
            continue
        count = sum(part.t_ns[0] <= start <= part.t_ns[-1] for start, _ in spans(events, kind))
        yield Metric(kind, float(count), "1", method="count")
        if way >= _LEAST_WAY_M:
            low, high = (limit * _KM_100 / way for limit in poisson_limits(count))
            rate = count * _KM_100 / way
            yield Metric(f"{kind}_per_100km", rate, "1/100 km", low=low, high=high, method="Poisson, 95 %")


def _diagram(parts: Iterable[tuple[int, Handling]], params: DrivingParams) -> pa.Table:
    """Time in each cell that is not empty."""
    cells: list[tuple[int, float, float, float]] = []
    for number, part in parts:
        known = (part.speed >= params.moving) & np.isfinite(part.along) & np.isfinite(part.left)
        x, y = (np.rint(values[known] / params.cell).astype(np.int64) for values in (part.along, part.left))
        places, slot = np.unique(np.column_stack([x, y]), axis=0, return_inverse=True)
        time = np.bincount(slot.ravel(), part.weight_s[known], len(places))
        cells += [(number, *(place * params.cell).tolist(), float(t)) for place, t in zip(places, time, strict=True)]
    trip, along, left, duration = zip(*cells, strict=True) if cells else ((), (), (), ())
    columns = {"accel_along": along, "accel_left": left, "duration": duration}
    return build(GG, trip=pa.array(trip, pa.int64()), **{k: pa.array(v, pa.float64()) for k, v in columns.items()})


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """analyzer.driving."""
    yield Analyzer(
        name="driving",
        summary="g-g diagram, friction circle, smoothness and harsh events for 100 km, whole and by trip.",
        version=5,
        params=DrivingParams,
        reads={"trajectory": NEED, "events": EVENTS.need("time", "end_time", "kind", optional=True)},
        writes={"gg": GG},
        run=analyze_driving,
        references=(
            "Milliken, Milliken (1995), Race car vehicle dynamics",
            "Commission Regulation (EU) 2017/1151, IIIA, 7a",
        ),
    )
