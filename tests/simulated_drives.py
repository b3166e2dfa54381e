"""Drives of the simulator, with parameters as people write them, and what their sensors should feel."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import (
    Anchor,
    earth_rate_n,
    normal_gravity,
    radii_of_curvature,
)
from recon.numerics.rotation import (
    Floats,
    conjugate,
    rotate,
)
from recon.parameters import bind
from recon.problems import Where
from recon.tables import Streams, matrix, vector
from recon.yaml_nodes import Node
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

EPS = np.finfo(float).eps
MOTIONS = ("rest", "straight", "circle", "spring", "roundabout", "s_curve", "hill", "city", "parking", "crash")
LONG = ("country", "mixed", "nonstop", "reverse", "ferry")
BOLOGNA = Anchor(44.4949, 11.3426, 100.0)


def params(**values: object) -> DriveParams:
    """Parameters from plain data as YAML has it."""
    found, problems = bind(DriveParams, Node.of(values, Where("test")), "simulator.drive")
    assert isinstance(found, DriveParams), problems
    return found


def simulate(**values: object) -> Streams:
    return simulate_drive(params(**values))


def triple(metrics: dict[str, float], name: str) -> Floats:
    return np.array([metrics[f"{name}_{axis}"] for axis in "xyz"])


def earth_rates(reference: pa.Table) -> tuple[Floats, Floats]:
    """Rate of the Earth and of the level frame at each place of the truth: (n, 3) rad/s, East-North-Up."""
    lat, height, (east, north, _) = vector(reference, "lat"), vector(reference, "height"), matrix(reference, "vel").T
    meridian, normal = (radius + height for radius in radii_of_curvature(lat))
    transport_n = np.column_stack((-north / meridian, east / normal, east * np.tan(np.radians(lat)) / normal))
    return earth_rate_n(lat), transport_n


def felt(reference: pa.Table) -> tuple[Floats, Floats]:
    """Specific force and inertial angular rate of the truth: (n, 3) m/s^2 and rad/s, vehicle. Groves 2013, eq. 5.54."""
    (earth_n, transport_n), q_vn = earth_rates(reference), conjugate(matrix(reference, "q"))
    up_n = np.zeros((reference.num_rows, 3))
    up_n[:, 2] = normal_gravity(vector(reference, "lat"), vector(reference, "height"))
    coriolis_n = np.cross(2.0 * earth_n + transport_n, matrix(reference, "vel"))
    force_v = matrix(reference, "accel") + rotate(q_vn, coriolis_n + up_n)
    return force_v, matrix(reference, "gyro") + rotate(q_vn, earth_n + transport_n)
