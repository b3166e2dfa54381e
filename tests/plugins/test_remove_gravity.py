from __future__ import annotations

import numpy as np
import pytest

from recon import ATTITUDE, GNSS, IMU, Event, build, events, matrix, with_meta
from recon.errors import DataError
from recon.numerics.motion import hill, specific_force
from recon.numerics.rotation import conjugate, rotate
from recon_filters.remove_gravity import GravityParams, declare_filters, remove_gravity

G = 9.80665
STOP = events([Event(0, 9_000_000_000, "standstill")])


def tables(truth, accel):
    t_ns = np.round(truth.t_s * 1e9).astype(np.int64)
    return (
        build(IMU, time=t_ns, accel=accel, gyro=truth.gyro_v),
        build(ATTITUDE, time=t_ns, q=truth.q_nv),
    )


def drive(accel_scale=1.0, noise=0.0):
    """Over a hill, so that gravity leans: truth, imu, attitude."""
    truth = hill().at(np.arange(0.0, 40.0, 0.01))
    scatter = np.random.default_rng(7).normal(0.0, noise, (len(truth.t_s), 3))
    return truth, *tables(truth, specific_force(truth, G) * accel_scale + scatter)


def clean(imu, attitude, stops=None, gnss=None, **params):
    return remove_gravity(imu=imu, attitude=attitude, events=stops, gnss=gnss, params=GravityParams(**params))


def gravity(result):
    (row,) = result["metrics"].to_pylist()
    return row


def test_what_is_left_is_the_acceleration_also_on_slopes():
    truth, imu, attitude = drive()
    result = clean(imu, attitude, magnitude="normal")
    expected = rotate(conjugate(truth.q_nv), truth.acc_n)
    np.testing.assert_allclose(matrix(result["imu"], "accel"), expected, atol=1e-13)
    np.testing.assert_array_equal(matrix(result["imu"], "gyro"), matrix(imu, "gyro"))


def test_a_scale_error_does_not_stay_behind_as_acceleration_at_rest():
    _, imu, attitude = drive(accel_scale=1.0105)
    result = clean(imu, attitude, STOP)
    still = matrix(result["imu"], "accel")[:900]
    np.testing.assert_allclose(still, 0.0, atol=1e-12)
    assert gravity(result)["value"] == pytest.approx(1.0105 * G, rel=1e-12)
    assert "measured" in gravity(result)["method"]


def test_vibration_at_rest_does_not_lengthen_gravity():
    # The mean of |f| would be too long by sigma^2 / g = 0.4 m/s^2; the mean vector of 901 samples is uncertain by
    # sigma / sqrt(901) = 0.067 m/s^2, and its length gains 2 (0.067)^2 / (2 g) from the horizontal axes, which is less.
    _, imu, attitude = drive(noise=2.0)
    assert gravity(clean(imu, attitude, STOP))["value"] == pytest.approx(G, abs=4 * 0.067)


def test_longer_stops_count_more():
    truth, imu, attitude = drive()
    accel = matrix(imu, "accel")
    accel[:100] *= 1.1
    imu, _ = tables(truth, accel)
    stops = events([Event(0, 990_000_000, "standstill"), Event(1_000_000_000, 3_990_000_000, "standstill")])
    assert gravity(clean(imu, attitude, stops))["value"] == pytest.approx(G * (1.1 + 3.0) / 4.0, rel=1e-12)


def test_without_a_stop_standard_gravity_is_used_and_said():
    _, imu, attitude = drive(accel_scale=1.0105)
    row = gravity(clean(imu, attitude))
    assert (row["value"], row["method"], row["note"]) == (G, "standard", "no stop to measure it")


@pytest.mark.parametrize("stops", [None, STOP])
def test_normal_gravity_is_that_of_the_place(stops):
    _, imu, attitude = drive()
    gnss = with_meta(build(GNSS, time=np.zeros(1, dtype=np.int64)), anchor={"lat": 90.0, "lon": 0.0, "height": 0.0})
    row = gravity(clean(imu, attitude, stops, gnss, magnitude="normal"))
    assert row["value"] == pytest.approx(9.8321849379, abs=1e-9)  # TR8350.2, table 3.4: normal gravity at the pole
    assert "anchor" in row["method"]


def test_an_attitude_at_other_times_is_refused():
    _, imu, attitude = drive()
    with pytest.raises(DataError, match="same times"):
        clean(imu, attitude.slice(1))


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_few_rows_are_no_matter(rows):
    _, imu, attitude = drive()
    result = clean(imu.slice(0, rows), attitude.slice(0, rows), STOP)
    np.testing.assert_allclose(matrix(result["imu"], "accel"), np.zeros((rows, 3)), atol=1e-13)


def test_the_record_is_without_faults():
    (record,) = declare_filters()
    assert record.faults() == []
