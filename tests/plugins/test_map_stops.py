"""What fuser.map makes of a vehicle that stands while its receiver errs."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from map_drives import drive, errors, fused

from recon import Streams, matrix, seconds, time_ns, vector
from recon.numerics.signals import runs
from recon.tables import replace

ERRS_S = 13.0


def ends_standing(streams: Streams) -> tuple[Streams, float, float]:
    """A log that ends with its longest standstill behind the first minutes, and when that begins and ends, in s."""
    truth = streams["reference"]
    t_s = seconds(truth)
    spans = t_s[runs(np.linalg.norm(matrix(truth, "vel"), axis=1) < 1e-3) - [0, 1]]
    start, stop = max(spans[spans[:, 0] > 120.0], key=lambda span: span[1] - span[0])
    until = time_ns(truth)[0] + round(stop * 1e9)
    kept = {name: streams[name].filter(pa.array(time_ns(streams[name]) <= until)) for name in ("imu", "gnss")}
    return {**streams, **kept}, float(start), float(stop)


def with_error(gnss: pa.Table, since_ns: int, vel: float, metres: float) -> pa.Table:
    """Fixes that are off by so much from a time on: their velocity to the east, their place to the north."""
    late = time_ns(gnss) >= since_ns
    velocity = matrix(gnss, "vel") + np.outer(late, [vel, 0.0, 0.0])
    return replace(gnss, vel=velocity, lat=vector(gnss, "lat") + late * metres / 111_000.0)


@pytest.mark.parametrize("vel", [0.3, 1.0])
@pytest.mark.parametrize(("sensors", "seed"), [("study_two", 205), ("consumer_mems", 205), ("study_one", 211)])
def test_what_stands_at_the_end_of_a_log_stands_although_the_receiver_errs(sensors: str, seed: int, vel: float) -> None:
    streams, start, stop = ends_standing(drive(sensors=sensors, seed=seed))
    assert stop - start > ERRS_S + 10.0
    since_ns = int(time_ns(streams["reference"])[0]) + round((stop - ERRS_S) * 1e9)
    found = fused({**streams, "gnss": with_error(streams["gnss"], since_ns, vel, 20.0)})
    off = errors(streams, found)
    late = (off.t_s > stop - ERRS_S) & (off.t_s < stop - 0.2)
    sigma = matrix(found["trajectory"], "vel_std")[late, :2]
    assert np.abs(off.vel[late, :2]).max() < 0.05
    assert np.abs(off.vel[late, :2] / sigma).max() < 4.0
