"""The numbers of a report as JSON data: what the page shows, with all digits.

    name, recon, pipeline, plan, inputs, outputs   from the manifest
    versions      of Python and the packages on which the numbers rest
    warnings      what the user should know before he believes the result
    summary       start and end of the run, s; distance, m, and top_speed, m/s, with their sigmas; stops
    sigmas        of the trajectory, one standard deviation: median, p95, max
    residuals     by sensor and component: accepted and rejected ones, mean and rms of the accepted ones in their own
                  unit, rms of value / sigma (1 if the sigmas are true), share beyond two sigma (normal: 4.55 %)
    errors        against the stream `reference`, as `recon evaluate` gives them; null without one
    metrics       every row: what the steps estimated, learnt and assumed
    events        every row, with its time in s after the start
    outages       GNSS that is silent, from the row before to the row after, also where the run begins or ends so
    streams       rows and facts of each stream

Times are ISO 8601 with nanoseconds; numbers that are not known are null.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.drive_summary import summarize
from recon.errors import DataError
from recon.evaluation import evaluate
from recon.manifest import RunInfo
from recon.numerics.evaluation import statistics
from recon.recording import Recording
from recon.schema import unnumbered
from recon.tables import Array, has, meta, time_ns, vector
from recon_exporters._panels import is_kind, kinds_of

Json = dict[str, Any]

_DEGREE: Final = math.degrees(1.0)
_SIGMAS: Final[Mapping[str, tuple[str, str, float]]] = {
    "pos_std_e": ("position east", "m", 1.0),
    "pos_std_n": ("position north", "m", 1.0),
    "pos_std_u": ("position up", "m", 1.0),
    "vel_std_e": ("velocity east", "m/s", 1.0),
    "vel_std_n": ("velocity north", "m/s", 1.0),
    "vel_std_u": ("velocity up", "m/s", 1.0),
    "att_std_roll": ("roll", "deg", _DEGREE),
    "att_std_pitch": ("pitch", "deg", _DEGREE),
    "att_std_yaw": ("heading", "deg", _DEGREE),
}
"""Name, unit and size of the unit, by column."""
_USUAL_STEPS: Final = 3.0
"""A slow receiver is not silent between its rows."""
_FROM_MANIFEST: Final = ("recon", "pipeline", "plan", "inputs", "outputs")


def facts_of(streams: Mapping[str, pa.Table], about: RunInfo, max_gap: float) -> Json:
    """Everything above.

    max_gap : s, GNSS that is silent for longer, and for three of its usual steps, is an outage
    """
    start, end = Recording(streams).span_ns() or (0, 0)
    found = {
        "recon_report": 1,
        "name": about.name,
        **{key: about.manifest.get(key) for key in _FROM_MANIFEST},
        "versions": _versions(about.manifest.get("environment", {})),
        "warnings": list(about.warnings),
        "summary": _summary(streams, start, end),
        "sigmas": list(_sigmas(streams.get("trajectory"))),
        "residuals": list(_residuals(streams.get("residuals"))),
        "errors": _errors(streams),
        "metrics": _rows(streams.get("metrics")),
        "events": [{"t_s": (row.pop("t_ns") - start) * 1e-9, **row} for row in _events(streams.get("events"))],
        "outages": [
            {"t_s": (gap.pop("t_ns") - start) * 1e-9, **gap} for gap in _outages(streams, max_gap, (start, end))
        ],
        "streams": {name: {"rows": table.num_rows, "facts": meta(table)} for name, table in streams.items()},
    }
    finite: Json = _finite(found)
    return finite


def moment(t_ns: int) -> str:
    """ISO 8601 with nanoseconds."""
    return f"{np.datetime64(t_ns, 'ns')}Z"


def _versions(environment: Mapping[str, Any]) -> Json:
    """Without times, hosts and folders: equal runs give equal reports, which say nothing of where they were made."""
    return {"Python": environment.get("python"), **environment.get("packages", {})}


def _summary(streams: Mapping[str, pa.Table], start: int, end: int) -> Json:
    found: Json = {"start": moment(start), "end": moment(end), "span": (end - start) * 1e-9}
    return found | summarize(*(streams.get(name) for name in ("trajectory", "gnss", "events", "knots")))


def _sigmas(trajectory: pa.Table | None) -> Iterator[Json]:
    for column, (name, unit, size) in _SIGMAS.items():
        figures = None
        if trajectory is not None and has(trajectory, column):
            figures = statistics(size * vector(trajectory, column, gaps=True))
        if figures is not None:
            yield {"name": name, "unit": unit, "median": figures.median, "p95": figures.p95, "max": figures.max}


def _residuals(residuals: pa.Table | None) -> Iterator[Json]:
    if residuals is None or not residuals.num_rows:
        return
    for sensor, component in kinds_of(residuals):
        part = residuals.filter(is_kind(residuals, sensor, component))
        accepted = np.asarray(part["accepted"].fill_null(True).combine_chunks().to_numpy(zero_copy_only=False), bool)
        value, sigma = (vector(part, name, gaps=True)[accepted] for name in ("value", "sigma"))
        ratio = value / sigma
        yield {
            "sensor": sensor,
            "component": component,
            "accepted": int(accepted.sum()),
            "rejected": int((~accepted).sum()),
            "mean": _mean(value),
            "rms": math.sqrt(_mean(value**2)),
            "rms_in_sigmas": math.sqrt(_mean(ratio**2)),
            "beyond_2_sigma": _mean((np.abs(ratio) > 2.0).astype(np.float64)),
        }


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def _errors(streams: Mapping[str, pa.Table]) -> Json | None:
    if "trajectory" not in streams or "reference" not in streams:
        return None
    try:
        return evaluate(streams["trajectory"], streams["reference"], streams.get("events")).as_data()
    except DataError as error:
        return {"notes": [error.message]}


def _rows(table: pa.Table | None) -> list[Json]:
    return [] if table is None else list(table.to_pylist())


def _events(events: pa.Table | None) -> Iterator[Json]:
    if events is None:
        return
    start, end = time_ns(events), time_ns(events, "end_time")
    others = [name for name in events.column_names if name not in ("time", "end_time")]
    for row, told in enumerate(events.select(others).to_pylist()):
        first, last = int(start[row]), int(end[row])
        yield {
            "t_ns": first,
            "time": moment(first),
            "end_time": moment(last),
            "duration": (last - first) * 1e-9,
            **told,
        }


def _outages(streams: Mapping[str, pa.Table], max_gap: float, run_ns: tuple[int, int]) -> Iterable[Json]:
    for name, table in streams.items():
        if unnumbered(name) == "gnss" and table.num_rows:
            t_ns = time_ns(table)
            usual = np.median(np.diff(t_ns)) if len(t_ns) > 1 else 0.0
            t_ns = np.concatenate([run_ns[:1], t_ns, run_ns[1:]])
            for row in np.flatnonzero(np.diff(t_ns) > max(max_gap * 1e9, _USUAL_STEPS * usual)).tolist():
                first, last = int(t_ns[row]), int(t_ns[row + 1])
                yield {
                    "t_ns": first,
                    "stream": name,
                    "time": moment(first),
                    "end_time": moment(last),
                    "duration": (last - first) * 1e-9,
                }


def _finite(data: Any) -> Any:
    """The data with null for numbers that are not finite."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return data
