"""Moves a trajectory from the box to another point of the vehicle, as its centre of gravity.

    p' = p + R l,    v' = v + R (omega x l),    a' = a + omega. x l + omega x (omega x l)

with l from the box to the point, in the vehicle, R its attitude, omega its turn rate, whose derivative is taken in
channel frequency class 60 so that noise does not become acceleration. A spin of 3 rad/s that builds up in 50 ms moves
what a box 1 m ahead of the centre of gravity feels by 6 g, so this comes before any number of a crash. The sigmas of
positions grow by what is not known of the lever arm; analyzer.crash reads that from the stream's facts.

References
    Groves (2013), "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2nd ed., sec. 2.5.5.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa

from recon import (
    SAME,
    TRAJECTORY,
    Aligner,
    Array,
    Metric,
    Params,
    Streams,
    has,
    hookimpl,
    matrix,
    metrics,
    quantity,
    replace,
    seconds,
    setting,
    time_ns,
    vector,
    warning,
    with_meta,
)
from recon.numerics.channel_class import channel_class
from recon.numerics.geodesy import Anchor, enu_to_geodetic, geodetic_to_enu
from recon.numerics.rotation import rotate, to_matrix
from recon.numerics.signals import differentiate, median_rate

_CFC = 60
_GAP_S = 0.1


class LeverArmParams(Params):
    """Parameters of aligner.lever_arm."""

    lever_arm: tuple[float, float, float] = quantity(
        (0.0, 0.0, 0.0), "m", doc="From the box to the point: forward, left, up; 0 m each leaves the trajectory."
    )
    sigma: tuple[float, float, float] = quantity((0.1, 0.1, 0.1), "m", doc="How well that is known.")
    point: str = setting("centre of gravity", doc="What the point is called in the trajectory's facts.")


def move(*, trajectory: pa.Table, params: LeverArmParams) -> Streams:
    """The trajectory of the point.

    trajectory : pos m, vel m/s, q; accel m/s^2, gyro rad/s, lat, lon, height and sigmas are moved where it has them
    """
    facts = {"reference_point": params.point, "lever_arm_sigma": list(params.sigma)}
    if not any(params.lever_arm):
        box = with_meta(trajectory, lever_arm_sigma=[0.0, 0.0, 0.0])
        note = "the trajectory is that of the box; give aligner.lever_arm the way from it to the centre of gravity"
        return {"trajectory": box, "metrics": metrics([Metric("lever_arm_length", 0.0, "m", note=note)])}
    lever, q_nv = np.array(params.lever_arm), matrix(trajectory, "q", gaps=True)
    arm_n = rotate(q_nv, np.broadcast_to(lever, (len(q_nv), 3)))
    moved: dict[str, Any] = {"pos": matrix(trajectory, "pos", gaps=True) + arm_n, **_place(trajectory, arm_n)}
    learnt = [Metric("lever_arm_length", float(np.linalg.norm(lever)), "m", float(np.linalg.norm(params.sigma)))]
    if has(trajectory, "gyro"):
        gyro = matrix(trajectory, "gyro", gaps=True)
        swing_v = np.cross(gyro, lever)
        moved["vel"] = matrix(trajectory, "vel", gaps=True) + rotate(q_nv, swing_v)
        if has(trajectory, "accel"):
            rate = _turn_acceleration(trajectory, gyro)
            moved["accel"] = matrix(trajectory, "accel", gaps=True) + np.cross(rate, lever) + np.cross(gyro, swing_v)
    else:
        learnt.append(warning("the trajectory has no turn rates: its position is moved, not how it moves"))
    if has(trajectory, "pos_std"):
        spread = to_matrix(q_nv) ** 2 @ np.square(params.sigma)
        moved["pos_std"] = np.sqrt(matrix(trajectory, "pos_std", gaps=True) ** 2 + spread)
    return {"trajectory": with_meta(replace(trajectory, **moved), **facts), "metrics": metrics(learnt)}


def _turn_acceleration(trajectory: pa.Table, gyro: Array) -> Array:
    """Derivative of the turn rate: (n, 3) rad/s^2, in pieces between gaps."""
    t_s, rate_hz = seconds(trajectory), median_rate(time_ns(trajectory))
    if len(t_s) < 3:
        return np.zeros_like(gyro)
    cuts = np.flatnonzero(np.diff(t_s) > max(_GAP_S, 3.5 / rate_hz)) + 1
    pieces = zip(np.split(t_s, cuts), np.split(gyro, cuts), strict=True)
    rates = [differentiate(t, channel_class(turn, _CFC, rate_hz)) for t, turn in pieces]
    return np.nan_to_num(np.concatenate(rates))


def _place(trajectory: pa.Table, arm_n: Array) -> dict[str, Array]:
    """Latitude, longitude and height of the point, where the trajectory has them."""
    if not (has(trajectory, "lat") and has(trajectory, "lon") and trajectory.num_rows):
        return {}
    lat, lon = (vector(trajectory, name, gaps=True) for name in ("lat", "lon"))
    known = np.isfinite(lat) & np.isfinite(lon)
    if not known.any():
        return {}
    there = has(trajectory, "height")
    height = vector(trajectory, "height", gaps=True) if there else np.full(len(lat), np.nan)
    origin = Anchor(float(lat[known][0]), float(lon[known][0]), float(np.nan_to_num(height)[known][0]))
    place = geodetic_to_enu(lat, lon, np.nan_to_num(height, nan=origin.height), origin)
    new_lat, new_lon, new_height = enu_to_geodetic(place + arm_n, origin)
    moved = {"height": np.where(np.isfinite(height), new_height, np.nan)} if there else {}
    return {"lat": new_lat, "lon": new_lon, **moved}


@hookimpl
def declare_aligners() -> Iterable[Aligner]:
    """Declare aligner.lever_arm."""
    yield Aligner(
        name="lever_arm",
        summary="Moves a trajectory from the box to another point of the vehicle, as its centre of gravity.",
        params=LeverArmParams,
        reads={
            "trajectory": TRAJECTORY.need("pos", "vel", "q", maybe=["lat", "lon", "height", "accel", "gyro", "pos_std"])
        },
        writes={"trajectory": SAME},
        run=move,
        references=("Groves 2013, section 2.5.5",),
    )
