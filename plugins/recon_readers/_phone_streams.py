"""Sensors of a phone to streams. Axes as Android and iOS both have them: x right, y up, z out of the screen.

Accelerometer and gyroscope of many phones are sampled at times of their own: then the rows of imu hold the one or the
other, as they were measured. Most stages need both at once: filter.resample brings them together, or the parameter
`together`, which reads the gyroscope between its samples at the times of the accelerometer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.signals import interpolate
from recon.parameters import Params, setting
from recon.rows import Metric, warning
from recon.schema import BARO, GNSS, IMU, MAG, STREAMS, Change, Schema
from recon.tables import Array, Streams, build, matrix, time_ns, with_meta
from recon_readers._arrays import interleave
from recon_readers._lines import Lines
from recon_readers._streams import Source, stream
from recon_readers._time_order import Mask, Times

AXES: Final = "x right, y up, z out of the screen"
WRITES: Final[Mapping[str, Schema]] = {
    "imu": IMU.only("accel", "gyro").open_ended(),
    "gnss": GNSS.only("lat", "lon", "height", "speed", "course", "pos_std", "vel_std").possible(),
    "mag": MAG.possible(),
    "baro": BARO.only("pressure").possible(),
}
CIRCLE: Final = 1.515
"""Radius within which 68 % of fixes lie, as phones tell it, over the sigma of each axis: sqrt(-2 ln 0.32)."""
Accel = Literal["specific_force", "acceleration"]
_SIZE: Final = (0.5, 2.0)
_SILENT: Final = 5.0
"""Sample periods after which a gyroscope is silent."""


class PhoneParams(Params):
    """Parameters that readers of phones share."""

    together: bool = setting(
        False, doc="Interpolate the gyroscope to the times of the accelerometer; false: rows hold the one or the other."
    )


@dataclass(frozen=True)
class Sensor:
    """What one sensor reported: times (n,) ns, where there is none, and groups of values in the units of its stream.

    numbered : are the lines numbered as in the file?
    """

    name: str
    lines: Lines
    t_ns: Times
    missing: Mask
    groups: Mapping[str, Array]
    numbered: bool = True

    def table(self, kind: str) -> tuple[pa.Table | None, list[Metric]]:
        """The rows that are whole, as a stream of that kind."""
        source = Source(self.lines.path, self.name, self.lines.line if self.numbered else None)
        made, learnt = stream(source, STREAMS[kind], self.t_ns, self.missing, dict(self.groups))
        return made, [*self.lines.learnt(), *learnt]


def columns(lines: Lines, names: tuple[str, ...]) -> Array:
    """Columns of numbers side by side: (n, k), NaN where there is no number."""
    found = [np.asarray(lines.table[name].combine_chunks().to_numpy(zero_copy_only=False)) for name in names]
    return np.column_stack([values.astype(np.float64) for values in found])


def streams_of(
    path: Path, sensors: Mapping[str, Sensor], felt: Accel, facts: Mapping[str, Any], params: PhoneParams
) -> tuple[Streams, list[Metric]]:
    """The streams of the sensors there are: accel, gyro, mag, baro, gnss.

    felt : what the accelerometer counts; facts : of every stream
    """
    made: Streams = {}
    learnt: list[Metric] = []
    parts: dict[str, tuple[Times, Array]] = {}
    for key, sensor in sensors.items():
        table, told = sensor.table("imu" if key in ("accel", "gyro") else key)
        learnt += told
        if table is None:
            learnt.append(warning(f"{sensor.name} of {path.name} holds no measurement"))
        elif key in ("accel", "gyro"):
            parts[key] = (time_ns(table), matrix(table, key, gaps=True))
        else:
            made[key] = with_meta(table, **facts, **_own_facts(key))
    if params.together and len(parts) == 2:
        learnt += _bring_together(parts)
    if parts:
        t_ns, values = interleave(parts)
        schema = Change(quantities={"accel": felt}).apply(IMU.only(*values))
        made = {"imu": with_meta(build(schema, time=t_ns, **values), **facts, axes=AXES), **made}
        learnt += _doubts(values, felt)
        if len(parts) == 2 and len(t_ns) > 1.5 * max(len(times) for times, _ in parts.values()):
            note = "accelerometer and gyroscope have times of their own: put filter.resample behind the reader, or set"
            learnt.append(warning(f"{note} its parameter 'together'"))
    return made, learnt


def _bring_together(parts: dict[str, tuple[Times, Array]]) -> list[Metric]:
    """Put the gyroscope at the times of the accelerometer, and tell; missing where it was silent."""
    (t_ns, _), (gyro_ns, gyro) = parts["accel"], parts["gyro"]
    if np.array_equal(t_ns, gyro_ns) or len(gyro_ns) < 2:
        return []
    step_s = float(np.median(np.diff(gyro_ns))) * 1e-9
    at_s, gyro_s = (t_ns - t_ns[0]) * 1e-9, (gyro_ns - t_ns[0]) * 1e-9
    there = interpolate(at_s, gyro_s, gyro, _SILENT * step_s)
    parts["gyro"] = (t_ns, there)
    count = int(np.isfinite(there[:, 0]).sum())
    note = f"gyroscope ({len(gyro_ns)} rows) interpolated to {count} of the {len(t_ns)} times of the accelerometer"
    return [Metric("gyro_interpolated", step_s, "s", note=note)]


def _own_facts(key: str) -> dict[str, str]:
    if key == "gnss":
        return {"height_datum": "ellipsoid", "heading_kind": "course_true"}
    return {"axes": AXES} if key == "mag" else {}


def _doubts(values: Mapping[str, Array], felt: Accel) -> list[Metric]:
    if "accel" not in values:
        return []
    known = values["accel"][np.isfinite(values["accel"]).all(axis=1)]
    size = float(np.median(np.linalg.norm(known, axis=1))) if len(known) else 0.0
    if felt == "specific_force" and not _SIZE[0] < size / STANDARD_GRAVITY < _SIZE[1]:
        return [warning(f"the median specific force is {size:.3g} m/s^2 where gravity is 9.8: is its unit another?")]
    return [Metric("gravity_felt", size, "m/s^2")] if felt == "specific_force" else []
