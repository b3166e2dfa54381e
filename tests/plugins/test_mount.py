from __future__ import annotations

import numpy as np
import pytest
from metric_rows import rows_by_name

import recon
from recon import GNSS, IMU, build, matrix, time_ns, vector
from recon.errors import DataError, NotEnoughData
from recon.numerics.rotation import conjugate, from_euler, multiply
from recon_aligners.mount import MountParams, declare_aligners, mount
from recon_simulators.drive import DriveParams, simulate_drive

PARAMS = MountParams()
NO_IMU = build(IMU, time=np.zeros(0, dtype=np.int64), accel=np.zeros((0, 3)), gyro=np.zeros((0, 3)))
ANGLES = [(0.0, 0.0, 0.0), (3.0, -2.0, 170.0), (10.0, 20.0, -60.0), (-90.0, 0.0, 45.0), (170.0, 5.0, 10.0)]
"""deg; roll, pitch, yaw of the box in the vehicle."""


def drive(angles=(0.0, 0.0, 0.0), **given):
    """Ten minutes on roads of all kinds; angles in deg."""
    roll, pitch, yaw = np.radians(angles)
    given = {"motion": "mixed", "duration": 600.0, **given}
    return simulate_drive(DriveParams(mount_roll=roll, mount_pitch=pitch, mount_yaw=yaw, **given))


def mounted(streams):
    return mount(imu=streams["imu"], gnss=streams["gnss"], params=PARAMS)


def errors(result, angles):
    """Rotation from the true vehicle to the one found, about its axes, in deg and in sigmas: (3,) each."""
    rows = rows_by_name(result)
    found = np.array([rows[f"mount_q{axis}"]["value"] for axis in "wxyz"])
    roll, pitch, yaw = np.radians(angles)
    w, *v = multiply(found, conjugate(from_euler(yaw, pitch, roll)))
    error = np.degrees(2.0 * np.sign(w) * np.array(v))
    return error, error / [rows[f"mount_{name}"]["sigma"] for name in ("roll", "pitch", "yaw")]


@pytest.mark.parametrize("angles", ANGLES)
def test_any_mounting_is_found_within_its_sigmas(angles):
    error, in_sigmas = errors(mounted(drive(angles, seed=2, route=2)), angles)
    assert np.abs(in_sigmas).max() < 3.5  # exceeded by chance once in 700 drives, three axes each
    assert np.abs(error[1:]).max() < 0.3


@pytest.mark.parametrize("sensors", ["study_one", "study_two"])
def test_levers_leaning_and_slip_do_not_mislead(sensors):
    angles = (5.0, -4.0, 30.0)
    _, in_sigmas = errors(mounted(drive(angles, sensors=sensors)), angles)
    assert np.abs(in_sigmas).max() < 3.5


def test_accel_and_gyro_are_turned_as_the_metrics_tell_and_nothing_else_changes():
    streams = drive((10.0, 20.0, -60.0), duration=300.0)
    result = mounted(streams)
    rows = rows_by_name(result)
    yaw, pitch, roll = (np.radians(rows[f"mount_{name}"]["value"]) for name in ("yaw", "pitch", "roll"))
    w, x, y, z = from_euler(yaw, pitch, roll)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    # Some ten operations on values of at most 100: rounding of 1e-13.
    for group in ("accel", "gyro"):
        expected = matrix(streams["imu"], group) @ turn.T
        np.testing.assert_allclose(matrix(result["imu"], group), expected, rtol=0.0, atol=1e-12)
    assert result["imu"].column_names == streams["imu"].column_names
    assert np.array_equal(time_ns(result["imu"]), time_ns(streams["imu"]))


def test_gnss_that_tells_only_speeds_does_as_well():
    angles = (5.0, -4.0, 30.0)
    streams = drive(angles)
    gnss = build(GNSS, time=time_ns(streams["gnss"]), speed=vector(streams["gnss"], "speed", gaps=True))
    _, in_sigmas = errors(mounted({**streams, "gnss": gnss}), angles)
    assert np.abs(in_sigmas).max() < 3.5


def test_a_standing_vehicle_is_not_enough():
    with pytest.raises(DataError, match="no motion to find the heading"):
        mounted(drive(motion="rest", duration=120.0))


def test_an_empty_gnss_is_not_enough():
    streams = drive(motion="straight", duration=40.0)
    with pytest.raises(NotEnoughData, match="GNSS"):
        mounted({**streams, "gnss": streams["gnss"].slice(0, 0)})


def test_an_empty_imu_is_refused():
    with pytest.raises(DataError, match="imu"):
        mounted({**drive(motion="straight", duration=40.0), "imu": NO_IMU})


def test_it_declares_itself():
    (record,) = declare_aligners()
    assert record.key == "aligner.mount"
    assert record.rotation
    assert not record.faults()


def test_on_a_real_crash_log_the_box_lies_flat_and_points_backwards(logs):
    rows = rows_by_name(mounted(recon.read(logs / "physycom_crash" / "crash_01.txt").streams))
    # At rest the log reads +9.9 m/s^2 on z and 0.1 on x and y; pulling away it reads -3.4 m/s^2 on x and 0.0 on y.
    assert abs(rows["mount_yaw"]["value"]) > 175.0
    assert abs(rows["mount_roll"]["value"]) < 10.0
    assert abs(rows["mount_pitch"]["value"]) < 5.0
