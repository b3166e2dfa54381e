"""Logs of u-blox receivers (UBX): GNSS, and the IMU and wheel speed of receivers with dead reckoning.

    gnss    NAV-PVT, else NAV-PVAT, else HNR-PVT, else NAV-POSLLH with NAV-VELNED, the week of NAV-SOL or
            NAV-TIMEGPS and the fix of NAV-SOL or NAV-STATUS; NAV-HPPOSLLH of the same time refines the place
    imu     ESF-MEAS, or ESF-RAW: accelerations in 2^-10 m/s^2, rates in 2^-12 deg/s
    wheel   the speed of ESF-MEAS; ticks of wheels have no length and are left out

Height is above the ellipsoid, course from true north. hAcc becomes the sigma of east and of north, sAcc that of each
velocity. Only rows whose time and fix the receiver calls valid count. Sentences of NMEA among the messages are left to
reader.nmea.

ESF messages carry the receiver's own clock in ms since its start. It is set to UTC by the navigation messages before
them, anew where it starts again, and for each sensor that ESF-MEAS numbers: the least delay seen is taken as none, so
that stamps of imu may be early by what the receiver needs to compute (about 0.1 s; aligner.time_offset finds out).
Accelerometers of some receivers read -g along an axis that points up, as seen on an M8U: which one it is, the log does
not tell, and without `at_rest` the imu is left out.

Payloads are decoded columnar from their layouts, not by a library one at a time.

References: u-blox, F9 HPG 1.32 interface description; u-blox M8 receiver description and protocol specification.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recon.errors import ReadFailed
from recon.hookspecs import hookimpl
from recon.numerics.gnss_time import DAY_NS, GPS_EPOCH_NS, NS, WEEK_NS, gps_to_utc, utc_to_gps
from recon.rows import Metric, metrics, warning
from recon.schema import GNSS, IMU, WHEEL
from recon.stages import Reader, Sniff
from recon.tables import Array, Streams, with_meta
from recon_readers._columns import at_rows
from recon_readers._streams import Source, stream
from recon_readers._time_order import Mask, Times
from recon_readers._time_text import days
from recon_readers._ubx_frames import ESF_MEAS, ESF_RAW, LAYOUTS, Kind, Messages, Places, count_messages, read_messages
from recon_readers._ubx_sensors import UbxParams, imu, measured, wheel

SOLUTIONS: Final = ("NAV-PVT", "NAV-PVAT", "HNR-PVT")
States: TypeAlias = Mapping[str, tuple[Places, NDArray[np.void]]]
"""Places (n,) and fields (n,) of the messages of a name."""
_WEEK_MS: Final = WEEK_NS // 1_000_000
VALID_TIME: Final = 0b11
"""Bits validDate and validTime."""
RESOLVED: Final = 0b100
"""Bit fullyResolved: without it the leap seconds are those that the firmware was made with."""
MOST_LEAP_SECONDS: Final = 10
"""That a firmware can have missed."""
FIXES: Final = np.array([0, 3, 2, 3, 3, 1])
"""u-blox: none, dead reckoning, 2D, 3D, both, time only; as `fix` of the stream."""
_NAMES: Final[dict[Kind, str]] = {
    **{kind: name for name, (kind, _) in LAYOUTS.items()},
    ESF_MEAS: "ESF-MEAS", ESF_RAW: "ESF-RAW", (0x02, 0x15): "RXM-RAWX", (0x02, 0x13): "RXM-SFRBX",
    (0x01, 0x35): "NAV-SAT", (0x01, 0x05): "NAV-ATT", (0x10, 0x10): "ESF-STATUS",
}  # fmt: skip


def read(path: Path, params: UbxParams) -> Streams:
    """The streams gnss, imu and wheel, whichever the file holds. Raises ReadFailed where it holds none of them."""
    found = read_messages(path)
    t_ns, place, gnss, told = _gnss(path, found)
    data, clock = measured(found, t_ns, place, params)
    made = {"gnss": (gnss, told), "imu": imu(path, found, data, params), "wheel": wheel(path, data)}
    streams = {name: table for name, (table, _) in made.items() if table is not None}
    learnt = [*_counted(path, found), *(row for _, rows in made.values() for row in rows)]
    if not streams:
        raise ReadFailed(path, f"it holds no fix, imu or wheel speed: {_about(found)}", hint=_hint(learnt))
    if streams.keys() & {"imu", "wheel"}:
        learnt += clock
    for name, table in streams.items():
        kind, scale = ("absolute", "UTC") if name == "gnss" or data.absolute else ("relative", "boot")
        streams[name] = with_meta(table, format="UBX", time_scale=scale, clock=kind)
    if "gnss" in streams:
        streams["gnss"] = with_meta(streams["gnss"], height_datum="ellipsoid", heading_kind="course_true")
    return {**streams, "metrics": metrics(learnt)}


def sniff(path: Path, head: bytes) -> Sniff:
    """Messages with right checksums."""
    counts = count_messages(head)
    read_kinds = {*(kind for kind, _ in LAYOUTS.values()), ESF_MEAS, ESF_RAW}
    if not counts:
        return Sniff(0.0, "no message of UBX")
    if counts.keys() & read_kinds:
        return Sniff(0.95, f"{counts.total()} messages of UBX")
    return Sniff(0.55, f"{counts.total()} messages of UBX, in its beginning none that is read")


# --- gnss -----------------------------------------------------------------------------------------------------------


def _gnss(path: Path, found: Messages) -> tuple[Times, Places, pa.Table | None, list[Metric]]:
    """Times (n,) and places (n,) of navigation messages that tell UTC; the stream gnss."""
    for name in SOLUTIONS:
        places, rows = found.rows(name)
        if len(rows):
            t_ns, missing, told = _utc(rows)
            source, groups = Source(path, name), _solution(rows, found)
            break
    else:
        places, rows = found.rows("NAV-POSLLH")
        states = {name: found.rows(name) for name in ("NAV-SOL", "NAV-TIMEGPS", "NAV-STATUS")}
        t_ns, missing = _by_week(states, places, rows["tow"])
        source, groups = Source(path, "NAV-POSLLH"), _older(rows, found)
        told = _fixed(groups, states, places, rows["tow"]) if len(rows) else []
    sure = ~missing
    if (sure & (groups.get("fix", sure) > 0)).any():  # without a fix the time may be that of a clock in the receiver
        sure &= groups.get("fix", sure) > 0
    made, learnt = stream(source, GNSS, t_ns, missing, groups) if len(rows) else (None, [])
    return t_ns[sure], places[sure], made, [*told, *learnt]


def _utc(rows: NDArray[np.void]) -> tuple[Times, Mask, list[Metric]]:
    """UTC of messages that carry a date, (n,) ns; which have none, (n,) bool; and what is to be told of it."""
    date, known = days(*(rows[name].astype(np.int64) for name in ("year", "month", "day")))
    second = (rows["hour"].astype(np.int64) * 60 + rows["min"]) * 60 + rows["sec"]
    t_ns = date * DAY_NS + second * NS + rows["nano"]
    missing = ~known | ((rows["valid"] & VALID_TIME) != VALID_TIME) | (np.abs(rows["nano"].astype(np.int64)) > NS)
    unsure = ~missing & ((rows["valid"] & RESOLVED) == 0)
    if not unsure.any():
        return t_ns, missing, []
    gps_ns = utc_to_gps(t_ns[unsure]) - GPS_EPOCH_NS
    late_ns = (gps_ns - rows["tow"][unsure].astype(np.int64) * 1_000_000 + WEEK_NS // 2) % WEEK_NS - WEEK_NS // 2
    late_s = np.round(late_ns * 1e-9).astype(np.int64)
    wrong = np.abs(late_s) <= MOST_LEAP_SECONDS
    t_ns[unsure] -= np.where(wrong, late_s, 0) * NS
    note = f"rows of {len(rows)} before the receiver was sure of the leap seconds, which go by the time of week"
    return t_ns, missing, [Metric("leap_seconds_set", float(np.count_nonzero(late_s[wrong])), note=note)]


def _solution(rows: NDArray[np.void], found: Messages) -> dict[str, Array]:
    """Columns of NAV-PVT, NAV-PVAT or HNR-PVT."""
    ok = (rows["flags"] & 1).astype(bool)
    groups = {**_place(rows), "speed": rows["speed"] * 1e-3, "course": np.radians(rows["course"] * 1e-5)}
    if "vel_n" in (rows.dtype.names or ()):
        groups |= {"vel_e": rows["vel_e"] * 1e-3, "vel_n": rows["vel_n"] * 1e-3, "vel_u": rows["vel_d"] * -1e-3}
        groups |= dict.fromkeys(("vel_std_e", "vel_std_n", "vel_std_u"), rows["s_acc"] * 1e-3)
    _refined(groups, rows["tow"], found)
    columns = groups if ok.all() else {name: np.where(ok, values, np.nan) for name, values in groups.items()}
    columns["fix"] = np.where(ok, FIXES[np.minimum(rows["fix"], 5)], 0).astype(np.float64)
    if "sats" in (rows.dtype.names or ()):
        columns["satellites"] = rows["sats"].astype(np.float64)
    return columns


def _place(rows: NDArray[np.void]) -> dict[str, Array]:
    return {
        "lat": rows["lat"] * 1e-7,
        "lon": rows["lon"] * 1e-7,
        "height": rows["height"] * 1e-3,
        **dict.fromkeys(("pos_std_e", "pos_std_n"), rows["h_acc"] * 1e-3),
        "pos_std_u": rows["v_acc"] * 1e-3,
    }


def _refined(groups: dict[str, Array], tow: NDArray[np.uint32], found: Messages) -> None:
    """Places with the digits of NAV-HPPOSLLH of the same time of week."""
    _, fine = found.rows("NAV-HPPOSLLH")
    fine = fine[(fine["flags"] & 1) == 0]
    if not len(fine) or len(np.unique(tow)) < len(tow):
        return
    _, own, others = np.intersect1d(tow, fine["tow"], return_indices=True)
    for name, unit, digits in (("lat", 1e-7, 1e-9), ("lon", 1e-7, 1e-9), ("height", 1e-3, 1e-4)):
        groups[name][own] = fine[name][others] * unit + fine[f"{name}_hp"][others] * digits
    for name, field in (("pos_std_e", "h_acc"), ("pos_std_n", "h_acc"), ("pos_std_u", "v_acc")):
        groups[name][own] = fine[field][others] * 1e-4


def _older(rows: NDArray[np.void], found: Messages) -> dict[str, Array]:
    """Columns of NAV-POSLLH and of NAV-VELNED of the same time of week."""
    groups = _place(rows)
    _, moving = found.rows("NAV-VELNED")
    _refined(groups, rows["tow"], found)
    own, others = np.intersect1d(rows["tow"], moving["tow"], return_indices=True)[1:]
    own, others = np.sort(own), others[np.argsort(own)]
    if len(own):
        told = {"vel_e": ("vel_e", 1e-2), "vel_n": ("vel_n", 1e-2), "vel_u": ("vel_d", -1e-2), "speed": ("speed", 1e-2)}
        told |= dict.fromkeys(("vel_std_e", "vel_std_n", "vel_std_u"), ("s_acc", 1e-2))
        told["course"] = ("course", np.radians(1e-5))
        for name, (field, unit) in told.items():
            groups[name] = at_rows(moving[field][others] * unit, own, len(rows))
    return groups


def _fixed(groups: dict[str, Array], states: States, places: Places, tow: NDArray[np.uint32]) -> list[Metric]:
    """Leave out what came without a fix, by the NAV-SOL or NAV-STATUS of the same time, else by the last one.

    places, tow : (n,) of NAV-POSLLH
    """
    name = next((name for name in ("NAV-SOL", "NAV-STATUS") if len(states[name][0])), None)
    if name is None:
        note = "neither NAV-SOL nor NAV-STATUS tells whether there was a fix: every NAV-POSLLH is taken as one"
        return [warning(note)]
    at, state = states[name]
    behind = np.searchsorted(at, places).clip(max=len(at) - 1)
    state = state[np.where(state["tow"][behind] == tow, behind, np.maximum(np.searchsorted(at, places) - 1, 0))]
    ok = (state["flags"] & 1).astype(bool)
    for column in list(groups) if not ok.all() else ():
        groups[column] = np.where(ok, groups[column], np.nan)
    groups["fix"] = np.where(ok, FIXES[np.minimum(state["fix"], 5)], 0).astype(np.float64)
    if name == "NAV-SOL":
        groups["satellites"] = state["sats"].astype(np.float64)
    return []


def _by_week(states: States, places: Places, tow: NDArray[np.uint32]) -> tuple[Times, Mask]:
    """UTC of times of week in ms by what NAV-SOL or NAV-TIMEGPS told last, or else first; a new week may have begun."""
    at, week, told = (np.zeros(0, dtype=np.int64) for _ in range(3))
    for name, field, bits in (("NAV-SOL", "flags", 0b1100), ("NAV-TIMEGPS", "valid", 0b11)):
        where, rows = states[name]
        known = (rows[field] & bits) == bits
        at, week = np.concatenate([at, where[known]]), np.concatenate([week, rows["week"][known].astype(np.int64)])
        told = np.concatenate([told, rows["tow"][known].astype(np.int64)])
    if not len(week) or not len(tow):
        return np.zeros(len(tow), dtype=np.int64), np.ones(len(tow), dtype=bool)
    order = np.argsort(at, kind="stable")
    near = order[np.maximum(np.searchsorted(at[order], places, side="right") - 1, 0)]
    own = tow.astype(np.int64)
    begun = np.round((told[near] - own) / _WEEK_MS).astype(np.int64)
    gps_ns = GPS_EPOCH_NS + (week[near] + begun) * WEEK_NS + own * 1_000_000
    return gps_to_utc(gps_ns), tow > _WEEK_MS


# --- what is told ---------------------------------------------------------------------------------------------------


def _about(found: Messages) -> str:
    told = [f"{count} {_name(kind)}" for kind, count in found.counts.most_common()]
    return ", ".join([*told[:6], *(["..."] if len(told) > 6 else [])]) or "no whole message"


def _name(kind: Kind) -> str:
    return _NAMES.get(kind, f"0x{kind[0]:02X}-0x{kind[1]:02X}")


def _counted(path: Path, found: Messages) -> list[Metric]:
    learnt = [Metric("messages", float(found.counts.total()), note=_about(found))]
    if found.damaged:
        learnt.append(Metric("damaged_messages", float(found.damaged), note="wrong checksum or cut off: left out"))
        many = f"{found.damaged} message{'s' * (found.damaged != 1)}"
        learnt.append(warning(f"left out of {path.name}: {many} with a wrong checksum or cut off"))
    return learnt


def _hint(learnt: list[Metric]) -> str:
    said = [row.note for row in learnt if row.name == "warning" and "set reader" in row.note]
    return said[0] if said else "switch NAV-PVT on in the receiver; raw observations need RTKLIB first"


@hookimpl
def declare_readers() -> Iterable[Reader]:
    """The reader of UBX."""
    place = GNSS.only("lat", "lon", "height", "speed", "course", "vel", "pos_std", "vel_std", "fix", "satellites")
    yield Reader(
        name="ubx",
        summary="u-blox logs (UBX): GNSS of NAV messages, imu and wheel speed of ESF messages.",
        params=UbxParams,
        run=read,
        version=3,
        sniff=sniff,
        writes={
            "gnss": place.possible(),
            "imu": IMU.only("accel", "gyro").possible(),
            "wheel": WHEEL.only("speed").possible(),
        },
        references=("u-blox, F9 HPG 1.32 interface description", "u-blox M8 receiver description"),
    )
