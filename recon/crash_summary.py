"""What a run says of its crash, for those who only read it: when it was, how severe, where the force came from."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.learnt import utc
from recon.recording import Recording
from recon.tables import meta, time_ns

SIGN: Final = "delta_v_resultant_max"
"""The metric by which the step that judged a crash is known."""
IMPACTS: Final = "impacts"
"""The metric in which that step counts crashes, with the reason in its note where there is none."""
_NUMBERS: Final = (SIGN, "pdof", "speed_before", "time_of_max")
_SAID: Final = ("value", "unit", "sigma", "low", "high", "method", "note")


def crash_summary(recording: Recording) -> dict[str, Any] | None:
    """The severest crash; None where no step, or more than one, judged crashes.

    impacts : how many there are; note : why there is none
    after_s : its time zero, s after the first row of the run
    time : the same in UTC, left out where the log has no date
    time_scale : UTC, and with it what was assumed of the log's clock
    delta_v_resultant_max, pdof, speed_before, time_of_max : value, unit, sigma, low, high, method, note
    """
    rows = recording["metrics"].to_pylist() if "metrics" in recording else []
    counts = [row for row in rows if row["name"] == IMPACTS]
    if len(counts) != 1:
        return None
    step = counts[0].get("step")
    numbers = {row["name"]: row for row in rows if row.get("step") == step and row["name"] in _NUMBERS}
    found: dict[str, Any] = {"impacts": round(counts[0]["value"] or 0.0), "note": counts[0]["note"] or ""}
    zero_ns, span = severest_impact(recording.get("events")), recording.span_ns()
    if zero_ns is not None and span is not None:
        dated = not any(meta(table).get("clock") == "relative" for table in recording.values())
        if dated:
            found |= {"time": f"{np.datetime64(zero_ns, 'ns')}Z", "time_scale": utc(rows)}
        found["after_s"] = (zero_ns - span[0]) * 1e-9
    return found | {name: {key: row[key] for key in _SAID} for name, row in numbers.items()}


def severest_impact(events: pa.Table | None) -> int | None:
    """Start of the largest event `impact`, ns since 1970; None without one."""
    if events is None:
        return None
    rows = zip(events["kind"].to_pylist(), events["value"].to_pylist(), time_ns(events).tolist(), strict=True)
    impacts = [(size, start) for kind, size, start in rows if kind == "impact" and size is not None]
    return max(impacts)[1] if impacts else None
