"""What a magnetometer reports of a drive: the Earth's field, turned into the box and spoiled by iron.

    mag_s = (1 + S) R_sv R_vn (B_n + d_n(t)) + h + n

with hard iron h, the field of magnets in the box and the car that turns with them, soft iron S, which bends the field,
white noise n, and disturbances d by what the car passes: bridges, trucks, rails. They rise and fall like a cosine.
The field of the Earth is that of the start.

Reference: Gebre-Egziabher et al. (2006), "Calibration of strapdown magnetometers in magnetic field domain", J.
Aerospace Engineering 19(2), 87-102.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from recon import Metric
from recon.magnetic import declination, magnetic_field_n
from recon.numerics.motion import EarthTruth
from recon.numerics.rotation import Floats, conjugate, rotate
from recon.utc import iso_ns
from recon_simulators.drive_params import DriveParams
from recon_simulators.gnss_model import random_outages
from recon_simulators.route import Route
from recon_simulators.sensor_model import regular_times

Vector: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Disturbance:
    """A foreign field between two times in s, at its largest (3,) T, local."""

    start_s: float
    stop_s: float
    field_n: Vector


@dataclass(frozen=True)
class MagModel:
    """A magnetometer at the origin of the vehicle frame, its axes those of the IMU.

    | field        | unit   | meaning                                            |
    |--------------|--------|----------------------------------------------------|
    | rate_hz      | Hz     | sampling rate                                      |
    | q_sv         | 1      | mounting, scalar first: takes vehicle to sensor    |
    | earth_n      | T      | field of the Earth, local East-North-Up            |
    | hard_iron    | T      | constant field, sensor                             |
    | soft_iron    | 1      | symmetric matrix S (3, 3)                          |
    | noise        | T      | sigma of each sample                               |
    | disturbances |        | foreign fields on the way                          |
    """

    rate_hz: float
    q_sv: tuple[float, float, float, float]
    earth_n: Vector
    hard_iron: Vector
    soft_iron: tuple[Vector, Vector, Vector]
    noise: float
    disturbances: tuple[Disturbance, ...] = ()


def drawn_iron(hard: float, soft: float, rng: np.random.Generator) -> tuple[Vector, tuple[Vector, Vector, Vector]]:
    """Hard iron (3,) in the unit of its sigma, and a symmetric matrix of soft iron whose elements have that sigma."""
    x, y, z = rng.normal(0.0, hard, 3).tolist()
    xx, yy, zz, xy, xz, yz = rng.normal(0.0, soft, 6).tolist()
    return (x, y, z), ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def drawn_disturbances(
    spans: tuple[tuple[float, float], ...], size: tuple[float, float], rng: np.random.Generator
) -> tuple[Disturbance, ...]:
    """Foreign fields of any direction in these spans, in s. size : least and largest, T"""
    found = []
    for start_s, stop_s in spans:
        direction = rng.standard_normal(3)
        field_n = rng.uniform(*size) * direction / np.linalg.norm(direction)
        found.append(Disturbance(start_s, stop_s, tuple(field_n.tolist())))
    return tuple(found)


def mag_measurements(truth: EarthTruth, model: MagModel, rng: np.random.Generator) -> Floats:
    """The field as the magnetometer reports it at the times of the truth: (n, 3) T, sensor."""
    field_n = np.tile(np.array(model.earth_n), (len(truth.t_s), 1))
    for foreign in model.disturbances:
        phase = np.clip((truth.t_s - foreign.start_s) / (foreign.stop_s - foreign.start_s), 0.0, 1.0)
        field_n += 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))[:, None] * np.array(foreign.field_n)
    field_s = rotate(np.array(model.q_sv), rotate(conjugate(truth.q_nv), field_n))
    bent = field_s @ (np.eye(3) + np.array(model.soft_iron)).T
    return np.asarray(bent + np.array(model.hard_iron) + model.noise * rng.standard_normal(bent.shape))


class Magnetometer(NamedTuple):
    """Sample times (n,) s, what was measured (n, 3) T, the errors, and what only a simulator knows."""

    t_s: Floats
    field_s: Floats
    model: MagModel
    learnt: list[Metric]


def magnetometer(
    route: Route,
    values: Mapping[str, Any],
    params: DriveParams,
    q_sv: tuple[float, float, float, float],
    rng: np.random.Generator,
) -> Magnetometer:
    """A magnetometer on this route. values : of the parameters, by their names, as given or of the preset

    Raises DataError where no model of the Earth's field holds at the time of the drive.
    """
    iron, places, foreign, noise = rng.spawn(4)
    field_n = params.earth_field
    if field_n is None:
        place = route.anchor
        earth = magnetic_field_n(place.lat, place.lon, place.height, iso_ns(params.start))
        field_n = (float(earth[0]), float(earth[1]), float(earth[2]))
    hard, soft = drawn_iron(values["mag_hard_iron"], values["mag_soft_iron"], iron)
    spans = random_outages(values["mag_disturbance_rate"], values["mag_disturbance_length"], route.duration_s, places)
    disturbances = drawn_disturbances(spans, values["mag_disturbance"], foreign)
    model = MagModel(values["mag_rate"], q_sv, field_n, hard, soft, values["mag_noise"], disturbances)
    t_s = regular_times(0.0, route.duration_s, model.rate_hz)
    return Magnetometer(t_s, mag_measurements(route.at(t_s), model, noise), model, _learnt(model))


def _learnt(model: MagModel) -> list[Metric]:
    note = "true = magnetic + this"
    found = [Metric("true_declination", float(np.degrees(declination(np.array(model.earth_n)))), "deg", note=note)]
    for name, vector, axes in (("earth_field", model.earth_n, "enu"), ("hard_iron", model.hard_iron, "xyz")):
        found += [Metric(f"true_{name}_{axis}", value, "T") for axis, value in zip(axes, vector, strict=True)]
    return found
