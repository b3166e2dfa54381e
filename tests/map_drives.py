"""Simulated drives through fuser.map, and how far the trajectory is from the truth."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from recon import Streams, matrix, meta, time_ns, vector
from recon.arithmetic import one_thread
from recon.numerics.geodesy import Anchor, geodetic_to_enu
from recon.numerics.rotation import conjugate, from_euler, multiply, rotate, to_rotvec
from recon.schema import FURTHER_GNSS
from recon_fusers.map import MapParams, fuse_map
from recon_simulators.drive import simulate_drive
from recon_simulators.drive_params import DriveParams

ROUTES = {"city", "country", "mixed", "nonstop", "reverse", "ferry"}
"""Motions that a number of the route tells apart."""
THOROUGH = os.environ.get("RECON_TEST_THOROUGH") == "1"


@dataclass(frozen=True)
class Errors:
    """Of n rows against the truth. turn : (n, 3) rad, axes of the place, of the vehicle; turn_s : of the box."""

    t_s: np.ndarray
    pos: np.ndarray
    vel: np.ndarray
    turn: np.ndarray
    turn_s: np.ndarray
    pos_std: np.ndarray

    def horizontal(self, span: tuple[float, float] | None = None) -> float:
        """Root mean square m, in a span of time in s."""
        some = slice(None) if span is None else (span[0] <= self.t_s) & (self.t_s <= span[1])
        return float(np.sqrt((self.pos[some, :2] ** 2).sum(axis=1).mean()))

    def over_sigma(self, span: tuple[float, float]) -> float:
        """Root mean square of the horizontal errors over their sigmas in a span of time in s."""
        some = (span[0] <= self.t_s) & (self.t_s <= span[1])
        return float(np.sqrt(((self.pos[some, :2] / self.pos_std[some, :2]) ** 2).mean()))

    @property
    def vertical(self) -> float:
        return float(np.sqrt((self.pos[:, 2] ** 2).mean()))

    @property
    def velocity(self) -> float:
        return float(np.sqrt((self.vel**2).sum(axis=1).mean()))

    @property
    def level(self) -> float:
        """Of the box, deg."""
        return float(np.degrees(np.sqrt((self.turn_s[:, :2] ** 2).mean())))

    @property
    def heading(self) -> float:
        """Of the box, deg."""
        return float(np.degrees(np.sqrt((self.turn_s[:, 2] ** 2).mean())))

    @property
    def heading_of_vehicle(self) -> float:
        """Degrees."""
        return float(np.degrees(np.sqrt((self.turn[:, 2] ** 2).mean())))


def drive(motion: str = "mixed", sensors: str = "study_two", seed: int = 0, **params: Any) -> Streams:
    """A drive of ten minutes by default; the route goes with the seed."""
    own = {"route": seed} if motion in ROUTES else {}
    lasts = {} if motion in {"parking", "s_curve", "straight", "circle"} else {"duration": 600.0}
    return simulate_drive(DriveParams(motion=motion, sensors=sensors, seed=seed, **{**own, **lasts, **params}))


def fused(streams: Streams, edit: Callable[[Streams], Streams] | None = None, **params: Any) -> Streams:
    """What fuser.map makes of it. edit : what is done to the streams before."""
    given = edit(streams) if edit else streams
    with one_thread():
        return fuse_map(
            imu=given["imu"],
            gnss=given["gnss"],
            wheel=given.get("wheel"),
            attitude=given.get("attitude"),
            events=given.get("events"),
            **{name: given.get(name) for name in FURTHER_GNSS},
            params=MapParams(**params),
        )


def numbers(streams: Streams) -> dict[str, float]:
    """Metrics by name."""
    return {row["name"]: row["value"] for row in streams["metrics"].to_pylist() if row["name"] != "warning"}


def errors(streams: Streams, found: Streams) -> Errors:
    """The trajectory less the truth at the same times."""
    trajectory, truth = found["trajectory"], streams["reference"]
    at = np.searchsorted(time_ns(truth), time_ns(trajectory))
    assert (time_ns(truth)[at] == time_ns(trajectory)).all()
    anchor = Anchor(**meta(truth)["anchor"])
    q_nv, true_nv = matrix(trajectory, "q"), matrix(truth, "q")[at]
    ours, true = numbers(found), numbers(streams)
    q_vs = np.array([ours[f"mount_q{part}"] for part in "wxyz"])
    true_vs = from_euler(*np.radians([true[f"true_mount_{angle}"] for angle in ("yaw", "pitch", "roll")]))
    turn_s = to_rotvec(multiply(multiply(q_nv, q_vs), conjugate(multiply(true_nv, true_vs))))
    return Errors(
        t_s=(time_ns(trajectory) - time_ns(truth)[0]) * 1e-9,
        pos=_places(trajectory, anchor) - _places(truth, anchor)[at],
        vel=matrix(trajectory, "vel") - matrix(truth, "vel")[at],
        turn=to_rotvec(multiply(q_nv, conjugate(true_nv))),
        turn_s=turn_s,
        pos_std=matrix(trajectory, "pos_std"),
    )


def _places(table: pa.Table, anchor: Anchor) -> np.ndarray:
    """(n, 3) m, seen from the anchor, which makes positions of other anchors comparable; NaN where not known."""
    lat, lon, height = (vector(table, name, gaps=True) for name in ("lat", "lon", "height"))
    level = np.where(np.isfinite(height), height, anchor.height)
    place = geodetic_to_enu(lat, lon, level, anchor)
    place[np.isnan(height), 2] = np.nan
    return place


def speed_error(streams: Streams, found: Streams) -> float:
    """Root mean square error m/s of the velocity in axes of the vehicle, which no heading has a part in."""
    truth, trajectory = streams["reference"], found["trajectory"]
    at = np.searchsorted(time_ns(truth), time_ns(trajectory))
    ours, true = (rotate(conjugate(matrix(t, "q")), matrix(t, "vel")) for t in (trajectory, truth))
    return float(np.sqrt(((ours - true[at]) ** 2).sum(axis=1).mean()))


def without(*columns: str) -> Callable[[Streams], Streams]:
    """An edit: these columns of gnss are not there."""
    return lambda streams: {
        **streams, "gnss": streams["gnss"].drop_columns([c for c in columns if c in streams["gnss"].column_names])
    }  # fmt: skip


def silent(*spans: tuple[float, float]) -> Callable[[Streams], Streams]:
    """An edit: the imu has no rows in these spans of time in s."""

    def edit(streams: Streams) -> Streams:
        imu = streams["imu"]
        t_s = (time_ns(imu) - time_ns(imu)[0]) * 1e-9
        heard = np.ones(len(t_s), dtype=bool)
        for start, stop in spans:
            heard &= (t_s <= start) | (t_s >= stop)
        return {**streams, "imu": imu.filter(pa.array(heard))}

    return edit


def scaled(columns: tuple[str, ...], factor: float, stream: str = "gnss") -> Callable[[Streams], Streams]:
    """An edit: these columns of a stream are multiplied."""

    def edit(streams: Streams) -> Streams:
        table = streams[stream]
        for name in columns:
            at = table.column_names.index(name)
            values = pa.array(vector(table, name, gaps=True) * factor)
            table = table.set_column(at, table.schema.field(at), values)
        return {**streams, stream: table}

    return edit
