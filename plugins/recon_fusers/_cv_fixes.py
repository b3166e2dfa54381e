"""What fuser.kalman_cv made of the fixes: their innovations, the spans without one, how many it doubted."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import RESIDUALS, Event, Metric, build, warning
from recon.numerics.constant_velocity import Innovations

OUTAGE_S: Final = 3.0
SUSPICIOUS: Final = 0.05
"""Share of fixes that are doubted, above which something else is wrong."""
_AXES: Final = ("e", "n", "u")


def residuals(fix_ns: NDArray[np.int64], seen: Innovations, gate: float) -> pa.Table:
    """The innovations, axis by axis."""
    count = 3 * len(fix_ns)
    value, sigma, weight = seen.value.ravel(), np.sqrt(seen.variance).ravel(), seen.weight.ravel()
    return build(
        RESIDUALS,
        time=np.repeat(fix_ns, 3),
        sensor=pa.repeat(pa.scalar("gnss"), count),
        component=pa.array([f"pos_{axis}" for axis in _AXES] * len(fix_ns), pa.string()),
        value=value,
        sigma=sigma,
        weight=weight,
        accepted=pa.array(np.abs(value) <= gate * sigma),
    )


def outages(t_ns: NDArray[np.int64], fix_ns: NDArray[np.int64]) -> list[Event]:
    """Spans without a fix that is due, from the first row of imu to the last."""
    edges = np.concatenate([t_ns[:1], fix_ns, t_ns[-1:]])
    step_s = np.diff(edges) * 1e-9
    usual = float(np.median(np.diff(fix_ns))) * 1e-9 if len(fix_ns) > 1 else 0.0
    long = np.flatnonzero(step_s > max(OUTAGE_S, 2.5 * usual))
    return [Event(int(edges[i]), int(edges[i + 1]), "outage", float(step_s[i]), "s") for i in long]


def counts(t_ns: NDArray[np.int64], kept: NDArray[np.int64], seen: Innovations, gate: float) -> list[Metric]:
    """What was left out, and what was doubted."""
    far = np.asarray((np.abs(seen.value) > gate * np.sqrt(seen.variance)).any(axis=1))
    found = [
        Metric("rows_before_the_first_fix", float(len(t_ns) - len(kept)), note="left out: no place is known there"),
        Metric("fixes", float(len(far) + 1)),
        Metric("fixes_doubted", float(far.sum()), note=f"further than {gate:g} sigmas from the prediction"),
    ]
    if len(far) and far.mean() > SUSPICIOUS:
        share = f"{100.0 * far.mean():.0f} % of the fixes are further than {gate:g} sigmas from the prediction"
        found.append(warning(f"{share}: is the attitude right? else raise accel_noise, or the sigmas of the fixes"))
    return found
