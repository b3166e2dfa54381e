"""Distance, duration and top speed, with what is missing left out."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest

import recon
from recon.drive_summary import summarize
from recon.numerics.rotation import from_euler
from recon.recording import Recording
from recon.rows import Event, events
from recon.schema import GNSS, TRAJECTORY
from recon.tables import build, matrix, replace
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

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
    slow = build(GNSS, time=START_NS + np.arange(3), speed=np.array([3.0, 0.1, 3.0]))
    assert "stops" not in summarize(None, slow, crash)
    assert summarize(None, build(GNSS, time=START_NS + np.arange(2), speed=np.ones(2)), crash)["stops"] == 0
    assert summarize(None, None, stop) == {"stops": 1}


def driven(speed: np.ndarray, sigma: np.ndarray | float = 0.05) -> pa.Table:
    """Rows a tenth of a second apart, eastwards."""
    vel = np.outer(speed, [1.0, 0.0, 0.0])
    still = from_euler(np.zeros(len(speed)), 0.0, 0.0)
    columns = {"pos": np.cumsum(vel, axis=0) * 0.1, "vel": vel, "q": still}
    time = START_NS + np.arange(len(speed)) * 100_000_000
    return build(TRAJECTORY, time=time, **columns, vel_std=np.outer(np.broadcast_to(sigma, len(speed)), np.ones(3)))


def standing(*spans_s: tuple[float, float]) -> pa.Table:
    return events(Event(START_NS + round(a * 1e9), START_NS + round(b * 1e9), "standstill") for a, b in spans_s)


def test_a_slammed_door_ends_no_stop_and_driving_off_does() -> None:
    speed = np.full(400, 0.02)
    speed[35:37] = 0.06  # the door
    assert summarize(driven(speed), None, standing((0.0, 3.0), (4.0, 39.0)))["stops"] == 1
    speed[200:250] = 0.7  # it rolls back
    assert summarize(driven(speed), None, standing((0.0, 3.0), (4.0, 19.0), (26.0, 39.0)))["stops"] == 2


def test_a_vehicle_that_stands_goes_no_way_and_one_on_a_ferry_does() -> None:
    speed = np.append(np.full(300, 0.02), np.full(100, 5.0))
    # the 9 steps behind the standstill count with 0.02 m/s, the 100 that follow with 5 m/s
    assert summarize(driven(speed), None, standing((0.0, 29.0)))["distance"] == pytest.approx(50.0 + 0.018, abs=1e-9)
    carried = np.full(100, 5.0)
    assert summarize(driven(carried), None, standing((0.0, 9.9)))["distance"] == pytest.approx(99 * 0.5)


def test_a_top_speed_is_one_that_is_known() -> None:
    speed, sigma = np.full(100, 20.0), np.full(100, 0.05)
    speed[50], sigma[50] = 21.0, 2.0  # in a pulse that the sensor clipped
    speed[70] = 20.2
    found = summarize(driven(speed, sigma), None)
    assert found["top_speed"] == 20.2
    assert found["top_speed_sigma"] == pytest.approx(0.05)


@pytest.mark.parametrize(("outage_s", "at_least", "at_most"), [(0.0, 0.05, 1.0), (14.0, 1.0, 30.0)])
def test_a_distance_that_gnss_leaves_open_has_the_sigma_of_it(outage_s: float, at_least: float, at_most: float) -> None:
    """A drive of 44 s, in the second case without fixes from right before the impact on."""
    params = DriveParams(
        motion="crash", seed=3, accel_full_scale=1000.0, outages=((44.0 - outage_s, 60.0),) if outage_s else ()
    )
    log = simulate_drive(params)
    found = recon.run("best_accuracy", Recording({name: log[name] for name in ("imu", "gnss")})).summary()
    way = np.linalg.norm(np.diff(matrix(log["reference"], "pos"), axis=0), axis=1).sum()
    assert at_least < found["distance_sigma"] < at_most
    assert abs(found["distance"] - way) < 3.0 * found["distance_sigma"]
