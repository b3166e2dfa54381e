from __future__ import annotations

import numpy as np
import pytest

from recon import ATTITUDE, GNSS, IMU, Event, build, events, matrix, with_meta
from recon.errors import DataError
from recon.numerics.geodesy import normal_gravity
from recon.numerics.motion import hill, specific_force
from recon.numerics.rotation import conjugate, from_euler, multiply, rotate
from recon.schema import Change
from recon.tables import conform
from recon_filters._gravity import GravityParams
from recon_filters.absolute_acceleration import absolute_acceleration, declare_filters

G = 9.80665
MOUNTING = from_euler(0.4, 1.2, -0.7)
"""A box that lies anyhow."""
ROUNDING = 1e-12
"""m/s^2; a few roundings of 10."""
PLACE = with_meta(build(GNSS, time=np.zeros(1, dtype=np.int64)), anchor={"lat": 48.08, "lon": 11.6, "height": 560.0})


def drive(scale=1.0, gravity=G):
    """Over a hill, so that gravity leans: the truth, imu along the axes of the box, the attitude of the box."""
    truth = hill().at(np.arange(0.0, 40.0, 0.01))
    t_ns = np.round(truth.t_s * 1e9).astype(np.int64)
    accel_s = rotate(conjugate(MOUNTING), specific_force(truth, gravity)) * scale
    imu = build(IMU, time=t_ns, accel=accel_s, gyro=truth.gyro_v)
    return truth, imu, build(ATTITUDE, time=t_ns, q=multiply(truth.q_nv, MOUNTING))


def run(imu, attitude, stops=None, gnss=None, **params):
    return absolute_acceleration(imu=imu, attitude=attitude, events=stops, gnss=gnss, params=GravityParams(**params))


def of_sensor(attitude):
    schema = Change(frames={"q": "sensor"}).apply(ATTITUDE)
    return conform(attitude, schema, stream="attitude", step="test")


def test_it_is_the_change_of_velocity_whichever_way_the_box_lies():
    truth, imu, attitude = drive()
    found = run(imu, of_sensor(attitude))["imu"]
    np.testing.assert_allclose(matrix(found, "accel"), truth.acc_n, rtol=0.0, atol=ROUNDING)
    np.testing.assert_array_equal(matrix(found, "gyro"), matrix(imu, "gyro"))


def test_gravity_is_that_of_the_box_where_it_stands_else_of_the_place():
    stop = events([Event(0, 9_000_000_000, "standstill")])
    truth, imu, attitude = drive(scale=1.018)  # as a real box reads
    found = run(imu, of_sensor(attitude), stop)
    np.testing.assert_allclose(matrix(found["imu"], "accel"), 1.018 * truth.acc_n, rtol=0.0, atol=100.0 * ROUNDING)
    (row,) = found["metrics"].to_pylist()
    assert (row["name"], row["method"]) == ("gravity", "measured at 1 stops")
    truth, imu, attitude = drive(gravity=float(normal_gravity(48.08, 560.0)))
    found = run(imu, of_sensor(attitude), gnss=PLACE)["imu"]
    np.testing.assert_allclose(matrix(found, "accel"), truth.acc_n, rtol=0.0, atol=ROUNDING)


def test_the_attitude_of_another_body_is_refused():
    _, imu, attitude = drive()
    with pytest.raises(DataError, match=r"imu\.accel is along the axes 'sensor' and attitude is that of 'vehicle'"):
        run(imu, attitude)


def test_an_attitude_at_other_times_is_refused():
    _, imu, attitude = drive()
    with pytest.raises(DataError, match="do not have the same times"):
        run(imu, of_sensor(attitude.slice(1)))


def test_the_declaration_has_no_fault():
    assert [stage.faults() for stage in declare_filters()] == [[]]
