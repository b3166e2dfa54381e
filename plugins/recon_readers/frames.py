"""Images and when they were taken: a folder of them, a list of their times, or a video.

    images/1574762400123.jpg, ...           the names tell the times
    cam0/data.csv beside cam0/data/*.png    a list of times, of times and files; the list itself may be named as well
    drive.mp4                               the times of its frames, `pip install 'recon-dynamics[video]'`

`frames` has a row for each, `index` counting from 0: in the order of the list, of the video, or of the times where
names tell them. `recon measure RUN --from '#12'` finds a frame by it. Pixels are not read.

A video says in whole seconds when it began, if it does: iPhones in com.apple.quicktime.creationdate, others in
creation_time, which some phones write when the recording ends. `start` takes the place of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
from pydantic import field_validator

from recon.errors import ReadFailed
from recon.extras import needs
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import NS
from recon.parameters import Params, setting
from recon.problems import shortened
from recon.rows import Metric, metrics, warning
from recon.schema import FRAMES
from recon.stages import Reader, Sniff
from recon.tables import Streams, build, with_meta
from recon.utc import start_ns, zone_ns
from recon_readers._frame_times import Line, Told, is_image, lines_of, told_by

LISTS: Final = (".txt", ".csv")
"""Endings of lists."""
LONGEST_S: Final = 1e8
"""s of a video; three years."""
LONGEST_LIST: Final = 200_000_000
"""Bytes."""
_HINT: Final = "give a list of times and files beside the images, or the list itself"


class FramesParams(Params):
    """What names, lists and videos leave open."""

    unit: Literal["auto", "s", "ms", "us", "ns"] = setting("auto", doc="Unit of numbers; auto: by their size.")
    zone: str = setting("+00:00", pattern=r"^[+-]\d\d:\d\d$", doc="Zone of dates that name none, such as +01:00.")
    start: str = setting("", doc="Zero of times that are not since 1970, ISO 8601; of a video, when it began.")

    @field_validator("start")
    @classmethod
    def _is_a_time(cls, value: str) -> str:
        if value:
            start_ns(value)
        return value

    @field_validator("zone")
    @classmethod
    def _is_a_zone(cls, value: str) -> str:
        zone_ns(value)
        return value

    @property
    def zone_ns(self) -> int:
        """Local time minus UTC in ns."""
        return zone_ns(self.zone)

    @property
    def start_ns(self) -> int | None:
        """The zero as ns since 1970 UTC, None where it is not given."""
        return start_ns(self.start, self.zone_ns) if self.start else None


class _Frames(NamedTuple):
    """Time, index and file of each, and what is to be told."""

    told: Sequence[Told]
    numbers: Sequence[int]
    files: Sequence[str | None]
    learnt: list[Metric]


def read(path: Path, params: FramesParams) -> Streams:
    """The stream frames. Raises ReadFailed where no time is told, PluginError where a package is missing."""
    if path.is_dir():
        found = _folder(path, params)
    elif path.suffix.lower() in LISTS:
        found = _listed(path, params)
    else:
        found = _video(path, params)
    absolute = found.told[0].absolute
    learnt = list(found.learnt)
    zero_ns = 0 if absolute else params.start_ns
    if zero_ns is None:
        learnt.append(warning(f"{path.name} does not tell when it began: give reader.frames.start to join it to a log"))
    if absolute and not all(told.zone for told in found.told):
        learnt.append(warning(f"{path.name}: dates are taken as of the zone {params.zone}, they name none"))
    t_ns = np.array([told.t_ns for told in found.told], dtype=np.int64) + (zero_ns or 0)
    rows = np.unique(t_ns, return_index=True)[1]
    learnt.append(Metric("frames", float(len(rows)), note=f"of {len(t_ns)}: a time that repeats is taken once"))
    table = build(
        FRAMES,
        time=t_ns[rows],
        index=np.array(found.numbers, dtype=np.int64)[rows],
        file=pa.array([found.files[row] for row in rows.tolist()], pa.string()),
    )
    clock, scale = ("relative", None) if zero_ns is None else ("absolute", "UTC")
    return {"frames": with_meta(table, time_scale=scale, clock=clock), "metrics": metrics(learnt)}


def _folder(path: Path, params: FramesParams) -> _Frames:
    """Images by a list in the folder, else by their names."""
    images = _images(path)
    if not images:
        raise ReadFailed(path, "it holds no image", hint="name the folder of the images, a list or a video")
    told = [told_by(Path(image).stem, params.unit, params.zone_ns) for image in images]
    known = [one for one in told if one is not None]
    if len(known) == len(images):
        order = sorted(range(len(images)), key=lambda row: known[row].t_ns)
        return _Frames([known[row] for row in order], range(len(order)), [images[row] for row in order], [])
    lists = sorted(part for part in path.iterdir() if part.suffix.lower() in LISTS and _is_list(part))
    if not lists:
        which = images[told.index(None)]
        what = f"the name of {shortened(which)} tells no time, and no list does"
        raise ReadFailed(path, what, hint=_HINT)
    found = _listed(lists[0], params)
    if all(file is None for file in found.files) and len(found.files) == len(images):
        return found._replace(files=images)
    return found


def _images(path: Path) -> list[str]:
    """Images in a folder, else in the folders in it, in the order of their names, relative to it."""
    for pattern in ("*", "*/*"):
        found = sorted(part.relative_to(path).as_posix() for part in path.glob(pattern) if is_image(part.name))
        if found:
            return found
    return []


def _is_list(path: Path) -> bool:
    with path.open("rb") as file:
        return sniff(path, file.read(65_536)).confidence > 0.0


def _listed(path: Path, params: FramesParams) -> _Frames:
    """A list of times, or of times and files."""
    if path.stat().st_size > LONGEST_LIST:
        raise ReadFailed(path, "it is too long for a list of images", hint="is it the right file?")
    texts = path.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = lines_of(texts, params.unit, params.zone_ns)
    kept = [line for _, line in lines if line is not None]
    wrong = [number for number, line in lines if line is None]
    if len(wrong) >= len(kept):
        line = wrong[0] if wrong else None
        raise ReadFailed(path, "it lists no times of images", line=line, hint="write a time and a file on each line")
    learnt = (
        [Metric("lines_left_out", float(len(wrong)), note=f"without a time as the others, first line {wrong[0]}")]
        if wrong
        else []
    )
    return _Frames([line.told for line in kept], range(len(kept)), [line.file or None for line in kept], learnt)


def _video(path: Path, params: FramesParams) -> _Frames:
    """The times at which the frames of a video are shown."""
    with needs("reader.frames", "av for videos", extra="video"):
        import av
    wrong = ""
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            if not container.streams.video:
                raise ReadFailed(path, "it holds no video", hint="is it the right file?")
            video, facts = container.streams.video[0], dict(container.metadata)
            shown = sorted(packet.pts for packet in container.demux(video) if packet.pts is not None)
            step = video.time_base
    except av.FFmpegError as error:
        # FFmpeg takes a size that no file has for a lack of memory
        wrong = "its sizes are damaged" if isinstance(error, MemoryError) else error.strerror or "it is damaged"
    if wrong:
        raise ReadFailed(path, f"it is no video that can be read: {wrong}", hint="copy it again")
    if not shown or step is None:
        raise ReadFailed(path, "its video has no frame with a time", hint="is it the right file?")
    since = [int((pts - shown[0]) * step * 1_000_000_000) for pts in shown]
    if since[-1] > LONGEST_S * NS:
        raise ReadFailed(path, f"its frames are {since[-1] / NS:.3g} s apart", hint="it is damaged: copy it again")
    began, learnt = params.start_ns, []
    if began is None:
        stated = next((facts[key] for key in ("com.apple.quicktime.creationdate", "creation_time") if key in facts), "")
        began = _stated_ns(stated)
        if began is not None:
            note = f"{path.name} says that it began at {stated}, to the second; some phones write when it ended"
            learnt.append(warning(note))
    told = [Told(t_ns + (began or 0), began is not None, True) for t_ns in since]
    return _Frames(told, range(len(since)), [path.name] * len(since), learnt)


def _stated_ns(text: str) -> int | None:
    """When a video says that it began, None where it says nothing or what is no time."""
    try:
        return start_ns(text)
    except ValueError:
        return None


def sniff(path: Path, head: bytes) -> Sniff:
    """A folder of images, a list that names images, or a video."""
    if path.is_dir():
        count = len(_images(path))
        return Sniff(0.5, f"folder of {count} images") if count else Sniff(0.0, "no folder of images")
    if head[4:8] == b"ftyp" or head.startswith(b"\x1a\x45\xdf\xa3") or (head[:4] == b"RIFF" and head[8:12] == b"AVI "):
        return Sniff(0.5, "video")
    if path.suffix.lower() not in LISTS:
        return Sniff(0.0, "neither images nor a list of them nor a video")
    texts = head.decode("utf-8", errors="replace").splitlines()
    lines: list[Line | None] = [line for _, line in lines_of(texts[:100], "auto", 0)]
    named = sum(line is not None and bool(line.file) for line in lines)
    if lines and named >= 0.9 * len(lines):
        return Sniff(0.9, "list of images and their times")
    return Sniff(0.0, "no list of images")


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of images and videos."""
    yield Reader(
        name="frames",
        summary="When images were taken: a folder of them, a list of their times, or a video.",
        params=FramesParams,
        run=read,
        version=2,
        sniff=sniff,
        writes={"frames": FRAMES},
    )
