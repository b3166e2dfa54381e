"""The comparison sheet of analyzer.edr: the reconstruction beside a recorder's table and GNSS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon import Array, Metric, has, time_ns, vector, warning
from recon.edr import ELEMENTS, SPEED
from recon.numerics.budget import NORMAL_95
from recon.numerics.signals import interpolate
from recon_analyzers._impact_state import speed_at

Rows = list[dict[str, Any]]

_GNSS_S: Final = (2.5, 0.5)
"""s before time zero in which speeds are compared on average."""
_APART_S: Final = {False: 0.025, True: 0.75}
"""s between rows of a recorder, of the pulse and of the speed before, between which it is interpolated."""


def sheet_of(
    before: Rows,
    after: Rows,
    recorded_before: pa.Table | None,
    recorded_after: pa.Table | None,
    gnss: pa.Table | None,
    zeros_ns: list[int],
    learnt: pa.Table | None,
) -> Rows:
    """Every speed and delta-V of the reconstruction, with what the recorder and GNSS have at that time."""
    sheet: Rows = []
    for rows, recorded in ((before, recorded_before), (after, recorded_after)):
        for row in rows:
            if row["sigma"] is None:
                continue
            line = _line(row, _at(recorded, row["element"], row["event"], row["t"]))
            if row["element"] == SPEED.name:
                line["gnss"] = _gnss_speed(gnss, learnt, zeros_ns[row["event"] - 1] + round(row["t"] * 1e9))
            sheet.append(line)
    return sheet


def _line(row: Mapping[str, Any], recorded: float | None) -> dict[str, Any]:
    element, value, sigma = ELEMENTS[row["element"]], row["value"], row["sigma"]
    line = {name: row[name] for name in ("event", "t", "element", "unit")} | {"recon": value, "recon_std": sigma}
    if recorded is not None:
        accuracy = max(element.share * abs(recorded), element.least) + 0.5 * element.resolution
        doubt = NORMAL_95 * sigma if np.isfinite(sigma) else 0.0
        line |= {"edr": recorded, "edr_accuracy": accuracy, "agrees": abs(value - recorded) <= accuracy + doubt}
    return line


def _at(recorded: pa.Table | None, element: str, event: int, t: float) -> float | None:
    """What a recorder's table has of an element at a time, interpolated; None outside of it."""
    if recorded is None or not recorded.num_rows:
        return None
    value, number, t_s = (vector(recorded, column, gaps=True) for column in ("value", "event", "t"))
    own = np.flatnonzero(
        (number == event) & np.isfinite(value) & (np.array(recorded["element"].to_pylist()) == element)
    )
    own = own[np.unique(t_s[own], return_index=True)[1]]
    found = interpolate(np.array([t]), t_s[own], value[own], _APART_S[element == SPEED.name]) if len(own) else [np.nan]
    return float(found[0]) if np.isfinite(found[0]) else None


def _delay_s(learnt: pa.Table | None) -> float:
    """Of GNSS speeds, as the fuser found it."""
    if learnt is None:
        return 0.0
    rows = {row["name"]: row["value"] for row in learnt.select(["name", "value"]).to_pylist()}
    return float(rows.get("gnss_delay") or 0.0) + float(rows.get("gnss_velocity_delay") or 0.0)


def _gnss_speed(gnss: pa.Table | None, learnt: pa.Table | None, at_ns: int) -> float | None:
    """km/h at a time, with the delay taken off; None where no fix is near."""
    found = _gnss_speeds(gnss, learnt, np.array([at_ns]))
    return None if found is None or not np.isfinite(found[0]) else float(found[0])


def _gnss_speeds(gnss: pa.Table | None, learnt: pa.Table | None, at_ns: np.ndarray) -> Array | None:
    if gnss is None or not has(gnss, "speed"):
        return None
    speed = vector(gnss, "speed", gaps=True)
    known = np.isfinite(speed)
    t_ns, late_ns = time_ns(gnss)[known], at_ns + round(_delay_s(learnt) * 1e9)
    if not len(t_ns):
        return None
    value = 3.6 * np.interp((late_ns - t_ns[0]) * 1e-9, (t_ns - t_ns[0]) * 1e-9, speed[known])
    return np.where((late_ns >= t_ns[0]) & (late_ns <= t_ns[-1]), value, np.nan)


def less_gnss(
    trajectory: pa.Table | None, gnss: pa.Table | None, learnt: pa.Table | None, found: list[tuple[int, int]]
) -> Iterable[Metric]:
    """How far the speed before the first impact is from that of GNSS."""
    if not found or trajectory is None:
        return
    at_ns = found[0][0] - (np.linspace(*_GNSS_S, 41) * 1e9).astype(np.int64)
    own = np.array(
        [3.6 * told[0] if (told := speed_at(trajectory, int(t), None)) is not None else np.nan for t in at_ns]
    )
    other = _gnss_speeds(gnss, learnt, at_ns)
    if other is None or not np.isfinite(own - other).any():
        return
    since, until = _GNSS_S
    note = f"mean from {since:g} to {until:g} s before the crash, {_delay_s(learnt):.2f} s of delay taken off GNSS"
    yield Metric("speed_before_less_gnss", float(np.nanmean(own - other)), "km/h", note=note)


def verdict(sheet: Rows) -> Iterable[Metric]:
    """How much of a recorder's table agrees."""
    compared = [line for line in sheet if "agrees" in line]
    if not compared:
        return
    share = sum(line["agrees"] for line in compared) / len(compared)
    note = f"of {len(compared)} values, within the accuracy of 49 CFR 563 and 95 % of the reconstruction"
    yield Metric("edr_agreement", share, "1", note=note)
    for name in sorted({line["element"] for line in compared if not line["agrees"]}):
        worst = max((line for line in compared if line["element"] == name), key=lambda o: abs(o["recon"] - o["edr"]))
        yield warning(
            f"{name}: the recorder has {worst['edr']:.0f} {worst['unit']} at {worst['t']:.2f} s, the reconstruction "
            f"{worst['recon']:.1f}: slip of wheels, another time zero, or one of them is wrong"
        )
