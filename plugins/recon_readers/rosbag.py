"""Bags of ROS 1 (.bag) and ROS 2 (a folder of SQLite or MCAP files, or one SQLite file).

Topics are chosen by the types of their messages, or by parameters: sensor_msgs/Imu, NavSatFix, MagneticField and
FluidPressure, by themselves or as fields of other messages, as they are; Odometry, TwistStamped and PoseStamped where a
parameter says what they stand for. Units and axes are those of REP 103: specific force, +g upwards at rest, x forward,
y left, z up of the sensor's housing, which may be mounted otherwise; heights of a NavSatFix are above the ellipsoid,
unless a parameter says that the driver wrote them above mean sea level.

Definitions of messages are read by rosbags. The bags themselves are walked here, one chunk at a time: rosbags refuses
one that was cut short or never indexed, and keeps an object for each message.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.rows import warning
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.storage import store_of
from recon.tables import Streams
from recon_readers import _mcap_channels, _rosbag1
from recon_readers._topics import Intake, TopicParams, writes

METADATA: Final = "metadata.yaml"
SQLITE: Final = b"SQLite format 3\0"
_BAG2: Final = b"rosbag2_bagfile_information"


def read(path: Path, params: TopicParams, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams of the topics of a bag.

    Raises ReadFailed, NothingUsable where no topic is one that recon reads, PluginError where a decoder is missing.
    """
    from recon_readers import _rosbag2  # sqlite3 takes its time

    intake = Intake(path, "reader.rosbag", params, wanted)
    version = 2
    for file in _files(path, intake):
        with file.open("rb") as opened:
            head = opened.read(len(SQLITE))
        if head.startswith(_rosbag1.MAGIC):
            version = 1
            _rosbag1.Bag(file, intake).take_in()
        elif head.startswith(SQLITE):
            _rosbag2.take_in(file, intake)
        else:
            _mcap_channels.take_in(file, intake)
    return intake.streams(format=f"ROS {version} bag")


def _files(path: Path, intake: Intake) -> list[Path]:
    """The files of a bag in their order: x_2 before x_10. Raises ReadFailed where a folder has none to read."""
    if path.name == METADATA:
        path = path.parent
    if path.is_file():
        return [path]
    found = [file for ending in ("db3", "mcap", "bag") for file in path.glob(f"*.{ending}")]
    packed = [file.name for file in sorted(path.glob("*.zstd")) if file.with_suffix("") not in found]
    if not found:
        hint = "unpack its files with 'zstd -d' first" if packed else "check that the bag was copied completely"
        raise ReadFailed(path, "it holds no .db3, .mcap or .bag file", hint=hint)
    if packed:
        intake.learnt.append(warning(f"{', '.join(packed)} is not read: unpack it with 'zstd -d' first"))
    return sorted(found, key=lambda file: [int(part) if part.isdigit() else part for part in _parts(file.name)])


def _parts(name: str) -> list[str]:
    return re.split(r"(\d+)", name)


def sniff(path: Path, head: bytes) -> Sniff:
    """The first words of a file, or the metadata or files of a folder."""
    if path.is_dir():
        about = path / METADATA
        if about.is_file() and _BAG2 in about.read_bytes()[:4096]:
            return Sniff(0.95, "folder of a ROS 2 bag")
        bags = any(path.glob("*.db3")) or (any(path.glob("*.mcap")) and not store_of(path))
        return Sniff(0.6, "folder with .db3 or .mcap files") if bags else Sniff(0.0, "a folder without bags")
    if path.name == METADATA and _BAG2 in head[:4096]:
        return Sniff(0.95, "metadata of a ROS 2 bag: its folder is read")
    if head.startswith(_rosbag1.MAGIC):
        return Sniff(0.95, "ROS 1 bag")
    if not head.startswith(SQLITE):
        return Sniff(0.0, "neither a ROS 1 bag nor SQLite")
    bag = b"messages" in head and b"topics" in head
    return Sniff(0.95, "ROS 2 bag in SQLite") if bag else Sniff(0.0, "SQLite without tables of a ROS 2 bag")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of ROS bags."""
    yield Reader(
        name="rosbag",
        summary="Bags of ROS 1 and ROS 2, by the types of their topics.",
        params=TopicParams,
        run=read,
        sniff=sniff,
        selective=True,
        writes=writes(),
        references=(
            "ROS bag format 2.0, wiki.ros.org/Bags/Format/2.0; ros2/rosbag2",
            "ROS REP 103, REP 145; sensor_msgs, nav_msgs, geometry_msgs",
        ),
    )
