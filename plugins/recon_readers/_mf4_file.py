"""Channels of an MDF file, read by asammdf in a process of its own.

At some damaged bytes the compiled code of asammdf takes its interpreter along. Here that becomes a ReadFailed.
The process is given folders with `job.json`, and leaves there `about.json`, and times and channels in NumPy's format,
which executes nothing when it is read (allow_pickle is off). Times that several channels share are written once, and a
channel is loaded when it is asked for. The process stays for the next file: asammdf takes 1.3 s to be imported.
"""

from __future__ import annotations

import atexit
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.util import find_spec
from io import BufferedRandom, BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np

from recon.errors import ReadFailed
from recon.extras import missing
from recon.problems import did_you_mean
from recon.tables import Array
from recon_readers._columns import kept
from recon_readers._time_order import Times

NS: Final = 1_000_000_000
LONGEST_S: Final = 60.0
"""For any file; and a second more for each of these:"""
BYTES_PER_S: Final = 2e6
_LATEST_NS: Final = 4_200_000_000 * NS
_HOUR_NS: Final = 3_600 * NS
_LOCAL, _OFFSET_VALID = 1, 2
"""Flags of the start time of MDF 4: it is local time; its zone is told."""
_TIME: Final = 1
"""Kind of master channel of MDF 4; others are angles, distances and numbers of rows. MDF 3 knows only time."""
_COPY: Final = "check that it is whole: copy it again, or repair it"
_idle: list[subprocess.Popen[bytes]] = []
"""Processes that wait for a file."""
_JOB, _ABOUT, _CHANNELS, _TIMES = "job.json", "about.json", "channel-{}.npy", "times-{}.npy"
_COMPLETED: Final = "completed.mf4"


@dataclass(frozen=True)
class Signal:
    """A channel: (n,) ns after the start, (n,) numbers, what the file calls it, and its unit, "" where none."""

    t_ns: Times
    values: Array
    label: str
    unit: str


@dataclass(frozen=True)
class Measurement:
    """What a file tells, and the channels that were asked for.

    start_ns : ns since 1970, UTC; local : it is local time of a zone that the file does not tell
    closed : the recorder finished the file
    groups : of each its number of rows and the names and units of its channels
    """

    start_ns: int
    local: bool
    closed: bool
    groups: Sequence[tuple[int, Sequence[tuple[str, str]]]]
    _folder: Path
    _channels: Mapping[str, tuple[str, str, str, str]]
    _times: dict[str, Times] = field(default_factory=dict)

    def signal(self, reference: str) -> Signal:
        """A channel that was asked for. Channels of one raster share their times."""
        label, unit, times, values = self._channels[reference]
        if times not in self._times:
            self._times[times] = np.load(self._folder / times, allow_pickle=False)
        return Signal(self._times[times], np.load(self._folder / values, allow_pickle=False), label, unit)


@contextmanager
def measurement(path: Path, references: Sequence[str]) -> Iterator[Measurement]:
    """Read a file and the channels of these names, "AccX@3" for one of group 3.

    Raises ReadFailed, PluginError where asammdf is not installed.
    """
    if find_spec("asammdf") is None:
        raise missing("reader.mf4", "asammdf", "mf4")
    try:
        longest = LONGEST_S + path.stat().st_size / BYTES_PER_S
    except OSError as error:
        raise ReadFailed(path, f"it cannot be read: {error.strerror}", hint="check the name") from error
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        job = {"path": str(path.resolve()), "references": list(references)}
        (folder / _JOB).write_text(json.dumps(job), encoding="utf-8", newline="\n")
        _run(path, folder, longest)
        about = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
        if "refused" in about:
            raise ReadFailed(path, about["refused"], hint=about["hint"])
        channels = about.pop("channels")
        yield Measurement(**about, _folder=folder, _channels=channels)


def _run(path: Path, folder: Path, longest: float) -> None:
    """Let a process write what it finds into the folder. Raises ReadFailed where it does not."""
    process, used = (_idle.pop(), True) if _idle else (_started(), False)
    ended = _ended_in(process, folder, longest)
    if ended == "broken" and used:  # perhaps by what it read before
        _end(process)
        process = _started()
        ended = _ended_in(process, folder, longest)
    if ended == "done":
        _idle.append(process)
        return
    _end(process)
    if ended == "late":
        raise ReadFailed(path, f"asammdf did not come to an end in {longest:.0f} s", hint=_COPY)
    raise ReadFailed(path, "asammdf broke down at it, so it is damaged", hint=_COPY)


def _started() -> subprocess.Popen[bytes]:
    paths = os.pathsep.join(part for part in sys.path if part)
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "recon_readers._mf4_file"], env={**os.environ, "PYTHONPATH": paths},
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def _ended_in(process: subprocess.Popen[bytes], folder: Path, longest: float) -> str:
    """Give a process a folder to work in: is it "done", "late" or "broken"?"""
    assert process.stdin is not None
    assert process.stdout is not None
    late = threading.Event()

    def stop() -> None:
        late.set()
        process.kill()

    clock = threading.Timer(longest, stop)
    clock.start()
    try:
        process.stdin.write(json.dumps(str(folder)).encode() + b"\n")
        process.stdin.flush()
        answer = process.stdout.readline()
    except OSError:
        answer = b""
    finally:
        clock.cancel()
    return "late" if late.is_set() else "done" if answer else "broken"


@atexit.register
def _end_all() -> None:
    while _idle:
        _end(_idle.pop())


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.communicate()


# --- in the process -------------------------------------------------------------------------------------------------


class _Refused(Exception):
    """What is wrong, and what to do."""


def _serve() -> None:
    """Do the jobs whose folders come in, line by line. Only the answers go out, whatever asammdf prints."""
    with os.fdopen(os.dup(1), "wb", buffering=0) as answers:
        os.dup2(2, 1)
        for line in sys.stdin.buffer:
            folder = Path(json.loads(line))
            (folder / _ABOUT).write_text(json.dumps(_found(folder)), encoding="utf-8", newline="\n")
            answers.write(b"done\n")


def _found(folder: Path) -> dict[str, Any]:
    job = json.loads((folder / _JOB).read_text(encoding="utf-8"))
    from asammdf import MDF

    try:
        with _opened(Path(job["path"]), folder) as opened, MDF(opened) as file:
            about = {**_about(file), "closed": opened.mode == "rb"}
            rasters: dict[int, tuple[Times, str]] = {}
            channels = {ref: _channel(file, ref, folder, n, rasters) for n, ref in enumerate(job["references"])}
            return {**about, "channels": channels}
    except _Refused as error:
        return {"refused": error.args[0], "hint": error.args[1]}
    except BaseException as error:  # it raises what it likes at damaged bytes
        return {"refused": f"asammdf cannot read it ({type(error).__name__})", "hint": _COPY}


def _opened(path: Path, folder: Path) -> BufferedReader | BufferedRandom:
    """The file, or a copy in which asammdf completes what a recorder left open when it lost its power."""
    with path.open("rb") as file:
        head = file.read(64)
    if head[8:9] < b"4" or not any(head[60:62]):
        return path.open("rb")
    shutil.copyfile(path, folder / _COMPLETED)
    return (folder / _COMPLETED).open("r+b")


def _about(file: Any) -> dict[str, Any]:
    start_ns, local = _start(file)
    if abs(start_ns) > _LATEST_NS:
        raise _Refused("it begins at a time that no clock shows", _COPY)
    groups = [
        (int(group.channel_group.cycles_nr), [(c.name, getattr(c, "unit", "") or "-") for c in group.channels])
        for group in file.groups
    ]
    return {"start_ns": start_ns, "local": local, "groups": groups}


def _start(file: Any) -> tuple[int, bool]:
    """Start of the measurement, ns since 1970, and whether it is local time of a zone that the file does not tell.

    MDF 4 counts in UTC or says that it does not. MDF 3 counts in local time, from 3.20 on in ns and with its hours
    before UTC, where 0 is also what stands there when nobody set it. asammdf writes UTC in place of the local time.
    """
    header = file.header
    if hasattr(header, "time_flags"):
        return int(header.abs_time), bool(header.time_flags & _LOCAL and not header.time_flags & _OFFSET_VALID)
    clock_ns = _clock_ns(header)
    local_ns, hours = (int(getattr(header, name, 0)) for name in ("abs_time", "tz_offset"))
    if not local_ns or not hours:
        return local_ns or clock_ns, True
    ahead = int((clock_ns - local_ns // NS * NS) / _HOUR_NS)
    is_utc = ahead == hours and file.identification.program_identification.startswith(b"amdf")
    return (local_ns if is_utc else local_ns - hours * _HOUR_NS), False


def _clock_ns(header: Any) -> int:
    """Date and time of day of an MDF 3 file as if they were UTC, ns since 1970; 0 where they are none."""
    try:
        text = f"{header.date.decode()} {header.time.decode()}".replace("\0", "").strip()
        moment = datetime.strptime(text, "%d:%m:%Y %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        return 0
    return int(moment.timestamp()) * NS


def _channel(
    file: Any, reference: str, folder: Path, index: int, rasters: dict[int, tuple[Times, str]]
) -> tuple[str, str, str, str]:
    """Write a channel; what the file says of it, its unit, and the names of its times and values.

    rasters : times that were written, and their names, by group
    """
    name, _, number = reference.rpartition("@") if re.search(r"@\d+$", reference) else (reference, "", "")
    places = [place for place in file.whereis(name) if not number or place[0] == int(number)]
    if not places:
        known = [channel.name for group in file.groups for channel in group.channels]
        hint = did_you_mean(name, known) or "without a mapping the channels are listed"
        raise _Refused(f"it has no channel '{reference}'", hint)
    if len({group for group, _ in places}) > 1:
        groups = ", ".join(f"'{name}@{group}'" for group, _ in places)
        raise _Refused(f"several groups have a channel '{name}'", f"write one of {groups}")
    group = places[0][0]
    _refuse_untimed(file, group)
    signal = file.get(group=group, index=places[0][1])
    if signal.samples.dtype.kind not in "iufb" or signal.samples.ndim != 1:
        raise _Refused(f"the channel '{reference}' holds no single numbers", "choose another channel")
    seconds = np.asarray(signal.timestamps, dtype=np.float64)
    sane = np.isfinite(seconds) & (np.abs(seconds) < 1e8)
    values = _CHANNELS.format(index)
    np.save(folder / values, kept(signal.samples.astype(np.float64), sane), allow_pickle=False)
    t_ns = np.round(kept(seconds, sane) * NS).astype(np.int64)
    if group not in rasters or not np.array_equal(t_ns, rasters[group][0]):  # samples may be invalid in one channel
        rasters[group] = t_ns, _TIMES.format(index)
        np.save(folder / rasters[group][1], t_ns, allow_pickle=False)
    unit = signal.unit or ""
    return f"{name} [{unit or '-'}] of group {group}", unit, rasters[group][1], values


def _refuse_untimed(file: Any, group: int) -> None:
    """Where a group's rows have no times, asammdf gives their numbers, or the distance or angle at which they were."""
    home = getattr(file.groups[group].channel_group, "cg_master_index", None)
    home = group if home is None else home
    index = file.masters_db.get(home)
    if index is not None and getattr(file.groups[home].channels[index], "sync_type", _TIME) == _TIME:
        return
    instead = f": its rows count by '{file.groups[home].channels[index].name}'" if index is not None else ""
    raise _Refused(f"group {group} has no channel of time{instead}", "choose a channel of another group")


if __name__ == "__main__":
    _serve()
