"""What the attitude filters share: blocks for the filter that levels the sensor, its heading, attitude and metrics.

A filter levels the sensor in each part of the record that has no gap; the heading is found in `_north`. Where GNSS
shows how the vehicle accelerates, that is taken off the specific force and the filter runs once more: it is then not
led astray by bends and brakes. The attitude is that of the sensor, as the frame of its columns says, against
East-North-Up with true north wherever that is known; the fact `heading_kind` is "true", "magnetic" where the
declination is not known, or "arbitrary" where nothing tells the heading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon import (
    ATTITUDE,
    GNSS,
    IMU,
    MAG,
    Integrator,
    Metric,
    Need,
    Params,
    Streams,
    build,
    has,
    meta,
    metrics,
    quantity,
    setting,
    time_ns,
    vector,
    warning,
    with_meta,
)
from recon.driving import measured
from recon.errors import DataError, NotEnoughData
from recon.numerics.attitude import Blocks, Rows, blocks_of
from recon.numerics.rotation import Floats, from_rotvec, multiply
from recon.placing import moment
from recon_integrators._heading import Heading, find_heading
from recon_integrators._levelled import Levelled, acceleration_g
from recon_integrators._north import Velocities, north_of, velocities_of

Triple: TypeAlias = tuple[float, float, float]

READS: Final[Mapping[str, Need]] = {
    "imu": IMU.need("accel", "gyro", frame="sensor", quantity={"accel": "specific_force"}),
    "mag": MAG.need("mag", frame="sensor", optional=True),
    "gnss": GNSS.need(maybe=["lat", "lon", "height", "speed", "course", "vel", "fix"], optional=True),
}
WRITES: Final = {"attitude": ATTITUDE.only("q", frame="sensor")}

_FELT: Final = (5.0, 20.0)
"""m/s^2 between which an accelerometer feels gravity on average."""
_SOME: Final = 7
"""One row in so many is enough for that."""
_ROUGH_S: Final = 2.0
"""Blocks in which the heading shows well enough to turn the vehicle's acceleration."""
_Q: Final = ("qw", "qx", "qy", "qz")


class NineAxesParams(Params):
    """Parameters that the attitude filters share."""

    heading: Literal["auto", "magnetometer", "course"] = setting(
        "auto", doc="What tells the heading; auto takes both where they are there and agree."
    )
    declination: float | None = quantity(
        None, "deg", ge=-180, le=180, doc="Of magnetic from true north, positive east; none: by place and date."
    )
    hard_iron: Triple | None = quantity(
        None, "uT", doc="Constant field of the box and the vehicle on the axes of mag; none: found from the drive."
    )
    max_gap: float = quantity(0.5, "s", gt=0, le=3600, doc="After a longer gap in imu the attitude is found anew.")


@dataclass(frozen=True)
class Level:
    """What a filter found in one record: q_ls (m, 4) at the ends of its blocks, bias (m, 3) rad/s or None."""

    q_ls: Floats
    bias_s: Floats | None = None


class Record(NamedTuple):
    """A part of the record without a gap: time of its first row, its blocks, and its rows within them."""

    start_ns: int
    blocks: Blocks
    rows: Rows


Filter: TypeAlias = Callable[[Blocks], Level]


def attitude_by(
    filter_: Filter, rate_hz: float, imu: pa.Table, mag: pa.Table | None, gnss: pa.Table | None, params: NineAxesParams
) -> Streams:
    """Attitude of the sensor at every row of imu, and what was learnt.

    rate_hz : blocks a second on which the filter works
    Raises NotEnoughData where imu is empty, DataError where it does not feel gravity, or where a magnetometer is to be
    used at a date for which no model of the Earth's field is known.
    """
    if not imu.num_rows:
        raise NotEnoughData("rows in imu", needed="1", found="0")
    imu, gyro_s, accel_s = _inertial(imu)
    t_ns = time_ns(imu)
    if (np.diff(t_ns) <= 0).any():
        raise DataError("the times of imu do not rise", "sort its rows by time")
    _check_gravity(accel_s)
    cuts = np.flatnonzero(np.diff(t_ns) > params.max_gap * 1e9) + 1
    notes = _gap_notes(t_ns, cuts)
    records = [
        Record(int(t_ns[part.start]), *blocks_of(_since_first(t_ns[part]), gyro_s[:, part], accel_s[:, part], rate_hz))
        for part in (slice(*ends) for ends in pairwise([0, *cuts, len(t_ns)]))
    ]
    levels, heading = _levelled(filter_, records, mag, gnss, params)
    turned = [_turned(*each) for each in zip(records, levels, heading.turns, strict=True)]
    columns = dict(zip(_Q, np.concatenate(turned, axis=1), strict=True))
    table = with_meta(build(WRITES["attitude"], time=t_ns, **columns), **{**meta(imu), "heading_kind": heading.kind})
    return {"attitude": table, "metrics": metrics([*_learnt(records, levels), *heading.learnt, *notes])}


def _levelled(
    filter_: Filter, records: list[Record], mag: pa.Table | None, gnss: pa.Table | None, params: NineAxesParams
) -> tuple[list[Level], Heading]:
    """Each record levelled, and the heading."""
    seen = mag if params.heading != "course" and mag is not None and has(mag, "mag") and mag.num_rows else None
    north, notes = north_of(seen, gnss, params.declination)
    velocities, more = velocities_of(gnss, north)
    course = velocities if params.heading != "magnetometer" else None

    def heading_of(pieces: list[Levelled]) -> Heading:
        return find_heading(pieces, seen, course, north, params.hard_iron)

    blocks = [record.blocks for record in records]
    if velocities is not None:
        blocks = _less_acceleration(filter_, records, heading_of, velocities)
    levels = [filter_(each) for each in blocks]
    heading = heading_of([Levelled(r.start_ns, r.blocks, level.q_ls) for r, level in zip(records, levels, strict=True)])
    return levels, replace(heading, learnt=[*heading.learnt, *notes, *more])


def _less_acceleration(
    filter_: Filter,
    records: list[Record],
    heading_of: Callable[[list[Levelled]], Heading],
    velocities: Velocities,
) -> list[Blocks]:
    """The blocks of each record, less the vehicle's acceleration that GNSS shows.

    It shows it along East and North, so the heading is found first, of the records levelled in rough blocks.
    """
    rough = []
    for start_ns, blocks, _ in records:
        merged = blocks.lasting(_ROUGH_S)
        rough.append(Levelled(start_ns, merged, filter_(merged).q_ls))
    heading = heading_of(rough)
    if heading.kind != "true":
        return [record.blocks for record in records]
    return [
        blocks._replace(
            force_g=blocks.force_g - acceleration_g(piece, turn, blocks.t_s - 0.5 * blocks.step_s, velocities)
        )
        for (_, blocks, _), piece, turn in zip(records, rough, heading.turns, strict=True)
    ]


def _since_first(t_ns: NDArray[np.int64]) -> Floats:
    return np.asarray((t_ns - t_ns[0]) * 1e-9)


def _inertial(imu: pa.Table) -> tuple[pa.Table, Floats, Floats]:
    """The rows that hold all six numbers, their turn rates (3, n) and specific forces (3, n)."""
    six = np.array([vector(imu, f"{group}_{axis}", gaps=True) for group in ("gyro", "accel") for axis in "xyz"])
    if np.isfinite(six.sum()):
        return imu, six[:3], six[3:]
    return _inertial(measured(imu))


def _turned(record: Record, level: Level, delta: Floats) -> Floats:
    """Attitude (4, n) at every row of a record, its level frame turned by delta (m,) rad at the ends of its blocks."""
    up = np.column_stack([np.zeros_like(delta), np.zeros_like(delta), delta])
    return record.rows.attitude(record.blocks, multiply(from_rotvec(up), level.q_ls))


def _check_gravity(accel_s: Floats) -> None:
    force = float(np.median(np.sqrt((accel_s[:, ::_SOME] ** 2).sum(axis=0))))
    if not _FELT[0] < force < _FELT[1]:
        raise DataError(
            f"the accelerometer feels {force:.2g} m/s^2 on average, where gravity is 9.8",
            "is its unit g, or has gravity been taken off?",
        )


def _gap_notes(t_ns: NDArray[np.int64], cuts: NDArray[np.intp]) -> list[Metric]:
    if not len(cuts):
        return []
    first = moment(t_ns, int(cuts[0]) - 1)
    return [warning(f"imu has {len(cuts)} gaps, the first after {first}: behind each the attitude is found anew")]


def _learnt(records: list[Record], levels: list[Level]) -> list[Metric]:
    """The bias of the gyroscope at the end of the longest record."""
    bias = levels[int(np.argmax([len(record.blocks.t_s) for record in records]))].bias_s
    if bias is None:
        return []
    note = "sensor frame, at the end; about the vertical the accelerometer does not show it"
    return [
        Metric(f"gyro_bias_{axis}", float(np.degrees(value)), "deg/s", note=note)
        for axis, value in zip("xyz", bias[-1], strict=True)
    ]


def declared(
    name: str, summary: str, params: type[NineAxesParams], run: Any, references: tuple[str, ...]
) -> Integrator:
    """The record of an attitude filter."""
    return Integrator(
        name=name, summary=summary, params=params, reads=READS, writes=WRITES, run=run, references=references
    )
