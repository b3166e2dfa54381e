"""Drives that break estimators, simulated and held to a limit that was set before.

An ordinary drive of ten minutes with the errors of study_two is to be within 2.1 m horizontally and vertically, 0.032
m/s, 0.035 deg of level and 0.10 deg of heading of the box, on average of many drives. A single drive is worse: the
slow error of 1.8 m in 120 s hardly averages out in 600 s, and the worst of two dozen drives may be 1.55 times their
mean. One drive is held to 1.75 times the limit (the worst of ten is so far from their root mean square), the median
of eight with RECON_TEST_THOROUGH=1 to 1.15 times: drives scatter by a fifth, medians of eight by a fifth over root of
eight, times 1.25 for a median and 1.65 for one side of 95 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from map_drives import (
    THOROUGH,
    Errors,
    drive,
    errors,
    fused,
    numbers,
    scaled,
    silent,
    speed_error,
    without,
)

from recon import ATTITUDE, Streams, build, matrix, spans, time_ns, vector, with_meta
from recon.numerics.rotation import from_euler, multiply
from recon.rows import warnings_of

SEEDS = range(20, 28) if THOROUGH else range(20, 21)
SLACK = 1.15 if THOROUGH else 1.75
MOUNTING = tuple(np.radians([-3.0, 4.0, 12.0]))
"""That of study_two: roll, pitch, yaw."""
INTO_BENDS = -1.0 / 9.81
"""rad per m/s^2; the lean at which a motorbike feels nothing across."""


@dataclass(frozen=True)
class Case:
    """A drive, what is done to its streams, how it is fused, and its limits where they are not the ordinary ones."""

    simulated: dict[str, Any] = field(default_factory=dict)
    params: dict[str, Any] = field(default_factory=dict)
    edit: Callable[[Streams], Streams] | None = None
    horizontal: float = 2.1
    vertical: float = 2.1
    velocity: float = 0.032
    level: float = 0.035
    heading: float = 0.10
    seeds: range = SEEDS


def turned(roll: float, pitch: float, yaw: float) -> Case:
    angles = np.radians([roll, pitch, yaw])
    return Case({f"mount_{name}": angle for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True)})


def with_first_attitude(streams: Streams) -> Streams:
    q_vs = from_euler(*np.radians([12.0, 4.0, -3.0]))
    first = multiply(matrix(streams["reference"], "q")[:1], q_vs)
    return {**streams, "attitude": build(ATTITUDE, time=time_ns(streams["imu"])[:1], q=first)}


def far_anchor(streams: Streams) -> Streams:
    """The same fixes, to be computed in axes of a place 500 km away."""
    anchor = {"lat": 44.4949, "lon": 11.3426 - 6.3, "height": 0.0}
    return {**streams, "gnss": with_meta(streams["gnss"], anchor=anchor, earth="wgs84")}


def noise(factor: float) -> dict[str, Any]:
    """That of the class, wrong by a factor."""
    return {"gyro_noise": np.radians(0.01) * factor, "accel_noise": 150e-6 * 9.80665 * factor}


# What is coarser has limits of its own:
# - at 10 Hz the vibration of 0.3 m/s^2 falls into the band of motion: its density, 0.13 m/s^2/sqrt(Hz) at most, is
#   fifty times that of the noise, and velocities of 0.1 m/s each second average only a few of them
# - without velocities these are known from positions of 1.1 m, white: half of the accuracy is left; and nothing but the
#   IMU, good for some ten seconds, tells slow error from motion: positions worse by a third, as the study found
# - speeds in steps of 1 km/h are uncertain by 0.08 m/s more, courses of 1 deg by 0.3 deg
# - in bursts of 60 s a fifth of the fixes is wrong by 8 to 35 m together, which is half a slow error itself: 9 m root
#   mean square, of which a third must be gone; how much differs from drive to drive
# - while it stands, tilt and bias of the accelerometer are one, and the bias wanders by 0.4 mg, which is 0.024 deg;
#   the heading may creep by 3e-5 rad/sqrt(s), in an hour by 0.1 deg
# - 150 s are hardly more than one slow error, which does not average out: twice as much; a quarter of the bends tells
#   the heading half as well
# - where the IMU is silent for two thirds of the time, heights there are those of GNSS, 3 m: with 2.1 m elsewhere 2.7 m
# - in reverse it goes at 2 m/s on average, and the heading that wheels tell is as much worse
# - without fixes for ten minutes and more see the tests below
CASES = {
    "ordinary": Case(),
    "no stop": Case({"motion": "nonstop"}),
    "begins at speed": Case({"motion": "nonstop", "begin": 120.0}),
    "stands for an hour": Case(
        {"duration": 4200.0, "rest": 3600.0, "imu_rate": 20.0, "vibration_band": (2.0, 9.0)}, level=0.042, heading=0.14
    ),
    "ferry": Case(
        {"motion": "ferry", "duration": 1800.0, "imu_rate": 50.0, "vibration_band": (8.0, 22.0)}, heading=0.15
    ),
    "ferry, wheels at rest": Case(
        {"motion": "ferry", "duration": 1800.0, "imu_rate": 50.0, "vibration_band": (8.0, 22.0), "wheel_rate": 10.0},
        heading=0.15,
    ),
    "reverse, mounting known": Case({"motion": "reverse"}, {"mounting": MOUNTING}, heading=0.5),
    "upside down": turned(180.0, 0.0, 0.0),
    "sideways": turned(90.0, 0.0, 0.0),
    "backwards": turned(0.0, 0.0, 180.0),
    "on its nose": turned(0.0, 89.0, 10.0),
    "on two wheels": Case({"body_roll": INTO_BENDS}),
    "anyhow": Case(
        {"mount_roll": np.radians(-120.0), "mount_pitch": np.radians(35.0), "mount_yaw": np.radians(140.0)}, level=0.1
    ),
    "fixes every 5 s": Case({"gnss_rate": 0.2, "outage_rate": 0.0}, heading=0.15),
    "10 fixes a second": Case({"gnss_rate": 10.0}),
    "imu at 10 Hz": Case({"imu_rate": 10.0, "vibration_band": (1.0, 4.5)}, velocity=0.05, heading=0.15),
    "imu at 50 Hz": Case({"imu_rate": 50.0, "vibration_band": (8.0, 22.0)}),
    "imu at 200 Hz": Case({"imu_rate": 200.0}),
    "imu at 1000 Hz": Case({"imu_rate": 1000.0, "duration": 150.0}, horizontal=4.2, vertical=4.2, heading=0.2),
    "imu with jitter": Case({"imu_jitter": 0.004}),
    "imu silent for 0.5 s": Case(
        {"outage_rate": 0.0}, edit=silent(*((t, t + 0.5) for t in range(60, 560, 50))), velocity=0.06, heading=0.3
    ),
    "imu silent for 5 s": Case(
        {"outage_rate": 0.0}, edit=silent((150, 155), (300, 305), (450, 455)), velocity=0.05, heading=0.15
    ),
    "imu silent for 60 s": Case({"outage_rate": 0.0}, edit=silent((300, 360)), heading=0.15),
    "imu silent for 20 min": Case(
        {"duration": 1800.0, "outage_rate": 0.0}, edit=silent((300, 1500)), heading=0.15, vertical=2.7
    ),
    "bursts of 60 s": Case(
        {"multipath": 0.2, "multipath_length": (60.0, 60.0)},
        horizontal=6.0,
        vertical=4.0,
        velocity=0.15,
        heading=0.15,
        seeds=SEEDS if THOROUGH else range(20, 24),
    ),
    "speed and course": Case({"gnss_vector": False}, vertical=2.3, heading=0.11),
    "coarse speed and course": Case(
        {
            "gnss_vector": False,
            "gnss_speed_step": 1.0 / 3.6,
            "gnss_course_step": np.radians(1.0),
            "gnss_course_hold": 2.0,
        },
        velocity=0.045,
        heading=0.15,
    ),
    "positions alone": Case(
        edit=without("speed", "course", "vel_e", "vel_n", "vel_u"),
        horizontal=2.8,
        velocity=0.08,
        heading=0.2,
        level=0.04,
    ),
    "sigmas twice too large": Case({"gnss_told_sigma": 2.0}),
    "sigmas half as large": Case({"gnss_told_sigma": 0.5}),
    "no sigmas": Case({"gnss_told_sigma": 0.0}),
    "noise told too small": Case(params=noise(0.2)),
    "noise told too large": Case(params=noise(5.0)),
    "80 ms late": Case({"gnss_lag": 0.08}),
    "300 ms late": Case({"gnss_lag": 0.3}),
    "1100 ms late": Case({"gnss_lag": 1.1}),
    "velocity 350 ms later": Case({"gnss_lag": 0.05, "gnss_velocity_lag": 0.4}),
    "installation known": Case(
        params={"mounting": MOUNTING, "lever_arm": (0.5, -0.3, -0.8), "rear_axle": (-1.2, -0.1, 0.6)}
    ),
    "first attitude known": Case(edit=with_first_attitude),
    "500 km from the anchor": Case(edit=far_anchor),
    "at 70 deg north": Case({"lat": np.radians(70.0)}),
    "south of the equator, at the date line": Case({"lat": np.radians(-17.0), "lon": np.radians(179.99)}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_hard_drive_is_as_good_as_its_limit_and_raises_no_doubt(name: str) -> None:
    case = CASES[name]
    found = []
    for seed in case.seeds:
        streams = drive(seed=seed, **case.simulated)
        result = fused(streams, case.edit, **case.params)
        # Multipath may put aside more than a fifth of the velocities of a short or a bad drive, and that is said.
        assert [note for note in warnings_of(result["metrics"]) if "were put aside" not in note] == []
        found.append(errors(streams, result))
    assert _median(found, "horizontal") < SLACK * case.horizontal
    assert _median(found, "vertical") < SLACK * case.vertical
    assert _median(found, "velocity") < SLACK * case.velocity
    assert _median(found, "level") < SLACK * case.level
    assert _median(found, "heading") < SLACK * case.heading


def _median(found: list[Errors], name: str) -> float:
    values = [getattr(one, name) for one in found]
    return float(np.median([value() if callable(value) else value for value in values]))


@pytest.mark.parametrize(("lean", "expected"), [(INTO_BENDS, INTO_BENDS), (0.0087, 0.0087), (-0.01, -0.01)])
def test_what_leans_into_bends_is_told_from_what_leans_out_of_them(lean: float, expected: float) -> None:
    """A car held to be a motorbike, or the other way round, would have a lean that is ten sigmas off."""
    for seed in SEEDS:
        rows = fused(drive(seed=seed, body_roll=lean))["metrics"].to_pylist()
        (found,) = (row for row in rows if row["name"] == "roll_per_acceleration")
        assert abs(found["value"] - expected) < 3.0 * found["sigma"] < 0.03
        assert (found["note"] == "it leans into bends, as what has two wheels does") == (lean == INTO_BENDS)


def test_without_heights_the_rest_stays_as_good() -> None:
    streams = drive(seed=20)
    found = errors(streams, fused(streams, without("height", "pos_std_u")))
    assert found.horizontal() < 1.5 * 2.1
    assert found.velocity < 1.5 * 0.032
    assert np.isnan(found.pos[:, 2]).all()


@pytest.mark.parametrize("columns", [("time", "speed"), ("time", "speed", "course")])
def test_without_positions_there_is_a_trajectory_from_the_start(columns: tuple[str, ...]) -> None:
    """Speed alone says nothing of the absolute heading: it begins north."""
    streams = drive(seed=20)
    result = fused(streams, lambda s: {**s, "gnss": s["gnss"].select(list(columns))})
    # The speed of each second is known to 0.1 m/s, and so is the motion across and upwards that wheels allow.
    assert speed_error(streams, result) < 0.1 * np.sqrt(3.0)
    assert np.isnan(vector(result["trajectory"], "lat", gaps=True)).all()
    assert np.abs(matrix(result["trajectory"], "pos")[0]).max() < 0.01
    assert warnings_of(result["metrics"]) == []


def test_in_reverse_the_box_is_right_and_which_end_is_in_front_is_said_to_be_a_guess() -> None:
    streams = drive("reverse", seed=20)
    result = fused(streams)
    found = errors(streams, result)
    assert found.horizontal() < 1.5 * 2.1
    assert found.level < 1.5 * 0.035
    assert found.heading < 1.5 * 0.5
    assert any("in front is a guess" in note for note in warnings_of(result["metrics"]))


def test_in_reverse_with_the_mounting_known_the_vehicle_faces_backwards() -> None:
    streams = drive("reverse", seed=20)
    assert errors(streams, fused(streams, mounting=MOUNTING)).heading_of_vehicle < 1.5 * 0.5


def bridged(first: float, last: float, duration: float) -> list[Errors]:
    """Of some drives without fixes in a span of time."""
    found = []
    for seed in range(20, 28) if THOROUGH else range(20, 22):
        streams = drive(
            seed=seed, duration=duration, outages=((first, last),), imu_rate=50.0, vibration_band=(8.0, 22.0)
        )
        found.append(errors(streams, fused(streams)))
    return found


@pytest.mark.parametrize(
    ("first", "last", "duration", "limit"),
    [(600.0, 1200.0, 1800.0, 25.0), (300.0, 600.0, 600.0, 50.0), (0.0, 300.0, 600.0, 50.0)],
)
def test_minutes_without_fixes_are_bridged(first: float, last: float, duration: float, limit: float) -> None:
    """In the middle, at the end, and at the start of the record.

    A tilt known to 0.025 deg is an acceleration of 4 mm/s^2, in the two minutes between stops 30 m, and in five minutes
    with independent signs 50 m. Fixes at both ends halve the time, and with it a quarter is left: at most 25 m.
    """
    assert np.median([one.horizontal((first, last)) for one in bridged(first, last, duration)]) < limit


@pytest.mark.parametrize(
    ("first", "last", "duration"), [(600.0, 1200.0, 1800.0), (300.0, 600.0, 600.0), (0.0, 300.0, 600.0)]
)
def test_sigmas_cover_what_minutes_without_fixes_cost(first: float, last: float, duration: float) -> None:
    """Three sigmas: the errors of one outage are all but one error."""
    assert np.median([one.over_sigma((first, last)) for one in bridged(first, last, duration)]) < 3.0


def test_a_stop_without_fixes_is_told_from_creeping_by_the_trajectory() -> None:
    """From 334 to 352 s this car creeps at 1 m/s, as quietly as it stands from 354 to 401 s."""
    streams = drive(
        seed=50006,
        duration=420.0,
        outages=((330.0, 380.0),),
        outage_rate=0.0,
        imu_rate=50.0,
        vibration_band=(8.0, 22.0),
    )
    result = fused(streams)
    stood = (np.array(spans(result["events"], "standstill")) - time_ns(streams["imu"])[0]) * 1e-9
    (silent,) = stood[(stood[:, 1] > 330.0) & (stood[:, 0] < 380.0)]
    assert 354.0 < silent[0] < 357.0  # a stop loses a second to windows, and what the body sways after it
    assert 398.0 < silent[1] < 401.0
    # A second of it is known to 0.02 m/s, and all of it, more than ten, to a third of that.
    at_rest = matrix(result["trajectory"], "vel")[np.searchsorted(errors(streams, result).t_s, 365.0)]
    assert np.linalg.norm(at_rest) < 0.02


def test_vibration_that_a_slow_imu_folds_down_is_noise_and_no_walk_of_the_bias() -> None:
    """At 10 Hz 0.3 m/s^2 of vibration at 54 km/h become white noise of 0.095 m/s^2/sqrt(Hz), sixty times what is
    expected; on average of the drive, which also stands, half as much.
    """
    for seed in SEEDS:
        found = numbers(fused(drive(seed=seed, imu_rate=10.0)))
        assert 0.3 * 0.095 < found["accel_noise"] < 0.095
        # The class has 30 ug/sqrt(s), known to a factor of exp(0.5): twice that.
        assert found["accel_bias_walk"] < 30e-6 * 9.81 * np.exp(2.0 * 0.5)


def test_wheels_help_most_where_there_are_no_fixes() -> None:
    """Once their scale error of 2 % is found; left as it is, it would be 0.2 m/s at 10 m/s."""
    with_wheels, alone = [], []
    for seed in SEEDS:
        streams = drive(seed=seed, outages=((200.0, 400.0),), wheel_rate=10.0, wheel_scale=0.02)
        with_wheels.append(errors(streams, fused(streams)).velocity)
        alone.append(errors(streams, fused({name: streams[name] for name in streams if name != "wheel"})).velocity)
    assert np.median(with_wheels) < 0.8 * np.median(alone)


def test_a_gyroscope_that_wanders_far_converges_without_fixes_and_wheels_help() -> None:
    """In the last four minutes its bias moves by 0.15 deg/s, so that the heading ends some 20 deg off, too far for a
    start that stays where the last fix was. Five sigmas: an error of the heading there is one error, and not linear.
    """
    last, rolled, alone = (720.0, 960.0), [], []
    for seed in range(1, 9) if THOROUGH else (1, 4):
        streams = drive(
            "mixed", "consumer_mems", seed, duration=960.0, imu_rate=50.0, outages=(last,), wheel_rate=20.0,
            gyro_bias_walk=np.radians(0.01),
        )  # fmt: skip
        without_wheels = {name: streams[name] for name in streams if name != "wheel"}
        for given, found in ((streams, rolled), (without_wheels, alone)):
            result = fused(given)
            assert warnings_of(result["metrics"]) == []
            found.append(errors(streams, result))
            assert found[-1].over_sigma(last) < 5.0
    assert np.median([one.horizontal(last) for one in rolled]) < np.median([one.horizontal(last) for one in alone])


@pytest.mark.parametrize("told", [0.5, 2.0])
def test_sigmas_told_wrong_hardly_change_the_position(told: float) -> None:
    """Under 5 % over many drives; a single one changes by its outliers, a few may by three times that."""
    changed = []
    for seed in range(20, 28) if THOROUGH else range(20, 22):
        true, wrong = (drive(seed=seed, gnss_told_sigma=factor) for factor in (1.0, told))
        changed.append([errors(streams, fused(streams)).horizontal() for streams in (true, wrong)])
    before, after = np.sqrt((np.array(changed) ** 2).mean(axis=0))
    assert after < (1.08 if THOROUGH else 1.15) * before


def test_corrected_fixes_give_centimetres_and_decimetres_after_a_minute_without() -> None:
    found = []
    for seed in SEEDS:
        streams = drive(sensors="rtk", seed=seed, outages=((300.0, 360.0),), imu_rate=100.0)
        found.append(errors(streams, fused(streams)))
    # In the outage, bridged from both ends: tilt that wanders with the noise of the gyroscope and the noise of the
    # accelerometer leave 0.07 m on each axis, heading 0.05 m across at 15 m/s, 0.11 m together; twice that, for biases
    # and scales are learnt from the same ten minutes.
    inside = [one.horizontal((300.0, 360.0)) for one in found]
    outside = [np.hypot(one.horizontal((0.0, 299.0)), one.horizontal((361.0, 600.0))) / np.sqrt(2.0) for one in found]
    assert np.median(outside) < 0.05
    assert np.median(inside) < 0.22


def test_a_wrong_unit_of_speed_is_said_loudly() -> None:
    streams = drive(seed=20, duration=300.0, gnss_vector=False)
    notes = warnings_of(fused(streams, scaled(("speed",), 3.6))["metrics"])
    assert any("km/h" in note for note in notes)
