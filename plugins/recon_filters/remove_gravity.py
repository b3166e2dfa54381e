"""Acceleration from specific force.

    a_v = f_v + R_vn g_n,    g_n = (0, 0, -g)

g is by default what the accelerometer itself reads while the vehicle stands, because a scale error of its vertical
axis would otherwise stay behind as a steady acceleration. It is the length of the mean vector, not the mean length:
noise and vibration lengthen the latter by about sigma^2 / g.

References
    Thesis, section 4.4. NIMA TR8350.2 (2000), eq. 4-1 (normal gravity).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

import numpy as np
import pyarrow as pa

from recon import (
    ATTITUDE,
    EVENTS,
    GNSS,
    IMU,
    Change,
    Filter,
    Metric,
    Params,
    Streams,
    hookimpl,
    matrix,
    metrics,
    replace,
    setting,
)
from recon.numerics.geodesy import STANDARD_GRAVITY, normal_gravity
from recon.numerics.rotation import Floats, conjugate, rotate
from recon.placing import anchor_of, attitude_of, rows_during


class GravityParams(Params):
    """Parameters of filter.remove_gravity."""

    magnitude: Literal["measured", "normal"] = setting(
        "measured", doc="Gravity as the box reads it at stops, or normal gravity of the place."
    )


def remove_gravity(
    *, imu: pa.Table, attitude: pa.Table, events: pa.Table | None, gnss: pa.Table | None, params: GravityParams
) -> Streams:
    """Take gravity off the specific force. Raises DataError where attitude is not given at the times of imu."""
    force_v = matrix(imu, "accel")
    up_v = rotate(conjugate(attitude_of(imu, attitude)), [0.0, 0.0, 1.0])
    gravity = _normal(gnss)
    if params.magnitude == "measured":
        gravity = _measured(imu, force_v, events, otherwise=gravity)
    return {"imu": replace(imu, accel=force_v - gravity.magnitude * up_v), "metrics": metrics([gravity.as_metric()])}


class Gravity(NamedTuple):
    """Magnitude in m/s^2, and where it is from."""

    magnitude: float
    method: str
    note: str = ""

    def as_metric(self) -> Metric:
        """The row that tells the user."""
        return Metric("gravity", self.magnitude, "m/s^2", method=self.method, note=self.note)


def _normal(gnss: pa.Table | None) -> Gravity:
    anchor = anchor_of(gnss)
    if anchor is None:
        return Gravity(STANDARD_GRAVITY, "standard", "the place is not known")
    return Gravity(float(normal_gravity(anchor.lat, anchor.height)), "normal gravity at the anchor")


def _measured(imu: pa.Table, force_v: Floats, events: pa.Table | None, otherwise: Gravity) -> Gravity:
    """Length of the mean specific force of each stop, averaged over the stops by their rows."""
    stops = rows_during(imu, events, "standstill")
    if not len(stops):
        return otherwise._replace(note="no stop to measure it")
    lengths = [np.linalg.norm(force_v[start:stop].mean(axis=0)) for start, stop in stops]
    return Gravity(float(np.average(lengths, weights=np.diff(stops)[:, 0])), f"measured at {len(stops)} stops")


@hookimpl
def declare_filters() -> Iterable[Filter]:
    """Declare filter.remove_gravity."""
    yield Filter(
        name="remove_gravity",
        summary="Acceleration from specific force, with gravity as measured at stops or normal.",
        params=GravityParams,
        reads={
            "imu": IMU.need("accel", frame="vehicle", quantity={"accel": "specific_force"}),
            "attitude": ATTITUDE.need("q"),
            "events": EVENTS.need("time", "end_time", "kind", optional=True),
            "gnss": GNSS.need(optional=True),
        },
        writes={"imu": Change(quantities={"accel": "acceleration"})},
        run=remove_gravity,
        references=("Thesis, section 4.4", "NIMA TR8350.2 (2000), eq. 4-1"),
    )
