from __future__ import annotations

import numpy as np
import pytest

from recon import ATTITUDE, GNSS, IMU, TRAJECTORY, Event, build, events, matrix, meta, metrics, vector, with_meta
from recon.errors import DataError
from recon.numerics.geodesy import SPHERE, WGS84, Anchor, geodetic_to_enu
from recon.placing import anchor_of, attitude_of, geolocate, rows_during, silence_warnings, silent_steps
from recon.rows import warnings_of

BOLOGNA = {"lat": 44.5, "lon": 11.35, "height": 60.0}


def imu_at(*t_ns):
    zeros = np.zeros((len(t_ns), 3))
    return build(IMU, time=np.array(t_ns, dtype=np.int64), accel=zeros, gyro=zeros)


def attitude_at(*t_ns):
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(t_ns), 1))
    return build(ATTITUDE, time=np.array(t_ns, dtype=np.int64), q=q)


def trajectory_at(pos):
    return build(TRAJECTORY, time=np.arange(len(pos), dtype=np.int64), pos=pos)


def test_rows_during_events_include_both_ends():
    found = rows_during(imu_at(0, 10, 20, 30, 40), events([Event(10, 30, "standstill")]), "standstill")
    assert found.tolist() == [[1, 4]]


def test_events_that_overlap_count_once():
    stops = events([Event(0, 20, "standstill"), Event(10, 30, "standstill"), Event(50, 60, "standstill")])
    assert rows_during(imu_at(0, 10, 20, 30, 40, 50, 60), stops, "standstill").tolist() == [[0, 4], [5, 7]]


def test_events_without_rows_and_of_other_kinds_are_left_out():
    stops = events([Event(11, 19, "standstill"), Event(0, 40, "crash"), Event(90, 99, "standstill")])
    assert rows_during(imu_at(0, 10, 20), stops, "standstill").tolist() == []


@pytest.mark.parametrize("t_ns", [(), (5,)])
def test_rows_during_no_events_are_none(t_ns):
    assert rows_during(imu_at(*t_ns), None, "standstill").shape == (0, 2)


def test_attitude_at_other_times_than_the_imu_is_refused():
    assert attitude_of(imu_at(0, 10), attitude_at(0, 10)).shape == (2, 4)
    with pytest.raises(DataError, match="same times"):
        attitude_of(imu_at(0, 10), attitude_at(0, 11))


@pytest.mark.parametrize(("earth", "ellipsoid"), [("wgs84", WGS84), ("sphere", SPHERE)])
def test_a_trajectory_is_located_with_the_anchor_and_figure_of_the_earth_of_its_positions(earth, ellipsoid):
    pos = np.array([[0.0, 0.0, 0.0], [1000.0, -2000.0, 30.0]])
    gnss = with_meta(build(GNSS, time=np.zeros(1, dtype=np.int64)), anchor=BOLOGNA, earth=earth, height_datum="msl")
    located = geolocate(trajectory_at(pos), gnss)
    place = [vector(located, name) for name in ("lat", "lon", "height")]
    # One unit of rounding of a coordinate of 6.4e6 m is 1e-9 m; some tens of operations.
    np.testing.assert_allclose(geodetic_to_enu(*place, Anchor(**BOLOGNA), ellipsoid), pos, atol=1e-7)
    assert {"anchor": BOLOGNA, "earth": earth, "height_datum": "msl"}.items() <= meta(located).items()
    assert anchor_of(located) == Anchor(**BOLOGNA)


def test_without_an_anchor_the_place_is_null_and_no_old_anchor_stays():
    old = with_meta(trajectory_at(np.ones((2, 3))), anchor=BOLOGNA)
    located = geolocate(old, None)
    assert np.isnan(matrix(located, "lat", gaps=True)).all()
    assert located["height"].null_count == 2
    assert anchor_of(located) is None


SECOND = 10**9


def test_steps_longer_than_a_gap_are_silent():
    imu = imu_at(0, SECOND // 2, SECOND, 3 * SECOND)
    assert silent_steps(imu, 0.5, 600.0).tolist() == [False, False, True]
    assert silent_steps(imu_at(5), 0.5, 600.0).tolist() == silent_steps(imu_at(), 0.5, 600.0).tolist() == []


def test_a_hole_is_refused_with_its_place():
    with pytest.raises(DataError, match=r"no imu for 3\.0 days from 1\.0 s after the first"):
        silent_steps(imu_at(0, SECOND, (3 * 86400 + 1) * SECOND), 0.5, 600.0)


def test_silences_are_told_with_time_and_length_and_many_are_counted():
    imu = imu_at(*(2 * SECOND * np.arange(6)))
    notes = warnings_of(metrics(silence_warnings(imu, silent_steps(imu, 0.5, 600.0), "it is held")))
    assert len(notes) == 4
    assert notes[1] == ("no imu for 2.0 s from 2.0 s after the first row: what happened there is unknown, it is held")
    assert notes[3] == "no imu in 2 more gaps; 10.0 s are missing in all"
