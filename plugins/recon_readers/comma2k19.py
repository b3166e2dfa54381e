"""Segments of the data set comma2k19: a minute of a commute, from a phone behind the windscreen and the car's CAN bus.

    <segment>/processed_log/IMU/accelerometer, gyro, magnetometer   m/s^2, rad/s, uT, along forward, right, down
    <segment>/processed_log/GNSS/live_gnss_ublox, live_gnss_qcom    deg, deg, m/s, UTC in ms, m, course in deg
    <segment>/processed_log/CAN/speed, wheel_speed, steering_angle  m/s; m/s front left, right, rear left, right; deg
    <segment>/global_pose/frame_*                                   ECEF pose of the camera at each frame of the video

Each sensor is a folder of two NumPy arrays without an ending, `t` in s since the boot of the phone and `value`. Any
of them may be absent. Nothing is unpickled.

What the description of the data leaves open or says otherwise was settled on its example: the magnetometer counts
microtesla and the receivers' UTC milliseconds; q takes forward, right, down to ECEF, v_e = R(q) v_b, not back; the
height is above the ellipsoid; the steering wheel's angle is positive to the left. UTC is boot time plus what the GPS
times of the frames say, less 18 leap seconds (2017 to the present), else what the receiver says, which is a few
tenths of a second late. Rows of GNSS keep the time at which they arrived.

Vectors are given along forward, left, up. The reference is of the camera: its attitude differs from that of the
vehicle by the mounting of the phone, its place from those of the antenna and the IMU by less than a phone.

Reference: Schafer, Santana, Haden, Biasini (2018), "A Commute in Data: The comma2k19 Dataset", arXiv:1812.05752.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.geodesy import ecef_to_geodetic
from recon.numerics.rotation import conjugate, from_rotvec, multiply, rotate
from recon.parameters import NoParams
from recon.rows import Metric, metrics
from recon.schema import FRAMES, GNSS, IMU, MAG, REFERENCE, WHEEL
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, build, with_meta
from recon_readers._arrays import FRONT_RIGHT_DOWN, NS, first_place, interleave, reference, unit_quaternions
from recon_readers._comma2k19_segment import (
    KINDS,
    LOG,
    POSE,
    RECEIVERS,
    Segment,
    array,
    only_segment,
    ordered,
    refuse_absent,
    segments,
    sensor,
    with_clock,
)
from recon_readers._limits import refuse_beyond, refuse_impossible
from recon_readers._time_order import Times

STEERING_DEG: Final = 2000.0
"""No steering wheel turns further."""
FARTHEST_M: Final = 1e7
"""From the centre of the Earth; no car is further away."""
VIDEO: Final = "video.hevc"
CAN: Final = {
    "speed": ("speed",),
    "wheel_speed": ("speed_front_left", "speed_front_right", "speed_rear_left", "speed_rear_right"),
    "steering_angle": ("steering_angle",),
}
_MICRO: Final = 1e-6
_FRD: Final = np.array((0.0, 1.0, 0.0, 0.0))
"""Quaternion from forward, left, up to forward, right, down."""

_Made: TypeAlias = tuple[Streams, list[Metric]]
"""Streams, and what is to be told of them."""


def read(path: Path, params: NoParams) -> Streams:
    """The streams imu, gnss, gnss_2, mag, wheel, reference and frames, as far as the segment holds them.

    path : a segment, or a folder that holds exactly one

    Raises ReadFailed, which names the array at fault.
    """
    segment, told = with_clock(only_segment(path))
    measured = [_imu(segment), _gnss(segment), _mag(segment), _wheel(segment)]
    if not any(table.num_rows for streams, _ in measured for table in streams.values()):
        what = f"no row of {', '.join(KINDS[:-1])} or {KINDS[-1]} is below {LOG}"
        raise ReadFailed(segment.folder, what, hint="check that the segment was copied completely")
    made = [*measured, _poses(segment)]
    streams = {name: table for part, _ in made for name, table in part.items()}
    learnt = [*told, *(row for _, rows in made for row in rows)]
    described = {name: with_meta(table, format="comma2k19", **segment.facts) for name, table in streams.items()}
    return {**described, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder with the folders of a segment, or with such folders."""
    found = segments(path) if path.is_dir() else []
    return Sniff(0.95, f"folder of a comma2k19 segment: {LOG}") if found else Sniff(0.0, "no folder of a segment")


# --- streams --------------------------------------------------------------------------------------------------------


def _imu(segment: Segment) -> _Made:
    parts, learnt = {}, []
    for group, name in (("accel", "IMU/accelerometer"), ("gyro", "IMU/gyro")):
        found = sensor(segment, name, 3)
        if found is not None:
            refuse_impossible(found.path, **{group: found.values})
            parts[group] = (found.t_ns, found.values * FRONT_RIGHT_DOWN)
            learnt += found.learnt
    if not parts:
        return {}, []
    t_ns, groups = interleave(parts)
    learnt.append(Metric("axes", note="imu and mag: logged along forward, right, down; given along forward, left, up"))
    return {"imu": with_meta(build(IMU.only(*groups), time=t_ns, **groups), axes="FRD")}, learnt


def _mag(segment: Segment) -> _Made:
    found = sensor(segment, "IMU/magnetometer", 3)
    if found is None:
        return {}, []
    mag = found.values * FRONT_RIGHT_DOWN * _MICRO
    refuse_impossible(found.path, mag=mag)
    return {"mag": with_meta(build(MAG, time=found.t_ns, mag=mag), axes="FRD")}, found.learnt


def _gnss(segment: Segment) -> _Made:
    streams: Streams = {}
    learnt = []
    for stream, name in RECEIVERS.items():
        found = sensor(segment, f"GNSS/{name}", 6)
        if found is None:
            continue
        lat, lon, speed, utc_ms, height, bearing_deg = found.values.T
        columns = {"lat": lat, "lon": lon, "height": height, "speed": speed, "course": np.radians(bearing_deg)}
        refuse_impossible(found.path, **columns)
        columns["course"] = np.mod(columns["course"], 2.0 * np.pi)
        table = build(GNSS.only(*columns), time=found.t_ns, **columns)
        streams[stream] = with_meta(table, height_datum="ellipsoid", heading_kind="course_true")
        learnt += [*found.learnt, *_age(segment, stream, found.t_ns, utc_ms)]
    return streams, learnt


def _age(segment: Segment, stream: str, t_ns: Times, utc_ms: Array) -> list[Metric]:
    """How long after the receiver's own time a row arrived, as a rule."""
    known = np.isfinite(utc_ms)
    if segment.facts["clock"] == "relative" or not known.any():
        return []
    age_s = float(np.median(t_ns[known] / NS - utc_ms[known] / 1e3))
    return [Metric("gnss_age", age_s, "s", note=f"{stream}: time of arrival minus the receiver's UTC, median")]


def _wheel(segment: Segment) -> _Made:
    parts: dict[str, tuple[Times, Array]] = {}
    learnt = []
    for name, columns in CAN.items():
        found = sensor(segment, f"CAN/{name}", len(columns))
        if found is None:
            continue
        values = found.values
        if name == "steering_angle":
            refuse_beyond(found.path, name, values, -STEERING_DEG, STEERING_DEG)
            values = np.radians(values)
            learnt.append(Metric("steering_angle", note="of the steering wheel, positive to the left"))
        else:
            refuse_impossible(found.path, speed=values)
        parts |= {column: (found.t_ns, values[:, index]) for index, column in enumerate(columns)}
        learnt += found.learnt
    if not parts:
        return {}, []
    t_ns, spread = interleave(parts)
    return {"wheel": build(WHEEL, time=t_ns, **spread)}, learnt


def _poses(segment: Segment) -> _Made:
    """The streams reference, of the camera, and frames; none where the poses are absent."""
    folder = segment.folder / POSE
    if not folder.is_dir():
        return {}, []
    names = ("times", "positions", "velocities", "orientations")
    times, positions, velocities, orientations = files = [folder / f"frame_{name}" for name in names]
    refuse_absent(*files)
    t_s = array(times, 1)[:, 0]
    pos_e, vel_e = array(positions, 3, len(t_s)), array(velocities, 3, len(t_s))
    refuse_beyond(positions, "position", pos_e, -FARTHEST_M, FARTHEST_M)
    refuse_impossible(velocities, vel=vel_e)
    q_ec = unit_quaternions(array(orientations, 4, len(t_s)))
    found = ordered(segment, POSE, times, t_s, np.column_stack([np.arange(len(t_s)), pos_e, vel_e, q_ec]))
    index, pos_e, vel_e, q_ec = np.split(found.values, (1, 4, 7), axis=1)
    video = VIDEO if (segment.folder / VIDEO).is_file() else None
    frames = build(
        FRAMES, time=found.t_ns, index=index[:, 0].astype(np.int64), file=pa.array([video] * len(index), pa.string())
    )
    note = "of the camera: x along its optical axis, y left, z up; not turned to the vehicle, no lever arm"
    learnt = [*found.learnt, Metric("reference_body", method="camera", note=note)]
    return {**_reference(positions, found.t_ns, pos_e, vel_e, q_ec), "frames": frames}, learnt


def _reference(path: Path, t_ns: Times, pos_e: Array, vel_e: Array, q_ec: Array) -> Streams:
    """The reference from Earth-fixed positions (n, 3) m, velocities (n, 3) m/s and attitudes (n, 4), camera to ECEF.

    Empty where no position is known.
    """
    lat, lon, height = ecef_to_geodetic(pos_e)
    refuse_impossible(path, height=height)
    place = np.column_stack([lat, lon, height])
    anchor = first_place(place)
    if anchor is None:
        return {}
    east = from_rotvec([0.0, 0.0, np.radians(anchor.lon) + 0.5 * np.pi])
    q_ne = conjugate(multiply(east, from_rotvec([0.5 * np.pi - np.radians(anchor.lat), 0.0, 0.0])))
    truth = reference(t_ns, place, anchor, rotate(q_ne, vel_e), multiply(multiply(q_ne, q_ec), _FRD))
    return {"reference": with_meta(truth, body="camera")}


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of the data set comma2k19."""
    place = GNSS.only("lat", "lon", "height", "speed", "course").possible()
    yield Reader(
        name="comma2k19",
        summary="Segments of the data set comma2k19: phone IMU, GNSS and CAN speeds, with a reference of the camera.",
        run=read,
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            **dict.fromkeys(RECEIVERS, place),
            "mag": MAG.possible(),
            "wheel": WHEEL.possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
            "frames": FRAMES.possible(),
        },
        references=(
            "Schafer, Santana, Haden, Biasini (2018), A Commute in Data: The comma2k19 Dataset, arXiv:1812.05752",
        ),
    )
