"""What is drawn over time, for the report and for figures: panels of curves, with bands of two sigma.

    speed                              from trajectories, GNSS, wheels and references; sigma of the speed v, for
                                       velocities v_i with independent sigmas s_i:  sqrt(sum((v_i s_i)^2)) / v
    height                             of trajectories and references; where there are none, of GNSS
    roll, pitch, heading               of trajectories and references
    acceleration, turn rate            in the vehicle: x forward, y left, z up (ISO 8855); without gravity
    sigma of position                  of the trajectory, east, north and up
    residuals                          value / sigma of each sensor and component, accepted or rejected
    specific force or acceleration, turn rates
                                       as logged, where no stream says how the vehicle moved

Streams count with their number: trajectory_2 is a second trajectory, under the name that its fact `run` gives.
Headings are continuous across north. Rows without a number are left out, and no line joins rows beside a gap.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from recon.numerics.rotation import to_euler
from recon.schema import unnumbered
from recon.tables import Array, has, matrix, meta, schema_of, time_ns, vector
from recon.trajectory import speed_sigma
from recon_exporters._style import role_of_fixes
from recon_exporters._words import words

FARTHEST: Final = 8.0
"""Residuals beyond so many sigmas are drawn there."""
KMH: Final = ("km/h", 3.6)

_AXES: Final = {"x": "forward", "y": "to the left", "z": "upwards"}


@dataclass(frozen=True)
class Curve:
    """Values over time.

    name : for the legend; role : what it is, by which it is drawn (see _style)
    t_ns : (n,) rising; values : (n,) in the unit of the panel; sigma : (n,), NaN where not known, None without
    """

    name: str
    role: str
    t_ns: NDArray[np.int64]
    values: Array
    sigma: Array | None = None


@dataclass(frozen=True)
class Panel:
    """Curves with a common unit.

    key : lower case, for files and tests; group : panels that belong together
    second : another unit and its size, for a second axis; levels : values that deserve a line
    circular : is 370 the same as 10?
    """

    key: str
    title: str
    unit: str
    group: str
    curves: Sequence[Curve]
    second: tuple[str, float] | None = None
    levels: Sequence[float] = ()
    circular: bool = False


@dataclass(frozen=True)
class Source:
    """A stream that says where the vehicle is: its name for the legend, its role, its table, its own name."""

    name: str
    role: str
    table: pa.Table
    stream: str


def panels_of(streams: Mapping[str, pa.Table]) -> list[Panel]:
    """The panels for which there is something to draw, in their order."""
    motions = sources_of(streams)
    panels = [
        Panel("speed", "Speed", "m/s", "motion", [*_speeds(motions), *_measured_speeds(streams, motions)], second=KMH),
        *(_vehicle_panel(motions, f"accel_{a}", f"Acceleration {_AXES[a]}", "m/s²", 1.0) for a in "xyz"),
        _vehicle_panel(motions, "gyro_z", "Turn rate, positive to the left", "°/s", np.degrees(1.0)),
        *_attitude_panels(motions),
        Panel("height", "Height", "m", "attitude", list(_heights(motions or _receivers(streams)))),
        Panel("pos_std", "Sigma of position", "m", "uncertainty", list(_sigmas(motions))),
        *_residual_panels(streams.get("residuals")),
        *([] if motions else _sensor_panels(streams)),
    ]
    return [panel for panel in panels if panel.curves]


def sources_of(streams: Mapping[str, pa.Table]) -> list[Source]:
    """Trajectories, then references; those without a row left out."""
    found = []
    for kind in ("trajectory", "reference"):
        named = [name for name, table in streams.items() if unnumbered(name) == kind and table.num_rows]
        for number, name in enumerate(named, start=1):
            role = f"trajectory {number}" if kind == "trajectory" else kind
            found.append(Source(str(meta(streams[name]).get("run", name)), role, streams[name], name))
    return found


def _receivers(streams: Mapping[str, pa.Table]) -> list[Source]:
    """Raw GNSS as what says where the vehicle is, for runs in which nothing else does."""
    named = [(name, table) for name, table in streams.items() if unnumbered(name) == "gnss" and table.num_rows]
    return [Source(name, role_of_fixes(name), table, name) for name, table in named]


def _curve(name: str, role: str, table: pa.Table, values: Array, sigma: Array | None = None) -> Curve | None:
    """The rows with a finite value; None where there is none."""
    known = np.isfinite(values)
    if not known.any():
        return None
    known_sigma = sigma is not None and bool(np.isfinite(sigma[known]).any())
    t_ns = time_ns(table)
    if known.all():
        return Curve(name, role, t_ns, values, sigma if known_sigma else None)
    return Curve(name, role, t_ns[known], values[known], sigma[known] if known_sigma and sigma is not None else None)


def _there(curves: Iterable[Curve | None]) -> Iterator[Curve]:
    return (curve for curve in curves if curve is not None)


def _speeds(motions: Sequence[Source]) -> Iterator[Curve]:
    for source in motions:
        if has(source.table, "vel"):
            vel = matrix(source.table, "vel", gaps=True)
            sigma = (
                speed_sigma(vel, matrix(source.table, "vel_std", gaps=True)) if has(source.table, "vel_std") else None
            )
            yield from _there([_curve(source.name, source.role, source.table, _length(vel), sigma)])


def _length(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)))


def _measured_speeds(streams: Mapping[str, pa.Table], motions: Sequence[Source]) -> Iterator[Curve]:
    """As reported; of GNSS alone also as derived from its positions."""
    for name, table in streams.items():
        kind = unnumbered(name)
        role = role_of_fixes(name) if kind == "gnss" else kind
        if kind in ("gnss", "wheel") and has(table, "speed"):
            yield from _there([_curve(name, role, table, vector(table, "speed", gaps=True))])
        elif kind == "gnss" and not motions and has(table, "vel"):
            yield from _there([_curve(name, role, table, _length(matrix(table, "vel", gaps=True)[:, :2]))])


def _vehicle_panel(motions: Sequence[Source], column: str, title: str, unit: str, size: float) -> Panel:
    found = [
        _curve(source.name, source.role, source.table, size * vector(source.table, column, gaps=True))
        for source in motions
        if has(source.table, column)
    ]
    return Panel(column, title, unit, "motion", list(_there(found)))


def _attitude_panels(motions: Sequence[Source]) -> Iterator[Panel]:
    placed = any(has(one.table, "lat") and np.isfinite(vector(one.table, "lat", gaps=True)).any() for one in motions)
    titles = {
        "heading": f"Heading, clockwise from {'' if placed else 'the '}north{'' if placed else ' of the local frame'}",
        "pitch": "Pitch, positive with the nose down",
        "roll": "Roll, positive to the right",
    }
    curves: dict[str, list[Curve]] = {name: [] for name in titles}
    for source in (source for source in motions if has(source.table, "q")):
        for name, curve in _angles(source):
            others = curves[name]
            curves[name].append(_beside(curve, others[0]) if others and name == "heading" else curve)
    for name, title in titles.items():
        yield Panel(name, title, "°", "attitude", curves[name], circular=name == "heading")


def _angles(source: Source) -> Iterator[tuple[str, Curve]]:
    """Heading, pitch and roll in degrees."""
    yaw, pitch, roll = to_euler(matrix(source.table, "q", gaps=True))
    heading = 0.5 * np.pi - yaw
    known = np.isfinite(heading)
    heading[known] = np.unwrap(heading[known])
    for name, axis, angle in (("heading", "yaw", heading), ("pitch", "pitch", pitch), ("roll", "roll", roll)):
        std = f"att_std_{axis}"
        sigma = np.degrees(vector(source.table, std, gaps=True)) if has(source.table, std) else None
        curve = _curve(source.name, source.role, source.table, np.degrees(angle), sigma)
        if curve is not None:
            yield name, curve


def _beside(curve: Curve, other: Curve) -> Curve:
    """The same heading, by whole turns as close to the other as it can be."""
    middle = len(curve.t_ns) // 2
    there = float(np.interp(curve.t_ns[middle], other.t_ns, other.values))
    turns = np.round((there - curve.values[middle]) / 360.0)
    return Curve(curve.name, curve.role, curve.t_ns, curve.values + 360.0 * turns, curve.sigma)


def _heights(motions: Sequence[Source]) -> Iterator[Curve]:
    for source in motions:
        column = "height" if has(source.table, "height") else "pos_u"
        if has(source.table, column):
            std = "pos_std_u"
            sigma = vector(source.table, std, gaps=True) if has(source.table, std) else None
            values = vector(source.table, column, gaps=True)
            yield from _there([_curve(source.name, source.role, source.table, values, sigma)])


def _sigmas(motions: Sequence[Source]) -> Iterator[Curve]:
    """Of the first trajectory."""
    for source in motions[:1]:
        for axis, word in (("e", "east"), ("n", "north"), ("u", "up")):
            if has(source.table, f"pos_std_{axis}"):
                values = vector(source.table, f"pos_std_{axis}", gaps=True)
                yield from _there([_curve(word, word, source.table, values)])


def _sensor_panels(streams: Mapping[str, pa.Table]) -> Iterator[Panel]:
    for name, table in streams.items():
        if unnumbered(name) != "imu":
            continue
        for group, title, unit, size in (
            ("accel", f"{_felt(table)}, as logged", "m/s²", 1.0),
            ("gyro", "Turn rates, as logged", "°/s", np.degrees(1.0)),
        ):
            columns = [column for column in (f"{group}_{axis}" for axis in "xyz") if has(table, column)]
            curves = [_curve(c[-1], c[-1], table, size * vector(table, c, gaps=True)) for c in columns]
            yield Panel(f"{name}_{group}", f"{title} ({name})", unit, "sensors", list(_there(curves)))


def _felt(table: pa.Table) -> str:
    """What its accel is: gravity is in the one and not in the other."""
    known = has(table, "accel_x") and schema_of(table)["accel_x"].quantity == "acceleration"
    return "Acceleration" if known else "Specific force"


def _residual_panels(residuals: pa.Table | None) -> Iterator[Panel]:
    if residuals is None or not residuals.num_rows:
        return
    for sensor, component in kinds_of(residuals):
        part = residuals.filter(is_kind(residuals, sensor, component))
        ratio = vector(part, "value", gaps=True) / vector(part, "sigma", gaps=True)
        accepted = np.asarray(part["accepted"].fill_null(True).combine_chunks().to_numpy(zero_copy_only=False), bool)
        drawn = np.clip(ratio, -FARTHEST, FARTHEST)
        found = [
            _curve(role, role, part, np.where(chosen, drawn, np.nan))
            for role, chosen in (("accepted", accepted), ("rejected", ~accepted))
        ]
        cut = f"; those beyond {FARTHEST:g} σ are drawn at {FARTHEST:g} σ" if (np.abs(ratio) > FARTHEST).any() else ""
        title = f"Residuals of {words(sensor)} {words(component)}".rstrip() + cut
        key = f"residuals_{sensor}_{component}"
        yield Panel(key, title, "σ", "residuals", list(_there(found)), levels=(-2.0, 2.0))


def kinds_of(residuals: pa.Table) -> list[tuple[str, str]]:
    """Sensors and components of a stream `residuals`, in the order in which they appear."""
    pairs = residuals.select(["sensor", "component"]).group_by(["sensor", "component"], use_threads=False)
    return [(row["sensor"] or "", row["component"] or "") for row in pairs.aggregate([]).to_pylist()]


def is_kind(residuals: pa.Table, sensor: str, component: str) -> Any:
    """(n,) Arrow bool: rows of that sensor and component."""
    same_sensor = pc.equal(pc.fill_null(residuals["sensor"], ""), sensor)
    return pc.and_(same_sensor, pc.equal(pc.fill_null(residuals["component"], ""), component))
