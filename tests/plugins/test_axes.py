from __future__ import annotations

import numpy as np
import pytest
from helpers import clock
from pydantic import ValidationError

from recon import IMU, build, matrix
from recon_aligners.axes import AxesParams, set_axes

ACCEL = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, np.nan]])
GYRO = 10.0 * ACCEL


def made(**params):
    imu = build(IMU, time=clock(2), accel=ACCEL, gyro=GYRO)
    result = set_axes(imu=imu, params=AxesParams(**params))["imu"]
    return tuple(matrix(result, name, gaps=True) for name in ("accel", "gyro"))


def test_by_default_nothing_changes():
    accel, gyro = made()
    np.testing.assert_array_equal(accel, ACCEL)
    np.testing.assert_array_equal(gyro, GYRO)


def test_axes_that_point_backwards_right_and_up_are_turned_forward_left_and_up():
    accel, gyro = made(axes="BRU")
    np.testing.assert_array_equal(accel, ACCEL * [-1.0, -1.0, 1.0])
    np.testing.assert_array_equal(gyro, GYRO * [-1.0, -1.0, 1.0])


def test_two_axes_that_were_swapped_change_places():
    np.testing.assert_array_equal(made(axes="LFU")[0], ACCEL[:, [1, 0, 2]])


def test_at_rest_down_turns_the_sign_of_the_accelerometer_alone():
    accel, gyro = made(at_rest="down")
    np.testing.assert_array_equal(accel, -ACCEL)
    np.testing.assert_array_equal(gyro, GYRO)


def test_an_axis_is_inverted_as_it_is_called_in_the_log_before_it_changes_places():
    accel, gyro = made(inverted=("accel_x", "gyro_z"), axes="LFU")
    np.testing.assert_array_equal(accel, (ACCEL * [-1.0, 1.0, 1.0])[:, [1, 0, 2]])
    np.testing.assert_array_equal(gyro, (GYRO * [1.0, 1.0, -1.0])[:, [1, 0, 2]])


def test_each_sensor_has_its_scale():
    accel, gyro = made(accel_scale=9.80665, gyro_scale=0.5)
    np.testing.assert_array_equal(accel, 9.80665 * ACCEL)
    np.testing.assert_array_equal(gyro, 0.5 * GYRO)


@pytest.mark.parametrize("axes", ["FLX", "FFU", "NED", "F"])
def test_letters_that_name_no_axes_of_a_box_are_refused(axes):
    with pytest.raises(ValidationError):
        AxesParams(axes=axes)
