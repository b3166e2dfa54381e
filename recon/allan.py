"""The noise of an IMU from a record of it standing still: Allan deviations, terms as data sheets name them, YAML."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import DataError, NotEnoughData
from recon.numerics.allan import Noise, fit, overlapping, sizes, uncertainty
from recon.numerics.signals import runs
from recon.numerics.smoothing import regular_samples
from recon.numerics.smoothing.stops import MOST_LIMITS, Blocks, block_means, find_stops
from recon.rounding import rounded
from recon.tables import Array, has, matrix, seconds, time_ns, vector
from recon.units import convert

SHAKEN: Final = 2.0
"""Times what the terms make of them, beyond which deviations show something else: a vibration."""
_WELL_KNOWN: Final = 0.1
LEAST_S: Final = 30.0
"""s of standing still, from which a noise is told."""
_BLOCK_S: Final = 0.1
_MOVED: Final = 0.02
"""Share of the seconds of a record without GNSS that may be unquiet."""
SENSORS: Final = {"gyro": "rad/s", "accel": "m/s^2"}


@dataclass(frozen=True)
class Axis:
    """What was found of one axis. sensor : gyro or accel; deviation : (j,) as tau; noise : SI"""

    sensor: str
    name: str
    deviation: Array
    noise: Noise


@dataclass(frozen=True)
class Allan:
    """start_s, stop_s : the part of the record that was used, s after its first row; tau_s, relative : (j,)"""

    start_s: float
    stop_s: float
    rate_hz: float
    tau_s: Array
    relative: Array
    axes: tuple[Axis, ...]

    def of(self, sensor: str) -> list[Axis]:
        """The axes of one sensor."""
        return [axis for axis in self.axes if axis.sensor == sensor]

    def unexplained(self) -> tuple[float, float]:
        """How many times what the terms make of it a deviation that is well known is at most, and at which tau, s."""
        told = np.array([axis.deviation / np.maximum(axis.noise.deviation(self.tau_s), 1e-30) for axis in self.axes])
        known = np.array([[axis.noise.white > 0.0] for axis in self.axes]) & (self.relative < _WELL_KNOWN)
        ratio = np.where(known, told, 0.0).max(axis=0)
        worst = int(ratio.argmax())
        return float(ratio[worst]), float(self.tau_s[worst])


def analyse(imu: pa.Table, gnss: pa.Table | None) -> Allan:
    """Allan deviations of the longest time at rest. Raises NotEnoughData and DataError where the box does not rest."""
    t_s = seconds(imu)
    groups = {name: matrix(imu, name) for name in SENSORS if has(imu, name)}
    if not groups or len(t_s) < 100:
        raise NotEnoughData("samples of an IMU", needed="100 rows", found=str(len(t_s)))
    accel, gyro = (groups.get(name, np.zeros((len(t_s), 3))) for name in ("accel", "gyro"))
    start, stop = _at_rest(t_s, gyro, accel, gnss, int(time_ns(imu)[0]))
    count = stop - start
    span = float(t_s[stop - 1] - t_s[start])
    if span < LEAST_S:
        hint = "record the box lying still: ten minutes tell white noise, hours tell drifts"
        raise NotEnoughData("rest", needed=f"{LEAST_S:g} s in a row", found=f"{span:.0f} s", hint=hint)
    rate = (count - 1) / span
    even = np.linspace(t_s[start], t_s[stop - 1], count)
    size = sizes(count)
    relative = uncertainty(count, size)
    axes = []
    for name, values in groups.items():
        part = np.column_stack([np.interp(even, t_s[start:stop], column) for column in values[start:stop].T])
        deviation = overlapping(part, size)
        axes += [Axis(name, x, of, fit(size / rate, of, relative)) for x, of in zip("xyz", deviation.T, strict=True)]
    return Allan(float(t_s[start]), float(t_s[stop - 1]), rate, size / rate, relative, tuple(axes))


def _at_rest(t_s: Array, gyro: Array, accel: Array, gnss: pa.Table | None, start_ns: int) -> tuple[int, int]:
    """First row and the row behind the last of the longest rest."""
    try:
        samples = regular_samples(t_s, gyro, accel)
    except ValueError as error:
        raise NotEnoughData("samples of an IMU", needed=f"{LEAST_S:g} s", found=str(error)) from error
    blocks = block_means(samples, max(1, round(_BLOCK_S / float(np.median(np.diff(t_s))))))
    if gnss is not None and has(gnss, "speed"):
        still = find_stops(blocks, seconds(gnss, since=start_ns), vector(gnss, "speed", gaps=True)).still
    else:
        still = _quiet(blocks)
    found = runs(still & blocks.measured)
    if not len(found):
        raise DataError("the box never rests in this log", "record it lying still, engine off")
    first, last = found[int(np.argmax(found[:, 1] - found[:, 0]))]
    edges = np.searchsorted(t_s, (blocks.t_s[first], blocks.t_s[last - 1]))
    return int(edges[0]), int(edges[1]) + 1


def _quiet(blocks: Blocks) -> Any:
    """(B,) of a record without speeds: everything, if hardly a second of it is more than a standing vehicle shows."""
    per_second = max(1, round(1.0 / blocks.duration))
    whole = len(blocks.t_s) // per_second * per_second
    spread = [
        np.sqrt((y[:, :whole].reshape(3, -1, per_second).std(axis=2) ** 2).sum(axis=0))
        for y in (blocks.gyro, blocks.accel)
    ]
    moved = (spread[0] > MOST_LIMITS[0]) | (spread[1] > MOST_LIMITS[1])
    if moved.mean() > _MOVED:
        still = np.ones(len(blocks.t_s), dtype=bool)
        still[:whole] = np.repeat(~moved, per_second)
        return still
    return np.ones(len(blocks.t_s), dtype=bool)


def typical(found: Allan, sensor: str, term: str) -> float | None:
    """Root mean square over the axes of a term in SI; None where it shows in no axis."""
    values = [getattr(axis.noise, term) for axis in found.of(sensor)]
    return float(np.sqrt(np.mean(np.square(values)))) if any(values) else None


def fuser_params(found: Allan) -> dict[str, str]:
    """What fuser.map reads, as a person writes it."""
    units = {
        "gyro_noise": ("gyro", "white", "rad/s/sqrt(Hz)", "deg/s/sqrt(Hz)"),
        "accel_noise": ("accel", "white", "m/s^2/sqrt(Hz)", "ug/sqrt(Hz)"),
        "gyro_bias_walk": ("gyro", "walk", "rad/s/sqrt(s)", "deg/s/sqrt(s)"),
        "accel_bias_walk": ("accel", "walk", "m/s^2/sqrt(s)", "ug/sqrt(s)"),
    }
    told = {}
    for name, (sensor, term, si, unit) in units.items():
        value = typical(found, sensor, term)
        if value:
            told[name] = f"{rounded(convert(value, si, unit), digits=3)} {unit}"
    return told
