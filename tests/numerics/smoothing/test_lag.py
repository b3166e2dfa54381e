from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from recon.numerics.rotation import from_euler, rotate
from recon.numerics.smoothing.lag import find_lag
from recon.numerics.smoothing.samples import regular_samples
from recon.numerics.smoothing.stops import Blocks, Floats, block_means

IMU_HZ = 100.0
ACCEL_NOISE, GYRO_NOISE = 0.02, np.radians(0.1)
"""m/s^2 and rad/s of each sample at 100 Hz: 200 ug/sqrt(Hz) and 0.01 deg/s/sqrt(Hz), a consumer's MEMS."""
SPEED_NOISE = 0.1
"""m/s of a fix, along and across."""
FLOOR_S = 0.01
"""The least sigma that is told."""


@dataclass(frozen=True)
class Motion:
    """Speed and yaw of a car as sums of sines, so that all derivatives are exact.

    amplitude : (k,) m/s and rad; rate : (k,) rad/s; phase : (k,)
    """

    speed: tuple[Floats, Floats, Floats]
    yaw: tuple[Floats, Floats, Floats]

    @classmethod
    def random(cls, rng: np.random.Generator) -> Motion:
        """Changes of speed of 1 m/s^2 and of course of 0.1 rad/s, root mean square, with periods of 6 s to a minute."""

        def sines(size: float) -> tuple[Floats, Floats, Floats]:
            rate = 2.0 * np.pi / rng.uniform(6.0, 60.0, 8)
            return size * np.sqrt(2.0 / 8.0) / rate, rate, rng.uniform(0.0, 2.0 * np.pi, 8)

        return cls(sines(1.0), sines(0.1))

    def at(self, t_s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Speed, its rate, yaw and its rate."""
        out = []
        for amplitude, rate, phase in (self.speed, self.yaw):
            angle = np.multiply.outer(t_s, rate) + phase
            out += [np.sin(angle) @ amplitude, np.cos(angle) @ (amplitude * rate)]
        return out[0] + 20.0, out[1], out[2], out[3]


@dataclass(frozen=True)
class Case:
    """What find_lag is given."""

    blocks: Blocks
    fix_t_s: Floats
    speed: Floats
    course: Floats

    def lag(self, largest_s: float = 2.0) -> tuple[float, float]:
        found = find_lag(self.blocks, self.fix_t_s, self.speed, self.course, largest_s)
        return found.seconds, found.sigma


def case(
    lag_s: float = 0.0,
    *,
    seed: int = 0,
    seconds: float = 600.0,
    fix_hz: float = 1.0,
    noise: float = 1.0,
    moving: bool = True,
    gap_s: tuple[float, float] = (0.0, 0.0),
    impact_s: float | None = None,
) -> Case:
    """A drive logged by a box that is mounted anyhow, whose fixes tell what was true lag_s before.

    noise : factor on all noise; gap_s : span without samples; impact_s : when the car is hit by 30 g for 50 ms
    """
    rng = np.random.default_rng(seed)
    motion = Motion.random(rng)
    t_s = np.arange(0.0, seconds, 1.0 / IMU_HZ)
    t_s = t_s[(t_s <= gap_s[0]) | (t_s >= gap_s[1])]
    speed, rate, _, turn = motion.at(t_s) if moving else (np.zeros_like(t_s),) * 4
    accel_v = np.stack([rate, speed * turn, np.full_like(t_s, 9.81)], axis=1)
    if impact_s is not None:
        accel_v[np.abs(t_s - impact_s) < 0.025, 0] -= 300.0
    gyro_v = np.stack([np.zeros_like(turn), np.zeros_like(turn), turn], axis=1)
    q_sv = from_euler(*rng.uniform(-np.pi, np.pi, 3))
    accel_s, gyro_s = (
        rotate(q_sv, y) + 0.1 * rng.standard_normal(3) * noise + noise * size * rng.standard_normal(y.shape)
        for y, size in ((accel_v, ACCEL_NOISE), (gyro_v, GYRO_NOISE))
    )
    blocks = block_means(regular_samples(t_s, gyro_s, accel_s), round(0.1 * IMU_HZ))
    fix_t_s = np.arange(0.3, seconds, 1.0 / fix_hz)
    speed, _, yaw, _ = motion.at(fix_t_s - lag_s) if moving else (np.zeros_like(fix_t_s),) * 4
    along, across = noise * SPEED_NOISE * rng.standard_normal((2, len(fix_t_s)))
    course = yaw + np.arctan2(across, np.maximum(speed, 1.0))
    return Case(blocks, fix_t_s, np.abs(speed + along), np.mod(-course, 2.0 * np.pi))


@pytest.mark.parametrize("fix_hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("lag_s", [-1.5, -0.33, 0.0, 0.35, 1.1])
def test_the_lag_is_found_for_any_mounting_and_rate(lag_s, fix_hz):
    seconds, sigma = case(lag_s, fix_hz=fix_hz, seed=round(100 * (lag_s + 2))).lag()
    assert abs(seconds - lag_s) < 3.0 * sigma
    assert sigma < 0.03


def test_without_noise_the_lag_is_exact_to_a_few_milliseconds():
    # The share explained falls with the square of the distance, so the vertex of the parabola is that of a cosine of
    # 6 s or more, at steps of 0.1 s: relative error (2 pi 0.1 / 6)^2 / 6 = 0.2 % of 50 ms. Blocks are interpolated
    # to a grid, which at 0.1 s leaves the same share of the acceleration and no shift; 2 ms in all.
    for lag_s in (-0.74, 0.0, 0.02, 0.55, 1.27):
        assert case(lag_s, noise=0.0, seed=7).lag()[0] == pytest.approx(lag_s, abs=2e-3)


def test_errors_are_those_that_the_sigmas_tell():
    # 40 drives: the root mean square of errors over sigmas scatters by 1 / sqrt(80) = 11 %; sigmas have a floor for
    # what is not simulated here, so the errors may be smaller than they say.
    lags = np.linspace(-0.5, 1.5, 40)
    found = np.array([case(lag_s, seed=seed).lag() for seed, lag_s in enumerate(lags)])
    error, sigma = found[:, 0] - lags, found[:, 1]
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 1.3
    assert np.abs(error).max() < 0.03
    assert sigma.max() < 0.05


def test_speed_alone_and_course_beside_it_agree():
    both = case(0.4)
    alone = replace(both, course=np.full_like(both.course, np.nan))
    seconds, sigma = alone.lag()
    assert abs(seconds - 0.4) < 3.0 * sigma
    assert both.lag()[1] <= sigma


def test_a_speed_that_hardly_changes_leaves_it_to_the_course():
    drive = case(0.4, seed=3)
    drive = replace(drive, speed=np.full_like(drive.speed, 30.0))
    seconds, sigma = drive.lag()
    assert abs(seconds - 0.4) < 3.0 * sigma
    # An antenna that may be 1.5 m ahead at 30 m/s leaves 50 ms open.
    assert 0.05 < sigma < 0.06


def test_an_antenna_ahead_of_the_axle_is_within_the_sigma_of_the_course():
    drive, ahead_m = case(0.0, noise=0.0, seed=4), 1.5
    step_s = ahead_m / 30.0
    course = np.interp(drive.fix_t_s + step_s, drive.fix_t_s, np.unwrap(drive.course))
    seconds, sigma = replace(drive, course=course, speed=np.full_like(course, 30.0)).lag()
    assert -1.2 * sigma < seconds < 0.0


def test_fixes_far_off_do_not_move_it():
    drive, rng = case(0.4), np.random.default_rng(1)
    wild = rng.random(len(drive.speed)) < 0.05
    drive = replace(drive, speed=np.where(wild, rng.uniform(0.0, 40.0, len(wild)), drive.speed))
    seconds, sigma = drive.lag()
    assert abs(seconds - 0.4) < 3.0 * sigma
    assert sigma < 0.05


def test_missing_fixes_and_silent_samples_do_not_move_it():
    drive = case(0.4, gap_s=(200.0, 230.0))
    kept = (drive.fix_t_s < 400.0) | (drive.fix_t_s > 460.0)
    drive = Case(drive.blocks, drive.fix_t_s[kept], drive.speed[kept], drive.course[kept])
    drive.speed[::7] = np.nan
    seconds, sigma = drive.lag()
    assert abs(seconds - 0.4) < 3.0 * sigma


def test_an_impact_that_no_receiver_follows_does_not_move_it():
    seconds, sigma = case(0.4, impact_s=300.0).lag()
    assert abs(seconds - 0.4) < 3.0 * sigma
    assert sigma < 0.05


def test_a_standing_box_tells_no_lag():
    assert case(moving=False).lag() == (0.0, np.inf)


def test_another_drive_tells_no_lag():
    drives = [case(seed=seed) for seed in range(5)]
    mixed = [replace(one, blocks=other.blocks) for one in drives for other in drives if one is not other]
    assert [one.lag() for one in mixed] == [(0.0, np.inf)] * len(mixed)


def test_a_lag_out_of_reach_is_not_found():
    assert case(0.9).lag(largest_s=0.5) == (0.0, np.inf)


def test_a_larger_reach_finds_a_larger_lag():
    seconds, sigma = case(4.2).lag(largest_s=6.0)
    assert abs(seconds - 4.2) < 3.0 * sigma


@pytest.mark.parametrize("seconds", [5.0, 15.0])
def test_a_log_that_is_too_short_tells_no_lag(seconds):
    assert case(seconds=seconds).lag() == (0.0, np.inf)


@pytest.mark.parametrize("fixes", [0, 1, 20])
def test_few_fixes_tell_no_lag(fixes):
    drive = case()
    few = slice(100, 100 + fixes)
    assert Case(drive.blocks, drive.fix_t_s[few], drive.speed[few], drive.course[few]).lag() == (0.0, np.inf)


def test_fixes_without_speed_tell_no_lag():
    drive = case()
    nothing = np.full_like(drive.speed, np.nan)
    assert replace(drive, speed=nothing, course=nothing).lag() == (0.0, np.inf)


def test_a_sensor_that_reads_nothing_tells_no_lag():
    drive = case()
    dead = replace(drive.blocks, accel=np.zeros_like(drive.blocks.accel), gyro=np.zeros_like(drive.blocks.gyro))
    assert replace(drive, blocks=dead).lag() == (0.0, np.inf)
