"""What the doctor says of units where a drive tells little, and what it shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.numerics.doctor.finding import contradicted
from recon.numerics.doctor.log import Claims, Imu
from recon.numerics.doctor.motion import Direction, Motion, Spans
from recon.numerics.doctor.pictures import picture_of
from recon.numerics.doctor.units import gyro_unit

GRAVITY = 9.80665


def banked(turn):
    """Bends banked for their speed: of what would push aside the IMU feels a sixtieth."""
    rng = np.random.default_rng(0)
    t_s = np.arange(300.0)
    rate, speed = 0.2 * np.sin(t_s / 7.0), np.full(300, 12.0)
    aside = speed * rate / 60.0 + rng.normal(0.0, 0.01, 300)
    spans = Spans(
        t_s,
        speed,
        ahead=np.zeros(300),
        across=np.full(300, np.nan),
        turn=np.full(300, np.nan),
        accel=np.column_stack([np.zeros(300), aside, np.full(300, GRAVITY)]),
        gyro=np.column_stack([np.zeros(300), np.zeros(300), rate]),
    )
    forward, up = Direction(np.array([1.0, 0.0, 0.0]), 0.01), Direction(np.array([0.0, 0.0, GRAVITY]), 0.01)
    imu = Imu(t_s, spans.accel, spans.gyro)
    return imu, Motion(forward, None, up, turn, spans)


def test_bends_alone_tell_the_unit_of_the_gyroscope_but_not_against_the_course():
    alone = gyro_unit(*banked(None), Claims())
    assert (alone.status, alone.value) == ("contradicted", "deg/s")
    course = Direction(np.array([0.0, 0.0, 0.85]), 0.17)  # too little to say that it is 1, enough that it is no 60
    assert gyro_unit(*banked(course), Claims()).status == "unknown"
    drowned = Direction(np.array([0.0, 0.0, 0.03]), 0.01)  # in the noise of the courses
    assert gyro_unit(*banked(drowned), Claims()).value == "deg/s"
    agreeing = Direction(np.array([0.0, 0.0, 50.0]), 12.0)
    assert gyro_unit(*banked(agreeing), Claims()).value == "deg/s"


def test_what_is_felt_ahead_is_not_shown_where_nothing_tells_where_ahead_is():
    imu, motion = banked(None)
    late = contradicted("gnss_velocity_lag", 0.4, "late")
    assert picture_of(late, imu, motion) is not None
    nowhere = Direction(np.zeros(3), 0.0)
    assert picture_of(late, imu, replace(motion, forward=nowhere, up=nowhere)) is None
