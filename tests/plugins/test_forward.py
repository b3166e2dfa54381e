from __future__ import annotations

import numpy as np
import pytest
from metric_rows import rows_by_name
from scipy.signal import lfilter

from recon import GNSS, IMU, Event, build, events, matrix, replace, time_ns
from recon.errors import NotEnoughData
from recon.numerics.motion import rest, s_curve, specific_force, stop_and_go
from recon.numerics.rotation import from_euler, rotate
from recon.numerics.signals import changes, wrap_angle
from recon_aligners.forward import ForwardParams, declare_aligners, forward

STOP = events([Event(0, 10_000_000_000, "standstill")])


def box(motion, duration_s, mount_yaw, noise=0.0, rate_hz=100.0):
    """A level box that looks `mount_yaw` rad to the left of the vehicle's nose; noise in m/s^2 on accel."""
    t_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    truth = motion.at(t_s)
    q_lv = from_euler(-mount_yaw, 0.0, 0.0)
    accel = rotate(q_lv, specific_force(truth)) + np.random.default_rng(3).normal(0.0, noise, (len(t_s), 3))
    return build(IMU, time=np.round(t_s * 1e9).astype(np.int64), accel=accel, gyro=rotate(q_lv, truth.gyro_v))


def speed_of(motion, duration_s, lag_s=0.0, rate_hz=10.0, sigma=0.0, group="speed"):
    t_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    vel = motion.at(t_s - lag_s).vel_n + np.random.default_rng(4).normal(0.0, sigma, (len(t_s), 3))
    values = np.hypot(vel[:, 0], vel[:, 1]) if group == "speed" else vel
    return build(GNSS, time=np.round(t_s * 1e9).astype(np.int64), **{group: values})


def city(seed=1):
    return stop_and_go(120.0, np.random.default_rng(seed))


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 90.0, 180.0, -137.0])
@pytest.mark.parametrize("lag_s", [0.0, 0.35, 1.1])
def test_the_yaw_of_the_box_is_found_however_late_gnss_is(yaw_deg, lag_s):
    drive = city()
    imu = box(drive, 120.0, np.radians(yaw_deg), noise=0.5)
    gnss = speed_of(drive, 120.0, lag_s, sigma=0.05)
    found = rows_by_name(forward(imu=imu, gnss=gnss, events=None, params=ForwardParams()))
    error = np.degrees(wrap_angle(np.radians(found["mount_yaw"]["value"] - yaw_deg)))
    assert abs(error) < 3.0 * found["mount_yaw"]["sigma"]
    assert found["mount_yaw"]["sigma"] < 1.0
    # Lags are tried 0.05 s apart.
    assert found["gnss_speed_lag"]["value"] == pytest.approx(lag_s, abs=0.051)


@pytest.mark.parametrize("with_speed", [True, False])
def test_the_sigma_knows_that_the_road_leans_for_many_windows_in_a_row(with_speed):
    duration_s, over = 300.0, []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        drive = stop_and_go(duration_s, rng)
        imu = box(drive, duration_s, 0.0, noise=0.1)
        kept = np.exp(-np.median(np.diff(time_ns(imu))) * 1e-9 / 10.0)  # leans last for 10 s, of 1.5 deg
        lean = lfilter([np.sqrt(1.0 - kept**2)], [1.0, -kept], 0.25 * rng.standard_normal(imu.num_rows))
        imu = replace(imu, accel=matrix(imu, "accel") + lean[:, None] * [0.0, 1.0, 0.0])
        gnss = speed_of(drive, duration_s, sigma=0.05) if with_speed else None
        found = rows_by_name(forward(imu=imu, gnss=gnss, events=STOP, params=ForwardParams()))["mount_yaw"]
        over.append(float(np.degrees(wrap_angle(np.radians(found["value"])))) / found["sigma"])
    assert np.sqrt(np.mean(np.square(over))) < 1.3  # of twenty values of sigma one: once in 37


def test_after_it_the_launch_is_along_x():
    drive = city()
    clean = box(drive, 120.0, 0.0)
    turned = forward(imu=box(drive, 120.0, 2.0), gnss=speed_of(drive, 120.0), events=None, params=ForwardParams())[
        "imu"
    ]
    # Error of direction of 0.3 deg times accelerations of at most 3 m/s^2.
    for group in ("accel", "gyro"):
        np.testing.assert_allclose(matrix(turned, group), matrix(clean, group), atol=0.02)


def test_a_velocity_serves_where_there_is_no_speed():
    drive = city()
    result = forward(
        imu=box(drive, 120.0, 1.0), gnss=speed_of(drive, 120.0, group="vel"), events=None, params=ForwardParams()
    )
    assert rows_by_name(result)["mount_yaw"]["value"] == pytest.approx(np.degrees(1.0), abs=0.3)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 180.0, -137.0])
def test_without_gnss_the_first_motion_after_a_stop_is_forward(yaw_deg):
    imu = box(city(), 120.0, np.radians(yaw_deg), noise=0.5)
    found = rows_by_name(forward(imu=imu, gnss=None, events=STOP, params=ForwardParams()))["mount_yaw"]
    error = np.degrees(wrap_angle(np.radians(found["value"] - yaw_deg)))
    assert found["method"] == "principal axis"
    assert abs(error) < 3.0 * found["sigma"]
    assert found["sigma"] < 2.0


def test_without_gnss_and_without_a_stop_the_sign_is_unknown():
    with pytest.raises(NotEnoughData, match="sign of forward"):
        forward(imu=box(city(), 120.0, 0.0), gnss=None, events=None, params=ForwardParams())


@pytest.mark.parametrize("with_speed", [True, False])
def test_a_drive_that_never_accelerates_cannot_tell(with_speed):
    gnss = speed_of(rest(60.0), 60.0, sigma=0.02) if with_speed else None
    with pytest.raises(NotEnoughData) as caught:
        forward(imu=box(rest(60.0), 60.0, 0.0, noise=0.05), gnss=gnss, events=STOP, params=ForwardParams())
    assert "parameter angle" in caught.value.hint


def test_speeds_that_have_nothing_to_do_with_the_accelerations_are_refused():
    gnss = speed_of(city(seed=2), 120.0)
    with pytest.raises(NotEnoughData, match="agreement on a forward axis"):
        forward(imu=box(city(seed=1), 120.0, 0.0), gnss=gnss, events=STOP, params=ForwardParams())


def test_an_angle_given_by_hand_is_used_as_it_is():
    drive = s_curve()
    result = forward(imu=box(drive, 5.0, 0.7), gnss=None, events=None, params=ForwardParams(angle=0.7))
    # Two rotations: rounding.
    np.testing.assert_allclose(matrix(result["imu"], "accel"), matrix(box(drive, 5.0, 0.0), "accel"), atol=1e-13)
    assert rows_by_name(result)["mount_yaw"]["value"] == pytest.approx(np.degrees(0.7))


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_a_row_or_two_are_not_enough_unless_the_angle_is_given(rows):
    imu = box(rest(1.0), 1.0, 0.0).slice(0, rows)
    with pytest.raises(NotEnoughData):
        forward(imu=imu, gnss=speed_of(rest(1.0), 1.0), events=STOP, params=ForwardParams())
    assert forward(imu=imu, gnss=None, events=None, params=ForwardParams(angle=1.0))["imu"].num_rows == rows


@pytest.mark.parametrize("with_speed", [True, False])
def test_on_a_real_crash_log_the_box_looks_backwards(logs, with_speed):
    rows = np.loadtxt(logs / "physycom_crash" / "crash_01.txt", skiprows=1)
    t_ns = np.round((rows[:, 0] - rows[0, 0]) * 1e4).astype(np.int64) * 100_000
    imu = build(IMU, time=t_ns, accel=rows[:, 2:5] * 9.80665, gyro=np.radians(rows[:, 5:8]))
    fresh = changes(rows[:, 1])
    gnss = build(GNSS, time=t_ns[fresh], speed=rows[fresh, 1] / 3.6) if with_speed else None
    stop = events([Event(0, 50_000_000_000, "standstill")])
    found = rows_by_name(forward(imu=imu, gnss=gnss, events=stop, params=ForwardParams()))
    # Nobody measured the mount: the box lies along the car as far as a hand can lay it.
    assert abs(found["mount_yaw"]["value"]) == pytest.approx(180.0, abs=5.0)


def test_the_record_is_without_faults():
    (record,) = declare_aligners()
    assert record.faults() == []


def test_windows_lie_where_there_are_samples_only():
    drive = city()
    whole = box(drive, 120.0, 1.0)
    t_ns = np.asarray(whole["time"].cast("int64"))
    parts = t_ns + np.where(np.arange(len(t_ns)) < 6000, 0, 30 * 86400 * 10**9)
    imu = build(IMU, time=parts, accel=matrix(whole, "accel"), gyro=matrix(whole, "gyro"))
    found = rows_by_name(forward(imu=imu, gnss=speed_of(drive, 60.0), events=None, params=ForwardParams()))
    assert found["mount_yaw"]["value"] == pytest.approx(np.degrees(1.0), abs=3.0 * found["mount_yaw"]["sigma"])


def test_a_speed_that_never_changes_and_one_of_another_time_are_called_that():
    imu = box(city(), 120.0, 0.0)
    t_ns = np.arange(1200) * 100_000_000
    for gnss, found in (
        (build(GNSS, time=t_ns, speed=np.zeros(1200)), "0 km/h throughout"),
        (
            build(GNSS, time=t_ns + 3600 * 10**9, speed=np.arange(1200.0)),
            "needs 3 from 0 to 11. s, found 1200 from 3600 to 3720 s",
        ),
    ):
        with pytest.raises(NotEnoughData, match=found):
            forward(imu=imu, gnss=gnss, events=None, params=ForwardParams())


@pytest.mark.parametrize("with_speed", [True, False])
def test_rows_a_second_apart_are_called_that(with_speed):
    imu = box(city(), 120.0, 0.0)
    every_second = imu.take(np.arange(0, imu.num_rows, round(imu.num_rows / 120.0)))
    gnss = speed_of(city(), 120.0) if with_speed else None
    with pytest.raises(
        NotEnoughData, match=r"samples of imu: needs rows at most 0.5 s apart for 1 s, found rows 1 s"
    ) as caught:
        forward(imu=every_second, gnss=gnss, events=STOP, params=ForwardParams())
    assert "pipeline 'gnss'" in caught.value.hint


@pytest.mark.parametrize("with_speed", [True, False])
def test_a_drive_that_always_turns_is_called_that(with_speed):
    imu = box(city(), 120.0, 0.0)
    turning = replace(imu, gyro=matrix(imu, "gyro") + np.array([0.0, 0.0, 3.0]))
    gnss = speed_of(city(), 120.0) if with_speed else None
    with pytest.raises(NotEnoughData, match=r"straight road: needs 3 s, found 0\.0 s"):
        forward(imu=turning, gnss=gnss, events=STOP, params=ForwardParams())
