from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pytest

from recon.numerics.moving_window import moving_average
from recon.numerics.signals import runs
from recon.numerics.smoothing.samples import Samples, regular_samples
from recon.numerics.smoothing.stops import (
    Blocks,
    Floats,
    Mask,
    block_means,
    find_stops,
    still_noise,
    still_spans,
)

RATE_HZ = 100.0
BLOCK = 10
GYRO_NOISE, ACCEL_NOISE = np.radians(0.01), 1.5e-3
"""rad/s/sqrt(Hz), m/s^2/sqrt(Hz)"""
ROAD = (np.radians(1.0), 0.5)
"""rad/s, m/s^2; what a road does to a car, at 10 m/s."""


class Case(NamedTuple):
    """A drive as the detector sees it, and the truth."""

    samples: Samples
    fix_t_s: Floats
    fix_speed: Floats
    speed: Floats

    def without_fixes(self, start_s: float, stop_s: float) -> Case:
        kept = (self.fix_t_s < start_s) | (self.fix_t_s > stop_s)
        return self._replace(fix_t_s=self.fix_t_s[kept], fix_speed=self.fix_speed[kept])


def drive(
    *pieces: tuple[float, float], road: Sequence[float] = ROAD, idle: float = 0.0, receiver: float = 0.05
) -> Case:
    """Pieces of (seconds, m/s) with ramps of 2 s between; fixes each second.

    road : rad/s, m/s^2 of body motion below some 5 Hz, at 10 m/s and proportional to the speed
    idle : rad/s of vibration at 27 Hz, all the time; receiver : m/s, noise of each component of the velocity
    """
    rng = np.random.default_rng(3)
    piecewise = np.concatenate([np.full(round(seconds * RATE_HZ), speed) for seconds, speed in pieces])
    speed = moving_average(piecewise, round(2 * RATE_HZ) + 1)
    t_s = np.arange(len(speed)) / RATE_HZ

    def noisy(density: float, motion: float) -> Floats:
        slow = moving_average(rng.standard_normal((len(t_s), 3)), 21) * np.sqrt(21)
        return density * np.sqrt(RATE_HZ) * rng.standard_normal((len(t_s), 3)) + motion * speed[:, None] / 10 * slow

    gyro = noisy(GYRO_NOISE, road[0]) + np.array([0.01, -0.02, 0.005])
    gyro += idle * np.sin(2 * np.pi * 27 * t_s)[:, None]
    accel = noisy(ACCEL_NOISE, road[1]) + np.array([0.1, 0.2, 9.8])
    accel[:, 0] += np.gradient(speed, t_s)
    fix_t_s = np.arange(0.4, t_s[-1], 1.0)
    velocity = np.interp(fix_t_s, t_s, speed) + receiver * rng.standard_normal((2, len(fix_t_s)))
    samples = Samples(t_s, gyro, accel, np.zeros(len(t_s) - 1, dtype=bool), np.arange(len(t_s)), 200)
    return Case(samples, fix_t_s, np.hypot(velocity[0], receiver * rng.standard_normal(len(fix_t_s))), speed)


def found(case: Case) -> tuple[Mask, Mask]:
    """Blocks called still, and blocks that are."""
    blocks = block_means(case.samples, BLOCK)
    standing = case.speed[: len(blocks.t_s) * BLOCK].reshape(-1, BLOCK).max(axis=1) == 0
    return find_stops(blocks, case.fix_t_s, case.fix_speed).still, standing


TOWN = ((30.0, 0.0), (60.0, 12.0), (20.0, 0.0), (60.0, 14.0), (20.0, 0.0), (60.0, 9.0))


def test_stops_are_found_and_nothing_else() -> None:
    still, standing = found(drive(*TOWN))
    assert not (still & ~standing).any()
    # A window reaches half a second beyond the block at its middle, and windows must be quiet half a second around:
    # a second is lost at five of the six ends (the log begins with a stop), and little more.
    assert (standing & ~still).sum() <= 5 * 13
    assert len(runs(still)) == 3


@pytest.mark.parametrize("idle", np.radians([0.3, 1.0]))
def test_an_idling_engine_is_not_motion(idle: float) -> None:
    still, standing = found(drive(*TOWN, idle=idle))
    assert not (still & ~standing).any()
    assert still.sum() > 0.85 * standing.sum()


@pytest.mark.parametrize("road", [ROAD, (0.0, 0.0)], ids=["road", "rails"])
@pytest.mark.parametrize("silent", [False, True], ids=["gnss throughout", "outage"])
def test_a_drive_that_never_stops_has_no_stop(road: tuple[float, float], silent: bool) -> None:
    case = drive((300.0, 30.0), road=road)
    still, _ = found(case.without_fixes(100.0, 200.0) if silent else case)
    assert not still.any()


def test_a_box_that_stands_all_the_time_stands_throughout() -> None:
    still, _ = found(drive((120.0, 0.0)))
    # Noise may exceed twice its 20th percentile: chi with 3 * 10 degrees of freedom has sigma 13 %, so at 7 sigma.
    assert still.all()


@pytest.mark.parametrize("road", [ROAD, (0.0, 0.0)], ids=["road", "no road"])
@pytest.mark.parametrize("speed", [0.4, 0.6, 1.0])
def test_creeping_is_no_stop(speed: float, road: tuple[float, float]) -> None:
    still, _ = found(drive((120.0, speed), road=road))
    assert not still.any()


@pytest.mark.parametrize("road", [ROAD, (0.0, 0.0)], ids=["road", "no road"])
@pytest.mark.parametrize("speed", [0.4, 0.6, 1.0])
def test_creeping_between_stops_is_no_stop(speed: float, road: tuple[float, float]) -> None:
    still, standing = found(drive((30.0, 0.0), (60.0, speed), (30.0, 0.0), (60.0, 15.0), road=road))
    assert not (still & ~standing).any()
    assert still.any()


QUEUE = (20.0, 1.0)
"""s, m/s; what shows whether a creeping car is quiet."""


def test_a_car_whose_creeping_shows_is_seen_to_stop_in_an_outage() -> None:
    case = drive(*TOWN, QUEUE).without_fixes(85.0, 175.0)  # 90 to 110 s is the second stop
    still, standing = found(case)
    assert not (still & ~standing).any()
    assert len(runs(still)) == 3


@pytest.mark.parametrize("creeps", [True, False], ids=["creeping is seen to be quiet", "creeping is not seen"])
def test_a_car_whose_creeping_may_be_quiet_is_not_believed_to_stop_in_an_outage(creeps: bool) -> None:
    soft = (np.radians(0.15), 0.05)  # at 1 m/s a tenth of the noise of the windows, at 12 m/s more than the limits
    end = (QUEUE,) if creeps else ()
    case = drive((30.0, 0.0), (60.0, 12.0), QUEUE, (60.0, 14.0), (20.0, 0.0), (60.0, 9.0), *end, road=soft)
    still, standing = found(case.without_fixes(85.0, 115.0))  # 90 to 110 s it creeps
    assert not (still & ~standing).any()
    assert len(runs(still)) == 2


def test_what_is_as_quiet_in_motion_as_at_rest_is_not_believed_in_an_outage() -> None:
    ferry = drive((60.0, 0.0), (300.0, 9.0), (60.0, 0.0), road=(0.0, 0.0))
    still, standing = found(ferry.without_fixes(150.0, 250.0))
    assert not (still & ~standing).any()
    assert len(runs(still)) == 2


def test_without_much_motion_nothing_is_believed_in_an_outage() -> None:
    case = drive((60.0, 0.0), (10.0, 9.0), (100.0, 0.0)).without_fixes(90.0, 130.0)
    still, _ = found(case)
    in_outage = slice(930, 1270)
    assert not still[in_outage].any()
    assert still[1350:1650].all()


def without_speed(case: Case) -> Case:
    return case._replace(fix_t_s=case.fix_t_s[:0], fix_speed=case.fix_speed[:0])


def test_without_any_speed_the_stops_of_a_car_are_found() -> None:
    case = drive(*TOWN)
    rng = np.random.default_rng(4)
    rattle = np.radians(0.5) * case.speed[:, None] / 10 * rng.standard_normal((len(case.speed), 3))
    samples = Samples(**{**vars(case.samples), "gyro_s": case.samples.gyro_s + rattle})
    still, standing = found(without_speed(case._replace(samples=samples)))
    assert not (still & ~standing).any()
    assert len(runs(still)) == 3


@pytest.mark.parametrize(
    "case",
    [
        drive((120.0, 0.0)),
        drive((300.0, 30.0)),
        drive((60.0, 0.0), (300.0, 9.0), (60.0, 0.0), road=(0.0, 0.0)),
    ],
    ids=["parked", "motorway", "ferry"],
)
def test_without_any_speed_what_could_be_smooth_motion_is_no_stop(case: Case) -> None:
    still, _ = found(without_speed(case))
    assert not still.any()


def test_speeds_that_are_missing_are_no_speeds() -> None:
    case = drive(*TOWN)
    expected, _ = found(case.without_fixes(85.0, 175.0))
    speed = np.where((case.fix_t_s >= 85.0) & (case.fix_t_s <= 175.0), np.nan, case.fix_speed)
    still, _ = found(case._replace(fix_speed=speed))
    assert (still == expected).all()


@pytest.mark.parametrize("count", [1, 2, 9, 150])
def test_a_log_of_next_to_nothing_has_no_stop(count: int) -> None:
    t_s = np.arange(count) / RATE_HZ
    zero = np.zeros((count, 3))
    samples = Samples(t_s, zero, zero, np.zeros(count - 1, dtype=bool), np.arange(count), 200)
    stops = find_stops(block_means(samples, BLOCK), np.array([0.5]), np.array([0.0]))
    assert len(stops.still) == count // BLOCK
    assert not stops.still.any()
    assert not stops.quiet.any()
    assert stops.limits is None


def test_what_was_filled_in_is_not_still() -> None:
    case = drive((120.0, 0.0))
    kept = (case.samples.t_s < 50.0) | (case.samples.t_s > 58.0)
    samples = regular_samples(*(y[kept] for y in (case.samples.t_s, case.samples.gyro_s, case.samples.accel_s)))
    blocks = block_means(samples, BLOCK)
    still = find_stops(blocks, case.fix_t_s, case.fix_speed).still
    inside = (blocks.t_s > 50.0) & (blocks.t_s < 58.0)
    assert inside.sum() > 10
    assert not blocks.measured[inside].any()
    assert not still[inside].any()
    assert still[blocks.t_s < 48.5].all()
    assert still[blocks.t_s > 59.5].all()


def test_padding_makes_no_blocks() -> None:
    case = drive((9.0, 0.0))
    samples = regular_samples(case.samples.t_s, case.samples.gyro_s, case.samples.accel_s)
    blocks = block_means(samples, BLOCK)
    assert len(samples.t_s) > len(case.speed)
    assert len(blocks.t_s) == len(case.speed) // BLOCK
    assert blocks.measured.all()


def test_blocks_hold_means_and_what_varies_inside() -> None:
    samples = drive((5.0, 8.0)).samples
    blocks = block_means(samples, BLOCK)
    count = len(blocks.t_s)
    gyro = samples.gyro_s[: count * BLOCK].reshape(count, BLOCK, 3)
    accel = samples.accel_s[: count * BLOCK].reshape(count, BLOCK, 3)
    # A sum of ten numbers near 10; a variance near 1e-5 as a difference of squares under 1e-2.
    assert blocks.gyro == pytest.approx(gyro.mean(axis=1).T, abs=1e-15)
    assert blocks.accel == pytest.approx(accel.mean(axis=1).T, abs=1e-13)
    assert blocks.vibration == pytest.approx(np.sqrt(gyro.var(axis=1).sum(axis=1)), rel=1e-9)
    assert blocks.t_s == pytest.approx(np.arange(count) * 0.1 + 0.045)
    assert blocks.duration == pytest.approx(0.1)


def test_a_block_needs_samples() -> None:
    with pytest.raises(ValueError, match="a block needs samples, not 0"):
        block_means(drive((5.0, 0.0)).samples, 0)


def test_a_span_is_still_if_all_blocks_that_touch_it_are() -> None:
    blocks = block_means(drive((3.0, 0.0)).samples, BLOCK)  # block k is from k / 10 to (k + 1) / 10 s
    still = np.zeros(30, dtype=bool)
    still[10:20] = True
    start = np.array([1.2, 1.05, 1.05, 0.95, 1.5, 1.0, 2.0, -5.0, 40.0])
    stop = np.array([1.2, 1.95, 2.05, 1.5, 1.6, 1.0, 2.0, -4.0, 41.0])
    # Where a moving block meets a still one, at 1.0 and 2.0 s, both are touched.
    expected = [True, True, False, False, True, False, False, False, False]
    assert still_spans(blocks, still, start, stop).tolist() == expected


def test_the_noise_in_stops_is_that_of_the_sensors() -> None:
    case = drive((400.0, 0.0), (100.0, 10.0))
    blocks = block_means(case.samples, BLOCK)
    gyro, accel = still_noise(blocks, find_stops(blocks, case.fix_t_s, case.fix_speed).still)
    # Overlapping Allan variance of white noise over 1 s of 400 s: 1.5 * 400 degrees of freedom, times three axes, so
    # 1.7 % sigma of the density; four of them.
    assert gyro == pytest.approx(GYRO_NOISE, rel=0.07)
    assert accel == pytest.approx(ACCEL_NOISE, rel=0.07)


@pytest.mark.parametrize("count", [0, 1, 15, 100])
def test_a_short_stop_tells_no_noise(count: int) -> None:
    blocks = block_means(drive((60.0, 0.0)).samples, BLOCK)
    still = np.arange(len(blocks.t_s)) < count
    assert still_noise(blocks, still) == (None, None)
    few = Blocks(BLOCK, *(y[..., :count] for y in (blocks.t_s, blocks.gyro, blocks.accel)), *(still[:count],) * 2)
    assert still_noise(few, still[:count]) == (None, None)


def test_what_is_quiet_far_from_fixes_waits_for_a_trajectory_that_tells_its_speed() -> None:
    soft = (np.radians(0.15), 0.05)
    case = drive((30.0, 0.0), (60.0, 12.0), (20.0, 0.0), QUEUE, (60.0, 14.0), road=soft).without_fixes(85.0, 145.0)
    blocks = block_means(case.samples, BLOCK)
    stops = find_stops(blocks, case.fix_t_s, case.fix_speed)
    quiet = stops.quiet
    assert quiet[stops.told].all()
    assert quiet[930:1070].all()  # it stands from 90 to 110 s
    assert quiet[1120:1280].any()  # and creeps from 110 to 130 s
    assert not quiet[1400:].any()  # and drives on, first without fixes
