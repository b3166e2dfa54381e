"""A motion set down on the rotating ellipsoid: where it goes, and what ideal inertial sensors on it measure.

A motion tells velocity and attitude relative to East, North and Up; here these are the axes of the place where the
body is, the local level frame n. Latitude and longitude follow from the velocity (Groves 2013, eq. 2.111), with the
radii of curvature M and N:

    lat. = v_n / (M + h),   lon. = v_e / ((N + h) cos lat),   h. = v_u

and the sensors from the rates of the Earth, omega_ie, and of the level frame, omega_en (eq. 5.44, 5.54; for
East-North-Up):

    omega_ib = omega_nb + R_vn (omega_ie + omega_en)
    f_v      = R_vn (v. + (2 omega_ie + omega_en) x v_n + (0, 0, gamma(lat, h)))

with normal gravity gamma, which holds the centrifugal force and points along the normal of the ellipsoid.

References: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013), ch. 2
and 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recon.numerics.geodesy import Anchor, earth_rate_n, normal_gravity, radii_of_curvature
from recon.numerics.motion.truth import Motion, MotionTruth
from recon.numerics.rotation import Floats, conjugate, rotate

_STEP_S = 0.1
"""Between the nodes at which the place is kept. Over it the radii change by less than 1e-6 of themselves, and the place
by the displacement over the radii in the middle: 1e-8 m at most from the exact integral."""
_ROUNDS = 6
"""Each brings the latitude, which its own radius depends on, nearer by a factor of 1e-2 per 10 deg travelled."""


@dataclass(frozen=True)
class EarthTruth(MotionTruth):
    """State of a body on the Earth at n times; frame n is the local level frame of its place.

    pos_n : (n, 3) m, the integral of vel_n: along the Earth, not through it
    acc_n : (n, 3) m/s^2, rate of the components of vel_n;  gyro_v : (n, 3) rad/s, relative to n
    lat, lon : (n,) deg;  height : (n,) m above the ellipsoid
    force_v : (n, 3) m/s^2, specific force;  rate_v : (n, 3) rad/s, inertial angular rate; both vehicle
    """

    lat: Floats
    lon: Floats
    height: Floats
    force_v: Floats
    rate_v: Floats


@dataclass(frozen=True)
class OnEarth:
    """A motion that begins at a place.

    start : where the body is at the time 0
    duration_s : s, how long the motion is looked at; before 0 and after this the body must stand
    Near the poles, where there is no east, it does not hold: latitudes must stay some km away from them.
    """

    motion: Motion
    start: Anchor
    duration_s: float
    _nodes: _Nodes = field(init=False)

    def __post_init__(self) -> None:
        """Follow the motion once."""
        t_s = np.arange(0.0, self.duration_s + _STEP_S, _STEP_S)
        object.__setattr__(self, "_nodes", _follow(self.motion.at(t_s).pos_n, self.start))

    def at(self, t_s: Floats) -> EarthTruth:
        """Truth at the times (n,) s, in any order."""
        truth = self.motion.at(t_s)
        node = np.clip(t_s / _STEP_S, 0, len(self._nodes.lat) - 1).astype(np.intp)
        lat, lon, height = _moved(self._nodes.at(node), truth.pos_n - self._nodes.pos_n[node])
        lon = lon - 360.0 * np.round(lon / 360.0)
        meridian, normal = radii_of_curvature(lat)
        east, north, _ = truth.vel_n.T
        earth_n = earth_rate_n(lat)
        turn_n = np.stack(
            (
                -north / (meridian + height),
                east / (normal + height),
                east * np.tan(np.radians(lat)) / (normal + height),
            ),
            axis=-1,
        )
        force_n = truth.acc_n + np.cross(2.0 * earth_n + turn_n, truth.vel_n)
        force_n[:, 2] += normal_gravity(lat, height)
        q_vn = conjugate(truth.q_nv)
        return EarthTruth(
            t_s=t_s,
            pos_n=truth.pos_n,
            vel_n=truth.vel_n,
            acc_n=truth.acc_n,
            q_nv=truth.q_nv,
            gyro_v=truth.gyro_v,
            lat=lat,
            lon=lon,
            height=height,
            force_v=rotate(q_vn, force_n),
            rate_v=truth.gyro_v + rotate(q_vn, earth_n + turn_n),
        )


@dataclass(frozen=True)
class _Nodes:
    """Places on the way: lat, lon (m,) deg, height (m,) m, and the motion's own pos_n (m, 3) there."""

    lat: Floats
    lon: Floats
    height: Floats
    pos_n: Floats

    def at(self, node: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        """Places at the numbers (n,) of nodes."""
        return self.lat[node], self.lon[node], self.height[node]


def _follow(pos_n: Floats, start: Anchor) -> _Nodes:
    """Places after each displacement; the latitude, whose radii depend on itself, by iteration."""
    east, north, up = np.diff(pos_n, axis=0).T
    height = start.height + np.concatenate(([0.0], np.cumsum(up)))
    middle = (height[:-1] + height[1:]) / 2.0
    lat = np.full(len(pos_n), start.lat)
    for _ in range(_ROUNDS):
        meridian, normal = radii_of_curvature((lat[:-1] + lat[1:]) / 2.0)
        lat = start.lat + np.concatenate(([0.0], np.cumsum(np.degrees(north / (meridian + middle)))))
    parallel = (normal + middle) * np.cos(np.radians((lat[:-1] + lat[1:]) / 2.0))
    lon = start.lon + np.concatenate(([0.0], np.cumsum(np.degrees(east / parallel))))
    return _Nodes(lat, lon, height, pos_n)


def _moved(place: tuple[Floats, Floats, Floats], step_n: Floats) -> tuple[Floats, Floats, Floats]:
    """Places (lat, lon deg, height m; (n,) each) after short displacements (n, 3) m, by the radii in the middle."""
    lat, lon, height = place
    east, north, up = step_n.T
    middle = height + up / 2.0
    half_way = lat + np.degrees(north / 2.0 / (radii_of_curvature(lat)[0] + middle))
    meridian, normal = radii_of_curvature(half_way)
    parallel = (normal + middle) * np.cos(np.radians(half_way))
    return lat + np.degrees(north / (meridian + middle)), lon + np.degrees(east / parallel), height + up
