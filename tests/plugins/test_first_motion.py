from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from recon import GNSS, IMU, build, matrix, replace, time_ns
from recon.errors import NotEnoughData
from recon.numerics.motion import Drive, Segment, circle, rest, specific_force
from recon.numerics.rotation import to_euler
from recon.rows import warnings_of
from recon_aligners.first_motion import FirstMotionParams, declare_aligners, initial_attitude


def imu_of(motion, duration_s, start_s=0.0):
    t_s = np.arange(start_s, duration_s, 0.01)
    truth = motion.at(t_s)
    return build(IMU, time=np.round(t_s * 1e9).astype(np.int64), accel=specific_force(truth), gyro=truth.gyro_v)


def gnss_of(motion, duration_s, rate_hz=5.0, offset=(0.0, 0.0, 0.0), start_s=0.0):
    t_s = np.arange(start_s, duration_s, 1.0 / rate_hz)
    return build(GNSS, time=np.round(t_s * 1e9).astype(np.int64), pos=motion.at(t_s).pos_n + offset)


def straight(yaw):
    return Drive((Segment(2.0, 0.0), Segment(4.0, 8.0), Segment(4.0, 0.0)), yaw=yaw)


def heading(result):
    row = result["metrics"].to_pylist()[0]
    assert row["name"] == "initial_heading"
    return row["value"], row["method"]


@pytest.mark.parametrize("heading_deg", [0.0, 45.0, 90.0, 200.0, 359.0])
def test_a_straight_start_gives_its_own_direction(heading_deg):
    motion = straight(np.radians(90.0 - heading_deg))
    gnss = gnss_of(motion, 10.0, offset=(500.0, -300.0, 20.0))
    result = initial_attitude(imu=imu_of(motion, 10.0), gnss=gnss, params=FirstMotionParams())
    found, method = heading(result)
    # No turn, no noise: rounding of positions of 500 m over 10 m.
    assert (found - heading_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
    assert method == "first motion"


def test_a_turn_within_the_first_metres_does_not_bias_it():
    # Out of a parking lot: the course turns by 10 m / 5 m = 2 rad within the distance.
    motion = Drive((Segment(2.0, 0.0), Segment(3.0, 5.0, curvature=0.2), Segment(3.0, 5.0, 0.2), Segment(3.0, 0.0)))
    result = initial_attitude(imu=imu_of(motion, 8.0), gnss=gnss_of(motion, 8.0), params=FirstMotionParams())
    # The chord of a fix interval of 0.2 s is turned back by the yaw at its middle; the course turns by at most
    # 5 m/s x 0.2 s / 5 m = 0.2 rad in it and not quite evenly: second order, 0.2^2 / 12 rad = 0.2 deg.
    assert heading(result)[0] == pytest.approx(90.0, abs=0.2)


def test_the_record_may_begin_in_a_bend():
    motion = circle(20.0, 8.0)
    result = initial_attitude(
        imu=imu_of(motion, 10.0, start_s=5.0), gnss=gnss_of(motion, 10.0, start_s=5.5), params=FirstMotionParams()
    )
    # At 5 s the course has turned left by 8 m/s x 5 s / 20 m = 2 rad from east. On a circle chords are exact.
    assert heading(result)[0] == pytest.approx((90.0 - np.degrees(2.0)) % 360.0, abs=1e-6)


def test_the_attitude_is_one_level_row_at_the_first_row_of_the_imu():
    imu = imu_of(straight(1.0), 10.0)
    attitude = initial_attitude(imu=imu, gnss=gnss_of(straight(1.0), 10.0), params=FirstMotionParams())["attitude"]
    assert time_ns(attitude).tolist() == [time_ns(imu)[0]]
    np.testing.assert_allclose(np.ravel(to_euler(matrix(attitude, "q"))), [1.0, 0.0, 0.0], atol=1e-9)


def test_noise_of_the_fixes_is_averaged_and_its_sigma_is_honest():
    errors, sigmas = [], []
    for seed in range(40):
        gnss = gnss_of(straight(0.5), 10.0)
        pos = matrix(gnss, "pos") + np.random.default_rng(seed).normal(0.0, 0.5, (gnss.num_rows, 3))
        gnss = build(GNSS, time=time_ns(gnss), pos=pos, pos_std=np.full(pos.shape, 0.5))
        result = initial_attitude(imu=imu_of(straight(0.5), 10.0), gnss=gnss, params=FirstMotionParams())
        errors.append(heading(result)[0] - 90.0 + np.degrees(0.5))
        sigmas.append(result["metrics"].to_pylist()[0]["sigma"])
    # 40 draws: errors over sigma have unit variance, known to sqrt(2 / 40) = 0.22; four of those. The two outermost
    # points alone would leave 0.5 m sqrt(2) / 10 m = 4.1 deg.
    assert np.mean(np.square(np.divide(errors, sigmas))) == pytest.approx(1.0, abs=4 * 0.22)
    assert np.std(errors) < 4.1 * 0.75


@pytest.mark.parametrize("told", [True, False])
def test_errors_that_last_for_minutes_are_in_the_sigma(told):
    over = []
    for seed in range(40):
        rng, gnss = np.random.default_rng(seed), gnss_of(straight(0.5), 10.0)
        step = np.exp(-0.2 / 100.0)
        drawn = 3.0 * np.sqrt(0.5) * rng.standard_normal((gnss.num_rows, 3))
        drawn[1:] *= np.sqrt(1.0 - step**2)
        slow = lfilter([1.0], [1.0, -step], drawn, axis=0)
        gnss = replace(gnss, pos=matrix(gnss, "pos") + slow)
        if told:
            gnss = build(GNSS, time=time_ns(gnss), pos=matrix(gnss, "pos"), pos_std=np.full((gnss.num_rows, 3), 3.0))
        result = initial_attitude(imu=imu_of(straight(0.5), 10.0), gnss=gnss, params=FirstMotionParams())
        over.append((heading(result)[0] - 90.0 + np.degrees(0.5)) / result["metrics"].to_pylist()[0]["sigma"])
    assert np.mean(np.square(over)) == pytest.approx(1.0, abs=4 * 0.22)  # as above


def test_a_heading_given_by_hand_wins():
    imu, gnss = imu_of(straight(1.0), 10.0), gnss_of(straight(1.0), 10.0)
    result = initial_attitude(imu=imu, gnss=gnss, params=FirstMotionParams(heading=np.radians(30.0)))
    assert heading(result) == (pytest.approx(30.0), "given")
    assert to_euler(matrix(result["attitude"], "q"))[0][0] == pytest.approx(np.radians(60.0))


@pytest.mark.parametrize(
    ("gnss", "why"),
    [
        (None, "no GNSS positions"),
        (build(GNSS, time=np.arange(3), speed=np.zeros(3)), "no GNSS positions"),
        (gnss_of(straight(0.0), 10.0).slice(0, 0), "no GNSS positions"),
        (gnss_of(rest(10.0), 10.0), "never move 10 m"),
    ],
)
def test_without_a_first_motion_north_is_assumed_and_said(gnss, why):
    result = initial_attitude(imu=imu_of(straight(0.0), 10.0), gnss=gnss, params=FirstMotionParams())
    assert heading(result) == (pytest.approx(0.0), "none")
    (note,) = warnings_of(result["metrics"])
    assert why in note
    assert "heading 0" in note
    assert to_euler(matrix(result["attitude"], "q"))[0][0] == pytest.approx(np.pi / 2.0)


def test_rows_without_a_fix_are_skipped():
    motion = straight(0.5)
    t_s = np.arange(0.0, 10.0, 0.2)
    pos = motion.at(t_s).pos_n
    pos[::3, 0] = np.nan
    gnss = build(GNSS, time=np.round(t_s * 1e9).astype(np.int64), pos=pos)
    result = initial_attitude(imu=imu_of(motion, 10.0), gnss=gnss, params=FirstMotionParams())
    assert heading(result)[0] == pytest.approx(90.0 - np.degrees(0.5), abs=1e-9)


def test_an_empty_imu_is_not_enough():
    with pytest.raises(NotEnoughData):
        initial_attitude(imu=imu_of(rest(1.0), 0.0), gnss=None, params=FirstMotionParams())


@pytest.mark.parametrize("rows", [1, 2])
def test_a_row_or_two_give_the_assumed_attitude(rows):
    gnss = gnss_of(straight(0.0), 10.0)
    result = initial_attitude(imu=imu_of(straight(0.0), 10.0).slice(0, rows), gnss=gnss, params=FirstMotionParams())
    assert result["attitude"].num_rows == 1
    assert len(warnings_of(result["metrics"])) == 1


def test_the_record_is_without_faults():
    (record,) = declare_aligners()
    assert record.faults() == []
