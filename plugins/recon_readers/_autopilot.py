"""What logs of autopilots have in common: sensors forward, right, down; an on-board estimate north, east, down."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from recon.errors import NothingUsable
from recon.numerics.geodesy import Anchor, enu_to_geodetic
from recon.numerics.rotation import from_euler, multiply, yaw_from_heading
from recon.rows import Metric, metrics, warning
from recon.schema import BARO, GNSS, IMU, MAG, REFERENCE, STREAMS
from recon.stages import Wanted
from recon.tables import Array, Streams, with_meta
from recon_readers._arrays import interleave, unit_quaternions
from recon_readers._columns import kept
from recon_readers._limits import LIMITS, MOST_FAULTY, possible
from recon_readers._sensing import doubts, turned
from recon_readers._streams import described, valued
from recon_readers._time_order import EARLIEST_NS, Times, rising

GAUSS: Final = 1e-4
"""T."""
GNSS_FACTS: Final = {"height_datum": "mean_sea_level", "heading_kind": "course_true"}
LONGEST_NS: Final = 10**17
"""No autopilot runs for three years; a time of more is damaged."""
RESTARTED_NS: Final = 10_000_000_000
"""By more than this a boot clock falls where the autopilot starts again; messages come late by less."""
_LARGEST_ANGLE: Final = 100.0
"""rad; more is no angle."""
_ENU_NED: Final = np.array((0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0))
"""Quaternion from north, east, down to east, north, up."""
_FRD_FLU: Final = np.array((0.0, 1.0, 0.0, 0.0))
"""Quaternion from forward, left, up to forward, right, down."""

WRITES: Final = {
    "imu": IMU.only("accel", "gyro").possible(),
    "gnss": GNSS.only(
        "lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix", "satellites"
    ).possible(),
    "mag": MAG.possible(),
    "baro": BARO.possible(),
    "reference": REFERENCE.only("pos", "vel", "q", "lat", "lon", "height").possible(),
}
"""What the logs of autopilots become."""


@dataclass
class Log:
    """Streams as they come out of one log.

    offset_ns : UTC minus the log's clock, None where nothing tells it; facts : of all streams
    """

    path: Path
    wanted: Wanted
    facts: Mapping[str, Any]
    offset_ns: int | None = None
    made: dict[str, pa.Table] = field(default_factory=dict)
    learnt: list[Metric] = field(default_factory=list)

    def wants(self, stream: str) -> bool:
        """Does a later step read anything of a stream?"""
        return bool(self.wanted.of(stream, STREAMS[stream].names))

    def add(self, stream: str, source: str, t_ns: Times, columns: MutableMapping[str, Array], **facts: Any) -> None:
        """A stream of a sensor, the next further one where there is one already.

        t_ns : (n,) ns of the log's clock, in any order; columns : (n,) by name, in the units of the stream, NaN where
        unknown; emptied; source : what the log calls it
        """
        sane = (t_ns >= 0) & (t_ns < LONGEST_NS)
        if not sane.all():
            note = f"{source}: of times that its clock cannot show, of {len(t_ns)}"
            self.learnt.append(Metric("rows_left_out", float(np.count_nonzero(~sane)), note=note))
        t_ns = kept(t_ns, sane)
        if len(t_ns) and int(np.diff(t_ns).min(initial=0)) < -RESTARTED_NS:
            text = f"{source}: its clock begins anew in the log, so that rows of several drives are mixed"
            self.learnt.append(warning(f"{text}: were several logs joined? Read each by itself"))
        names = self.wanted.of(stream, columns)
        chosen = valued({name: kept(columns.pop(name), sane) for name in names})
        if not chosen or not len(t_ns):
            return
        rows, told = rising(t_ns, source)
        self.learnt += told
        for name, values in chosen.items():
            chosen[name], told = possible(self.path, stream, name, values[rows], most=MOST_FAULTY)
            self.learnt += told
        number = sum(name.rstrip("_0123456789") == stream for name in self.made) + 1
        key = stream if number == 1 else f"{stream}_{number}"
        t_ns = t_ns[rows] + (self.offset_ns or 0)
        clock = "absolute" if self.offset_ns is not None and len(t_ns) and t_ns[0] >= EARLIEST_NS else "relative"
        own = {name: value for name, value in facts.items() if value is not None}
        scale = "UTC" if clock == "absolute" else "boot"
        table = described(STREAMS[stream], t_ns, chosen)
        self.made[key] = with_meta(table, **self.facts, **own, clock=clock, time_scale=scale, source=source)
        self.learnt.append(Metric("source", float(table.num_rows), method=key, note=source))

    def add_frd(self, stream: str, source: str, t_ns: Times, columns: MutableMapping[str, Array]) -> None:
        """A stream whose vectors are logged along forward, right, down; they are given along forward, left, up."""
        self.add(stream, source, t_ns, turned(columns, "FRD"), axes="FRD")

    def streams(self, held: str) -> Streams:
        """All streams. Raises NothingUsable, with what the log holds, where there is none."""
        if not self.made:
            what = "is read" if all(map(self.wants, WRITES)) else "the steps read"
            raise NothingUsable(self.path, f"it holds nothing that {what}; it holds {held}", hint=_NOTHING)
        if self.offset_ns is None:
            self.learnt.append(warning("nothing in the log tells UTC: times count from the start of the autopilot"))
        return {**self.made, "metrics": metrics([*self.learnt, *doubts(self.made)])}


_NOTHING: Final = "was the logging of sensors switched on, and do the steps read what the log holds?"


def boot_ns(counts: Times, factor: int) -> Times:
    """Counts of a boot clock, of `factor` ns each, as ns, -1 where that cannot be."""
    return np.where((counts >= 0) & (counts < LONGEST_NS // factor), counts * factor, -1)


def account(log: Log, damaged: int, what: str) -> None:
    """Tell of places in the log that are damaged."""
    if damaged:
        where = "in one place" if damaged == 1 else f"in {damaged} places"
        text = f"{log.path.name} is cut short or damaged {where}: every whole message is used"
        log.learnt += [Metric("damaged_places", float(damaged), note=what), warning(text)]


def fixed(columns: dict[str, Array], status: Array, satellites: Array, speed: Array, course: Array) -> dict[str, Array]:
    """Columns of gnss where there is a fix. status : 0, 1 none, 2 two-dimensional, above three-dimensional."""
    lost = status < 2.0
    moving = {"speed": speed, "course": np.mod(course, 2.0 * np.pi)}
    known = {name: np.where(lost, np.nan, values) for name, values in {**columns, **moving}.items()}
    return {**known, "fix": np.clip(np.where(lost, 0.0, status), 0.0, 3.0), "satellites": satellites}


def sigmas_of(horizontal: Array, vertical: Array, speed: Array) -> dict[str, Array]:
    """Columns of a receiver's accuracies."""
    position = {"pos_std_e": horizontal, "pos_std_n": horizontal, "pos_std_u": vertical}
    return {**position, **dict.fromkeys(("vel_std_e", "vel_std_n", "vel_std_u"), speed)}


def positive(values: Array) -> Array:
    """The values, NaN where they are not above zero."""
    return np.where(values > 0.0, values, np.nan)


def attitude_of(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Forward, left, up in east, north, up, from angles of forward, right, down in north, east, down, rad."""
    roll, pitch, yaw = map(angle, (roll, pitch, yaw))
    return np.asarray(from_euler(yaw_from_heading(yaw), -pitch, roll))


def angle(values: Array) -> Array:
    """The values in rad, NaN where one is no angle, as infinity is none."""
    return np.where(np.abs(values) < _LARGEST_ANGLE, values, np.nan)


def attitude(q_ned: Array) -> Array:
    """Attitudes of forward, left, up in east, north, up from those of forward, right, down in north, east, down."""
    return np.asarray(multiply(multiply(_ENU_NED, unit_quaternions(q_ned)), _FRD_FLU))


def pose(
    moved: tuple[Times, Array, Array], turned_q: tuple[Times, Array] | None, anchor: Anchor | None
) -> tuple[Times, dict[str, Array], dict[str, Any]]:
    """Times, columns and facts of a reference: positions and attitudes at their own times.

    moved : times, positions (n, 3) m and velocities (n, 3) m/s, both north, east, down of the anchor; turned_q : times
    and attitudes (n, 4), forward, left, up in east, north, up; anchor : None where it is not known
    """
    t_ns, pos, vel = moved
    pos, vel = pos[:, [1, 0, 2]] * (1.0, 1.0, -1.0), vel[:, [1, 0, 2]] * (1.0, 1.0, -1.0)
    parts: dict[str, tuple[Times, Array]] = {f"pos_{axis}": (t_ns, pos[:, n]) for n, axis in enumerate("enu")}
    parts |= {f"vel_{axis}": (t_ns, vel[:, n]) for n, axis in enumerate("enu")}
    facts: dict[str, Any] = {}
    if anchor is not None:
        place = enu_to_geodetic(np.where(np.abs(pos) < LIMITS["pos"][1], pos, np.nan), anchor)
        parts |= {name: (t_ns, values) for name, values in zip(("lat", "lon", "height"), place, strict=True)}
        facts = {"anchor": asdict(anchor), "earth": "wgs84", "height_datum": "mean_sea_level"}
    if turned_q is not None:
        t_ns, q = turned_q
        parts |= {name: (t_ns, values) for name, values in zip(("qw", "qx", "qy", "qz"), q.T, strict=True)}
    parts = {name: _once(t_ns, values) for name, (t_ns, values) in parts.items()}
    return *interleave(parts), facts


def _once(t_ns: Times, values: Array) -> tuple[Times, Array]:
    """In the order of time, each time once."""
    times, rows = np.unique(t_ns, return_index=True)
    return times, values[rows]
