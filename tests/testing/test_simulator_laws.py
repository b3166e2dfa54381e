"""Every law of simulators fails for a simulator that is wrong in that one way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from broken_laws import broken

from recon import GNSS, IMU, REFERENCE, Params, Simulator, build, setting
from recon.numerics.motion import specific_force
from recon.numerics.rotation import conjugate, rotate
from recon.testing.laws import simulators
from recon.testing.motions import CIRCLE


class CircleParams(Params):
    """Parameters of the simulators of these tests."""

    seed: int = setting(0, doc="Seed of the noise.")
    noise: float = setting(1.0, doc="Factor on the noise.")


def circle_of(true=lambda truth, params: truth, noise_of=lambda params: params.noise, gyro=1.0, speed=1.0):
    """A simulator of a swaying circle, with ways to go wrong.

    true : what it says is the truth; noise_of : factor on the noise; gyro, speed : factors on what is measured
    """

    def simulate(params):
        seen = CIRCLE.at(np.arange(1000) * 0.01)
        truth = true(seen, params)
        noise = noise_of(params) * 0.01 * np.random.default_rng(params.seed).standard_normal((1000, 3))
        time = np.arange(1000) * 10_000_000
        reference = build(
            REFERENCE,
            time=time,
            pos=truth.pos_n,
            vel=truth.vel_n,
            q=truth.q_nv,
            accel=rotate(conjugate(truth.q_nv), truth.acc_n),
            gyro=truth.gyro_v,
        )
        fixes = {"vel": speed * seen.vel_n[::20], "speed": speed * np.linalg.norm(seen.vel_n[::20], axis=1)}
        return {
            "imu": build(IMU, time=time, accel=specific_force(seen) + noise, gyro=gyro * seen.gyro_v + noise),
            "gnss": build(GNSS, time=time[::20], **fixes),
            "reference": reference,
        }

    return Simulator(
        name="circle",
        summary="A swaying circle.",
        params=CircleParams,
        run=simulate,
        writes={"imu": IMU, "gnss": GNSS, "reference": REFERENCE},
        ideal={"noise": 0.0},
    )


def test_a_simulator_that_is_what_it_declares_breaks_no_law():
    assert broken(simulators, circle_of()) == {}


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        ("pos_n", "the position changes by"),
        ("vel_n", "the position changes by"),
        ("acc_n", "the velocity changes by"),
        ("gyro_v", "the attitude changes by"),
    ],
)
def test_a_truth_that_contradicts_itself_breaks_the_law_of_integrals(rate, words):
    longer = circle_of(true=lambda truth, params: replace(truth, **{rate: 1.01 * getattr(truth, rate)}))
    message = broken(simulators, longer)["the_truth_is_the_integral_of_its_rates"]
    assert f"of 'reference' {words}" in message
    assert "the step explains a difference of" in message


def test_a_truth_that_is_not_what_the_sensors_saw_breaks_no_law_of_integrals():
    found = broken(simulators, circle_of(gyro=180.0 / np.pi))
    assert [*found] == ["ideal_sensors_measure_the_truth"]
    assert found["ideal_sensors_measure_the_truth"].startswith(
        "of ideal sensors the magnitude of imu.gyro is off the truth by up to"
    )


def test_fixes_in_another_unit_break_the_law_of_ideal_sensors():
    found = broken(simulators, circle_of(speed=3.6))
    assert [*found] == ["ideal_sensors_measure_the_truth"]
    # 10 m/s taken 3.6 times are off by 26 m/s; the first direction is east.
    assert found["ideal_sensors_measure_the_truth"].startswith("of ideal sensors gnss.vel is off the truth by up to 26")


def test_noise_that_does_not_go_away_breaks_the_law_of_ideal_sensors():
    assert [*broken(simulators, circle_of(noise_of=lambda params: 1.0))] == ["ideal_sensors_measure_the_truth"]


def test_a_seed_that_moves_the_truth_breaks_the_law_of_the_seed():
    aside = circle_of(true=lambda truth, params: replace(truth, pos_n=truth.pos_n + params.seed))
    assert broken(simulators, aside) == {
        "another_seed_gives_other_noise_on_the_same_truth": "the seeds 1 and 2 gave another 'reference'; "
        "the seed is that of the noise, not of the motion"
    }


def test_a_seed_that_does_nothing_breaks_the_law_of_the_seed():
    assert broken(simulators, circle_of(noise_of=lambda params: 0.0)) == {
        "another_seed_gives_other_noise_on_the_same_truth": "the seeds 1 and 2 gave the same imu, gnss; "
        "the seed must act"
    }
