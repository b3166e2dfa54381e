"""What other sensors add to IMU and GNSS, as factors of knots: maps, cameras, speeds, steering. Barometers: `climbs`.

    ground      n (p - p_g)                 = 0           on the plane of the ground below, normal n
    direction   E C^T u / |u|               = 0           E across the direction that a camera saw, C what its axes are
                                                          off by, u = R^T v + w x l its velocity, l its lever; sensor
    speed       |v|                         - (1 + k) s   s a speed along the way, k the error of its scale
    rate        a (gyro - b_g)              - r           r a turn rate about a, from a camera or from wheels

Each aid is told in its own times, and `at` the knots it becomes factors. All are robust (Cauchy), for a map does not
know bridges, and a camera follows other cars.

References
    Groves (2013), 2nd ed., sections 13.1 (height aiding), 13.3 (visual navigation).
    Holland, Welsch (1977), Communications in Statistics A6(9) (Cauchy's weights).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from recon.numerics.smoothing.earth import GravityField
from recon.numerics.smoothing.normal import Normal
from recon.numerics.smoothing.robust import cauchy_weights
from recon.numerics.smoothing.soa import Floats, cross, mtv, rotation_exp
from recon.numerics.smoothing.state import (
    CAMERA,
    CAMERA_LEVER,
    GYRO_BIAS,
    POSITION,
    ROTATION,
    VELOCITY,
    WHEEL,
    State,
)

_C2: Final = 9.0
_AROUND_S: Final = 1.0
"""s before and behind a knot from which an aid's samples count for it."""
_MOVING: Final = 1.0
"""m/s above which a direction of travel means something."""
_MEAN_SIGMA: Final = np.radians(0.1)
"""rad by which the mean of directions over two seconds is another than that of the middle."""


class Factors(Protocol):
    """An aid at the knots of a drive."""

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state."""


class Aid(Protocol):
    """Measurements in their own times."""

    def at(self, knot_t_s: Floats) -> Factors:
        """The factors at knots (N,) s; those outside of the aid's times are without."""


@dataclass(frozen=True)
class Ground:
    """Planes of the ground that the box moves along.

    t_s : (m,) s, rising; pos_n : (3, m) m, a point of the plane, raised by the height of the box; normal_n : (3, m)
    sigma : (m,) m, of the distance from the plane; apart : m, over which errors of the map are the same
    """

    t_s: Floats
    pos_n: Floats
    normal_n: Floats
    sigma: Floats
    apart: float

    def at(self, knot_t_s: Floats) -> GroundFactors:
        """The plane nearest in time; a stretch of `apart` tells no more than one of its knots."""
        right = np.clip(np.searchsorted(self.t_s, knot_t_s), 1, len(self.t_s) - 1)
        nearest = right - (knot_t_s - self.t_s[right - 1] < self.t_s[right] - knot_t_s)
        k = np.flatnonzero(np.abs(self.t_s[nearest] - knot_t_s) <= _AROUND_S)
        row = nearest[k]
        moved = np.sqrt((np.diff(self.pos_n[:, row]) ** 2).sum(axis=0))
        share = np.clip(np.append(moved, moved[-1:]) / self.apart, 0.01, 1.0)
        return GroundFactors(k, self.pos_n[:, row], self.normal_n[:, row], self.sigma[row] ** 2 / share)


@dataclass(frozen=True)
class GroundFactors:
    """k : (n,) knots; pos_n, normal_n : (3, n); variance : (n,) m^2."""

    k: NDArray[np.intp]
    pos_n: Floats
    normal_n: Floats
    variance: Floats

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state."""
        error = (self.normal_n * (state.pos_n[:, self.k] - self.pos_n)).sum(axis=0)
        root = np.sqrt(cauchy_weights(error**2 / self.variance, _C2) / self.variance)
        tall = np.stack([*(self.normal_n * root), -error * root], axis=-1)[:, None]
        normal.add_knots(POSITION, slice(0, 0), tall, self.k)


@dataclass(frozen=True)
class Direction:
    """Directions of travel as a camera saw them.

    t_s : (m,) s, rising; direction_s : (3, m) unit vectors, axes of the box; sigma : (m,) rad
    rate_s : (3, m) rad/s, turn rates of the box then
    """

    t_s: Floats
    direction_s: Floats
    sigma: Floats
    rate_s: Floats

    def at(self, knot_t_s: Floats) -> DirectionFactors:
        """Means around the knots."""
        count, mean = around(knot_t_s, self.t_s, np.vstack([self.direction_s, self.sigma[None], self.rate_s]))
        length = np.sqrt((mean[:3] ** 2).sum(axis=0))
        k = np.flatnonzero((count > 0) & (length > 0.5))
        variance = mean[3, k] ** 2 / count[k] + _MEAN_SIGMA**2
        return DirectionFactors(k, _across(mean[:3, k] / length[k]), mean[4:, k], variance)


@dataclass(frozen=True)
class DirectionFactors:
    """k : (n,) knots; across_s : (2, 3, n) two directions across; rate_s : (3, n) rad/s; variance : (n,) rad^2."""

    k: NDArray[np.intp]
    across_s: Floats
    rate_s: Floats
    variance: Floats

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state: sideways and upwards of the direction nothing, by as much as it is doubted.

        Where the state moves the other way, which is as little across, along the direction as fast as it does.
        """
        rot, vel_n = state.rot_ns[..., self.k], state.vel_n[:, self.k]
        lever = np.broadcast_to(state.common[CAMERA_LEVER, None], vel_n.shape)
        vel_s = mtv(rot, vel_n) + cross(self.rate_s, lever)
        speed = np.maximum(np.sqrt((vel_s**2).sum(axis=0)), _MOVING)
        axes_s = np.stack([*self.across_s, cross(*self.across_s)])
        axes_s = np.einsum("ij,ajm->aim", rotation_exp(state.common[CAMERA, None])[..., 0], axes_s)
        error = np.einsum("aim,im->am", axes_s, vel_s) / speed
        back = error[2] < 0.0
        error[2] -= 1.0
        on = speed > _MOVING
        weight = cauchy_weights((error[:2] ** 2).sum(axis=0) / self.variance, _C2) / self.variance
        root = np.sqrt(weight * on) / speed
        to_n = np.einsum("aim,jim->ajm", axes_s, rot)
        tall = np.zeros((len(self.k), 3, 13))
        for row, (along_n, along_s) in enumerate(zip(to_n, axes_s, strict=True)):
            parts = cross(along_n, vel_n), along_n, cross(along_s, vel_s), cross(along_s, self.rate_s)
            tall[:, row, :12] = (np.concatenate(parts) * root).T
            tall[:, row, 12] = -error[row] * root * speed
        tall[~back, 2] = 0.0
        normal.add_knots(slice(ROTATION.start, VELOCITY.stop), slice(CAMERA.start, CAMERA_LEVER.stop), tall, self.k)


@dataclass(frozen=True)
class Speed:
    """Speeds along the way, whichever way that is: of wheels under a vehicle that slips, of a log in the water.

    t_s : (m,) s, rising; speed : (m,) m/s, without sign; sigma : m/s
    """

    t_s: Floats
    speed: Floats
    sigma: float

    def at(self, knot_t_s: Floats) -> SpeedFactors:
        """The speed at the knots that have samples around them."""
        count, _ = around(knot_t_s, self.t_s, self.speed[None])
        k = np.flatnonzero((count > 0) & (knot_t_s >= self.t_s[0]) & (knot_t_s <= self.t_s[-1]))
        return SpeedFactors(k, np.interp(knot_t_s[k], self.t_s, self.speed), self.sigma**2)


@dataclass(frozen=True)
class SpeedFactors:
    """k : (n,) knots; speed : (n,) m/s; variance : (m/s)^2."""

    k: NDArray[np.intp]
    speed: Floats
    variance: float

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state; while it hardly moves it has no direction, and there is none."""
        vel_n = state.vel_n[:, self.k]
        speed = np.sqrt((vel_n**2).sum(axis=0))
        error = speed - (1.0 + state.common[WHEEL]) * self.speed
        weight = cauchy_weights(error**2 / self.variance, _C2) / self.variance * (speed > _MOVING)
        root = np.sqrt(weight)
        ahead = vel_n / np.maximum(speed, _MOVING)
        tall = np.stack([*(ahead * root), -self.speed * root, -error * root], axis=-1)[:, None]
        normal.add_knots(VELOCITY, slice(WHEEL, WHEEL + 1), tall, self.k)


@dataclass(frozen=True)
class Rate:
    """Turn rates that another sensor saw over spans of the gyroscope's record.

    t_s : (m,) s, middle of each span, rising; span_s : (m,) s
    gyro_s : (3, m) rad/s, mean of the gyroscope over the span; seen_s : (3, m) rad/s, what the other sensor says
    axes_s : (3, m) unit vectors, the one axis that it knows, or None where it knows all three
    sigma : (m,) rad/s, of one span
    """

    t_s: Floats
    span_s: Floats
    gyro_s: Floats
    seen_s: Floats
    axes_s: Floats | None
    sigma: Floats

    def at(self, knot_t_s: Floats) -> RateFactors:
        """Each knot's spans together: what the gyroscope's bias then is."""
        axes = np.ones_like(self.gyro_s) if self.axes_s is None else self.axes_s
        rows = np.vstack([self.gyro_s - self.seen_s, axes, self.sigma[None]])
        count, mean = around(knot_t_s, self.t_s, rows)
        k = np.flatnonzero(count > 0)
        return RateFactors(
            k, mean[:3, k], None if self.axes_s is None else mean[3:6, k], mean[6, k] ** 2 / np.maximum(count[k], 1)
        )


@dataclass(frozen=True)
class RateFactors:
    """k : (n,) knots; bias : (3, n) rad/s; axes_s : (3, n) or None; variance : (n,) (rad/s)^2."""

    k: NDArray[np.intp]
    bias: Floats
    axes_s: Floats | None
    variance: Floats

    def add(self, normal: Normal, state: State, gravity: GravityField) -> None:
        """Add the factors at a state."""
        error = state.gyro_bias[:, self.k] - self.bias
        if self.axes_s is None:
            weight = cauchy_weights((error**2).sum(axis=0) / self.variance, _C2) / self.variance
            normal.add_values(self.k, GYRO_BIAS, error.T, np.repeat(weight[:, None], 3, axis=1))
            return
        along = (self.axes_s * error).sum(axis=0)
        root = np.sqrt(cauchy_weights(along**2 / self.variance, _C2) / self.variance)
        tall = np.stack([*(self.axes_s * root), -along * root], axis=-1)[:, None]
        normal.add_knots(GYRO_BIAS, slice(0, 0), tall, self.k)


def around(knot_t_s: Floats, t_s: Floats, rows: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Means of samples within a second of the knots.

    knot_t_s : (N,) s; t_s : (m,) s, rising; rows : (c, m)
    returns : number of samples (N,), means (c, N), 0 where there is no sample
    """
    first = np.searchsorted(t_s, knot_t_s - _AROUND_S)
    stop = np.searchsorted(t_s, knot_t_s + _AROUND_S, side="right")
    total = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(rows, axis=1)], axis=1)
    count = stop - first
    return count, (total[:, stop] - total[:, first]) / np.maximum(count, 1)


def _across(direction: Floats) -> Floats:
    """Two unit vectors across each: (2, 3, n) of (3, n)."""
    least = np.abs(direction).argmin(axis=0)
    other = np.zeros_like(direction)
    other[least, np.arange(direction.shape[1])] = 1.0
    first = cross(direction, other)
    first = first / np.sqrt((first**2).sum(axis=0))
    return np.stack([first, cross(direction, first)])
