"""Every law of integrators fails for an integrator that is wrong in that one way."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from broken_laws import broken

from recon import ATTITUDE, IMU, TRAJECTORY, Integrator, build, matrix, seconds, time_ns
from recon.numerics.integration import cumulative, increments
from recon.numerics.rotation import from_rotvec, rotate
from recon.numerics.rotation_series import compose
from recon.testing.laws import integrators

EMPTY = build(TRAJECTORY, time=np.zeros(0, dtype=np.int64))


def attitude_of(rule="trapezoid", offset=0.0, length=1.0, order=0):
    """An integrator of attitude from north and level."""

    def integrate(*, imu, params):
        t_s, gyro = seconds(imu), matrix(imu, "gyro") + offset
        turns = increments(t_s, gyro, rule) + np.diff(t_s)[:, None] ** 2 / 12.0 * np.cross(gyro[:-1], gyro[1:])
        q = compose(from_rotvec(turns), [1.0, 0.0, 0.0, 0.0])
        return {"attitude": build(ATTITUDE, time=time_ns(imu), q=length * q)}

    return Integrator(
        name="turns",
        summary="Attitude.",
        run=integrate,
        reads={"imu": IMU.need("gyro", frame="vehicle")},
        writes={"attitude": ATTITUDE},
        order=order,
    )


def motion_of(rule="trapezoid", offset=0.0, order=0, first=0.0):
    """An integrator of motion from the origin; first : m/s, its first velocity on each axis."""

    def integrate(*, imu, attitude, params):
        t_s, q = seconds(imu), matrix(attitude, "q")
        vel = first + cumulative(t_s, rotate(q, matrix(imu, "accel") + offset), rule)
        return {"trajectory": build(TRAJECTORY, time=time_ns(imu), pos=cumulative(t_s, vel, rule), vel=vel, q=q)}

    return Integrator(
        name="moves",
        summary="Motion.",
        run=integrate,
        reads={
            "imu": IMU.need("accel", frame="vehicle", quantity={"accel": "acceleration"}),
            "attitude": ATTITUDE.need("q"),
        },
        writes={"trajectory": TRAJECTORY},
        order=order,
    )


@pytest.mark.parametrize("made", [attitude_of, motion_of])
@pytest.mark.parametrize(("rule", "order"), [("rectangle", 1), ("trapezoid", 2), ("parabola", 3)])
def test_an_integrator_that_is_what_it_declares_breaks_no_law(made, rule, order):
    assert broken(integrators, made(rule, order=order)) == {}


@pytest.mark.parametrize(("made", "what"), [(attitude_of, "attitude (attitude)"), (motion_of, "velocity")])
def test_motion_out_of_nothing_breaks_the_law_of_rest(made, what):
    ((name, message),) = broken(integrators, made(offset=np.array([0.0, 0.0, 1e-6]))).items()
    assert name == "rest_stays_at_rest"
    # 1e-6 about or along z for 20 s, less the step of 0.01 s after the last row.
    assert f"the {what} became 1.999e-05, where it must stay 0" in message


def test_a_velocity_to_begin_with_breaks_the_law_of_rest_but_not_that_of_the_order():
    ((name, message),) = broken(integrators, motion_of(first=0.1, order=2)).items()
    assert name == "rest_stays_at_rest"
    assert "the velocity became 0.1, where it must stay 0" in message


def test_an_integrator_without_a_result_breaks_all_laws_of_motion():
    nothing = dataclasses.replace(motion_of(order=2), run=lambda imu, attitude, params: {"trajectory": EMPTY})
    messages = broken(integrators, nothing)
    assert [*messages] == ["rest_stays_at_rest", "the_error_falls_with_the_order_when_the_step_is_halved"]
    assert all("it gave no value of them" in message for message in messages.values())


@pytest.mark.parametrize(("made", "what"), [(attitude_of, "attitude (attitude)"), (motion_of, "velocity")])
def test_an_order_too_high_breaks_the_law_of_the_order(made, what):
    ((name, message),) = broken(integrators, made("trapezoid", order=3)).items()
    assert name == "the_error_falls_with_the_order_when_the_step_is_halved"
    assert f"with half the step the error of the {what} went from " in message
    assert "by a factor of 4.00; order 3 is declared, which means 8" in message


def test_an_error_that_no_step_cures_breaks_the_law_of_the_order():
    found = broken(integrators, attitude_of(offset=0.01, order=1))
    assert "by a factor of 1." in found["the_error_falls_with_the_order_when_the_step_is_halved"]


def test_a_quaternion_that_is_too_long_breaks_its_law():
    ((name, message),) = broken(integrators, attitude_of(length=1.001, order=2)).items()
    assert name == "quaternions_are_of_unit_length"
    assert "a quaternion of 'attitude' (row" in message
