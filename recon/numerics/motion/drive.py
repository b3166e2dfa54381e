"""A drive as a row of segments, each easing the vehicle from the state before it to its own end state.

Within a segment of duration T the speed is a function of time, and the road (its curvature, slope and bank) a function
of the distance travelled, so that a vehicle never yaws on the spot and reverses along its own track. With x = t / T,
d(x) the distance since the start of the segment and D = d(1), every quantity goes from its old to its new value along
the cycloidal law of cam design (Norton, Cam Design and Manufacturing Handbook, ch. 3), which is twice continuously
differentiable:

    S(x) = x - sin(2 pi x) / (2 pi),    S'(x) = 2 sin^2(pi x)   (the haversine pulse)

    speed v = v0 + (v1 - v0) S(x)       curvature k = k0 + (k1 - k0) S(d / D)
    d       = T (v0 x + (v1 - v0) Q(x)) yaw       = yaw0 + D (k0 u + (k1 - k0) Q(u)),  u = d / D

with Q the integral of S; slope and bank ease over u as the curvature does, the dive of the body over x. The vehicle
moves along its road without side-slip: v_n = v (cos yaw cos slope, sin yaw cos slope, sin slope). All of this and its
derivatives are closed formulas; only the position is integrated, by Gauss-Legendre quadrature of v_n over pieces so
short that its error is below rounding.

The road has the ISO 8855 Euler angles yaw, pitch = -slope and roll = bank; the body on it is turned by the dive about
its y axis, positive nose down.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from recon.numerics.motion.euler import angular_acceleration, angular_rate, carried_rates
from recon.numerics.motion.truth import RoadTruth
from recon.numerics.rotation import Floats, from_euler, from_rotvec, multiply

# A piece is at most 1/16 of a segment and 0.4 rad of yaw on average over time, so that the phases 2 pi x, 2 pi d / D
# (d' <= 2 D) and yaw turn by less than 1 rad in it. The remainder of eight nodes over a length h,
# h^17 (8!)^4 / (17 (16!)^3) f^(16) = 2e-23 h^17 f^(16), is then far below rounding.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_PIECES, _YAW_PER_PIECE = 16, 0.4
_Y = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Segment:
    """A stretch of a drive. Each value holds at the end of the segment; the segment before it says where it starts.

    duration_s : s
    speed : m/s along the vehicle's x axis, negative in reverse
    curvature : 1/m of the road ahead of the vehicle, positive where forward driving turns left
    slope : rad, positive uphill in the direction of x
    bank : rad, positive where the left side is higher
    dive : rad, pitch of the body relative to the road, positive nose down; it turns about the origin of the vehicle
    """

    duration_s: float
    speed: float
    curvature: float = 0.0
    slope: float = 0.0
    bank: float = 0.0
    dive: float = 0.0


def duration_of(segments: Iterable[Segment]) -> float:
    """How long segments last together: s."""
    return sum(segment.duration_s for segment in segments)


@dataclass(frozen=True)
class Drive:
    """Segments one after the other, from rest on a level road at the origin to rest.

    yaw : rad, at the start, from east towards north
    Before its start and after its end the vehicle stands still.
    Raises ValueError where the segments do not make a drive: see `_faults`.
    """

    segments: tuple[Segment, ...]
    yaw: float = 0.0

    def __post_init__(self) -> None:
        """Refuse an impossible drive where it is written down, not where it is evaluated."""
        for fault in _faults(self.segments):
            raise ValueError(fault)

    @property
    def edges_s(self) -> Floats:
        """Start of each segment and end of the last: (segments + 1,) s."""
        return np.append(self._legs.start_s, self.duration_s)

    @property
    def duration_s(self) -> float:
        """Length of the drive in s."""
        return float(self._legs.start_s[-1] + self._legs.duration_s[-1])

    @cached_property
    def _legs(self) -> _Legs:
        return _Legs.of(self.segments, self.yaw)

    @cached_property
    def _track(self) -> _Track:
        return _Track.of(self._legs)

    def at(self, t_s: Floats) -> RoadTruth:
        """Truth at the times (n,) s, in any order."""
        legs = self._legs
        leg = np.clip(np.searchsorted(legs.start_s, t_s, side="right") - 1, 0, None)
        x = np.clip((t_s - legs.start_s[leg]) / legs.duration_s[leg], 0.0, 1.0)
        speed, speed_rate = legs.speeds(leg, x)
        u, u_rate, u_accel = legs.progress(leg, x), speed / legs.moving[leg], speed_rate / legs.moving[leg]
        yaw, bend = legs.yaw(leg, u), legs.value(legs.bend, leg, u)
        slope, bank, dive = (legs.value(v, leg, w) for v, w in ((legs.slope, u), (legs.bank, u), (legs.dive, x)))
        bend_rate, _ = legs.rates(legs.bend, leg, u, u_rate, u_accel)
        slope_rate, slope_accel = legs.rates(legs.slope, leg, u, u_rate, u_accel)
        bank_rate, bank_accel = legs.rates(legs.bank, leg, u, u_rate, u_accel)
        dive_rate, dive_accel = legs.rates(legs.dive, leg, x, 1.0 / legs.duration_s[leg], np.zeros_like(x))

        rates = np.stack((bend * speed, -slope_rate, bank_rate), axis=-1)
        accels = np.stack((bend_rate * speed + bend * speed_rate, -slope_accel, bank_accel), axis=-1)
        q_rv = from_rotvec(dive[:, None] * _Y)
        gyro_v, gyro_rate_v = carried_rates(
            q_rv,
            angular_rate(-slope, bank, rates),
            angular_acceleration(-slope, bank, rates, accels),
            dive_rate[:, None] * _Y,
            dive_accel[:, None] * _Y,
        )
        left_n = np.stack((-np.sin(yaw), np.cos(yaw), np.zeros_like(yaw)), axis=-1)
        above_n = np.stack((-np.cos(yaw) * np.sin(slope), -np.sin(yaw) * np.sin(slope), np.cos(slope)), axis=-1)
        along_n = _direction(yaw, slope)
        return RoadTruth(
            t_s=t_s,
            pos_n=self._track.position(leg, x),
            vel_n=speed[:, None] * along_n,
            acc_n=speed_rate[:, None] * along_n
            + (speed * bend * speed * np.cos(slope))[:, None] * left_n
            + (speed * slope_rate)[:, None] * above_n,
            q_nv=multiply(from_euler(yaw, -slope, bank), q_rv),
            gyro_v=gyro_v,
            gyro_rate_v=gyro_rate_v,
        )


@dataclass(frozen=True)
class _Legs:
    """The segments as arrays over their number m; values (m, 2) at their start and end."""

    start_s: Floats
    duration_s: Floats
    length: Floats  # (m,) m, negative in reverse
    start_yaw: Floats
    speed: Floats
    bend: Floats
    slope: Floats
    bank: Floats
    dive: Floats

    @classmethod
    def of(cls, segments: Sequence[Segment], yaw: float) -> _Legs:
        duration_s = np.array([s.duration_s for s in segments])
        ends = np.array([(s.speed, s.curvature, s.slope, s.bank, s.dive) for s in segments])
        values = np.stack((np.vstack((np.zeros(5), ends[:-1])), ends), axis=-1)
        speed, bend, slope, bank, dive = np.moveaxis(values, 1, 0)
        length = duration_s * speed.mean(axis=1)
        turns = length * bend.mean(axis=1)
        start_s = np.concatenate(([0.0], np.cumsum(duration_s[:-1])))
        start_yaw = yaw + np.concatenate(([0.0], np.cumsum(turns[:-1])))
        return cls(start_s, duration_s, length, start_yaw, speed, bend, slope, bank, dive)

    @cached_property
    def moving(self) -> Floats:
        """(m,) m, the length, and infinity where the leg stands, so that its progress is zero."""
        return np.where(self.length == 0.0, np.inf, self.length)

    def speeds(self, leg: NDArray[np.intp], x: Floats) -> tuple[Floats, Floats]:
        """Speed in m/s and its rate in m/s^2 at the fraction x of the leg's duration."""
        rate, _ = self.rates(self.speed, leg, x, 1.0 / self.duration_s[leg], np.zeros_like(x))
        return self.value(self.speed, leg, x), rate

    def progress(self, leg: NDArray[np.intp], x: Floats) -> Floats:
        """The fraction u of the leg's length travelled."""
        start, end = self.speed[leg].T
        return np.asarray(self.duration_s[leg] * (start * x + (end - start) * _ease_integral(x)) / self.moving[leg])

    def yaw(self, leg: NDArray[np.intp], u: Floats) -> Floats:
        """Yaw in rad at the fraction u of the leg's length."""
        start = self.bend[leg, 0]
        turns = start * u + (self.bend[leg, 1] - start) * _ease_integral(u)
        return np.asarray(self.start_yaw[leg] + self.length[leg] * turns)

    @staticmethod
    def value(values: Floats, leg: NDArray[np.intp], u: Floats) -> Floats:
        """Value at the fraction u of its leg."""
        start = values[leg, 0]
        return np.asarray(start + (values[leg, 1] - start) * _ease(u))

    @staticmethod
    def rates(
        values: Floats, leg: NDArray[np.intp], u: Floats, u_rate: Floats, u_accel: Floats
    ) -> tuple[Floats, Floats]:
        """First and second derivative by time of a value at the fraction u of its leg."""
        change, slope = values[leg, 1] - values[leg, 0], _ease_rate(u)
        return change * slope * u_rate, change * (2.0 * np.pi * np.sin(2.0 * np.pi * u) * u_rate**2 + slope * u_accel)

    def velocity(self, leg: NDArray[np.intp], x: Floats) -> Floats:
        """(n, 3) m/s, local."""
        u = self.progress(leg, x)
        return self.value(self.speed, leg, x)[:, None] * _direction(self.yaw(leg, u), self.value(self.slope, leg, u))

    def displacement(self, leg: NDArray[np.intp], x_from: Floats, x_to: Floats) -> Floats:
        """Integral of the velocity between two fractions of the leg's duration: (n, 3) m, local."""
        half, middle = (x_to - x_from) / 2.0, (x_to + x_from) / 2.0
        mean = np.zeros((len(leg), 3))
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            mean += weight * self.velocity(leg, middle + node * half)
        return (half * self.duration_s[leg])[:, None] * mean


@dataclass(frozen=True)
class _Track:
    """Positions at the edges of the pieces into which the legs are cut for the quadrature."""

    legs: _Legs
    pieces: NDArray[np.intp]  # (m,) pieces of each leg
    first: NDArray[np.intp]  # (m,) number of the first piece of each leg
    start_n: Floats  # (pieces, 3) m, local, at the start of each piece

    @classmethod
    def of(cls, legs: _Legs) -> _Track:
        most_yaw = np.abs(legs.length) * np.abs(legs.bend).max(axis=1)
        pieces = np.maximum(_PIECES, np.ceil(most_yaw / _YAW_PER_PIECE)).astype(np.intp)
        first = np.cumsum(pieces) - pieces
        leg = np.repeat(np.arange(len(pieces)), pieces)
        number = np.arange(len(leg)) - first[leg]
        steps = legs.displacement(leg, number / pieces[leg], (number + 1) / pieces[leg])
        return cls(legs, pieces, first, np.vstack((np.zeros(3), np.cumsum(steps[:-1], axis=0))))

    def position(self, leg: NDArray[np.intp], x: Floats) -> Floats:
        """Position at the fraction x of the leg's duration: (n, 3) m, local."""
        pieces = self.pieces[leg]
        number = np.minimum((x * pieces).astype(np.intp), pieces - 1)
        return self.start_n[self.first[leg] + number] + self.legs.displacement(leg, number / pieces, x)


def _ease(x: Floats) -> Floats:
    return x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi)


def _ease_rate(x: Floats) -> Floats:
    return 2.0 * np.sin(np.pi * x) ** 2


def _ease_integral(x: Floats) -> Floats:
    return x**2 / 2.0 - np.sin(np.pi * x) ** 2 / (2.0 * np.pi**2)


def _direction(yaw: Floats, slope: Floats) -> Floats:
    """Unit vector of a heading that climbs: (n, 3), local."""
    return np.stack((np.cos(yaw) * np.cos(slope), np.sin(yaw) * np.cos(slope), np.sin(slope)), axis=-1)


def _faults(segments: Sequence[Segment]) -> list[str]:
    """What keeps the segments from being a drive, one sentence each."""
    if not segments:
        return ["a drive needs at least one segment"]
    faults = []
    before = Segment(0.0, 0.0)
    for number, segment in enumerate(segments):
        if not segment.duration_s > 0.0:
            faults.append(f"segment {number} lasts {segment.duration_s} s; it must be longer than nothing")
        if before.speed * segment.speed < 0.0:
            faults.append(f"segment {number} reverses from {before.speed} to {segment.speed} m/s; stop in between")
        standing = before.speed == segment.speed == 0.0
        if standing and (segment.slope, segment.bank) != (before.slope, before.bank):
            faults.append(f"segment {number} changes slope or bank while the vehicle stands; repeat those before it")
        before = segment
    if before.speed != 0.0:
        faults.append(f"the last segment ends at {before.speed} m/s; a drive ends at rest")
    return faults
