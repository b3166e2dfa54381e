"""How a vehicle moved between two times, or between many pairs of times: lengths, bearings, changes, their sigmas.

Sigmas follow from the covariance of the errors at both times, which recon.knots tells; without it they are NaN. They
are of first order, and of use where a length is well above its sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from recon.knots import ATTITUDE, POSITION, VELOCITY
from recon.numerics.geodesy import Ellipsoid, geodesic
from recon.numerics.rotation import to_euler
from recon.numerics.signals import wrap_angle
from recon.tables import Array

if TYPE_CHECKING:
    from recon.trajectory import Poses

_UNKNOWN_RAD: Final = np.pi / np.sqrt(3.0)
"""Sigma of a bearing of which nothing is known."""


@dataclass(frozen=True)
class Movement:
    """How the vehicle moved from one time to another; sigmas and covariances are NaN where they are not known.

    start, stop : UTC; duration : s
    displacement (3,) m, local East-North-Up, with displacement_covariance (3, 3) m^2; distance : m, its length
    ground_distance : m, the shortest way along the ellipsoid; the horizontal part of `displacement` where the place on
        the Earth is not known
    initial_bearing, final_bearing : rad in [0, 2 pi), of that way where it begins and ends, clockwise from true north,
        with bearing_sigma; NaN where the place on the Earth is not known, or is the same
    height_difference : m; path_length : m, of the path that was driven in between
    velocity_change (3,) m/s, local, with velocity_covariance (3, 3) (m/s)^2; delta_v : m/s, its length
    heading_change : rad, clockwise, in (-pi, pi]; heading_sigma : rad

    Sigmas of lengths are those along the vector.
    """

    start: np.datetime64
    stop: np.datetime64
    duration: float
    displacement: Array
    displacement_covariance: Array
    distance: float
    distance_sigma: float
    ground_distance: float
    ground_distance_sigma: float
    initial_bearing: float
    final_bearing: float
    bearing_sigma: float
    height_difference: float
    height_sigma: float
    path_length: float
    velocity_change: Array
    velocity_covariance: Array
    delta_v: float
    delta_v_sigma: float
    heading_change: float
    heading_sigma: float


@dataclass(frozen=True)
class Movements:
    """How the vehicle moved between n pairs of times: as Movement, with an axis in front."""

    start: NDArray[np.datetime64]
    stop: NDArray[np.datetime64]
    duration: Array
    displacement: Array
    displacement_covariance: Array
    distance: Array
    distance_sigma: Array
    ground_distance: Array
    ground_distance_sigma: Array
    initial_bearing: Array
    final_bearing: Array
    bearing_sigma: Array
    height_difference: Array
    height_sigma: Array
    path_length: Array
    velocity_change: Array
    velocity_covariance: Array
    delta_v: Array
    delta_v_sigma: Array
    heading_change: Array
    heading_sigma: Array

    def __len__(self) -> int:
        return len(self.duration)

    def only(self) -> Movement:
        """The movement of the first pair."""
        first = {field.name: getattr(self, field.name)[0] for field in fields(Movement)}
        values: dict[str, Any] = {name: float(x) if isinstance(x, np.floating) else x for name, x in first.items()}
        return Movement(**values)


def movements(start: Poses, stop: Poses, path_length: Array, covariance: Array, earth: Ellipsoid) -> Movements:
    """What lies between n pairs of poses.

    path_length : (n,) m; covariance : (n, 9, 9), as recon.knots orders it, of the errors at `stop` less those at
        `start`; earth : the figure on which lat and lon are
    """
    moved, faster = stop.position - start.position, stop.velocity - start.velocity
    spread, spread_v = covariance[:, POSITION, POSITION], covariance[:, VELOCITY, VELOCITY]
    level, across = moved[:, :2], np.column_stack([-moved[:, 1], moved[:, 0]])
    way, initial, final = geodesic(start.lat, start.lon, stop.lat, stop.lon, earth)
    ground = np.where(np.isfinite(way), way, np.hypot(*level.T))
    with np.errstate(divide="ignore", invalid="ignore"):
        bearing_sigma = np.minimum(_sigma_along(across, spread[:, :2, :2]) / ground, _UNKNOWN_RAD)
    climbed = stop.height - start.height
    yaw, yaw_before = to_euler(stop.attitude)[0], to_euler(start.attitude)[0]
    return Movements(
        start=start.time,
        stop=stop.time,
        duration=np.asarray((stop.time - start.time).astype(np.int64) / 1e9),
        displacement=moved,
        displacement_covariance=spread,
        distance=np.linalg.norm(moved, axis=1),
        distance_sigma=_sigma_along(moved, spread),
        ground_distance=ground,
        ground_distance_sigma=_sigma_along(level, spread[:, :2, :2]),
        initial_bearing=initial,
        final_bearing=final,
        bearing_sigma=np.where(np.isfinite(initial), bearing_sigma, np.nan),
        height_difference=np.where(np.isfinite(climbed), climbed, moved[:, 2]),
        height_sigma=_root(spread[:, 2, 2]),
        path_length=path_length,
        velocity_change=faster,
        velocity_covariance=spread_v,
        delta_v=np.linalg.norm(faster, axis=1),
        delta_v_sigma=_sigma_along(faster, spread_v),
        heading_change=wrap_angle(yaw_before - yaw),
        heading_sigma=_root(covariance[:, ATTITUDE, ATTITUDE][:, 2, 2]),
    )


def _sigma_along(vectors: Array, covariance: Array) -> Array:
    """Sigma of the lengths of vectors (n, k), to first order; root mean square of those without length: (n,)."""
    length = np.linalg.norm(vectors, axis=1)
    along = vectors / np.where(length > 0.0, length, 1.0)[:, None]
    variance = np.einsum("ni,nij,nj->n", along, covariance, along)
    return _root(np.where(length > 0.0, variance, np.trace(covariance, axis1=1, axis2=2)))


def _root(variance: Array) -> Array:
    """Square root; rounding may have left less than nothing."""
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
