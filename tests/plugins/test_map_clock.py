"""fuser.map and a receiver whose clock runs away from that of the IMU."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from map_drives import drive, errors, fused, numbers

from recon import Streams, time_ns
from recon.rows import warnings_of


def running(streams: Streams, ppm: float) -> Streams:
    """Fixes whose stamps run ahead of the IMU's by so much, and agree at the start."""
    gnss, start_ns = streams["gnss"], time_ns(streams["imu"])[0]
    since = time_ns(gnss) - start_ns
    at = gnss.column_names.index("time")
    stamps = pa.array(start_ns + since + np.rint(since * ppm * 1e-6).astype(np.int64)).cast(gnss.schema.field(at).type)
    return {**streams, "gnss": gnss.set_column(at, gnss.schema.field(at), stamps)}


def clock(found: Streams) -> tuple[float, float]:
    """Drift of the clocks and its sigma, ppm."""
    (row,) = (row for row in found["metrics"].to_pylist() if row["name"] == "gnss_clock_drift")
    assert row["unit"] == "ppm"
    return row["value"], row["sigma"]


@pytest.fixture(scope="module")
def streams() -> Streams:
    return drive("mixed", seed=41, duration=1500.0)


@pytest.mark.parametrize("ppm", [-100.0, 0.0, 100.0])
def test_the_drift_of_the_clocks_is_found_and_costs_nothing(streams: Streams, ppm: float) -> None:
    """In the 25 minutes, of which 20 tell the noise, 100 ppm are .15 s: 2 m at 14 m/s."""
    right, off = fused(streams), fused(running(streams, ppm))
    drift, sigma = clock(off)
    assert sigma < 15.0
    assert abs(drift - ppm) < 3.0 * sigma
    assert errors(streams, off).velocity < 1.05 * errors(streams, right).velocity
    assert errors(streams, off).heading < 1.1 * errors(streams, right).heading
    # The stamp in the middle is late by what the delay tells.
    late = numbers(off)["gnss_delay"] - numbers(right)["gnss_delay"]
    assert late == pytest.approx(750.0 * ppm * 1e-6, abs=0.01)
    assert not warnings_of(off["metrics"])


def test_what_no_clock_does_is_told(streams: Streams) -> None:
    notes = [note for note in warnings_of(fused(running(streams, 400.0))["metrics"]) if "run apart" in note]
    assert len(notes) == 1


def test_one_clock_has_no_drift(streams: Streams) -> None:
    assert "gnss_clock_drift" not in numbers(fused(streams, gnss_clock_drift=0.0))
