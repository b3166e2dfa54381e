"""Sets right the stamps of GNSS that is late against the IMU.

Whatever the mounting, the change of the speed over ground between two fixes follows from the accelerometer's axes, and
that of the course from the gyroscope's, if they are read at the time that the fixes describe. The lag at which they do
so best is taken off every stamp of gnss:

    t_new = t - lag

The lag is that of velocities; those and positions of one fix are taken to be equally late. Where no lag stands out,
nothing is shifted. See recon.numerics.smoothing.lag for the model. A lag that is known, and how fast it grows, as
`recon doctor` finds them, may be given instead:

    t_new = t - shift - drift (t - first row of imu)

References
    Knapp, Carter (1976), "The generalized correlation method for estimation of time delay", IEEE T-ASSP 24(4).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pyarrow as pa

from recon import (
    GNSS,
    IMU,
    SAME,
    Aligner,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    quantity,
    seconds,
    time_ns,
    warning,
)
from recon.errors import NotEnoughData
from recon.tables import replace, times
from recon_aligners._over_ground import course_of, speed_of

_BLOCK_S = 0.1


class TimeOffsetParams(Params):
    """Parameters of aligner.time_offset."""

    largest: float = quantity(2.0, "s", gt=0, le=60, doc="Lags are sought up to this, late and early.")
    shift: float | None = quantity(None, "s", doc="Taken off every stamp of gnss; none: found from the drive.")
    drift: float = quantity(0.0, "us/s", ge=-1e5, le=1e5, doc="By how much the clock of gnss gains on that of imu.")


def shift_gnss(*, imu: pa.Table, gnss: pa.Table, params: TimeOffsetParams) -> Streams:
    """Take the lag found off the times of gnss. Raises NotEnoughData where imu is empty."""
    from recon.numerics.smoothing import regular_samples  # slow import: only when used
    from recon.numerics.smoothing.lag import find_lag
    from recon.numerics.smoothing.stops import block_means

    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    if params.shift is not None or params.drift:
        return _as_told(imu, gnss, params.shift or 0.0, params.drift)
    speed = speed_of(gnss)
    if speed is None:
        return _unshifted(gnss, "gnss holds no speed")
    try:
        samples = regular_samples(seconds(imu), matrix(imu, "gyro"), matrix(imu, "accel"))
    except ValueError as error:
        return _unshifted(gnss, str(error))
    size = max(1, round(_BLOCK_S / float(np.median(np.diff(samples.t_s)))))
    fix_s = seconds(gnss, since=int(time_ns(imu)[0]))
    lag = find_lag(block_means(samples, size), fix_s, speed, course_of(gnss), params.largest)
    if not np.isfinite(lag.sigma):
        return _unshifted(gnss, f"no lag up to {params.largest:g} s explains the speeds clearly better than others")
    shifted = replace(gnss, time=times(time_ns(gnss) - round(lag.seconds * 1e9)))
    note = "positive: fixes were stamped too late; taken off the times of gnss"
    learnt = Metric("gnss_delay", lag.seconds, "s", lag.sigma, method="regression on the IMU", note=note)
    return {"gnss": shifted, "metrics": metrics([learnt])}


def _as_told(imu: pa.Table, gnss: pa.Table, shift: float, drift: float) -> Streams:
    since_s = seconds(gnss, since=int(time_ns(imu)[0]))
    off_ns = np.rint(1e9 * (shift + drift * (since_s - shift))).astype(np.int64)
    learnt = Metric("gnss_delay", shift, "s", method="given", note="taken off the times of gnss")
    return {"gnss": replace(gnss, time=times(time_ns(gnss) - off_ns)), "metrics": metrics([learnt])}


def _unshifted(gnss: pa.Table, why: str) -> Streams:
    return {"gnss": gnss, "metrics": metrics([warning(f"the times of gnss were left as they are: {why}")])}


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.time_offset."""
    yield Aligner(
        name="time_offset",
        summary="Finds how late GNSS is against the IMU, for any mounting, and takes it off the times of gnss.",
        params=TimeOffsetParams,
        reads={"imu": IMU.need("accel", "gyro"), "gnss": GNSS.need(maybe=["speed", "course", "vel"])},
        writes={"gnss": SAME},
        run=shift_gnss,
        references=("Knapp, Carter 1976",),
    )
