"""Every law of aligners fails for an aligner that is wrong in that one way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from broken_laws import broken

from recon import IMU, SAME, Aligner, Change, matrix, replace
from recon.numerics.rotation import conjugate, from_euler, from_rotvec, multiply, rotate, shortest_arc
from recon.testing.drives import MOUNT_YAW, MOUNTING
from recon.testing.laws import aligners

LEVEL = Change(frames={"accel": "level", "gyro": "level"})


def upright(imu):
    """The rotation that makes the mean of the first 5 s point up."""
    return shortest_arc(matrix(imu, "accel")[:500].mean(axis=0), [0.0, 0.0, 1.0])


def aligner_of(rotation=upright, accel=lambda a: a, gyro=lambda g: g, writes=LEVEL):
    """An aligner that turns imu by a rotation and then puts a function to its vectors."""

    def align(*, imu, params):
        q = rotation(imu)
        turned = {"accel": accel(rotate(q, matrix(imu, "accel"))), "gyro": gyro(rotate(q, matrix(imu, "gyro")))}
        return {"imu": replace(imu, **turned)}

    return Aligner(
        name="turn",
        summary="Turns imu.",
        run=align,
        reads={"imu": IMU.need("accel", "gyro", frame="sensor")},
        writes={"imu": writes},
        rotation=True,
    )


def test_an_aligner_that_is_what_it_declares_breaks_no_law():
    assert broken(aligners, aligner_of()) == {}


def test_a_gain_breaks_the_law_of_lengths():
    ((name, message),) = broken(aligners, aligner_of(accel=lambda a: 1.001 * a)).items()
    assert name == "turned_vectors_keep_their_length"
    assert message.startswith("imu.accel in row 0 had the length ")
    assert message.endswith("its record declares rotation")


def test_another_rotation_for_the_gyroscope_breaks_the_law_of_angles():
    slightly = from_rotvec([0.001, 0.0, 0.0])
    ((name, message),) = broken(aligners, aligner_of(gyro=lambda g: rotate(slightly, g))).items()
    assert name == "turned_vectors_keep_their_angles"
    assert message.startswith("imu.accel and imu.gyro were not turned by one rotation")


def test_a_rotation_that_names_no_frame_breaks_its_law():
    ((name, message),) = broken(aligners, aligner_of(writes=SAME)).items()
    assert name == "the_result_is_in_another_frame_that_is_declared"
    assert "`writes` changes the frame of no vector" in message


def test_a_rotation_the_wrong_way_round_is_off_the_truth():
    ((name, message),) = broken(aligners, aligner_of(lambda imu: conjugate(upright(imu)))).items()
    assert name == "the_result_agrees_with_the_truth_in_its_frame"
    # The box leans by acos(cos 0.05 cos 0.04) = 3.67 deg: turned the wrong way it leans by twice that.
    assert "imu.accel is off the truth, by 7." in message
    assert "deg away from the vertical; the noise of the suite's sensors explains 0.63 deg" in message


def test_a_rotation_that_does_not_look_at_the_data_turns_what_is_aligned():
    always = multiply(from_euler(-MOUNT_YAW, 0.0, 0.0), MOUNTING)
    ((name, message),) = broken(aligners, aligner_of(lambda imu: always)).items()
    assert name == "what_is_aligned_already_stays"
    assert "imu.accel was turned although it was aligned already, by 3." in message


def test_a_row_that_is_lost_breaks_all_laws_that_compare_rows():
    def shorter(*, imu, params):
        return {"imu": imu.slice(1)}

    found = broken(aligners, dataclasses.replace(aligner_of(), run=shorter))
    assert len(found) == 4
    assert {*found.values()} == {"'imu' came back with other rows; its record declares rotation, which changes none"}


@pytest.mark.parametrize("mirror", [[1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
def test_a_mirror_is_no_rotation(mirror):
    mirrored = aligner_of(accel=lambda a: a * mirror, gyro=lambda g: g * np.array(mirror))
    assert "what_is_aligned_already_stays" in broken(aligners, mirrored)


def test_a_vehicle_that_faces_backwards_is_off_the_truth():
    backwards = Change(frames={"accel": "vehicle", "gyro": "vehicle"})
    found = broken(
        aligners, aligner_of(lambda imu: multiply(from_euler(np.pi, 0.0, 0.0), upright(imu)), writes=backwards)
    )
    assert (
        "deg about the vertical; the noise of the suite's sensors explains 3.09 deg"
        in (found["the_result_agrees_with_the_truth_in_its_frame"])
    )
