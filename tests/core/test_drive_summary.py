"""Distance, duration and top speed, with what is missing left out."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

from recon.drive_summary import summarize
from recon.numerics.rotation import from_euler
from recon.rows import Event, events
from recon.schema import GNSS, TRAJECTORY
from recon.tables import build, matrix, replace

EPS = np.finfo(float).eps
START_NS = 1714550400_000000000


def line() -> pa.Table:
    """Ten seconds at (3, 4, 0) m/s."""
    t_s = np.arange(11.0)
    vel = np.tile([3.0, 4.0, 0.0], (11, 1))
    time = START_NS + np.arange(11) * 1_000_000_000
    return build(TRAJECTORY, time=time, pos=t_s[:, None] * vel, vel=vel, q=from_euler(np.zeros(11), 0.0, 0.0))


def test_a_summary_comes_from_the_trajectory_else_from_gnss() -> None:
    found = summarize(line(), None)
    assert found == pytest.approx({"distance": 50.0, "duration": 10.0, "top_speed": 5.0}, rel=10.0 * EPS)
    gnss = build(GNSS, time=START_NS + np.arange(3), speed=np.array([1.0, np.nan, 7.0]))
    apart = build(GNSS, time=START_NS + np.arange(3) * 4_000_000_000, speed=np.array([1.0, 2.0, 7.0]))
    assert summarize(None, gnss)["top_speed"] == 7.0
    assert summarize(None, apart) == pytest.approx({"duration": 8.0, "top_speed": 7.0, "distance": 6.0 + 18.0})
    outage = build(GNSS, time=START_NS + np.array([0, 1, 60]) * 1_000_000_000, speed=np.ones(3))
    assert "distance" not in summarize(None, outage)
    assert summarize(line().slice(0, 0), None) == summarize(None, None) == {}
    gap = line()
    pos = matrix(gap, "pos")
    pos[3:6] = np.nan
    assert summarize(replace(gap, pos=pos), None) == pytest.approx(found, rel=10.0 * EPS)
    silent = build(GNSS, time=START_NS + np.arange(3), speed=np.full(3, np.nan))
    assert summarize(replace(gap, pos=np.full_like(pos, np.nan)), silent) == {"duration": pytest.approx(2e-9)}


def test_no_stops_are_told_where_nothing_could_look_for_one() -> None:
    begin = START_NS + 2_000_000_000
    nothing, crash, stop = (
        events(found) for found in ([], [Event(begin, begin, "crash")], [Event(begin, begin + 9, "standstill")])
    )
    assert summarize(line(), None, nothing)["stops"] == summarize(line(), None, crash)["stops"] == 0
    assert "stops" not in summarize(None, None, crash)
    assert summarize(None, None, stop) == {"stops": 1}
