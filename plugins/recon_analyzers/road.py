"""The road under the wheels: roughness of every 100 m, and potholes with their position.

    roughness      root mean square of the vertical acceleration of the body in a band of 0.5 to 20 Hz, whose upper edge
                   passes half of the power; of a logger slower than 100 Hz it is where its own band ends
    roughness_80   the same at 80 km/h: of a road of ISO 8608 with waviness 2 the power of a linear vehicle's answer is
                   proportional to its speed, so that the root goes with sqrt(v)
    pothole        a peak beyond 0.4 g, recon's own limit, that also stands out of the road around it

What is measured is the answer of this vehicle, with its springs, tyres and load, at this place of the box: good to
compare stretches and days of one vehicle. It is no International Roughness Index, which needs the profile of the road
or a calibration of the vehicle. A peak tells that something was hit, not what: potholes, bumps, joints and rails look
alike.

References
    ISO 8608:2016 (road surface profiles); ISO 8855:2011.
    Mednis, Strazdins, Zviedris, Kanonirs, Selavo (2011), "Real time pothole detection using Android smartphones with
    accelerometers", IEEE DCOSS: limits on the vertical acceleration find potholes; the limit here is not theirs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    EVENTS,
    Analyzer,
    Array,
    Column,
    Event,
    Metric,
    Params,
    Schema,
    Streams,
    build,
    hookimpl,
    matrix,
    metrics,
    quantity,
    setting,
    time_ns,
    vector,
    warning,
)
from recon import events as events_of
from recon.handling import NEED, Handling, handling_of
from recon.numerics.handling import of_neighbours, smoothed, spells, weighted_quantile
from recon.rows import spans
from recon.schema import TRAJECTORY
from recon.tables import has, meta, with_meta

_PLACE: Final = TRAJECTORY.columns_of("time", "pos", "lat", "lon")
ROAD: Final = Schema(
    (
        *_PLACE,
        Column("distance", "m", quantity="distance", doc="from the first row of the trajectory to the stretch"),
        Column("length", "m", quantity="distance"),
        Column("speed", "m/s", quantity="speed", doc="mean"),
        Column("roughness", "m/s^2", quantity="acceleration"),
        Column("roughness_80", "m/s^2", quantity="acceleration", doc="scaled to 80 km/h; null where it was too slow"),
        Column("peak", "m/s^2", quantity="acceleration"),
    )
)
POTHOLES: Final = Schema(
    (
        *_PLACE,
        Column("distance", "m", quantity="distance", doc="from the first row of the trajectory"),
        Column("speed", "m/s", quantity="speed"),
        Column("peak", "m/s^2", quantity="acceleration", doc="largest vertical acceleration, up or down"),
    )
)
_LOW_HZ: Final = 0.5
_HIGH_HZ: Final = 20.0
_LEAST_RATE: Final = 40.0
"""Hz; twice the upper edge of the band."""
_REFERENCE_SPEED: Final = 80.0 / 3.6
_AROUND_CRASH_NS: Final = 5_000_000_000


class RoadParams(Params):
    """Parameters of analyzer.road."""

    length: float = quantity(100.0, "m", gt=0, doc="Length of a stretch.")
    slowest: float = quantity(15.0, "km/h", gt=0, doc="Slower rows are left out.")
    threshold: float = quantity(0.4, "g", gt=0, doc="Least peak of a pothole.")
    prominence: float = setting(4.0, ge=1, doc="Least peak of a pothole in roughnesses of its stretch.")
    merge: float = quantity(0.5, "s", ge=0, doc="Peaks that follow so soon are one pothole: both axles, and the echo.")


def analyze_road(*, trajectory: pa.Table, events: pa.Table | None, params: RoadParams) -> Streams:
    """The streams `road` and `potholes`, an event for each pothole, and what they amount to.

    trajectory : vel m/s, q, accel m/s^2; events : rows around a crash are left out

    Raises NotEnoughData where fewer than three rows are known.
    """
    found = handling_of(trajectory, None)
    usable = has(trajectory, "accel") and found.rate >= _LEAST_RATE
    band = _band(found) if usable else np.full(len(found.t_ns), np.nan)
    counted = (found.speed >= params.slowest) & np.isfinite(band) & ~_near_crash(found, events)
    stretches = list(_stretches(found, band, counted, params))
    hits = list(_hits(found, band, counted, stretches, params))
    learnt = list(_learnt(stretches, hits))
    if not usable:
        learnt = [warning(f"no roughness: it needs accelerations at {_LEAST_RATE:g} Hz or more in the trajectory")]
    happened = [Event(t, t, "pothole", abs(peak), "m/s^2", f"speed {v * 3.6:.0f} km/h") for t, peak, v in _told(hits)]
    return {
        "road": _table(trajectory, ROAD, stretches),
        "potholes": _table(trajectory, POTHOLES, hits),
        "events": events_of(happened),
        "metrics": metrics(learnt),
    }


def _told(hits: Iterable[dict[str, Any]]) -> Iterator[tuple[int, float, float]]:
    for hit in hits:
        yield hit["t_ns"], hit["peak"], hit["speed"]


def _band(found: Handling) -> Array:
    """Vertical acceleration (n,) m/s^2 without what is slower than the body or faster than the axles."""
    quick = of_neighbours(found.t_ns, found.up, _HIGH_HZ, found.max_gap_s)
    return np.asarray(quick - smoothed(found.t_ns, quick, _LOW_HZ, found.max_gap_s))


def _near_crash(found: Handling, events: pa.Table | None) -> NDArray[np.bool_]:
    near = np.zeros(len(found.t_ns), dtype=bool)
    for start, end in spans(events, "crash"):
        near |= (found.t_ns >= start - _AROUND_CRASH_NS) & (found.t_ns <= end + _AROUND_CRASH_NS)
    return near


def _stretches(
    found: Handling, band: Array, counted: NDArray[np.bool_], params: RoadParams
) -> Iterator[dict[str, Any]]:
    """Stretches of which at least half was driven fast enough."""
    way = found.distance
    number = np.floor(way / params.length).astype(np.int64)
    step = found.speed * found.weight_s
    every = np.flatnonzero(counted)
    for rows in np.split(every, np.flatnonzero(np.diff(number[every])) + 1) if len(every) else ():
        length, weight = float(step[rows].sum()), found.weight_s[rows]
        if length < 0.5 * params.length:
            continue
        speed = length / float(weight.sum())
        roughness = float(np.sqrt((band[rows] ** 2 * weight).sum() / weight.sum()))
        yield {
            "t_ns": int(found.t_ns[rows[0]]),
            "number": int(number[rows[0]]),
            "distance": float(number[rows[0]] * params.length),
            "length": length,
            "speed": speed,
            "roughness": roughness,
            "roughness_80": roughness * float(np.sqrt(_REFERENCE_SPEED / speed)),
            "peak": float(np.abs(band[rows]).max()),
        }


def _hits(
    found: Handling,
    band: Array,
    counted: NDArray[np.bool_],
    stretches: Iterable[dict[str, Any]],
    params: RoadParams,
) -> Iterator[dict[str, Any]]:
    """Peaks that stand out of their stretch."""
    rough = {stretch["number"]: stretch["roughness"] for stretch in stretches}
    way = found.distance
    beyond = counted & (np.abs(np.nan_to_num(band)) >= params.threshold)
    for first, last in spells(found.t_ns, beyond, params.merge, 0.0, found.max_gap_s):
        row = int(first + np.nanargmax(np.abs(band[first : last + 1])))
        usual = rough.get(int(way[row] // params.length), 0.0)
        if abs(band[row]) >= params.prominence * usual:
            yield {
                "t_ns": int(found.t_ns[row]),
                "distance": float(way[row]),
                "speed": float(found.speed[row]),
                "peak": float(band[row]),
            }


def _table(trajectory: pa.Table, schema: Schema, rows: list[dict[str, Any]]) -> pa.Table:
    """Rows with the place of the trajectory at their time."""
    t_ns = np.array([row["t_ns"] for row in rows], dtype=np.int64)
    at = np.searchsorted(time_ns(trajectory), t_ns)
    columns: dict[str, Any] = {
        name: np.array([row[name] for row in rows], dtype=np.float64)
        for name in schema.names
        if rows and name in rows[0]
    }
    if has(trajectory, "pos"):
        columns["pos"] = matrix(trajectory, "pos", gaps=True)[at]
    for name in ("lat", "lon"):
        if has(trajectory, name):
            columns[name] = vector(trajectory, name, gaps=True)[at]
    facts = {key: value for key, value in meta(trajectory).items() if key in ("anchor", "earth")}
    return with_meta(build(schema, time=t_ns, **columns), **facts)


def _learnt(stretches: list[dict[str, Any]], hits: list[dict[str, Any]]) -> Iterator[Metric]:
    method = f"vertical acceleration, {_LOW_HZ:g} to {_HIGH_HZ:g} Hz, root mean square"
    yield Metric("stretches", float(len(stretches)))
    yield Metric("potholes", float(len(hits)), note="potholes, bumps, joints and rails look alike")
    way = sum(stretch["length"] for stretch in stretches)
    if not way:
        return
    lengths = np.array([stretch["length"] for stretch in stretches])
    for name in ("roughness", "roughness_80"):
        values = np.array([stretch[name] for stretch in stretches])
        yield Metric(f"{name}_median", weighted_quantile(values, lengths, 0.5), "m/s^2", method=method)
        yield Metric(f"{name}_p95", weighted_quantile(values, lengths, 0.95), "m/s^2", method=method)
    yield Metric("potholes_per_km", len(hits) / way * 1000.0, "1/km")


@hookimpl
def declare_analyzers() -> Iterable[Analyzer]:
    """analyzer.road."""
    yield Analyzer(
        name="road",
        version=2,
        summary="Roughness of every 100 m of road as this vehicle felt it, and potholes with their position.",
        params=RoadParams,
        reads={"trajectory": NEED, "events": EVENTS.need("time", "end_time", "kind", optional=True)},
        writes={"road": ROAD, "potholes": POTHOLES, "events": EVENTS},
        run=analyze_road,
        references=("ISO 8608:2016", "Mednis et al. (2011), IEEE DCOSS"),
    )
