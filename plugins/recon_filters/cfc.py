"""Channel frequency class of SAE J211 and ISO 6487: the low-pass in which crash pulses are compared.

Coefficients, the run forward and backward and the mirrored ends are those of the standards;
recon.numerics.channel_class has the formulas. The samples are taken as regular, at their median rate; pieces between
gaps are filtered apart. Where the sampling is so slow that the class lies beyond half its rate, nothing is changed.

The analyses of a crash filter by themselves what a standard wants filtered. Put this before a plot or an exporter.

References
    SAE J211-1 (1995), Instrumentation for impact test, part 1, appendix C; ISO 6487:2002, annex A.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import numpy as np
import pyarrow as pa

from recon import (
    IMU,
    SAME,
    Array,
    Filter,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    setting,
    time_ns,
    warning,
)
from recon.numerics import signals
from recon.numerics.channel_class import LEAST_RATE, channel_class

_IRREGULAR = 0.5
"""Share of a step by which the steps may differ before the filter is in doubt."""


class CfcParams(Params):
    """Parameters of filter.cfc."""

    channel_class: Literal[60, 180, 600, 1000] = setting(
        60, doc="60: structure of the vehicle; 180: what is integrated; 600: chest; 1000: head."
    )
    gyro: bool = setting(True, doc="Filter gyro as well as accel.")
    max_gap: float = quantity(0.1, "s", gt=0, le=3600, doc="A longer gap between samples is not filtered across.")


def cfc(*, imu: pa.Table, params: CfcParams) -> Streams:
    """The imu in a channel frequency class.

    imu : accel m/s^2, gyro rad/s, any frame, without missing values (see filter.resample)
    raises : DataError on missing values
    """
    t_ns = time_ns(imu)
    rate_hz = signals.median_rate(t_ns) if len(t_ns) > 1 else np.inf
    steps = np.diff(t_ns)
    cuts = np.flatnonzero(steps > round(params.max_gap * 1e9)) + 1
    groups = ["accel", "gyro"] if params.gyro and "gyro_x" in imu.column_names else ["accel"]
    smooth = {name: _filtered(matrix(imu, name), params.channel_class, rate_hz, cuts) for name in groups}
    learnt = [
        Metric("channel_class", float(params.channel_class), "", method="SAE J211-1, ISO 6487"),
        Metric("sampling_rate", float(rate_hz) if np.isfinite(rate_hz) else None, "Hz", note="median"),
    ]
    return {"imu": replace(imu, **smooth), "metrics": metrics([*learnt, *_doubts(steps, cuts, rate_hz, params)])}


def _filtered(y: Array, cfc: float, rate_hz: float, cuts: np.ndarray) -> Array:
    """y (n, 3) filtered in each piece between the rows `cuts`."""
    if not np.isfinite(rate_hz):
        return y
    return np.concatenate([channel_class(piece, cfc, rate_hz) for piece in np.split(y, cuts)])


def _doubts(steps: np.ndarray, cuts: np.ndarray, rate_hz: float, params: CfcParams) -> Iterable[Metric]:
    least = LEAST_RATE * params.channel_class
    if rate_hz < (1.0 - 1e-3) * least:  # times of whole nanoseconds round the rate
        yield warning(
            f"CFC {params.channel_class} wants {least:.0f} samples per second, here are {rate_hz:.0f}: "
            "what was faster than half of that may be aliased into the pulse"
        )
    within = np.delete(steps, cuts - 1) * 1e-9 * rate_hz
    if len(within) and np.abs(within - 1.0).max() > _IRREGULAR:
        yield warning("the samples are not regular: put filter.resample before filter.cfc")


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.cfc."""
    yield Filter(
        name="cfc",
        summary="Channel frequency class 60, 180, 600 or 1000 of SAE J211 and ISO 6487.",
        params=CfcParams,
        reads={"imu": IMU.need("accel", maybe=["gyro"])},
        writes={"imu": SAME},
        run=cfc,
        linear=True,
        unit_gain=True,
        references=("SAE J211-1 (1995)", "ISO 6487:2002"),
    )
