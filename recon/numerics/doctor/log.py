"""What the doctor looks at: arrays of a log, and what its reader took for granted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from recon.numerics.doctor.finding import Floats

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Imu:
    """t_s : (n,) s, rising; accel : (n, 3) m/s^2, gyro : (n, 3) rad/s, sensor axes, NaN where missing."""

    t_s: Floats
    accel: Floats
    gyro: Floats


@dataclass(frozen=True)
class Gnss:
    """Fixes, NaN where a receiver does not tell.

    t_s : (m,) s on the clock of the IMU's stamps, rising
    lat, lon : (m,) deg; height : (m,) m; speed : (m,) m/s; course : (m,) rad clockwise from north
    vel_n : (m, 3) m/s east, north, up; pos_std, vel_std : (m, 3), as the receiver tells them
    """

    t_s: Floats
    lat: Floats
    lon: Floats
    height: Floats
    speed: Floats
    course: Floats
    vel_n: Floats
    pos_std: Floats
    vel_std: Floats

    def some(self, rows: np.ndarray) -> Gnss:
        """Only some rows."""
        return Gnss(**{name: value[rows] for name, value in self.__dict__.items()})

    def later(self, shift_s: float) -> Gnss:
        """With stamps so many seconds later."""
        return replace(self, t_s=self.t_s + shift_s)

    @property
    def over_ground(self) -> Floats:
        """Speed: (m,) m/s, from vectors where nothing else tells it."""
        return np.where(np.isfinite(self.speed), self.speed, np.hypot(self.vel_n[:, 0], self.vel_n[:, 1]))

    @property
    def direction(self) -> Floats:
        """Course: (m,) rad clockwise from north, from vectors where there are any."""
        east, north = self.vel_n[:, 0], self.vel_n[:, 1]
        return np.where(np.isfinite(east + north), np.arctan2(east, north), self.course)


@dataclass(frozen=True)
class Claims:
    """What the reader took for granted, as the file has it; "" where it does not say.

    speed_unit, accel_unit, gyro_unit : units in the file; axes : where its x, y, z point, such as FRD
    at_rest : what its accelerometer shows at rest: up, down or zero
    heading_kind, height_datum : as the streams tell; sensor_class : of the noise that is expected
    dropped : rows that the reader could not use, by the reason
    """

    speed_unit: str = "m/s"
    accel_unit: str = "m/s^2"
    gyro_unit: str = "rad/s"
    axes: str = ""
    at_rest: str = "up"
    heading_kind: str = ""
    height_datum: str = ""
    sensor_class: str = "consumer_mems"
    dropped: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Log:
    """A log. heights : further sources of heights, (t_s, height m) by name."""

    imu: Imu | None
    gnss: Gnss | None
    claims: Claims
    heights: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)


def pairs(t_s: Floats, least_s: float, most_s: float) -> tuple[Rows, Rows]:
    """Rows, each with the first one at least `least_s` later, as far as that is less than `most_s` later: (k,) both.

    t_s : (n,) s, rising
    """
    after = np.searchsorted(t_s, t_s + least_s)
    first = np.flatnonzero(after < len(t_s))
    last = after[first]
    near = t_s[last] - t_s[first] < most_s
    return first[near], last[near]
