"""The simulated drives of the benchmark, what fuser.map is told of them, and what is demanded of it.

Route and noise of a drive have the number FIRST and those after it, which no parameter was ever chosen on. Cases of the
same kind of drive share the numbers, so that they can be compared. Fixes tell no sigma unless the case says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from recon.sensor_classes import SensorClass, typical
from recon_fusers.map import MapParams
from recon_simulators.drive_params import DriveParams
from recon_simulators.presets import preset_value

FIRST: Final = 6000
TEN_MINUTES, HOUR = 600.0, 3600.0

Demand = Mapping[str, float]
"""Largest value of a column: its root mean square over drives, or the statistic named before a colon."""


@dataclass(frozen=True)
class Job:
    """One drive, and what fuser.map is told."""

    drive: DriveParams
    fuser: MapParams = field(default_factory=MapParams)


@dataclass(frozen=True)
class Case:
    """Drives of one kind. jobs : as many as are asked for, each with its own number."""

    name: str
    jobs: tuple[Job, ...]
    demand: Demand = field(default_factory=dict)


@dataclass(frozen=True)
class Size:
    """How much is measured. drives : of each case, None for its own; longest_s : no drive is longer."""

    drives: int | None = None
    longest_s: float = HOUR

    def jobs(self, usual: int, seconds: float, of: Callable[[int, float], Job]) -> tuple[Job, ...]:
        """`of` called with the number and the length of each drive."""
        length = min(seconds, self.longest_s)
        return tuple(of(FIRST + i, length) for i in range(self.drives or usual))


_LEAST_SIZE: Final = 1e-6
"""In SI; a scale error that is not there has still a sigma."""
_CLASSES: Final[Mapping[str, SensorClass]] = {"rtk": "automotive", "automotive": "automotive"}
"""Sensors whose class is told; the others are of the default."""
_STUDY_ONE: Final = {
    "horizontal": 1.20, "vertical": 1.3, "velocity": 0.030, "tilt": 0.026, "heading": 0.06, "outage_horizontal": 1.3,
}  # fmt: skip
_STUDY_TWO: Final = {
    "horizontal": 2.1, "vertical": 2.1, "velocity": 0.032, "tilt": 0.035, "heading": 0.10,
    "vehicle_heading": 0.085, "vehicle_pitch": 0.035, "vehicle_roll": 0.20,
    "outage_horizontal": 2.1, "outage_velocity": 0.037, "outage_heading": 0.10,
}  # fmt: skip
_STUDY_TWO_HOUR: Final = {
    "horizontal": 1.75, "vertical": 1.4, "velocity": 0.030, "tilt": 0.025, "heading": 0.065,
    "vehicle_heading": 0.06, "vehicle_pitch": 0.02, "vehicle_roll": 0.12,
    "outage_horizontal": 1.7, "outage_velocity": 0.042, "outage_heading": 0.075,
}  # fmt: skip
_ANY_MOUNTING: Final = {
    "mean:horizontal": 1.35, "max:horizontal": 2.1, "vertical": 1.4, "velocity": 0.030, "tilt": 0.032, "heading": 0.08,
    "outage_horizontal": 1.3,
}  # fmt: skip
_SPEED_AND_COURSE: Final = {**_STUDY_TWO, "vertical": 1.1 * 2.1, "heading": 1.1 * 0.10}


def drive_of(number: int, seconds: float, sensors: str, motion: str, **more: Any) -> DriveParams:
    """Parameters of the drive of some number on a long route; fixes tell no sigma unless `more` says otherwise."""
    drive = {"sensors": sensors, "motion": motion, "duration": seconds, "route": number, "seed": number}
    return DriveParams.model_validate({**drive, "gnss_told_sigma": 0.0, **more})


def kind(sensors: str, motion: str, **more: Any) -> Callable[[int, float], Job]:
    """Makes drives of one kind; `more` are parameters of the simulator."""
    fuser = MapParams(sensor_class=_CLASSES.get(sensors, "consumer_mems"))
    return lambda number, seconds: Job(drive_of(number, seconds, sensors, motion, **more), fuser)


def _mounted_anyhow(number: int, seconds: float) -> Job:
    """Of each three drives two have the box turned by quarters, tilted, and perhaps upside down."""
    if number % 3 == 0:
        return Job(drive_of(number, seconds, "study_one", "country"))
    rng = np.random.default_rng(number)
    yaw, roll = 90.0 * rng.integers(4) + rng.uniform(-10.0, 10.0), 180.0 * rng.integers(2) + rng.uniform(-15.0, 15.0)
    angles = np.radians([yaw, rng.uniform(-20.0, 20.0), roll])
    mounting = dict(zip(("mount_yaw", "mount_pitch", "mount_roll"), angles.tolist(), strict=True))
    return Job(drive_of(number, seconds, "study_one", "country", **mounting))


def _with_outages(sensors: str, length_s: float, **more: Any) -> Callable[[int, float], Job]:
    """Twice in a city drive there is no fix for a while."""

    def of(number: int, seconds: float) -> Job:
        outages = tuple((share * seconds, share * seconds + length_s) for share in (0.3, 0.65))
        return kind(sensors, "city", outages=outages, **more)(number, seconds)

    return of


_SIZES: Final = (
    *(f"{sensor}_{what}" for sensor in ("gyro", "accel") for what in ("noise", "bias_walk", "bias", "scale")),
    *(f"gnss_{what}" for what in ("horizontal", "vertical", "white_horizontal", "white_vertical")),
    *("gnss_correlation", "gnss_velocity", "gnss_velocity_vertical"),
)
"""What simulator and fuser call by the same name: sigmas, noise densities and a time."""


def _told_truly(of: Callable[[int, float], Job]) -> Callable[[int, float], Job]:
    """The same drives with the size of every error told as it is drawn, so that nothing is left to learn of it."""

    def told(number: int, seconds: float) -> Job:
        job = of(number, seconds)
        sizes = {name: max(preset_value(job.drive.sensors, name), _LEAST_SIZE) for name in _SIZES}
        return replace(job, fuser=MapParams.model_validate({**sizes, "estimate_noise": False}))

    return told


def accuracy_cases(size: Size) -> list[Case]:
    """The rows of the tables of errors and of honesty."""
    coarse = {"gnss_vector": False, "gnss_speed_step": 1.0 / 3.6, "gnss_course_step": np.radians(1.0)}
    fine = {name: value if value is False else 0.1 * value for name, value in coarse.items()}
    named: list[tuple[str, int, float, Callable[[int, float], Job], Demand]] = [
        ("study_one, country, 60 min", 10, HOUR, kind("study_one", "country"), _STUDY_ONE),
        ("study_one, country, 10 min, two of three mounted anyhow", 24, TEN_MINUTES, _mounted_anyhow, _ANY_MOUNTING),
        ("the same, true sizes of all errors told", 24, TEN_MINUTES, _told_truly(_mounted_anyhow), {}),
        ("study_two, mixed, 10 min", 20, TEN_MINUTES, kind("study_two", "mixed"), _STUDY_TWO),
        ("study_two, mixed, 60 min", 6, HOUR, kind("study_two", "mixed"), _STUDY_TWO_HOUR),
        ("study_two, mixed, 10 min, speed and course only", 20, TEN_MINUTES,
         kind("study_two", "mixed", gnss_vector=False), _SPEED_AND_COURSE),
        ("the same, steps of 0.1 km/h and 0.1 deg", 20, TEN_MINUTES,
         kind("study_two", "mixed", **fine), _SPEED_AND_COURSE),
        ("the same, steps of 1 km/h and 1 deg", 20, TEN_MINUTES, kind("study_two", "mixed", **coarse), {}),
        ("rtk, city, sigmas told, two outages of 30 s", 10, TEN_MINUTES,
         _with_outages("rtk", 30.0, gnss_told_sigma=1.0), {}),
        ("rtk, city, sigmas told, two outages of 60 s", 10, TEN_MINUTES,
         _with_outages("rtk", 60.0, gnss_told_sigma=1.0), {"outage_horizontal": 0.15}),
        ("rtk, city, sigmas told", 10, TEN_MINUTES, kind("rtk", "city", gnss_told_sigma=1.0), {"horizontal": 0.05}),
        ("rtk, city", 10, TEN_MINUTES, kind("rtk", "city"), {}),
        ("consumer_mems, city, two outages of 30 s", 10, TEN_MINUTES, _with_outages("consumer_mems", 30.0), {}),
        ("automotive, city, two outages of 30 s", 10, TEN_MINUTES, _with_outages("automotive", 30.0), {}),
    ]  # fmt: skip
    return [Case(name, size.jobs(usual, seconds, of), demand) for name, usual, seconds, of, demand in named]


def insurance_cases(size: Size) -> list[Case]:
    """The same drives with what fuser.map is told right and wrong; the first case is the right one."""

    def told(factor: float) -> Callable[[int, float], Job]:
        return kind("study_two", "mixed", gnss_told_sigma=factor)

    def given(factor: float) -> Callable[[int, float], Job]:
        noise = {name: factor * typical("consumer_mems", name) for name in ("gyro_noise", "accel_noise")}
        of = told(1.0)
        return lambda number, seconds: replace(of(number, seconds), fuser=MapParams.model_validate(noise))

    named = [
        ("nothing wrong", told(1.0)),
        ("all sigmas of GNSS doubled", told(2.0)),
        ("all sigmas of GNSS halved", told(0.5)),
        ("noise of the IMU given 5 times too large", given(5.0)),
        ("noise of the IMU given 5 times too small", given(0.2)),
    ]
    return [Case(name, size.jobs(20, TEN_MINUTES, of)) for name, of in named]
