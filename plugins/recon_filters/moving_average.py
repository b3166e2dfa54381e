"""Centred moving average of the inertial channels.

    v_i = mean(y_(i-h), ..., y_(i+h)),    2 h + 1 samples

Near the ends, and beside a gap, the window shrinks symmetrically: no sample is dropped, the first and the last keep
their value, and a straight line passes unchanged.

The window flattens: the mean of a half-sine pulse as long as the window is 2/pi of its peak, and a pulse is seen half
a window before it begins. As a low-pass its gain is sinc(f w), zero at 1/w and at its multiples, with sidelobes of
-13 dB between them; an aliased vibration in these is not removed.

References
    The thesis on vehicle reconstruction from inertial and GNSS data, section 4.3.
    Smith (1997), "The scientist and engineer's guide to digital signal processing", chapter 15.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

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
    time_ns,
    warning,
)
from recon.numerics import moving_window
from recon.numerics.signals import median_rate


class MovingAverageParams(Params):
    """Parameters of filter.moving_average."""

    window: float = quantity(
        0.05, "s", gt=0, le=60, doc="Width of the window. A wide one flattens peaks and shows a pulse before it begins."
    )
    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="A longer gap between samples is not averaged across.")


def moving_average(*, imu: pa.Table, params: MovingAverageParams) -> Streams:
    """The imu with accel and gyro averaged.

    imu : accel m/s^2, gyro rad/s, any frame, without missing values (see filter.resample)
    raises : DataError on missing values
    """
    t_ns = time_ns(imu)
    samples = _samples(t_ns, params.window)
    cuts = np.flatnonzero(np.diff(t_ns) > round(params.max_gap * 1e9)) + 1
    smooth = {group: _averaged(matrix(imu, group), samples, cuts) for group in ("accel", "gyro")}
    learnt = [
        Metric("window", float(samples), "", note="samples"),
        Metric("gaps", float(len(cuts)), note=f"longer than {params.max_gap:g} s"),
    ]
    if samples == 1:
        learnt.append(warning(f"a window of {params.window:g} s holds one sample: nothing is averaged"))
    return {"imu": replace(imu, **smooth), "metrics": metrics(learnt)}


def _samples(t_ns: NDArray[np.int64], window_s: float) -> int:
    """The odd number of samples that comes closest to the window at the median rate."""
    if len(t_ns) < 2:
        return 1
    return 2 * max(round((window_s * median_rate(t_ns) - 1.0) / 2.0), 0) + 1


def _averaged(y: Array, samples: int, cuts: NDArray[np.intp]) -> Array:
    """y (n, 3) averaged in each piece between the rows `cuts`."""
    return np.concatenate([moving_window.moving_average(piece, samples) for piece in np.split(y, cuts)])


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.moving_average."""
    yield Filter(
        name="moving_average",
        summary="Centred moving average of accel and gyro.",
        params=MovingAverageParams,
        reads={"imu": IMU.need("accel", "gyro")},
        writes={"imu": SAME},
        run=moving_average,
        linear=True,
        unit_gain=True,
    )
