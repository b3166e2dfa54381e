from __future__ import annotations

import numpy as np
import pytest
from pyquaternion import Quaternion
from sampling import irregular

from recon import ATTITUDE, IMU, build, matrix, meta, time_ns, with_meta
from recon.errors import DataError, NotEnoughData
from recon.numerics.integration import RULES
from recon.numerics.motion import circle
from recon.numerics.rotation import angle, from_euler, to_euler
from recon.rows import warnings_of
from recon_integrators.attitude import AttitudeParams, declare_integrators, integrate_attitude


def imu_of(t_s, gyro):
    t_ns = np.round(np.asarray(t_s) * 1e9).astype(np.int64)
    return build(IMU, time=t_ns, accel=np.zeros((len(t_ns), 3)), gyro=np.asarray(gyro).reshape(-1, 3))


def start(q, t_ns=0):
    return build(ATTITUDE, time=np.array([t_ns], dtype=np.int64), q=np.asarray(q)[None])


def euler_motion(t_s):
    """A body that yaws, pitches and rolls at once: attitude (n, 4) and its body rate (n, 3)."""
    yaw, pitch, roll = 0.8 * t_s, 0.5 * np.sin(1.1 * t_s), 0.7 * np.sin(0.9 * t_s)
    yaw_rate, pitch_rate, roll_rate = 0.8, 0.55 * np.cos(1.1 * t_s), 0.63 * np.cos(0.9 * t_s)
    rate = np.column_stack(
        [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
            yaw_rate * np.cos(pitch) * np.cos(roll) - pitch_rate * np.sin(roll),
        ]
    )
    return from_euler(yaw, pitch, roll), rate


def integrate(t_s, gyro, q0, **params):
    result = integrate_attitude(imu=imu_of(t_s, gyro), attitude=start(q0), params=AttitudeParams(**params))
    return matrix(result["attitude"], "q")


@pytest.mark.parametrize("rule", RULES)
def test_a_steady_turn_is_exact_at_any_rate(rule):
    t_s = irregular(4.0)
    truth = circle(10.0, 12.0).at(t_s)
    q = integrate(t_s, truth.gyro_v, truth.q_nv[0], rule=rule)
    # Some tens of products, rounding 1e-16 each, times of 1 ns of resolution at 1.2 rad/s.
    assert angle(q, truth.q_nv).max() < 1e-8


@pytest.mark.parametrize(("rule", "order"), [("rectangle", 1), ("trapezoid", 2), ("parabola", 3)])
def test_the_error_of_a_turning_axis_falls_with_the_order_of_the_rule(rule, order):
    errors = []
    for rate_hz in (25.0, 50.0, 100.0):
        t_s = irregular(rate_hz)
        truth, gyro = euler_motion(t_s)
        errors.append(angle(integrate(t_s, gyro, truth[0], rule=rule), truth).max())
    # Halving the step divides the error by 2^order; irregular steps scatter that by some tenths.
    assert np.log2(errors[0] / errors[2]) / 2.0 == pytest.approx(order, abs=0.4)


def test_turns_compose_and_do_not_add_axis_by_axis():
    # A quarter turn of yaw, then one about the new x: a body increment multiplies from the right.
    gyro = [[0.0, 0.0, np.pi / 2.0], [np.pi / 2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    t_s = np.arange(0.0, 2.0 + 1e-9, 0.001)
    held = np.array(gyro)[np.minimum(t_s.astype(int), 2)]
    q = integrate(t_s, held, [1.0, 0.0, 0.0, 0.0], rule="rectangle")
    expected = Quaternion(axis=[0, 0, 1], degrees=90) * Quaternion(axis=[1, 0, 0], degrees=90)
    # One step of 1 ms is charged to the jump: h^2 / 12 (pi / 2)^2.
    assert angle(q[-1], expected.elements) < 1e-6


def test_quaternions_stay_of_unit_length_over_a_long_record():
    rng = np.random.default_rng(6)
    t_s = np.arange(200_000) * 0.0024
    q = integrate(t_s, rng.normal(0.0, 2.0, (len(t_s), 3)), [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=1e-14)


def test_without_an_initial_attitude_north_is_faced_and_said():
    result = integrate_attitude(imu=imu_of([0.0, 0.1], np.zeros(6)), attitude=None, params=AttitudeParams())
    yaw, pitch, roll = to_euler(matrix(result["attitude"], "q"))
    np.testing.assert_allclose([yaw, pitch, roll], [[np.pi / 2.0] * 2, [0.0] * 2, [0.0] * 2], atol=1e-15)
    assert "heading 0" in warnings_of(result["metrics"])[0]


def test_times_and_facts_are_those_of_the_imu():
    imu = with_meta(imu_of([0.0, 0.1, 0.25], np.zeros(9)), time_scale="UTC")
    attitude = integrate_attitude(imu=imu, attitude=start([1.0, 0.0, 0.0, 0.0]), params=AttitudeParams())["attitude"]
    assert np.array_equal(time_ns(attitude), time_ns(imu))
    assert meta(attitude)["time_scale"] == "UTC"


def test_an_initial_attitude_of_another_time_is_refused():
    with pytest.raises(DataError, match="first row"):
        integrate_attitude(
            imu=imu_of([0.0, 0.1], np.zeros(6)), attitude=start([1.0, 0.0, 0.0, 0.0], 7), params=AttitudeParams()
        )


@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("rule", RULES)
def test_a_row_or_two_are_enough(rows, rule):
    q = integrate(0.5 * np.arange(rows), np.tile([0.0, 0.0, 1.0], (rows, 1)), [1.0, 0.0, 0.0, 0.0], rule=rule)
    np.testing.assert_allclose(to_euler(q)[0], 0.5 * np.arange(rows), atol=1e-15)


def test_an_empty_imu_is_not_enough():
    with pytest.raises(NotEnoughData):
        integrate_attitude(imu=imu_of([], []), attitude=None, params=AttitudeParams())


def test_the_record_is_without_faults():
    (record,) = declare_integrators()
    assert record.faults() == []


def test_over_a_gap_the_attitude_is_held_and_it_is_said():
    t_s = np.concatenate((np.arange(0.0, 2.0, 0.01), 5.0 + np.arange(0.0, 2.0, 0.01)))
    gyro = np.tile([0.0, 0.0, 0.1], (len(t_s), 1))
    result = integrate_attitude(imu=imu_of(t_s, gyro), attitude=start([1.0, 0, 0, 0]), params=AttitudeParams())
    yaw = to_euler(matrix(result["attitude"], "q"))[0]
    # Rounding of 400 products.
    assert yaw[200] == yaw[199]
    assert yaw[-1] == pytest.approx(0.1 * 2 * 1.99, abs=1e-12)
    (note,) = warnings_of(result["metrics"])
    assert note.startswith("no imu for 3.0 s from 2.0 s after the first row")


def test_a_log_with_a_hole_is_refused():
    with pytest.raises(DataError, match=r"the log has a hole: no imu for 60\.0 min"):
        integrate([0.0, 0.01, 3600.01], np.zeros((3, 3)), [1.0, 0, 0, 0])
