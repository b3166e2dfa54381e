"""First-order low-pass of the inertial channels.

    y_k = y_(k-1) + a (x_k - y_(k-1)),    a = dt / (tau + dt)

It begins at the first sample and lags by the time constant tau. Samples are taken to be evenly spaced.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import IMU, SAME, Array, Filter, Params, Streams, hookimpl, matrix, quantity, replace, time_ns
from recon.numerics.signals import median_rate


class LowpassParams(Params):
    """Parameters of filter.$name."""

    tau: float = quantity(50.0, "ms", gt=0, doc="Time constant: a step is reached to 63 % after it.")


def lowpass(*, imu: pa.Table, params: LowpassParams) -> Streams:
    """The imu with accel and gyro smoothed.

    imu : accel m/s^2, gyro rad/s, any frame
    raises : DataError on missing values
    """
    if imu.num_rows < 2:
        return {"imu": imu}
    share = 1.0 / (params.tau * median_rate(time_ns(imu)) + 1.0)
    return {"imu": replace(imu, **{group: _smooth(matrix(imu, group), share) for group in ("accel", "gyro")})}


def _smooth(x: Array, share: float) -> Array:
    """x : (n, 3). returns : (n, 3), beginning with x[0]."""
    from scipy.signal import lfilter  # slow import: only when used

    smooth, _ = lfilter([share], [1.0, share - 1.0], x, axis=0, zi=(1.0 - share) * x[:1])
    return np.asarray(smooth)


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """filter.$name."""
    yield Filter(
        name="$name",
        summary="First-order low-pass of accel and gyro.",
        params=LowpassParams,
        run=lowpass,
        reads={"imu": IMU.need("accel", "gyro")},
        writes={"imu": SAME},
        linear=True,
        unit_gain=True,
    )
