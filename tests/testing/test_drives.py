"""The suite's drives are what they say: the same world, seen as the conditions tell."""

from __future__ import annotations

import numpy as np
import pytest

from recon import matrix, seconds, time_ns
from recon.numerics.rotation import angle, rotate
from recon.testing.drives import DRIFT, START_NS, Conditions, drive
from recon.testing.motions import CIRCLE

IDEAL = Conditions(noise=0.0)


def test_ideal_sensors_leave_no_drift():
    recording = drive(IDEAL)
    assert recording["trajectory"].equals(recording["reference"])


def test_the_trajectory_drifts_with_a_constant_acceleration():
    recording = drive()
    error = matrix(recording["trajectory"], "pos") - matrix(recording["reference"], "pos")
    t_s = seconds(recording["reference"])
    drift = 2.0 * error[-1] / t_s[-1] ** 2
    assert error == pytest.approx(t_s[:, None] ** 2 / 2.0 * drift, abs=1e-9)
    assert 0.0 < np.abs(drift).max() < 5.0 * DRIFT


@pytest.mark.parametrize("stream", ["gnss", "trajectory", "reference"])
def test_a_turned_world_is_the_same_world_turned_with_its_errors(stream):
    turned = Conditions(yaw=1.0)
    usual, found = drive()[stream], drive(turned)[stream]
    for group in ("pos", "vel"):
        assert matrix(found, group) == pytest.approx(rotate(turned.turn, matrix(usual, group)), abs=1e-9)


def test_a_turned_or_moved_drive_feels_the_same_in_the_box():
    for conditions in (Conditions(yaw=1.0), Conditions(shift_n=(10.0, 20.0, 30.0))):
        assert matrix(drive(conditions)["imu"], "accel") == pytest.approx(matrix(drive()["imu"], "accel"), abs=1e-12)


def test_the_step_of_the_imu_is_the_one_asked_for():
    recording = drive(Conditions(motion=CIRCLE, step_s=0.04))
    assert time_ns(recording["imu"])[:3].tolist() == [START_NS, START_NS + 40_000_000, START_NS + 80_000_000]
    assert not recording["events"].num_rows


def test_the_axis_of_rotation_turns_on_the_swaying_circle():
    truth = CIRCLE.at(np.arange(0.0, 10.0, 0.1))
    rate = truth.gyro_v / np.linalg.norm(truth.gyro_v, axis=1)[:, None]
    assert (rate @ rate[0]).min() < 0.5
    assert angle(truth.q_nv[1:], truth.q_nv[:-1]).max() < 0.2
