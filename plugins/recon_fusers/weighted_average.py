"""Continuous weighted average of inertial motion and GNSS.

At every record, with weight w of GNSS and d the step that the fused velocity makes,

    p[k] = (1 - w) (p[k-1] + d[k]) + w p_gnss(t[k])

and likewise for the velocity. With r the difference of GNSS from the inertial position this is p = inertial + e,

    e[k] = (1 - w) e[k-1] + w r[k],    e[k] = e[k-1] where GNSS is absent,

a low-pass of first order with time constant -dt / ln(1 - w). Because w is per record, as in the thesis, the time
constant follows the rate of the log. e begins with the first difference in position, so that the trajectory passes
through the first fix, and with zero in velocity, where the inertial start is better than one noisy fix. After a gap in
the trajectory longer than `max_gap` inertia tells nothing: there e begins anew, both with the first difference.

In the end the speed of the trajectory is compared with that of GNSS, and a strong disagreement gives a warning.

References
    Thesis, chapter 6.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    GNSS,
    SAME,
    TRAJECTORY,
    Fuser,
    Metric,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    seconds,
    setting,
    time_ns,
    vector,
    warning,
)
from recon.agreement import agreement, as_metrics
from recon.numerics.integration import cumulative
from recon.numerics.rotation import Floats
from recon.numerics.signals import interpolate, median_rate
from recon.placing import geolocate


class AverageParams(Params):
    """Parameters of fuser.weighted_average."""

    weight: float = setting(0.01, gt=0, le=1, doc="Weight of the GNSS position at each record.")
    velocity_weight: float = setting(
        0.01, ge=0, le=1, doc="Weight of the GNSS velocity at each record, where GNSS gives its direction too."
    )
    max_gap: float = quantity(
        1.5,
        "s",
        gt=0,
        le=3600,
        doc="Between fixes further apart the weights are zero; records so far apart start anew.",
    )
    vertical: Literal["inertial", "gnss"] = setting(
        "inertial", doc="Height and vertical speed from inertia alone, or averaged as the horizontal ones are."
    )


def weighted_average(*, trajectory: pa.Table, gnss: pa.Table | None, params: AverageParams) -> Streams:
    """Draw the trajectory towards GNSS, position and velocity, record by record."""
    if gnss is None or not (has(gnss, "pos_e") and has(gnss, "pos_n")) or not trajectory.num_rows:
        alone = warning("no GNSS positions: the trajectory is inertial alone")
        return {"trajectory": trajectory, "metrics": metrics([alone, *_compared(trajectory, gnss)])}
    pos_n, vel_n = matrix(trajectory, "pos"), matrix(trajectory, "vel")
    breaks = np.flatnonzero(np.diff(time_ns(trajectory)) > params.max_gap * 1e9) + 1
    behind_vel = _at_records(trajectory, gnss, "vel", params) - vel_n
    error_vel = _drawn(behind_vel, params.velocity_weight, breaks, np.zeros(3))
    pos_n = pos_n + cumulative(seconds(trajectory), error_vel, "trapezoid")
    behind_pos = _at_records(trajectory, gnss, "pos", params) - pos_n
    pos_n = pos_n + _drawn(behind_pos, params.weight, breaks)
    fused = geolocate(replace(trajectory, pos=pos_n, vel=vel_n + error_vel), gnss)
    learnt = [
        *_time_constants(trajectory, behind_pos, "position", params.weight),
        *_time_constants(trajectory, behind_vel, "velocity", params.velocity_weight),
        *_sparse_fixes(gnss, params.max_gap),
        *_compared(fused, gnss),
    ]
    return {"trajectory": fused, "metrics": metrics(learnt)}


def _at_records(trajectory: pa.Table, gnss: pa.Table, group: str, params: AverageParams) -> Floats:
    """What GNSS says at the times of the trajectory: (n, 3), NaN where it says nothing or is not asked."""
    said = np.full((trajectory.num_rows, 3), np.nan)
    asked = "enu" if params.vertical == "gnss" else "en"
    for column, name in enumerate(f"{group}_{axis}" for axis in asked):
        if name in gnss.column_names:
            values = vector(gnss, name, gaps=True)
            said[:, column] = interpolate(time_ns(trajectory), time_ns(gnss), values, params.max_gap * 1e9)
    return said


def _drawn(behind: Floats, weight: float, breaks: NDArray[np.intp], before: Floats | None = None) -> Floats:
    """The recursion e[k] = (1 - w) e[k-1] + w behind[k], which holds e where behind is NaN.

    behind : (n, k); breaks : rows at which e begins anew, with the first number from there on
    before : (k,) e before the first number of all, None for that number itself
    returns : (n, k), zero in columns without a number
    """
    from scipy.signal import lfilter

    result = np.zeros_like(behind)
    if not weight:
        return result
    for column, values in enumerate(behind.T):
        end = 0.0 if before is None else float(before[column])
        anew = before is None
        for piece, target in zip(np.split(values, breaks), np.split(result[:, column], breaks), strict=True):
            known = np.isfinite(piece)
            start = float(piece[known][0]) if anew and known.any() else end
            drawn, _ = lfilter([weight], [1.0, weight - 1.0], piece[known], zi=[(1.0 - weight) * start])
            target[:] = np.concatenate([[start], drawn])[np.cumsum(known)]
            end, anew = float(target[-1]), True
    return result


def _compared(trajectory: pa.Table, gnss: pa.Table | None) -> list[Metric]:
    """How the speed of the trajectory compares with the one that GNSS reports, or with that of its positions."""
    if gnss is None or not (has(gnss, "speed") or (has(gnss, "vel_e") and has(gnss, "vel_n"))):
        return []
    reference = (
        vector(gnss, "speed", gaps=True)
        if has(gnss, "speed")
        else np.hypot(*(vector(gnss, name, gaps=True) for name in ("vel_e", "vel_n")))
    )
    speed = np.hypot(vector(trajectory, "vel_e"), vector(trajectory, "vel_n"))
    found = agreement(time_ns(trajectory), speed, time_ns(gnss), reference)
    return as_metrics(found, "the speed of the trajectory", "gnss speed")


def _time_constants(trajectory: pa.Table, behind: Floats, name: str, weight: float) -> list[Metric]:
    """What the weight means in time, and how many of the records it acts on."""
    if not 0.0 < weight < 1.0 or trajectory.num_rows < 2:
        return []
    seconds_each = 1.0 / median_rate(time_ns(trajectory))
    share = float(np.isfinite(behind[:, :2]).all(axis=1).mean())
    return [
        Metric(f"{name}_time_constant", -seconds_each / float(np.log1p(-weight)), "s", method=f"weight {weight:g}"),
        Metric(f"{name}_records_with_gnss", share, "1"),
    ]


def _sparse_fixes(gnss: pa.Table, max_gap: float) -> list[Metric]:
    rate = median_rate(time_ns(gnss))
    if not rate * max_gap < 1.0:
        return []
    note = f"GNSS has a fix every {1.0 / rate:.1f} s, further apart than max_gap ({max_gap:g} s): it is hardly used"
    return [warning(note)]


@hookimpl
def declare_fusers() -> Iterable[Fuser]:
    """Declare fuser.weighted_average."""
    yield Fuser(
        name="weighted_average",
        summary="Weighted average of inertial motion and GNSS at every record.",
        params=AverageParams,
        reads={
            "trajectory": TRAJECTORY.need("pos", "vel"),
            "gnss": GNSS.need(maybe=["pos", "vel", "speed"], optional=True),
        },
        writes={"trajectory": SAME},
        run=weighted_average,
        budget=0.6,
        references=("Thesis, chapter 6",),
    )
