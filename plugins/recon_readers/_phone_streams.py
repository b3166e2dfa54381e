"""Sensors of a phone to streams. Axes as Android and iOS both have them: x right, y up, z out of the screen.

Accelerometer and gyroscope of many phones are sampled at times of their own: then the rows of imu hold the one or the
other, as they were measured. Most stages need both at once: filter.resample brings them together, or the parameter
`together`, which reads the gyroscope between its samples at the times of the accelerometer.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.numerics.geodesy import STANDARD_GRAVITY
from recon.numerics.signals import interpolate
from recon.parameters import Params, setting
from recon.rows import Metric, warning
from recon.schema import BARO, GNSS, IMU, MAG, STREAMS, Change, Schema, spread
from recon.tables import Array, Streams, build, time_ns, vector, with_meta
from recon_readers._arrays import interleave
from recon_readers._lines import Lines
from recon_readers._streams import Source, stream
from recon_readers._time_order import Times

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
_ENOUGH: Final = 100_000
"""Rows from which a median is told."""
_SILENT: Final = 5.0
"""Sample periods after which a gyroscope is silent."""


class PhoneParams(Params):
    """Parameters that readers of phones share."""

    together: bool = setting(
        False, doc="Interpolate the gyroscope to the times of the accelerometer; false: rows hold the one or the other."
    )


@dataclass(frozen=True)
class Sensor:
    """What one sensor reported: `time` (n,) ns, `missing` (n,) bool where there is none, and columns of its stream.

    numbered : are the lines numbered as in the file?
    """

    name: str
    lines: Lines
    columns: MutableMapping[Any, NDArray[Any]]
    numbered: bool = True

    def table(self, kind: str) -> tuple[pa.Table | None, list[Metric]]:
        """The rows that are whole, as a stream of that kind; empties the columns."""
        source = Source(self.lines.path, self.name, self.lines.line if self.numbered else None)
        t_ns, missing = self.columns.pop("time"), self.columns.pop("missing")
        made, learnt = stream(source, STREAMS[kind], t_ns, missing, self.columns)
        return made, [*self.lines.learnt(), *learnt]


def streams_of(
    path: Path, sensors: Mapping[str, Sensor], felt: Accel, facts: Mapping[str, Any], params: PhoneParams
) -> tuple[Streams, list[Metric]]:
    """The streams of the sensors there are: accel, gyro, mag, baro, gnss.

    felt : what the accelerometer counts; facts : of every stream
    """
    made: Streams = {}
    learnt: list[Metric] = []
    parts: dict[str, tuple[Times, Array]] = {}
    inertial: dict[str, Times] = {}
    for key, sensor in sensors.items():
        table, told = sensor.table("imu" if key in ("accel", "gyro") else key)
        learnt += told
        if table is None:
            learnt.append(warning(f"{sensor.name} of {path.name} holds no measurement"))
        elif key in ("accel", "gyro"):
            inertial[key] = time_ns(table)
            names = spread(key, table.column_names)
            parts |= {name: (inertial[key], vector(table, name, gaps=True)) for name in names}
        else:
            made[key] = with_meta(table, **facts, **_own_facts(key))
    if not parts:
        return made, learnt
    learnt += _doubts(parts, felt)
    if params.together and len(inertial) == 2:
        learnt += _bring_together(parts, inertial)
    longest = max(len(times) for times in inertial.values())
    t_ns, values = interleave(parts)
    schema = Change(quantities={"accel": felt}).apply(IMU.only(*inertial))
    made = {"imu": with_meta(build(schema, time=t_ns, **values), **facts, axes=AXES), **made}
    if len(inertial) == 2 and len(t_ns) > 1.5 * longest:
        note = "accelerometer and gyroscope have times of their own: put filter.resample behind the reader, or set"
        learnt.append(warning(f"{note} its parameter 'together'"))
    return made, learnt


def _bring_together(parts: dict[str, tuple[Times, Array]], inertial: dict[str, Times]) -> list[Metric]:
    """Put the gyroscope at the times of the accelerometer, and tell; missing where it was silent."""
    t_ns, gyro_ns = inertial["accel"], inertial["gyro"]
    if np.array_equal(t_ns, gyro_ns) or len(gyro_ns) < 2:
        return []
    step_s = float(np.median(np.diff(gyro_ns))) * 1e-9
    at_s, gyro_s = (t_ns - t_ns[0]) * 1e-9, (gyro_ns - t_ns[0]) * 1e-9
    count = 0
    for name in spread("gyro", parts):
        there = interpolate(at_s, gyro_s, parts[name][1], _SILENT * step_s)
        parts[name] = (t_ns, there)
        count = int(np.isfinite(there).sum())
    inertial["gyro"] = t_ns
    note = f"gyroscope ({len(gyro_ns)} rows) interpolated to {count} of the {len(t_ns)} times of the accelerometer"
    return [Metric("gyro_interpolated", step_s, "s", note=note)]


def _own_facts(key: str) -> dict[str, str]:
    if key == "gnss":
        return {"height_datum": "ellipsoid", "heading_kind": "course_true"}
    return {"axes": AXES} if key == "mag" else {}


def _doubts(parts: Mapping[str, tuple[Times, Array]], felt: Accel) -> list[Metric]:
    axes = [parts[name][1] for name in spread("accel", parts)]
    if not axes or felt != "specific_force":
        return []
    every = 1 + len(axes[0]) // _ENOUGH
    size = float(np.nan_to_num(np.nanmedian(np.linalg.norm([values[::every] for values in axes], axis=0))))
    if not _SIZE[0] < size / STANDARD_GRAVITY < _SIZE[1]:
        return [warning(f"the median specific force is {size:.3g} m/s^2 where gravity is 9.8: is its unit another?")]
    return [Metric("gravity_felt", size, "m/s^2")]
