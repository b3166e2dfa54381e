"""What may have happened while the IMU was silent is of the size of what did."""

from __future__ import annotations

import numpy as np
import pytest
from map_drives import drive

from recon.numerics.smoothing.disturbances import Disturbances
from recon.numerics.smoothing.model import Noise
from recon.numerics.smoothing.samples import regular_samples
from recon.tables import matrix, seconds

NO_NOISE = Noise(0.0, 0.0, 0.0, 0.0, np.ones(3), 100.0, np.ones(3), np.ones(3))


@pytest.mark.parametrize("gap_s", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("motion", ["city", "mixed"])
def test_a_line_through_a_silence_errs_by_less_than_is_believed_but_not_by_far_less(motion: str, gap_s: float) -> None:
    imu = drive(motion, sensors="consumer_mems", seed=12000, outages=())["imu"]
    t_s = seconds(imu)
    count = round(gap_s * 100.0)
    missed = {}
    for name in ("gyro", "accel"):
        of = matrix(imu, name)
        first = np.arange(0, len(of) - count, 25)
        total = np.cumsum(of, axis=0)
        mean = (total[first + count] - total[first]) / count
        missed[name] = np.sqrt((((mean - 0.5 * (of[first] + of[first + count])) * gap_s) ** 2).mean(axis=0)).max()
    kept = (t_s < 100.0) | (t_s >= 100.0 + gap_s)
    samples = regular_samples(t_s[kept], matrix(imu, "gyro")[kept], matrix(imu, "accel")[kept])
    silent = Disturbances.of(samples, ())
    length = np.diff(samples.knot_times)
    densities = silent.densities(NO_NOISE)
    believed = [float(np.sqrt((density**2 * length)[silent.gap_s > 0.0].sum())) for density in densities]
    # Motion has peaks: one silence in a hundred misses three to five times the root mean square.
    for name, sigma in zip(("gyro", "accel"), believed, strict=True):
        assert 0.15 * sigma < missed[name] < sigma
