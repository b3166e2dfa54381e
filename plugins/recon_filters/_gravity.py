"""How large gravity is: as the accelerometer itself reads it while the vehicle stands, or normal gravity of the place.

The first is right for an accelerometer with a scale error, of which the second would leave a steady acceleration. It is
the length of the mean vector of a stop, not the mean length: noise and vibration lengthen the latter by sigma^2 / g.

References
    Thesis, section 4.4. NIMA TR8350.2 (2000), eq. 4-1 (normal gravity).
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa

from recon import Metric, Params, matrix, setting
from recon.numerics.geodesy import STANDARD_GRAVITY, normal_gravity
from recon.placing import anchor_of, rows_during

Magnitude: TypeAlias = Literal["measured", "normal"]


class GravityParams(Params):
    """Parameters of filters that remove gravity."""

    magnitude: Magnitude = setting(
        "measured", doc="Gravity as the box reads it at stops, or normal gravity of the place."
    )


class Gravity(NamedTuple):
    """Magnitude in m/s^2, and where it is from."""

    magnitude: float
    method: str
    note: str = ""

    def as_metric(self) -> Metric:
        """The row that tells the user."""
        return Metric("gravity", self.magnitude, "m/s^2", method=self.method, note=self.note)


def gravity_of(imu: pa.Table, events: pa.Table | None, gnss: pa.Table | None, magnitude: Magnitude) -> Gravity:
    """The gravity to be removed.

    imu : accel, the specific force in any frame; events : standstills; gnss : its anchor is the place
    """
    normal = _normal(gnss)
    return _measured(imu, events, otherwise=normal) if magnitude == "measured" else normal


def _normal(gnss: pa.Table | None) -> Gravity:
    anchor = anchor_of(gnss)
    if anchor is None:
        return Gravity(STANDARD_GRAVITY, "standard", "the place is not known")
    return Gravity(float(normal_gravity(anchor.lat, anchor.height)), "normal gravity at the anchor")


def _measured(imu: pa.Table, events: pa.Table | None, otherwise: Gravity) -> Gravity:
    """Length of the mean specific force of each stop, averaged over the stops by their rows."""
    stops = rows_during(imu, events, "standstill")
    if not len(stops):
        return otherwise._replace(note="no stop to measure it")
    force = matrix(imu, "accel")
    lengths = [np.linalg.norm(force[start:stop].mean(axis=0)) for start, stop in stops]
    return Gravity(float(np.average(lengths, weights=np.diff(stops)[:, 0])), f"measured at {len(stops)} stops")
