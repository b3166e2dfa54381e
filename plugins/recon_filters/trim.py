"""A part of a log: the rows from one time to another, of every stream.

For a log that holds more than the drive in question: the minutes around a crash, the drive without the hours in the
garage, the part before the box was turned in its mount. Rows that stay are not changed, so that `recon explain` finds
them in the lines of the whole log. Events and metrics, which only grow, stay as they are.

`recon run PIPELINE LOG --from 120s --to 2024-05-01T08:30:00Z` puts this step behind the reader.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from pydantic import field_validator

from recon import DataError, Filter, Metric, Params, Streams, hookimpl, metrics, select_rows, setting, time_ns
from recon.moments import LAST_NS, moment_ns
from recon.recording import Recording
from recon.rounding import milliseconds
from recon.schema import APPENDED, Schema

_HINT = "write for example '120 s', which is after the first row, or '2024-05-01T08:01:30Z'"


class TrimParams(Params):
    """Parameters of filter.trim."""

    start: str | None = setting(
        None,
        doc="First time that is kept: '120 s' after imu's first row, or ISO 8601, UTC where it names no zone.",
    )
    stop: str | None = setting(None, doc="Last time that is kept, likewise.")

    @field_validator("start", "stop")
    @classmethod
    def _is_a_time(cls, value: str | None) -> str | None:
        if value is not None:
            _moment_ns(value, 0)
        return value


def trim(*, streams: Mapping[str, pa.Table], params: TrimParams) -> Streams:
    """The rows between two times, ends included, of every stream but events and metrics.

    Raises DataError where the first time is behind the last one, or no row lies between them.
    """
    timed = Recording({name: table for name, table in streams.items() if name not in APPENDED})
    span = timed.span_ns()
    if span is None:
        return dict(timed)
    first = int(time_ns(timed["imu"])[0]) if "imu" in timed and timed["imu"].num_rows else span[0]
    start = -LAST_NS if params.start is None else _moment_ns(params.start, first)
    stop = LAST_NS if params.stop is None else _moment_ns(params.stop, first)
    if start > stop:
        raise DataError(f"start ({params.start}) is behind stop ({params.stop})", "give the earlier one as start")
    kept = {name: _between(table, start, stop) for name, table in timed.items()}
    left = Recording(kept).span_ns()
    if left is None:
        lasts = f"{(span[0] - first) * 1e-9:.3f} s to {(span[1] - first) * 1e-9:.3f} s after its first row"
        raise DataError(
            f"no row lies between {params.start or 'the first row'} and {params.stop or 'the last row'}",
            f"the log runs from {_utc(span[0])} to {_utc(span[1])}, which is {lasts}",
        )
    dropped = sum(table.num_rows - kept[name].num_rows for name, table in timed.items())
    learnt = [
        Metric("start", (left[0] - first) * 1e-9, "s", note=f"after the first row of the log: {_utc(left[0])}"),
        Metric("duration", (left[1] - left[0]) * 1e-9, "s", note=f"until {_utc(left[1])}"),
        Metric("rows_dropped", float(dropped), note="of all streams"),
    ]
    return {**kept, "metrics": metrics(learnt)}


def _between(table: pa.Table, start: int, stop: int) -> pa.Table:
    if "time" not in table.column_names:
        return table
    t_ns = time_ns(table)
    return select_rows(table, (t_ns >= start) & (t_ns <= stop))


def _utc(t_ns: int) -> str:
    return f"{milliseconds(str(np.datetime64(t_ns, 'ns')))} UTC"


def _moment_ns(text: str, first: int) -> int:
    """A time in ns since 1970. Raises ValueError for what is none, which a Params tells with its place."""
    try:
        return moment_ns(text, first)
    except DataError as error:
        raise ValueError(f"{error.message}: {_HINT}") from error


def _same_streams(inputs: Mapping[str, Schema], _: Any) -> dict[str, Schema]:
    return {name: schema for name, schema in inputs.items() if name not in APPENDED}


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.trim."""
    yield Filter(
        name="trim",
        summary="The rows from one time to another, of every stream.",
        params=TrimParams,
        run=trim,
        every_stream=True,
        plan=_same_streams,
    )
