"""The folder of a comma2k19 segment: where it is, its arrays, its clock.

Each array is a NumPy file; nothing is unpickled. `comma2k19.py` says what the arrays hold.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from recon.errors import ReadFailed
from recon.rows import Metric, warning
from recon.tables import Array
from recon_readers._arrays import LONGEST_S, in_time, left_out
from recon_readers._limits import refuse_beyond
from recon_readers._time_order import Times

LOG: Final = "processed_log"
POSE: Final = "global_pose"
KINDS: Final = ("IMU", "GNSS", "CAN")
RECEIVERS: Final = {"gnss": "live_gnss_ublox", "gnss_2": "live_gnss_qcom"}
"""By stream the folder of the receiver."""
GPS_EPOCH_S: Final = 315_964_800
"""1980-01-06 in s since 1970."""
YEAR_2100_S: Final = 4_102_444_800
LEAP_SECONDS: Final = 18
"""GPS minus UTC in s since 2017; all of the data set is later."""
WEEK_S: Final = 604_800


@dataclass(frozen=True)
class Segment:
    """A segment: its folder, UTC minus boot time in ns, the facts of its clock."""

    folder: Path
    zero_ns: int
    facts: Mapping[str, str]


@dataclass(frozen=True)
class Sensor:
    """What a sensor logged: path of its values, times (n,) ns that rise, values (n, k), what was left out."""

    path: Path
    t_ns: Times
    values: Array
    learnt: list[Metric]


def segments(path: Path) -> list[Path]:
    """The folder itself where it is a segment, else those in it that are."""
    if _is_segment(path):
        return [path]
    return sorted(part for part in path.iterdir() if part.is_dir() and _is_segment(part))


def _is_segment(path: Path) -> bool:
    return any((path / LOG / kind).is_dir() for kind in KINDS)


def only_segment(path: Path) -> Path:
    """The one segment at a path. Raises ReadFailed where there is none, or several."""
    found = segments(path) if path.is_dir() else []
    if not found:
        hint = f"name the folder that holds {LOG}/IMU, {LOG}/GNSS or {LOG}/CAN"
        raise ReadFailed(path, "this is no segment of comma2k19", hint=hint)
    if len(found) > 1:
        names = ", ".join(part.name for part in found[:3])
        raise ReadFailed(path, f"it holds {len(found)} segments: {names}", hint="name the folder of one of them")
    return found[0]


# --- arrays ---------------------------------------------------------------------------------------------------------


def array(path: Path, width: int, rows: int | None = None) -> Array:
    """A NumPy file as (n, width). Raises ReadFailed where it is damaged or of another shape than `rows` by width."""
    try:
        with path.open("rb") as file:
            values = np.lib.format.read_array(file, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # NumPy's parser of headers raises whatever damaged bytes lead to
        what = "it is no whole NumPy array of numbers"
        raise ReadFailed(path, what, hint="copy the file again; arrays of objects are not read") from error
    if values.dtype.kind not in "fiu" or values.ndim not in (1, 2) or values.size != len(values) * width:
        what = f"it is an array of {values.dtype}, shape {values.shape}; numbers of shape (n, {width}) are needed"
        raise ReadFailed(path, what, hint="check that it is the array of that sensor")
    if rows is not None and len(values) != rows:
        raise ReadFailed(path, f"it has {len(values)} rows where its times are {rows}", hint="copy both files again")
    return np.asarray(values.reshape(len(values), width), dtype=np.float64)


def _logged(folder: Path, name: str, width: int) -> tuple[Path, Array, Array] | None:
    """The path of a sensor's values, times (n,) s since boot and values (n, width); None where both are absent."""
    times, values = (folder / LOG / name / part for part in ("t", "value"))
    if not times.exists() and not values.exists():
        return None
    refuse_absent(times, values)
    t_s = array(times, 1)[:, 0]
    return values, t_s, array(values, width, len(t_s))


def sensor(segment: Segment, name: str, width: int) -> Sensor | None:
    """A sensor's rows in order of time, by the name of its folder; None where it is absent. Raises ReadFailed."""
    logged = _logged(segment.folder, name, width)
    return None if logged is None else ordered(segment, name, *logged)


def refuse_absent(*files: Path) -> None:
    """Raises ReadFailed at the first file of several that belong together that is not there."""
    for path in files:
        if not path.is_file():
            raise ReadFailed(path, "the file is not there", hint="copy the segment completely")


def ordered(segment: Segment, name: str, path: Path, t_s: Array, values: Array) -> Sensor:
    """The rows among which time rises.

    t_s : (n,) s since boot; values : (n, k)
    """
    t_ns, rows = in_time(t_s, segment.zero_ns)
    return Sensor(path, t_ns[rows], values[rows], left_out(rows, name))


# --- the clock ------------------------------------------------------------------------------------------------------


def with_clock(folder: Path) -> tuple[Segment, list[Metric]]:
    """The segment with UTC minus boot time, and from what it is known."""
    for offset_s, source in _offsets(folder):
        if offset_s is not None:
            segment = Segment(folder, round(offset_s * 1e6) * 1000, {"time_scale": "UTC", "clock": "absolute"})
            return segment, [Metric("clock_offset", offset_s, "s", note=f"UTC minus boot time, by the {source}")]
    text = "nothing in the segment tells UTC: times count from the boot of the phone"
    return Segment(folder, 0, {"clock": "relative", "time_scale": "boot"}), [warning(text)]


def _offsets(folder: Path) -> Iterator[tuple[float | None, str]]:
    """UTC minus boot time in s by each source, None where it does not tell, the best source first."""
    boot, gps = (folder / POSE / name for name in ("frame_times", "frame_gps_times"))
    if boot.is_file() and gps.is_file():
        boot_s = array(boot, 1)[:, 0]
        week, s_of_week = array(gps, 2, len(boot_s)).T
        refuse_beyond(gps, "GPS week", week, 0.0, 1e4)
        refuse_beyond(gps, "time of week", s_of_week, 0.0, WEEK_S)
        utc_s = week * WEEK_S + s_of_week + (GPS_EPOCH_S - LEAP_SECONDS)
        yield _median_offset(utc_s, boot_s), "GPS times of the frames"
    for name in RECEIVERS.values():
        logged = _logged(folder, f"GNSS/{name}", 6)
        if logged is not None:
            _, boot_s, values = logged
            yield _median_offset(values[:, 3] / 1e3, boot_s), f"UTC of {name}, late by what its rows took to arrive"


def _median_offset(utc_s: Array, boot_s: Array) -> float | None:
    """Median of UTC minus boot time, s, where both are those of clocks that were set; None where none are."""
    believed = (utc_s > GPS_EPOCH_S) & (utc_s < YEAR_2100_S) & (np.abs(boot_s) < LONGEST_S)
    return float(np.median((utc_s - boot_s)[believed])) if believed.any() else None
