"""Streams are served in the frames and quantities that a stage asks for."""

from __future__ import annotations

import numpy as np
import pytest

from recon import IMU, MAG, matrix
from recon.numerics.rotation import rotate
from recon.testing.drives import FIELD_N, GRAVITY, Conditions, drive
from recon.testing.motions import STAND
from recon.testing.serving import serve

IDEAL = Conditions(noise=0.0)


def test_gravity_points_up_in_every_frame_but_that_of_the_tilted_box():
    recording = drive(Conditions(noise=0.0, motion=STAND))
    up = {
        frame: matrix(serve(recording, {"imu": IMU.need("accel", frame=frame)})["imu"], "accel")[0]
        for frame in ("sensor", "level", "vehicle", "local")
    }
    assert np.hypot(*up.pop("sensor")[:2]) > 0.3
    for force in up.values():
        assert force == pytest.approx([0.0, 0.0, GRAVITY], abs=1e-12)


def test_acceleration_is_free_of_gravity():
    need = IMU.need("accel", frame="local", quantity={"accel": "acceleration"})
    recording = drive(IDEAL)
    expected = rotate(matrix(recording["reference"], "q"), matrix(recording["reference"], "accel"))
    assert matrix(serve(recording, {"imu": need})["imu"], "accel") == pytest.approx(expected, abs=1e-12)


def test_the_magnetic_field_is_that_of_the_place_in_the_local_frame():
    field = matrix(serve(drive(IDEAL), {"mag": MAG.need("mag", frame="local")})["mag"], "mag")
    assert field == pytest.approx(np.tile(FIELD_N, (len(field), 1)), abs=1e-18)
