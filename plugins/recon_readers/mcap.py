"""MCAP files: recordings that recon keeps, and logs of ROS 1, ROS 2 and Foxglove.

A recording that recon keeps is the file itself, or a run's folder with `streams.mcap`; `recon.storage.mcap` describes
its layout, and all streams come as they were kept. In a log of another program topics are chosen by the types of their
messages, or by parameters: sensor_msgs/Imu, NavSatFix, MagneticField and FluidPressure, by themselves or as fields of
other messages, and foxglove.LocationFix as they are; Odometry, TwistStamped, PoseStamped, PoseInFrame and
FrameTransform where a parameter says what they stand for.

Of a file that is cut short, never closed or damaged everything whole is read, and a warning counts what is lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from recon.hookspecs import hookimpl
from recon.rows import metrics, warning
from recon.schema import STREAMS
from recon.stages import EVERYTHING, Reader, Sniff, Wanted
from recon.storage import salvage_recording, store_of
from recon.storage.mcap import MAGIC, is_own
from recon.tables import Streams, append
from recon_readers._mcap_channels import take_in
from recon_readers._topics import Intake, TopicParams


def read(path: Path, params: TopicParams, wanted: Wanted = EVERYTHING) -> Streams:
    """The streams of a recording of recon, or of the topics of another program's log.

    Raises ReadFailed, NothingUsable where no topic is one that recon reads, PluginError where a decoder is missing.
    """
    return salvaged(path) if path.is_dir() or _is_own_file(path) else _logged(path, params, wanted)


def salvaged(path: Path) -> Streams:
    """The streams of a recording that recon keeps at `path`. Raises ReadFailed where nothing in it is whole."""
    recording, loss = salvage_recording(path)
    streams = dict(recording)
    if loss:
        told, kept = metrics([warning(loss)]), streams.get("metrics")
        streams["metrics"] = told if kept is None else append(told, kept)
    return streams


def _logged(path: Path, params: TopicParams, wanted: Wanted) -> Streams:
    intake = Intake(path, "reader.mcap", params, wanted)
    take_in(path, intake)
    return intake.streams(format="MCAP")


def _is_own_file(path: Path) -> bool:
    """Is it a file of recon, or too damaged to tell?"""
    with path.open("rb") as file:
        head = file.read(64)
    return is_own(head) or not head.startswith(MAGIC + b"\x01")


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder with `streams.mcap`, or an MCAP file."""
    if path.is_dir():
        own = store_of(path) == "mcap"
        return Sniff(1.0, "folder with streams as MCAP") if own else Sniff(0.0, "a folder without streams")
    if is_own(head):
        return Sniff(1.0, "MCAP file of profile recon")
    return Sniff(0.9, "MCAP file") if head.startswith(MAGIC) else Sniff(0.0, "another magic number")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of MCAP files."""
    yield Reader(
        name="mcap",
        summary="Recordings kept by recon as MCAP; MCAP logs of ROS 1, ROS 2 and Foxglove.",
        params=TopicParams,
        run=read,
        sniff=sniff,
        self_describing=True,
        selective=True,
        writes={name: schema.open_ended() for name, schema in STREAMS.items()},
        references=(
            "MCAP specification, mcap.dev/spec",
            "ROS REP 103, REP 145; sensor_msgs, nav_msgs, geometry_msgs",
            "Foxglove message schemas, docs.foxglove.dev",
        ),
    )
