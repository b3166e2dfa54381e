"""Data of NaveGo: structures in .mat files of MATLAB 5 to 7, one or more in each file.

    imu   t, fb, wb                                     s, m/s^2, rad/s, along forward, right, down
    gnss  t, lat, lon, h; vel, stdm, stdv, larm         s, rad, rad, m; north, east, down m/s, m, m/s; body m
    ref   t, lat, lon, h, vel, roll, pitch, yaw         s, rad, rad, m, north, east, down m/s, rad

A structure is known by its fields, whatever it is called; fields that are not named here are left alone. The input is
a file, several, or a folder of them: its files are taken in the order of their names, a second IMU becomes imu_2.

fb is specific force: a still one reads -g down, hence +g up. Vectors are given along forward, left, up, and east,
north, up; of an attitude of north, east, down with axes forward, right, down, ISO 8855 makes

    yaw = pi/2 - yaw_ned,    pitch = -pitch_ned,    roll = roll_ned.

Times count from the start of the log; no date is known.

Reference: Gonzalez, Giribet, Patino (2015), "NaveGo: a simulation framework for low-cost integrated navigation
systems", Control Engineering and Applied Informatics 17(2), 110-120.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, Literal, TypeAlias

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.joining import combine
from recon.numerics.rotation import from_euler, yaw_from_heading
from recon.parameters import NoParams
from recon.recording import Recording
from recon.rows import Metric, metrics
from recon.schema import GNSS, IMU, REFERENCE
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, build, with_meta
from recon_readers._arrays import FRONT_RIGHT_DOWN, first_place, in_time, left_out, reference
from recon_readers._limits import refuse_beyond, refuse_impossible
from recon_readers._matlab import COMPRESSED, HEADER, byte_order, structures
from recon_readers._time_order import Times

OPENING: Final = 8192
"""Bytes of the first element in which its fields are named."""
TURNS: Final = 1000.0
"""rad; no angle that was unwrapped on a drive is larger."""
FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
    "imu": ("t", "fb", "wb"),
    "reference": ("t", "lat", "lon", "h", "vel", "roll", "pitch", "yaw"),
    "gnss": ("t", "lat", "lon", "h", "stdm"),
}
"""By stream, the fields by which a structure is known; the first that fits is meant."""
VECTORS: Final = ("fb", "wb", "vel", "stdm", "stdv", "larm")

Fields: TypeAlias = Mapping[str, Array | None]
"""By name, None where a field holds no numbers."""


def read(path: Path, params: NoParams) -> Streams:
    """The streams imu, gnss and reference of a file, or of all .mat files of a folder.

    Raises ReadFailed, and DataError where two structures contradict each other.
    """
    files = _files(path)
    if not files:
        raise ReadFailed(path, "it holds no .mat file", hint="name the .mat files, or the folder that holds them")
    parts, told = [], []
    for file in files:
        for name, fields in _structures(file).items():
            stream = _stream_of(fields)
            if not stream:
                told.append(Metric("not_read", note=f"{file.name}: '{name}' is neither imu, gnss nor ref"))
                continue
            made, learnt = _MAKERS[stream](file, name, fields)
            parts.append(Recording({stream: made}, {"sources": [f"{file.name}: {name}"]}))
            told += learnt
    if not parts:
        needed = "; ".join(f"{stream} has {', '.join(names)}" for stream, names in FIELDS.items())
        raise ReadFailed(path, "it holds no structure of NaveGo", hint=f"save one with the fields: {needed}")
    recording, learnt = combine(parts)
    return {**recording, "metrics": metrics([*told, *learnt])}


def sniff(path: Path, head: bytes) -> Sniff:
    """The fields of the first structure of a file, or of any .mat file of a folder."""
    if path.is_dir():
        known = any(_stream_of(_fields_of(file)) for file in _files(path))
        return Sniff(0.9, "folder with structures of NaveGo") if known else Sniff(0.0, "no .mat files of NaveGo in it")
    if head.startswith(b"MATLAB 7.3"):
        return Sniff(0.3, _HDF5)
    if not head.startswith(b"MATLAB 5.0"):
        return Sniff(0.0, "no .mat file")
    stream = _stream_of(_names_in(head))
    return (
        Sniff(0.9, f"structure of NaveGo: {stream}") if stream else Sniff(0.3, "a .mat file without imu, gnss or ref")
    )


# --- files ----------------------------------------------------------------------------------------------------------


_HDF5: Final = "this .mat file is HDF5: save it again in MATLAB with save(name, '-v7')"


def _files(path: Path) -> list[Path]:
    return sorted(path.glob("*.mat")) if path.is_dir() else [path]


def _fields_of(file: Path) -> set[str]:
    with file.open("rb") as opened:
        return _names_in(opened.read(HEADER + 8 + OPENING))


def _names_in(head: bytes) -> set[str]:
    """Words in the opening of the first element, among them the names of its fields."""
    opening = head[HEADER + 8 :][:OPENING]
    order: Literal["big", "little"] = "big" if byte_order(head) == ">" else "little"
    if int.from_bytes(head[HEADER : HEADER + 4], order) == COMPRESSED:
        try:
            opening = zlib.decompressobj().decompress(opening, OPENING)
        except zlib.error:
            return set()
    return {word.decode() for word in re.findall(rb"\w+", opening, re.ASCII)}


def _stream_of(names: Iterable[str]) -> str:
    """The stream that a structure of these fields holds; "" where it is none of NaveGo."""
    there = set(names)
    return next((stream for stream, needed in FIELDS.items() if there.issuperset(needed)), "")


def _structures(file: Path) -> Mapping[str, Fields]:
    """Fields by name of each structure of a file. Raises ReadFailed where it cannot be read."""
    data = file.read_bytes()
    if data.startswith(b"MATLAB 7.3"):
        what, _, hint = _HDF5.partition(": ")
        raise ReadFailed(file, what, hint=hint)
    try:
        return structures(data)
    except ValueError as error:
        raise ReadFailed(file, f"it is no whole MATLAB file: {error}", hint="copy the file again") from error


def _numbers(file: Path, name: str, fields: Fields, field: str, rows: int | None = None) -> Array:
    """A field as (n,), or (n, 3) where it holds vectors. Raises ReadFailed where it holds something else.

    rows : how many it must have; a field of one row or column may lie either way
    """
    values, width = fields[field], 3 if field in VECTORS else 1
    if values is None:
        raise ReadFailed(file, f"{name}.{field} holds no numbers", hint=_AGAIN)
    rows = values.size // width if rows is None else rows
    if values.shape != (rows, width) and not (1 in (rows, width) and values.shape == (width, rows)):
        what = f"{name}.{field} is of shape {values.shape}, where {rows} x {width} numbers are needed"
        raise ReadFailed(file, what, hint=_AGAIN)
    return values.reshape(rows, width) if field in VECTORS else values.reshape(rows)


_AGAIN: Final = "save the structure again, all fields of equal length"


# --- streams --------------------------------------------------------------------------------------------------------

_Made: TypeAlias = tuple[pa.Table, list[Metric]]


def _columns(
    file: Path, name: str, fields: Fields, wanted: Iterable[str]
) -> tuple[Times, dict[str, Array], list[Metric]]:
    """Times (n,) ns that rise, the fields wanted at them, and how many rows were left out."""
    t_s = _numbers(file, name, fields, "t")
    t_ns, rows = in_time(t_s)
    columns = {field: _numbers(file, name, fields, field, len(t_s))[rows] for field in wanted}
    return t_ns[rows], columns, left_out(rows, name)


def _imu(file: Path, name: str, fields: Fields) -> _Made:
    t_ns, columns, learnt = _columns(file, name, fields, ("fb", "wb"))
    accel, gyro = columns["fb"], columns["wb"]
    refuse_impossible(file, accel=accel, gyro=gyro)
    table = build(IMU.only("accel", "gyro"), time=t_ns, accel=accel * FRONT_RIGHT_DOWN, gyro=gyro * FRONT_RIGHT_DOWN)
    axes = Metric("axes", note=f"{name}: logged along forward, right, down; given along forward, left, up")
    return with_meta(_described(table), axes="FRD"), [*learnt, axes]


def _gnss(file: Path, name: str, fields: Fields) -> _Made:
    """GNSS with what the receiver says of its errors: stdm, stdv hold for all rows."""
    with_vel = ("vel",) if "vel" in fields else ()
    t_ns, columns, learnt = _columns(file, name, fields, ("lat", "lon", "h", *with_vel))
    lat, lon, height = _place(file, columns).T
    groups = {"lat": lat, "lon": lon, "height": height}
    groups |= {field: _velocity(file, columns) for field in with_vel}
    sigmas = {"pos_std": "stdm"} | ({"vel_std": "stdv"} if with_vel and "stdv" in fields else {})
    for group, field in sigmas.items():
        sigma_ned = _numbers(file, name, fields, field, 1)
        refuse_beyond(file, field, sigma_ned, 0.0, 1e6)
        groups[group] = np.tile(sigma_ned[:, [1, 0, 2]], (len(t_ns), 1))
    table = build(GNSS.only(*groups), time=t_ns, **groups)
    return _described(with_meta(table, height_datum="ellipsoid")), [*learnt, *_lever_arm(file, name, fields)]


def _lever_arm(file: Path, name: str, fields: Fields) -> list[Metric]:
    """From the IMU to the antenna, in the axes in which imu is given."""
    if "larm" not in fields:
        return []
    arm_b = _numbers(file, name, fields, "larm", 1)[0] * FRONT_RIGHT_DOWN + 0.0  # no -0
    note = f"{name}: from the IMU to the antenna, along forward, left, up"
    return [
        Metric(f"lever_arm_{axis}", value, "m", note=note) for axis, value in zip("xyz", arm_b.tolist(), strict=True)
    ]


def _reference(file: Path, name: str, fields: Fields) -> _Made:
    t_ns, columns, learnt = _columns(file, name, fields, FIELDS["reference"][1:])
    place, vel = _place(file, columns), _velocity(file, columns)
    for angle in ("roll", "pitch", "yaw"):
        refuse_beyond(file, angle, columns[angle], -TURNS, TURNS)
    anchor = first_place(place)
    if anchor is None:
        raise ReadFailed(file, f"{name} has no row with a place", hint=_AGAIN)
    q = from_euler(yaw_from_heading(columns["yaw"]), -columns["pitch"], columns["roll"])
    return _described(reference(t_ns, place, anchor, vel, q)), learnt


def _place(file: Path, columns: Mapping[str, Array]) -> Array:
    """Latitude and longitude in deg, height in m: (n, 3)."""
    refuse_beyond(file, "lat", columns["lat"], -0.5 * np.pi, 0.5 * np.pi)
    refuse_beyond(file, "lon", columns["lon"], -2.0 * np.pi, 2.0 * np.pi)
    refuse_impossible(file, height=columns["h"])
    return np.column_stack([np.degrees(columns["lat"]), np.degrees(columns["lon"]), columns["h"]])


def _velocity(file: Path, columns: Mapping[str, Array]) -> Array:
    """Velocity in m/s, east, north, up: (n, 3)."""
    refuse_impossible(file, vel=columns["vel"])
    return np.asarray(columns["vel"][:, [1, 0, 2]] * (1.0, 1.0, -1.0))


def _described(table: pa.Table) -> pa.Table:
    return with_meta(table, clock="relative", format="NaveGo")


_MAKERS: Final[Mapping[str, Callable[[Path, str, Fields], _Made]]] = {
    "imu": _imu,
    "gnss": _gnss,
    "reference": _reference,
}


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of NaveGo's structures."""
    yield Reader(
        name="navego",
        summary="Structures imu, gnss and ref of NaveGo in .mat files.",
        run=read,
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "vel", "pos_std", "vel_std").possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
        },
        references=(
            "Gonzalez, Giribet, Patino (2015), NaveGo: a simulation framework for low-cost integrated navigation "
            "systems, Control Engineering and Applied Informatics 17(2), 110-120",
        ),
    )
