"""The oxts folder of a KITTI raw recording: what its OXTS RT 3003 measured, and its own solution.

    <drive>/oxts/timestamps.txt        a time for each packet, with nanoseconds, naming no zone
    <drive>/oxts/data/0000000000.txt   a packet each: 30 numbers, among them

     0..2  lat lon deg, alt m           3..5   roll pitch yaw rad: left side up, front down, counter-clockwise from east
     6, 7  vn ve, 10 vu m/s             11..13 ax ay az m/s^2 along forward, left, up: specific force
    17..19 wx wy wz rad/s               23, 24 sigmas of position m and velocity m/s;   26 number of satellites

Angles and axes are those of ISO 8855 and of recon. The solution is one of GNSS and IMU together: it becomes
`reference`, and a `gnss` of its positions, velocities and sigmas, which is smoother than a receiver's alone. Folders
"extract" hold 100 Hz, "sync" 10 Hz. The input is the folder of the drive or oxts itself.

Reference: Geiger, Lenz, Stiller, Urtasun (2013), "Vision meets robotics: the KITTI dataset", IJRR 32(11), and the
dataformat.txt in each folder.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import NS
from recon.parameters import Params, quantity
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU, REFERENCE
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._reference import reference_columns
from recon_readers._streams import Source, stream
from recon_readers._text_blocks import contents
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import moments

WIDTH: Final = 30
TIMES: Final = "timestamps.txt"


class KittiParams(Params):
    """What the files do not tell."""

    clock_offset: float = quantity(0.0, "h", ge=-14, le=14, doc="Clock of the recorder minus UTC.")


def read(path: Path, params: KittiParams) -> Streams:
    """The streams imu, gnss and reference. Raises ReadFailed."""
    folder = _oxts(path)
    if folder is None:
        hint = f"name the folder of a drive that holds oxts/{TIMES} and oxts/data"
        raise ReadFailed(path, "this is no recording of KITTI", hint=hint)
    t_ns, missing = _times(folder / TIMES)
    packets, damaged = _packets(folder / "data", len(t_ns))
    t_ns = t_ns - round(params.clock_offset * NS)
    groups, anchored = _groups(packets)
    if not groups:
        raise ReadFailed(folder / "data", "no packet holds a place", hint="copy the folder again")
    facts: dict[str, Any] = {"format": "KITTI oxts", "clock": "absolute", "time_scale": "UTC"}
    placed = {**facts, "height_datum": "ellipsoid"}
    felt, world = {**facts, "axes": "FLU"}, {**facts, **anchored}
    streams: Streams = {}
    learnt = [Metric("packets", float(len(packets))), *_told(folder, damaged, params), *_untimed(folder, len(packets))]
    for name, schema, more in (
        ("imu", IMU, felt),
        ("gnss", GNSS, placed),
        ("reference", REFERENCE, world),
    ):
        table, told = stream(Source(folder / "data", name), schema, t_ns, missing, groups[name])
        learnt += told
        if table is not None:
            streams[name] = with_meta(table, **more)
    if not streams:
        raise ReadFailed(folder / TIMES, "no packet has a time", line=1, hint="copy the folder again")
    return {**streams, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder with oxts/timestamps.txt and oxts/data."""
    if path.is_dir() and _oxts(path) is not None:
        return Sniff(0.95, "folder oxts of a KITTI recording")
    return Sniff(0.0, "no folder oxts of KITTI")


def _oxts(path: Path) -> Path | None:
    """The folder that holds the times and packets; None where there is none."""
    candidates = (path, path / "oxts")
    return next((part for part in candidates if (part / TIMES).is_file() and (part / "data").is_dir()), None)


def _times(path: Path) -> tuple[Times, Mask]:
    text = contents(path).decode("ascii", "replace").splitlines()
    t_ns, good = moments(pa.array(text, pa.string()))
    if not good.any():
        raise ReadFailed(
            path, "no line of it is a time like 2011-09-26 13:02:25.964389445", line=1, hint="copy it again"
        )
    return t_ns, ~good


def _packets(folder: Path, count: int) -> tuple[Array, int]:
    """The numbers of each packet, (count, 30), NaN where its file is absent or damaged; how many are."""
    packets = np.full((count, WIDTH), np.nan)
    for row in range(count):
        try:
            packets[row] = np.array((folder / f"{row:010d}.txt").read_bytes().split(), dtype=np.float64)
        except (OSError, ValueError):  # absent; another count of numbers, or no numbers
            continue
    return packets, int(np.isnan(packets).all(axis=1).sum())


def _groups(packets: Array) -> tuple[dict[str, dict[str, Array]], dict[str, Any]]:
    """Columns by stream, and the facts of the reference; empty where no packet has a place."""
    with np.errstate(invalid="ignore"):
        roll, pitch, yaw = np.where(np.abs(packets[:, 3:6]) < 100.0, packets[:, 3:6], np.nan).T
    vel = packets[:, (7, 6, 10)]
    world, facts = reference_columns(list(packets[:, :3].T), list(vel.T), (yaw, pitch, roll))
    if not world:
        return {}, {}
    place = {name: world[name] for name in ("lat", "lon", "height")}
    sigmas = {"pos_std": np.tile(packets[:, 23:24], (1, 3)), "vel_std": np.tile(packets[:, 24:25], (1, 3))}
    return {
        "imu": {"accel": packets[:, 11:14], "gyro": packets[:, 17:20]},
        "gnss": {**place, "vel": vel, **sigmas, "satellites": packets[:, 26]},
        "reference": world,
    }, facts


def _told(folder: Path, damaged: int, params: KittiParams) -> list[Metric]:
    note = "clock of the recorder minus UTC; its times name no zone"
    found = [Metric("assumed_clock_offset", params.clock_offset, "s", note=note)]
    if damaged:
        found.append(Metric("packets_left_out", float(damaged), note="absent, or not of 30 numbers"))
        found.append(warning(f"left out of {folder.name}: {damaged} packets that are absent or not of 30 numbers"))
    note = "gnss is the recorder's solution of GNSS and IMU: smoother than a receiver's, its errors last longer"
    return [*found, Metric("gnss_source", method="GNSS and IMU", note=note)]


def _untimed(folder: Path, times: int) -> list[Metric]:
    """What is to be said where there are more packets than times."""
    names = (file.stem for file in (folder / "data").glob("*.txt"))
    more = sum(name.isdecimal() and int(name) >= times for name in names)
    return [warning(f"{more} packets are not read, for {TIMES} has {times} lines only: copy it again")] if more else []


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of KITTI's oxts folders."""
    yield Reader(
        name="kitti",
        summary="The oxts folder of a KITTI raw recording: imu, gnss and reference.",
        params=KittiParams,
        run=read,
        sniff=sniff,
        writes={
            "imu": IMU.only("accel", "gyro").possible(),
            "gnss": GNSS.only("lat", "lon", "height", "vel", "pos_std", "vel_std", "satellites").possible(),
            "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
        },
        references=("Geiger, Lenz, Stiller, Urtasun (2013), Vision meets robotics: the KITTI dataset, IJRR 32(11)",),
    )
